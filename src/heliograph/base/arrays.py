"""Types of arrays that many modules share."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Numbers in double precision."""

Gray = NDArray[np.uint8]
"""Gray image, (rows, columns) uint8."""

TINY = 1e-12
"""Minimum divisor, which keeps a quotient finite; the square of the smallest gray level, 1/65535^2, is larger."""

RCOND = 1e-6
"""Fraction of the largest singular value below which least squares ignores others: the columns are then alike.

Sums over thousands of pixels in double precision are right to 1e-12, and the roots to 1e-6.
"""
