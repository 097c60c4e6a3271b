"""The balance of the single mode: rows of D11 are sent as they are or inverted to keep the light even (section 6.3).

D11 alone changes a pattern's mean luminance: mean(x) = 1/2 + mean(D11) / 8. In the single mode column 0 of D11 carries
no data. In rows 1 and below it is the row's polarity: +1 where the row's data are sent as they are, -1 where they are
inverted. In row 0, whose data are always sent as they are, it is free. All of the column is chosen to keep the running
sum of D11 at 0.
"""

import numpy as np
from numpy.typing import NDArray

Signs = NDArray[np.int8]
"""Array of -1 and +1."""


def balance(data: Signs, ahead: int = 0) -> Signs:
    """Return matrices D11 that carry the data and keep the light even.

    Parameters
    ----------
    data
        (patterns, h, h - 1) int8 of -1 and +1, in the order of time; h even.
    ahead
        Sum of all D11 sent before.

    Returns
    -------
    (patterns, h, h) int8: the polarities in column 0, then each row's data times its polarity.
    """
    count, h, _ = data.shape
    out = np.ones((count, h, h), dtype=np.int8)
    out[:, :, 1:] = data
    for pattern in out:
        ahead += int(pattern[0, 1:].sum())
        sums = pattern[1:].sum(1, dtype=np.int64)
        # rows in the order of falling magnitude of their sums, each against the running sum
        for row in np.argsort(-np.abs(sums), kind="stable"):
            sign = -1 if ahead * int(sums[row]) > 0 else 1
            pattern[1 + row] *= np.int8(sign)
            ahead += sign * int(sums[row])
        # the running sum is odd by now: the free symbol makes it even, mostly 0
        pattern[0, 0] = -1 if ahead > 0 else 1
        ahead += int(pattern[0, 0])
    return out


def unbalance(d11: Signs) -> Signs:
    """Return the data that matrices D11 carry, the inverse of `balance`: (..., h, h - 1).

    Parameters
    ----------
    d11
        (..., h, h) int8 of -1 and +1, the polarities in column 0.
    """
    polarity = d11[..., :1].copy()
    polarity[..., 0, :] = 1
    return np.asarray(d11[..., 1:] * polarity)
