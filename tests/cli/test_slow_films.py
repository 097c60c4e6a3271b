"""`receive` reports a slow film source once, only on a terminal."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.cli import receive
from heliograph.media import create_film, open_film

SLOW = {"reading_seconds": 9.0, "seconds": 10.0, "frames": 100}


def said(source: Any, report: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> str:
    receive._show_reading_time(source, report)
    shown = capsys.readouterr()
    assert shown.out == ""
    return shown.err


def film(faster: tuple[str, ...]) -> SimpleNamespace:
    return SimpleNamespace(faster=faster, rate_hz=1000.0, path=Path("take/a.mkv"))


def test_a_slow_film_names_the_faster_kinds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert said(film(("HDF5",)), SLOW, capsys) == "", "no terminal"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert said(film(("HDF5", "lossless H.264")), SLOW, capsys) == (
        "reading the film took 9.0 s: HDF5 and lossless H.264 are read faster, see 'heliograph "
        "convert take/a.mkv take/a.h5'\n"
    )
    assert "HDF5 is read faster" in said(film(("HDF5",)), SLOW, capsys)
    assert said(film(()), SLOW, capsys) == "", "none is faster"
    for other in ({"reading_seconds": 4.0}, {"seconds": 20.0}, {"frames": 10_000}):
        assert said(film(("HDF5",)), SLOW | other, capsys) == ""


@pytest.mark.parametrize(("suffix", "options", "faster"), [
    (".mkv", {}, ("HDF5", "lossless H.264")), (".mp4", {"lossless": True}, ("HDF5",)), (".h5", {}, ()),
])  # fmt: skip
def test_each_film_knows_what_is_faster(
    tmp_path: Path, suffix: str, options: dict[str, Any], faster: tuple[str, ...]
) -> None:
    path = tmp_path / f"a{suffix}"
    with create_film(path, width=32, height=16, rate_hz=100.0, **options) as written:
        written.write(Frame(0, 0.0, np.zeros((16, 32), np.uint8)))
    for crop in (None, (0, 0, 16, 16)):
        with open_film(path, crop=crop) as opened:
            assert opened.faster == faster
