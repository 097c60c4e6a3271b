"""Recorded frames for the background, without files."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Footage:
    """Gray frames that can be read from the start any number of times."""

    # Returns a new iterator over (rows, columns) uint8 frames, all of one size; gray levels are taken as linear light
    frames: Callable[[], Iterator[NDArray[np.uint8]]]
    # Frames a second, above 0
    rate_hz: float

    def __post_init__(self) -> None:
        """Check the rate."""
        if not self.rate_hz > 0:
            raise ValueError(f"footage has a rate above 0, not {self.rate_hz:g}")
