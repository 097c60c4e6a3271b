"""Types of arrays that many modules share."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Numbers in double precision."""

Gray = NDArray[np.uint8]
"""Gray image, (rows, columns) uint8."""

TINY = 1e-12
"""Least divisor, which keeps a quotient finite: the smallest squares of gray levels' fractions, 1/65535^2, are above.

Where it stands in place of a divisor the quotient's other part is 0 as well, or what follows asks for more light.
"""

RCOND = 1e-6
"""Singular values below this fraction of the largest are left out of least squares: columns are then alike.

Sums over thousands of pixels in double precision are right to 1e-12, their roots to 1e-6.
"""
