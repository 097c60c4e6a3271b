"""Impossible claims of films raise a clear error."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_checks import refused, write_levels

from heliograph.media.record import FilmRecord


@pytest.mark.parametrize("wrong", [
    {"rate_hz": 0}, {"rate_hz": 1e300}, {"rate_hz": "NaN"}, {"bits": 99}, {"bits": 1e999}, {"start_s": 1e300},
], ids=str)  # fmt: skip
def test_an_impossible_record_is_ignored(wrong: dict[str, Any]) -> None:
    good: dict[str, Any] = {"rate_hz": 1000.0, "bits": 8, "start_s": 0.0, "metadata": {}}
    assert FilmRecord.loads(FilmRecord(**good).dumps()) == FilmRecord(**good)
    assert FilmRecord.loads(json.dumps(good | wrong)) is None
    assert FilmRecord.loads('{"a":' * 20_000 + "1" + "}" * 20_000) is None


def test_a_pipe_is_no_film(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mkv")
    assert "is a pipe or a device" in refused(tmp_path / "a.mkv")[1]
    assert "is a pipe or a device" in refused(Path("/dev/zero"))[1]


def test_a_film_of_other_bits_than_its_record_is_refused(tmp_path: Path) -> None:
    path = write_levels(tmp_path / "a.mkv", np.zeros((1, 16, 16), np.uint8))
    held = path.read_bytes()
    assert b'"bits": 8' in held
    path.write_bytes(held.replace(b'"bits": 8,', b'"bits":12,'))
    assert "has 16x16 pixels of 8 bits after 0 whole frames, the film 16x16 of 12" in refused(path)[1]
