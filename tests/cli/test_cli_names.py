"""Arbitrary bytes in file names: each result and error stays on its line."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Call, failed
from film_checks import write_levels

from heliograph.cli import console, messages
from heliograph.experiments.report import Report
from heliograph.experiments.reproduce import recordings_in

ODD = os.fsdecode(b"-caf\xe9\n\x1b[31m 'q\" #%?\xe2\x80\xae.H5")
SHOWN = r"""-caf\xe9\n\x1b[31m 'q" #%?\u202e.H5"""


LEVELS = np.full((20, 16, 16), 90, np.uint8)


def test_results_and_errors_name_a_film_on_one_line(tmp_path: Path, call: Call) -> None:
    write_levels(tmp_path / ODD, LEVELS)
    line = failed(call("receive", "--output", "results", "--", ODD))
    assert line.startswith(f"heliograph: {SHOWN} has 20 frames")
    assert json.loads(Path("results/summary.json").read_bytes())["film"] == ODD
    assert line.endswith(json.loads(Path("results/summary.json").read_bytes())["error"])

    run = call("probe", "--output", "seen", "--", ODD)
    assert run.returncode == 3, run.stderr
    assert run.stdout.startswith(f"{SHOWN}: 20 frames")
    assert "<title>Probe of -caf\\xe9\\n" in Path("seen/probe.html").read_text(encoding="utf-8")

    for command in ("receive", "probe"):
        line = failed(call(command, "--", f"no{ODD}"))
        assert line == f"heliograph: there is no file no{SHOWN}: check the name"

    run = call("receive", "--workers", "1", "--", ODD, f"no{ODD}")
    assert [json.loads(row)["film"] for row in run.stdout.splitlines()] == [ODD, f"no{ODD}"]

    run = call("convert", f"./{ODD}", f"to{ODD}")
    assert run.stdout == f"to{SHOWN}: 20 frames\n"


def test_characters_beyond_an_encoding_are_escaped(tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    write_levels(tmp_path / "試.h5", LEVELS)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out := io.BytesIO(), "ascii", "strict"))
    assert (call("convert", "試.h5", "験.h5").returncode, out.getvalue()) == (0, b"\\u9a13.h5: 20 frames\n")


@pytest.mark.parametrize("name", ["a.h5", "a b.h5", "-x.h5", "it's.h5", "$(rm x)`", ODD, "試.h5", "caf\udce9b\\n.h5"])
def test_a_file_name_is_quoted_for_the_shell(name: str) -> None:
    script = f"printf '%s\\0' {console.argument(Path(name))}"
    out = subprocess.run(["bash", "-c", script], capture_output=True, check=True).stdout
    assert out == os.fsencode(f"./{name}" if name.startswith("-") else name) + b"\0"


def test_text_and_file_names_that_are_not_utf_8_are_sent(tmp_path: Path) -> None:
    assert messages.message_of("high", os.fsdecode(b"caf\xe9")) == b"caf\xe9"
    path = tmp_path / os.fsdecode(b"caf\xe9" + b"n" * 251)
    path.write_bytes(b"x")
    assert messages.file_of(path, "cauchy").name == "caf_" + "n" * 251


def test_a_report_takes_any_text(tmp_path: Path) -> None:
    report = Report("caf\udce9")
    report.text("\ud800")
    report.write(tmp_path / "a.html")
    assert "caf\\udce9" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_recordings_may_have_any_name_and_suffix(tmp_path: Path) -> None:
    (tmp_path / "driving").mkdir()
    for name in ("caf\udce9.Mp4", "a.mp4", "a.MP4", "b.txt"):
        (tmp_path / "driving" / name).touch()
    clips = {name: path.name for name, path in recordings_in(tmp_path)["clips"].items()}
    assert (sorted(clips), sorted(clips.values())) == (["a", "a.mp4", "caf\\xe9"], ["a.MP4", "a.mp4", "caf\udce9.Mp4"])
