"""Shared array types and numerical limits."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Double-precision array."""

Gray = NDArray[np.uint8]
"""Gray image, (rows, columns) uint8."""

TINY = 1e-12
"""Minimum divisor, which keeps quotients finite; below the squared smallest gray level, 1/65535^2."""

RCOND = 1e-6
"""Least squares ignores singular values below this fraction of the largest: such columns are nearly parallel."""
