"""On-off keying with a bit per LED: the baseline for the hierarchical code (section 6.2)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.signal.pwm import SLOTS


def encode(d: ArrayLike) -> NDArray[np.uint8]:
    """Map data matrices, (..., n, n) with values -1 and +1, to uint8 levels: 4 for +1, 0 for -1."""
    return np.where(np.asarray(d) > 0, SLOTS, 0).astype(np.uint8)


def decode(x: ArrayLike) -> NDArray[np.float64]:
    """Return soft data x' / 2 from luminances x' = level - 2; positive values mean d = +1, bit 0."""
    return 0.5 * np.asarray(x, dtype=np.float64)
