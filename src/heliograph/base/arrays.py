"""Types of arrays that many modules share."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Numbers in double precision."""

Gray = NDArray[np.uint8]
"""Gray image, (rows, columns) uint8."""
