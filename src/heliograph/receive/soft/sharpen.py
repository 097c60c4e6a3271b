"""Poses sharpened by what is decoded: a bright background may pull the sum's pose away, a difference it cannot.

With the light of the decoded cells known, the difference of a pair tells where the array is. For a small error e of the
pose its likelihood is that of

    d - g (B c + o) = g H e + g B_u (c_u - m_u) + n,   H = d(B_k c_k) / d pose

k the decoded cells and u the others, which the equaliser takes out as far as they can hide an error. Errors of
successive pairs are alike: they are smoothed as a process that forgets itself in a few pairs, of the size that explains
the packet best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.receive import kernels as plain
from heliograph.receive.pose import Pose
from heliograph.receive.soft.equalise import KNOWN, equalise
from heliograph.receive.soft.look import Floats, Glance, Look, Noise, weigh
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

SPREAD = np.array([0.2, 0.2, 0.004, 0.02])
"""Standard deviations of the errors of x, y, ln pitch and roll before a background that pulls hard."""

SIZES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Sizes of the errors tried, as shares of that."""

MEMORY_PAIRS = 8.0
"""Pairs in which an error forgets itself."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a look says of its pose's error e: information (4, 4) and score (4,), e = information^-1 score."""

    information: Floats
    score: Floats


def sharpen(
    glances: Sequence[Glance | None],
    looks: Sequence[Look | None],
    light: tuple[float, Noise],
    mean: Floats,
    variance: Floats,
    form: PacketFormat,
    shares: Floats,
) -> list[Glance | None]:
    """Glances with better poses.

    Parameters
    ----------
    glances, looks
        One a data pair; None where the array was not seen.
    light
        Gain, and noise inside and beside the array.
    mean, variance
        (pairs, cells) what is known of each cell.
    form
        The packet's format.
    shares
        (n, n) share of its light that each LED gives.
    """
    known = np.where(variance < KNOWN, mean, 0.0)
    levels = 0.5 * haar.inverse_transform(form.join(known))
    evidence = [
        None
        if glance is None or look is None or not known[k].any()
        else _evidence(glance, look, light, (mean[k], variance[k]), levels[k], shares)
        for k, (glance, look) in enumerate(zip(glances, looks, strict=True))
    ]
    errors = _smoothed(evidence)
    return [None if glance is None else _moved(glance, e) for glance, e in zip(glances, errors, strict=True)]


def _evidence(
    glance: Glance, look: Look, light: tuple[float, Noise], cells: tuple[Floats, Floats], levels: Floats, shares: Floats
) -> Evidence:
    """Fisher's information and score of a look."""
    gain, noise = light
    side = len(levels)
    estimate = equalise(look, gain, noise.lit, *cells)
    weighted = weigh(glance, noise, side, shares)
    image = np.empty((6, *glance.change.shape))
    plain.render(glance.middle.full_vector(), levels * shares, float(glance.corner[0]), float(glance.corner[1]), image)
    slopes = weighted.root * image[1:5]
    residual = weighted.residual(gain, estimate.mean)
    # score = g H^T W (d - g (B m + o)) / s^2
    score = gain / noise.lit * np.tensordot(slopes, residual, 2)
    scale = gain**2 / noise.lit
    information = scale * np.tensordot(slopes, slopes, ((1, 2), (1, 2)))
    if estimate.unknown.size:
        # less what the open cells can hide: g^2 / s^2 H^T W B_u S B_u^T W H g^2 / s^2
        hidden = np.stack([weighted.correlated(slope)[estimate.unknown] for slope in slopes])
        information -= scale**2 * hidden @ estimate.covariance @ hidden.T
    return Evidence(np.asarray(0.5 * (information + information.T)), np.asarray(score))


def _smoothed(evidence: Sequence[Evidence | None]) -> Floats:
    """Errors (pairs, 4) most probable by all looks, of the size that makes the looks most probable."""
    count = len(evidence)
    information, score = np.zeros((count, 4, 4)), np.zeros((count, 4))
    for k, one in enumerate(evidence):
        if one is not None:
            information[k], score[k] = one.information, one.score
    tried = [_filtered(information, score, size * SPREAD) for size in SIZES]
    errors, _ = max(tried, key=lambda result: result[1])
    return errors


def _filtered(information: Floats, score: Floats, spread: Floats) -> tuple[Floats, float]:
    """Errors (pairs, 4) of a Gauss-Markov process of a spread, and the log-likelihood of the looks less a constant."""
    # e_k = a e_(k-1) + w, w of variance (1 - a^2) P: the joint precision is block tridiagonal
    count, a = len(score), float(np.exp(-1 / MEMORY_PAIRS))
    chain = np.diag(np.full(count, 1 + a**2)) - a * (np.eye(count, k=1) + np.eye(count, k=-1))
    chain[0, 0] = chain[-1, -1] = 1.0
    prior = np.kron(chain / (1 - a**2), np.diag(1 / spread**2))
    matrix = prior.copy()
    for k, block in enumerate(information):
        matrix[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] += block
    errors = np.linalg.solve(matrix, score.ravel())
    # ln p = s^T (P^-1 + J)^-1 s / 2 - ln det(P^-1 + J) / 2 + ln det(P^-1) / 2
    likelihood = 0.5 * (score.ravel() @ errors - np.linalg.slogdet(matrix)[1] + np.linalg.slogdet(prior)[1])
    return errors.reshape(count, 4), float(likelihood)


def _moved(glance: Glance, error: Floats) -> Glance:
    """The glance with its poses corrected."""
    step = np.append(error, np.zeros(3))
    first, second = (Pose.of(pose.full_vector() + step) for pose in glance.poses)
    return replace(glance, poses=(first, second))
