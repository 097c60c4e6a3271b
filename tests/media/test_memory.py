"""Memory is independent of film length, for each format."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from made_recordings import write_kinds
from waiting import run_alone

from heliograph.media import open_film

FRAMES, ROWS, COLUMNS = 60, 64, 512


@pytest.mark.slow
def test_reading_holds_only_a_few_frames(tmp_path: Path) -> None:
    levels = np.zeros((FRAMES, ROWS, COLUMNS), np.uint8)
    films = {kind: path for kind, (path, _) in write_kinds(tmp_path, levels, 1000).items()}
    for kind, (count, peak) in run_alone(read_and_trace, films).items():
        assert count == FRAMES, kind
        assert peak < 12 * ROWS * COLUMNS, kind


def read_and_trace(films: dict[str, Path]) -> dict[str, tuple[int, int]]:
    """Return the number of frames, and the peak memory in bytes while reading."""
    found = {}
    for kind, path in films.items():
        with open_film(path, rate_hz=1000) as film:
            next(iter(film))  # import modules before measuring
            tracemalloc.start()
            found[kind] = sum(1 for _ in film), tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    return found
