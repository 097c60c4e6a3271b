"""Recorded frames for the background, as a value without files."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Footage:
    """Gray frames that can be read from the start, any number of times.

    Attributes
    ----------
    frames
        Makes an iterator over (rows, columns) uint8 frames of any one size; gray levels stand for linear light.
    rate_hz
        Frames a second.
    """

    frames: Callable[[], Iterator[NDArray[np.uint8]]]
    rate_hz: float

    def __post_init__(self) -> None:
        """Check the rate."""
        if not self.rate_hz > 0:
            raise ValueError(f"footage has a rate above 0, not {self.rate_hz:g}")
