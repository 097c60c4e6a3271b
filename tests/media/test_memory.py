"""Memory is independent of film length, for each format."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from made_recordings import write_kinds
from waiting import run_alone

from heliograph.media import open_film

FRAMES, ROWS, COLUMNS = 200, 64, 512


@pytest.mark.parametrize("kind", ["folder", "pattern", "tiff", "npy", "mraw", "cine"])
@pytest.mark.slow
def test_a_few_frames_are_held(tmp_path: Path, kind: str) -> None:
    levels = np.zeros((FRAMES, ROWS, COLUMNS), np.uint8)
    path, _ = write_kinds(tmp_path, levels, 1000)[kind]
    count, peak = run_alone(read_and_trace, path)
    assert count == FRAMES
    assert peak < 12 * ROWS * COLUMNS


def read_and_trace(path: Path) -> tuple[int, int]:
    """Return the number of frames, and the peak memory in bytes while reading."""
    with open_film(path, rate_hz=1000) as film:
        next(iter(film))  # import modules before measuring
        tracemalloc.start()
        return sum(1 for _ in film), tracemalloc.get_traced_memory()[1]
