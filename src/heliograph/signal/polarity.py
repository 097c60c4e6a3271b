"""The single mode's balance: rows of D11 are sent as they are or inverted, so that the light is even.

Of a pattern only D11 changes the mean luminance: mean(x) = 1/2 + mean(D11) / 8. In the single mode column 0 of D11 is
no data. In the rows from 1 on it is the row's polarity, +1 where the row's data are sent as they are, -1 where they are
inverted; in row 0, whose data are always sent as they are, it is free. All are chosen to keep the running sum of D11 at
0.
"""

import numpy as np
from numpy.typing import NDArray

Signs = NDArray[np.int8]


def balance(data: Signs, ahead: int = 0) -> Signs:
    """Matrices D11 of data, chosen for balance.

    Parameters
    ----------
    data
        (patterns, h, h - 1) of -1 and +1, in the order of time; h even.
    ahead
        Sum of all D11 before.

    Returns
    -------
    (patterns, h, h) int8: column 0 the polarities, then the data times their row's.
    """
    count, h, _ = data.shape
    out = np.ones((count, h, h), dtype=np.int8)
    out[:, :, 1:] = data
    for pattern in out:
        ahead += int(pattern[0, 1:].sum())
        sums = pattern[1:].sum(1, dtype=np.int64)
        # the rows that weigh most first, each against what is ahead
        for row in np.argsort(-np.abs(sums), kind="stable"):
            sign = -1 if ahead * int(sums[row]) > 0 else 1
            pattern[1 + row] *= np.int8(sign)
            ahead += sign * int(sums[row])
        # odd by now: the free cell is the last step
        pattern[0, 0] = -1 if ahead > 0 else 1
        ahead += int(pattern[0, 0])
    return out


def undone(d11: Signs) -> Signs:
    """The data of matrices D11 (..., h, h), the inverse of `balance`: (..., h, h - 1)."""
    polarity = d11[..., :1].copy()
    polarity[..., 0, :] = 1
    return np.asarray(d11[..., 1:] * polarity)
