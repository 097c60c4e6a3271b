"""Reference for `kernels.py` and `statistics.py`: dense matrices and textbook formulas."""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import RCOND, Floats


def transform(side: int) -> Floats:
    """Return T, (n n LEDs row by row, n n symbols): 2 x - 1 = T c."""
    half = side // 2
    # symbols: D11, D12, D21, D22, each row by row
    quarters = np.eye(side * side).reshape(-1, 2, 2, half, half)
    d = quarters.transpose(0, 1, 3, 2, 4).reshape(-1, side, side)
    # (9) H: sums in the upper half, differences in the lower half
    h = np.vstack([np.kron(np.eye(half), [1, 1]), np.kron(np.eye(half), [1, -1])])
    # (8) x' = 4 x - 2 = 1/2 H^T D H
    x = 0.5 * h.T @ d @ h
    # 2 x - 1 = x' / 2; column k is the pattern for symbol k
    return np.asarray(0.5 * x.reshape(side * side, -1).T)


def pair_model(a_1: Floats, a_2: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return B (pixels, symbols) and o (pixels,) for a pair d = g (B c + o) + n."""
    # g (A_1 x - A_2 (1 - x)) with x = (1 + T c) / 2
    return 0.5 * (a_1 + a_2) @ t, 0.5 * (a_1 - a_2).sum(1)


def weights(a: Floats, pitch: float, lit: float, dark: float, ring: int, shape: tuple[int, int]) -> Floats:
    """Return W (pixels,): lit over pixel noise variance, as row times column factors."""
    side = round(np.sqrt(a.shape[1]))
    image = a.sum(1).reshape(shape)
    parts = []
    for axis, count in ((1, shape[0]), (0, shape[1])):
        # row or column profile with all LEDs on, 1 inside the array
        f = np.clip(image.sum(axis) / (side * pitch), 0, 1)
        part = lit / (dark + (lit - dark) * f)
        inside = (np.arange(count) >= ring) & (np.arange(count) < count - ring)
        parts.append(np.where(inside, part, 0.0))
    return np.outer(parts[0], parts[1]).ravel()


def uneven(total: Floats, lit: Floats, inside: NDArray[np.bool_]) -> Floats:
    """Return the residual after fitting array light and a plane, (pixels inside,)."""
    y, x = np.nonzero(inside)
    columns = np.stack([lit[inside], np.ones(len(x)), x - x.mean(), y - y.mean()], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, total[inside], rcond=RCOND)[0]
    return np.asarray(total[inside] - fitted)
