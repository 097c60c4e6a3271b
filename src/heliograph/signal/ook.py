"""Plain on-off keying, one bit an LED: the baseline of hierarchical coding."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def encode(d: ArrayLike) -> NDArray[np.uint8]:
    """Light every LED whose datum is +1.

    Parameters
    ----------
    d
        (..., n, n) array of -1 and +1.

    Returns
    -------
    (..., n, n) uint8, level 4 (fully on) or 0.
    """
    data = np.asarray(d)
    if not np.isin(data, (-1, 1)).all():
        raise ValueError("a data matrix holds -1 and +1 only")
    return np.where(data > 0, 4, 0).astype(np.uint8)


def decode(x: ArrayLike) -> NDArray[np.float64]:
    """Soft data of received luminances x' = level - 2 (any multiple of it): x' / 2, so +-1 without noise."""
    return 0.5 * np.asarray(x, dtype=np.float64)
