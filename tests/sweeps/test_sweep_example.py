"""The worked example runs."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "error_rates.py"


def test_the_example_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), "--few"])
    found = runpy.run_path(str(EXAMPLE))
    assert found["reach"]["high"]
    assert "units" in found["data"]["channel.distance_m"].attrs
    assert "below" in capsys.readouterr().out
