"""The soft receiver's algebra written for reading: whole matrices, textbook formulas, no tricks.

Nothing runs on it but the tests that hold `kernels.py`, `look.py` and `equalise.py` to it.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.receive.pose import Pose
from heliograph.receive.soft.kernels import DOUBTFUL, FEW, MANY, SURE
from heliograph.signal import haar

Floats = NDArray[np.float64]


def transform(side: int) -> Floats:
    """T, (n n LEDs row by row, n n cells): 2 x - 1 = T c."""
    half = side // 2
    # cells: the quarters D11, D12, D21, D22 of the data matrix, each row by row
    quarters = np.eye(side * side).reshape(-1, 2, 2, half, half)
    d = quarters.transpose(0, 1, 3, 2, 4).reshape(-1, side, side)
    # (8) x' = 4 x - 2 = 1/2 H^T D H
    return np.asarray(0.5 * haar.inverse_transform(d).reshape(side * side, -1).T)


def blur_matrix(
    pose: Pose, side: int, corner: tuple[int, int], shape: tuple[int, int], spread: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """A, (pixels, n n LEDs row by row): each LED's Gaussian integrated over each pixel of a window.

    `spread` is a standard deviation in x and y added to the blur's.
    """
    points = pose.leds(side).reshape(-1, 2)
    across = _shares(points[:, 0] - corner[0], shape[1], float(np.hypot(pose.blur, spread[0])))
    down = _shares(points[:, 1] - corner[1], shape[0], float(np.hypot(pose.blur, spread[1])))
    # an array with all LEDs on that is not resolved has the image 1: each LED has the light of its cell, pitch^2
    return np.asarray(pose.pitch**2 * np.einsum("ki,kj->ijk", down, across).reshape(-1, side * side))


def _shares(centres: Floats, count: int, sigma: float) -> Floats:
    """Share of a Gaussian about each centre in each pixel, (centres, count)."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    edges = np.arange(count + 1) - 0.5
    return np.asarray(np.diff(ndtr((edges - centres[:, None]) / sigma), axis=1))


def pair_model(a_1: Floats, a_2: Floats, t: Floats) -> tuple[Floats, Floats]:
    """B, (pixels, cells), and o, (pixels,), of a pair with blur matrices A_1 and A_2: d = g (B c + o) + n."""
    # g (A_1 x - A_2 (1 - x)) with x = (1 + T c) / 2
    return 0.5 * (a_1 + a_2) @ t, 0.5 * (a_1 - a_2).sum(1)


def weights(a: Floats, pitch: float, lit: float, dark: float, ring: int, shape: tuple[int, int]) -> Floats:
    """W, (pixels,): 1 / variance of each pixel's noise, as a product of its row and its column, in units of 1 / lit.

    a is A of the pair's middle, `pitch` its pixels between LEDs; the outer `ring` pixels of the window weigh nothing.
    """
    side = round(np.sqrt(a.shape[1]))
    image = a.sum(1).reshape(shape)
    parts = []
    for axis, count in ((1, shape[0]), (0, shape[1])):
        # what all LEDs together give a row or a column, 1 inside the array
        f = np.clip(image.sum(axis) / (side * pitch), 0, 1)
        part = lit / (dark + (lit - dark) * f)
        inside = (np.arange(count) >= ring) & (np.arange(count) < count - ring)
        parts.append(np.where(inside, part, 0.0))
    return np.outer(parts[0], parts[1]).ravel()


@dataclass(frozen=True, slots=True)
class Posterior:
    """Cells after linear MMSE estimation.

    Attributes
    ----------
    mean, covariance
        (cells,) and (cells, cells).
    extrinsic
        (cells,) LLR = ln P(c=+1)/P(c=-1) of each without its own prior, see `_extrinsic`.
    """

    mean: Floats
    covariance: Floats
    extrinsic: Floats


def lmmse(b: Floats, d: Floats, noise: Floats, mean: Floats, variance: Floats) -> Posterior:
    """Linear MMSE estimate of cells c of d = B c + n, gain and offset within B and d.

    Parameters
    ----------
    b, d
        (pixels, cells) and (pixels,).
    noise
        (pixels,) variance of each.
    mean, variance
        (cells,) the prior.
    """
    # K = B V B^T + N, m = c + V B^T K^-1 (d - B c), S = V - V B^T K^-1 B V
    k = (b * variance) @ b.T + np.diag(noise)
    gain = variance[:, None] * np.linalg.solve(k, b).T
    rest = d - b @ mean
    covariance = np.diag(variance) - (gain @ b) * variance
    extrinsic = np.array([_extrinsic(i, k, b, rest, mean, variance) for i in range(len(mean))])
    return Posterior(mean + gain @ rest, covariance, extrinsic)


def _extrinsic(i: int, k: Floats, b: Floats, rest: Floats, mean: Floats, variance: Floats) -> float:
    """LLR of cell i by the matched filter in coloured noise: all others are noise, its own prior is taken out.

    The few that disturb it most are taken as the +-1 they are, the others as Gaussian; more where it is worth it.
    """
    # K_i = K - v b b^T, f = K_i^-1 b, z = f^T (d - B c + b c_i): mean mu c_i, variance mu, mu = f^T b
    image = b[:, i]
    matched = np.linalg.solve(k - variance[i] * np.outer(image, image), image)
    mu, z = matched @ image, matched @ (rest + image * mean[i])
    share = matched @ b
    power = share**2 * variance
    power[i] = 0.0
    llr = 0.0
    for most in (FEW, MANY):
        worst = np.argsort(-power)[:most]
        spread = mu - power[worst].sum()
        others = np.array([*product((1, -1), repeat=len(worst))])
        prior = np.prod(0.5 * (1 + others * mean[worst]), axis=1)
        off = z - (others - mean[worst]) @ share[worst]
        log_p = [np.logaddexp.reduce(np.log(prior) - (off - sign * mu) ** 2 / (2 * spread)) for sign in (1, -1)]
        llr = float(log_p[0] - log_p[1])
        if not DOUBTFUL < abs(llr) < SURE:
            break
    return llr
