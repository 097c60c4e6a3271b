"""Shared by the tests of commands."""

from pathlib import Path

import pytest
from cli_runs import Call, called


@pytest.fixture
def call(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run commands in this process and an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: called(*arguments, capfd=capfd, monkeypatch=monkeypatch)
