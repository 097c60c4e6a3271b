"""Memory is independent of the length of a film or a file of slots, for each format."""

import tracemalloc
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest
from made_recordings import write_kinds
from waiting import run_alone

from heliograph.media import open_film, open_slots
from heliograph.media.slots import SUFFIXES, SlotForm, write_slots

FRAMES, ROWS, COLUMNS = 30, 64, 512
FEW, MANY = 20, 250


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    levels = np.zeros((FRAMES, ROWS, COLUMNS), np.uint8)
    films = {kind: path for kind, (path, _) in write_kinds(tmp_path, levels, 1000).items()}
    peaks = run_alone(trace, films, tmp_path)
    for kind in films:
        assert peaks[kind] < 12 * ROWS * COLUMNS, kind
    for kind in SUFFIXES:
        assert peaks[f"{MANY}{kind}"] < peaks[f"{FEW}{kind}"] + 100_000


def trace(films: dict[str, Path], folder: Path) -> dict[str, int]:
    """Return the peak memory in bytes for reading films, and for writing and reading slots of 512 bytes."""
    peaks, slot = {}, np.random.default_rng(0).integers(0, 2, (64, 64), np.uint8)
    for kind, path in films.items():
        with open_film(path, rate_hz=1000) as film:
            next(iter(film))  # import modules before measuring
            tracemalloc.start()
            assert sum(1 for _ in film) == FRAMES
            peaks[kind] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    for name, count in [(f"{count}{kind}", count) for kind in SUFFIXES for count in (FEW, MANY)]:
        tracemalloc.start()
        write_slots(folder / name, repeat(slot, count), SlotForm(64, 4, 250_000, count))
        assert sum(1 for _ in open_slots(folder / name)) == count
        peaks[name] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peaks
