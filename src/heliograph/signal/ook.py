"""On-off keying, one bit per LED: the baseline for the hierarchical code (section 6.2)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.signal.pwm import SLOTS


def encode(d: ArrayLike) -> NDArray[np.uint8]:
    """Turn data matrices into patterns: every LED whose datum is +1 is lit.

    Parameters
    ----------
    d
        (..., n, n) array of -1 and +1.

    Returns
    -------
    (..., n, n) uint8, level 4 (fully on) or 0.

    Raises
    ------
    ValueError
        The matrices hold a value that is neither -1 nor +1.
    """
    data = np.asarray(d)
    if not np.isin(data, (-1, 1)).all():
        raise ValueError("a data matrix holds -1 and +1 only")
    return np.where(data > 0, SLOTS, 0).astype(np.uint8)


def decode(x: ArrayLike) -> NDArray[np.float64]:
    """Turn received luminances into soft data x' / 2: -1 or +1 in the absence of noise.

    A gain on the luminances is a gain on the result. Positive means d = +1, that is bit 0.

    Parameters
    ----------
    x
        Luminances x' = level - 2, times any gain, of any shape.
    """
    return 0.5 * np.asarray(x, dtype=np.float64)
