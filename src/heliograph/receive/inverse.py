"""Inverse of the channel: the LEDs' luminances by least squares on all pixels, the blur of all LEDs known.

Every LED shines on its neighbours' pixels too. With the pose and the blur known the matrix A of what each LED gives
each pixel is known, and the difference of pattern and inverse is A (2 x - 1). Each LED's image is a product of a
function of x and one of y, whatever the roll, so A itself is never made. The sums are too small to be worth the
threads of a BLAS.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.frames import Frame
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose

Floats = NDArray[np.float64]

LOADING = 1e-4
"""lambda: loading of the diagonal of A^T A, in units in which a wide array with all LEDs on has the image 1.

Zero-forcing is meant, so lambda is what the noise is worth and no more: (noise / light)^2 = 2 (0.006 / 0.8)^2 = 1e-4
for LEDs of +-1 in the difference of two frames of the reference link. To 55 m it changes nothing; from 60 m on there
are combinations of LEDs that hardly any pixel sees, and lambda keeps their noise out of all the others.
"""

MARGIN_PX = 2.5
"""Pixels beyond the array that are used: LEDs on the rim shine there."""


def unblurred(
    pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], gain: float, side: int, loading: float = LOADING
) -> Floats:
    """Normalised luminances x' = level - 2 of a pair, the blur undone.

    With A_1 and A_2 at the poses of the two frames, the background equal in both, s = 2 x - 1:

        d = (r - r_inverted) / gain = A_1 x - A_2 (1 - x) = M s + (A_1 - A_2) 1 / 2,  M = (A_1 + A_2) / 2
        s = (M^T M + lambda I)^-1 M^T (d - (A_1 - A_2) 1 / 2)

    M is taken as A at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2.

    Parameters
    ----------
    pattern, inverted, poses, gain, side
        As for `extract.pair_luminances`.
    loading
        lambda.

    Returns
    -------
    (side, side) float64, -2 to 2 without noise and with a tiny lambda.
    """
    middle, motion = _between(*poses)
    window = window_around(middle, side, MARGIN_PX + max(abs(motion[0]), abs(motion[1])))
    x0, y0, width, height = window
    change = (cut_out(pattern, x0, y0, width, height) - cut_out(inverted, x0, y0, width, height)) / max(gain, 1e-6)
    change -= 0.5 * (_all_on(poses[0], side, window) - _all_on(poses[1], side, window))
    across, down = _axes(middle, side, window, motion)
    light = np.einsum("kj,kj->k", np.einsum("ki,ij->kj", down, change), across)
    s = np.empty(side * side)
    _solve(across, down, light, loading, s)
    return np.asarray(2 * s.reshape(side, side))


def blur_matrix(pose: Pose, side: int, window: tuple[int, int, int, int]) -> Floats:
    """A, (pixels, n n): what each LED gives each pixel of a window (x, y, columns, rows)."""
    across, down = _axes(pose, side, window)
    return np.asarray((down[:, :, None] * across[:, None, :]).reshape(side * side, -1).T)


def _between(a: Pose, b: Pose) -> tuple[Pose, tuple[float, float]]:
    """The pose between two, and half the motion from one to the other."""
    half = 0.5 * (b.x - a.x), 0.5 * (b.y - a.y)
    return Pose.between(a, b), half


def _all_on(pose: Pose, side: int, window: tuple[int, int, int, int]) -> Floats:
    """A 1, the image of all LEDs, (rows, columns)."""
    across, down = _axes(pose, side, window)
    return np.asarray(np.einsum("ki,kj->ij", down, across))


def _axes(
    pose: Pose, side: int, window: tuple[int, int, int, int], spread: tuple[float, float] = (0.0, 0.0)
) -> tuple[Floats, Floats]:
    """Shares of each LED by column and by row, (n n, columns) and (n n, rows), times the pitch.

    `spread` is a standard deviation in x and y added to the blur's.
    """
    x0, y0, width, height = window
    points = pose.leds(side).reshape(-1, 2)
    across = _shares(points[:, 0] - x0, width, float(np.hypot(pose.blur, spread[0])))
    down = _shares(points[:, 1] - y0, height, float(np.hypot(pose.blur, spread[1])))
    return pose.pitch * across, pose.pitch * down


def _shares(centres: Floats, count: int, sigma: float) -> Floats:
    """Share of a Gaussian about each centre in each of `count` pixels, (centres, count)."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    edges = np.arange(count + 1) - 0.5
    return np.asarray(np.diff(ndtr((edges - centres[:, None]) / sigma), axis=1))


@njit(cache=True, nogil=True, fastmath=True)
def _dot(a, b, count):
    total = 0.0
    for k in range(count):
        total += a[k] * b[k]
    return total


@njit(cache=True, nogil=True)
def _solve(across, down, light, loading, out):
    """Solve (A^T A + loading I) out = light by Cholesky's factors L L^T.

    <a_i, a_j> = <across_i, across_j> <down_i, down_j>, across (n, columns), down (n, rows), light and out (n,).
    """
    n, cols, rows = across.shape[0], across.shape[1], down.shape[1]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            value = _dot(down[i], down[j], rows)
            if value != 0.0:
                value *= _dot(across[i], across[j], cols)
            if i == j:
                low[i, i] = math.sqrt(value + loading - _dot(low[i], low[i], i))
            else:
                low[i, j] = (value - _dot(low[i], low[j], j)) / low[j, j]
        out[i] = (light[i] - _dot(low[i], out, i)) / low[i, i]
    for i in range(n - 1, -1, -1):
        out[i] /= low[i, i]
        for j in range(i):
            out[j] -= low[i, j] * out[i]
