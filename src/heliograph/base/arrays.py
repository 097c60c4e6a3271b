"""Types of arrays that many modules share."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Numbers in double precision."""

Gray = NDArray[np.uint8]
"""Gray image, (rows, columns) uint8."""

TINY = 1e-12
"""Minimum divisor, which keeps a quotient finite; below the square of the smallest gray level, 1/65535^2."""

RCOND = 1e-6
"""Fraction of the largest singular value below which least squares ignores others: the columns are then alike."""
