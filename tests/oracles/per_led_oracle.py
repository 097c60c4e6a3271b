"""Reference for the plain receiver's kernel in `kernels.py`."""

import numpy as np

from heliograph.base.arrays import Floats


def sample_cubic(image: Floats, points: Floats) -> Floats:
    """Interpolate an image by Keys' cubic convolution, (n,); the border repeats."""
    out = np.empty(len(points))
    for k, (x, y) in enumerate(points):
        j, i = int(np.floor(x)), int(np.floor(y))
        rows, cols = np.arange(i - 1, i + 3), np.arange(j - 1, j + 3)
        values = image[np.ix_(np.clip(rows, 0, image.shape[0] - 1), np.clip(cols, 0, image.shape[1] - 1))]
        # f(x, y) = sum_ij h(y - i) h(x - j) f_ij
        out[k] = _keys(y - rows) @ values @ _keys(x - cols)
    return out


def _keys(t: Floats) -> Floats:
    """Keys' kernel with a = -1/2."""
    # 3/2 |t|^3 - 5/2 |t|^2 + 1 to 1, then -1/2 |t|^3 + 5/2 |t|^2 - 4 |t| + 2 to 2
    a = np.abs(t)
    inner, outer = 1.5 * a**3 - 2.5 * a**2 + 1, -0.5 * a**3 + 2.5 * a**2 - 4 * a + 2
    return np.where(a <= 1, inner, np.where(a <= 2, outer, 0.0))
