"""Shared array types and numerical limits."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Gray = NDArray[np.uint8]  # gray image, (rows, columns)

TINY = 1e-12  # minimum divisor, which keeps quotients finite; below the squared smallest gray level, 1/65535^2
RCOND = 1e-6  # fraction of the largest singular value below which least squares ignores others: nearly parallel columns
