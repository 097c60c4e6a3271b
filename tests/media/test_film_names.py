"""Films with any legal file name are written, read, and quoted correctly in errors."""

import os
from pathlib import Path

import numpy as np
import pytest
from film_checks import write_levels
from made_recordings import write_pictures

from heliograph.base.errors import MediaError, SettingsError
from heliograph.media import open_film
from heliograph.media.live.reader import is_camera

NAMES = [
    b"caf\xe9", b"\xff\xfe", b"a\nb\tc", b"\x1b[31mred\x7f", b"-x", b" a b ", b"a#b?c=d&e%20", b"100%d", b"%04d",
    b"it's \"q\" `$HOME`", "\N{GRINNING FACE}\u202eabc سلام".encode(), b"[ab]*{x}", b"camera:played", b"file:x",
    b"a\\b", b"concat:a|b", b"..x.", b"~", b"n" * 251, "試".encode() * 83, b"12:30 a%d",
]  # fmt: skip


FRAME = np.zeros((1, 16, 16), np.uint8)


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name[:20]))
def test_a_film_of_any_name_is_written_and_read(name: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for suffix in (".H5", ".Mkv"):
        film = os.fsdecode(name + suffix.encode())
        write_levels(f"./{film}", FRAME)
        assert [path.name for path in tmp_path.iterdir()] == [film]
        for given in (f"./{film}", tmp_path / film, film):
            with open_film(given) as source:
                assert sum(1 for _ in source) == 1
        Path(film).unlink()


def test_an_error_states_a_long_name_in_full(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"cannot write .*/n{253}\.h5: File name too long; choose a name"):
        write_levels(tmp_path / ("n" * 253 + ".h5"), FRAME)
    with pytest.raises(MediaError, match=r"cannot read n{253}\.h5: File name too long"):
        open_film("n" * 253 + ".h5")


def test_a_folder_part_names_a_file_and_no_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MediaError, match=r"there is no file .*/camera:x\.h5: check the name"):
        open_film("./camera:x.h5")
    with pytest.raises(SettingsError, match=r"unknown camera 'x\.h5'"):
        open_film("camera:x.h5")
    assert is_camera("camera:x.h5")
    write_levels("./camera:x.h5", FRAME)
    assert not is_camera("camera:x.h5")
    assert not is_camera(Path("camera:x.h5"))


def test_pictures_of_any_name_are_read(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"caf\xe9\n[x]")
    write_pictures(tmp_path / "shots", np.zeros((2, 8, 8), np.uint8)).rename(folder)
    for given in (folder, folder / "img%04d.png"):
        with open_film(given, rate_hz=100) as source:
            assert sum(1 for _ in source) == 2
