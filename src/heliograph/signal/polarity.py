"""Single-mode balance: inverting rows of D11 keeps the mean luminance steady (section 6.3).

Only D11 changes the mean luminance of a pattern: mean(x) = 1/2 + mean(D11) / 8. In single mode, column 0 carries no
data. In rows 1 and below, column 0 holds the row polarity: +1 for original data, -1 for inverted data. Row 0 is never
inverted, so the column 0 symbol is free. The encoder chooses all of column 0 to keep the running sum of D11 at 0.
"""

import numpy as np
from numpy.typing import NDArray

Signs = NDArray[np.int8]  # array with values -1 and +1


def balance(data: Signs, ahead: int = 0) -> Signs:
    """Return balanced matrices D11, (patterns, h, h): polarities in column 0, then row data times polarity.

    `data` is (patterns, h, h - 1) in time order with h even; `ahead` is the sum of all previous D11.
    """
    count, h, _ = data.shape
    out = np.ones((count, h, h), dtype=np.int8)
    out[:, :, 1:] = data
    for pattern in out:
        ahead += int(pattern[0, 1:].sum())
        sums = pattern[1:].sum(1, dtype=np.int64)
        # process rows by decreasing absolute sum; the sign of each row opposes the running sum
        for row in np.argsort(-np.abs(sums), kind="stable"):
            sign = -1 if ahead * int(sums[row]) > 0 else 1
            pattern[1 + row] *= np.int8(sign)
            ahead += sign * int(sums[row])
        # the running sum is odd; the free symbol makes the sum even, mostly 0
        pattern[0, 0] = -1 if ahead > 0 else 1
        ahead += int(pattern[0, 0])
    return out
