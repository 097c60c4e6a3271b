"""Searches for headers, frames with an array of square pixels, and frames with squares that flicker."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.signal.header import all_header_cells

HEADER: Floats = np.kron(all_header_cells()[4] > 0, np.ones((8, 8))).astype(np.float64)
"""Header of identity 4, (32, 32) of 0 and 1: two pixels per LED."""


def search_parameters(**changes: Any) -> SearchParameters:
    """Return the soft receiver's parameters for upright arrays, with changes."""
    defaults: dict[str, Any] = {"min_side_px": 8.0, "max_side_px": 64.0, "min_contrast": 0.03, "score": 0.9}
    return SearchParameters(**{**defaults, "regularity": 0.15, "candidates": 6, "blur_px": 0.55, **changes})


def shown_patterns(is_header: Callable[[int], bool], rng: np.random.Generator) -> Iterator[Floats]:
    """Yield the array's light, (32, 32) from 0 to 1: for even frames a header or random data, then the inverse."""
    frame = 0
    while True:
        data = np.asarray(rng.integers(0, 5, (16, 16)) / 4, np.float64)
        shown = HEADER if is_header(frame) else data.repeat(2, 0).repeat(2, 1)
        yield shown
        yield 1 - shown
        frame += 2


def flicker(count: int, seed: int, shape: tuple[int, int] = (96, 128)) -> list[Frame]:
    """Return frames with independent random gray levels in 8 px squares."""
    levels = np.random.default_rng(seed).integers(0, 256, (count, shape[0] // 8, shape[1] // 8), np.uint8)
    return [Frame(k, 1e-3 * k, np.kron(level, np.ones((8, 8), np.uint8))) for k, level in enumerate(levels)]
