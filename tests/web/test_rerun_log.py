import subprocess
import sys
from pathlib import Path

import pytest
from cli_runs import lasting, succeeded, within

from heliograph.base.errors import HeliographError
from heliograph.receive.settings import CalibrationSettings
from heliograph.web.rerun_log import open_rerun


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with (
        pytest.raises(HeliographError, match=r"needs the package rerun-sdk: pip install 'heliograph\[rerun\]'"),
        open_rerun(tmp_path / "run.rrd", 16, CalibrationSettings()),
    ):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_recording_has_frames_arrays_soft_values_codewords_and_events(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk takes 700 MB")
    far = ("--set", "channel.distance_m=75")
    succeeded(within(tmp_path, "simulate", "a.mkv", *lasting(0.25), "--high", "text:red", *far))
    succeeded(within(tmp_path, "receive", "a.mkv", "--rerun", "run.rrd"))
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(tmp_path / "run.rrd")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    kinds = ("camera", "camera/array-0", "distance/array-0", "pairs/array-0/pattern", "pairs/array-0/inverse", "events")
    layers = [f"{kind}/{layer}" for kind in ("codewords", "information") for layer in ("high", "middle", "low")]
    for path in (*kinds, *layers, "soft-values/array-0/low"):
        assert f" - /{path} - " in printed, path
