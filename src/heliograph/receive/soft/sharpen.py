"""Poses sharpened by what is decoded: a bright background may pull the sum's pose away, a difference it cannot.

With the light of the decoded cells known, the difference of a pair tells where the array is. For a small error e of the
pose its likelihood is that of

    d - g (B m + o) = g H e + g B_u (c_u - m_u) + n,   H = d(B_k c_k) / d pose

k the decoded cells and u the others, which the equaliser takes out as far as they can hide an error. Errors of
successive pairs are alike: they are smoothed as a process that forgets itself in a few pairs, of the size that explains
the packet best.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.receive import kernels as plain
from heliograph.receive.soft.equalise import KNOWN, Estimate, equalise
from heliograph.receive.soft.glance import Floats, Glance
from heliograph.receive.soft.look import Look, Weighted
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

SPREAD = np.array([0.2, 0.2, 0.004, 0.02])
"""Standard deviations of the errors of x, y, ln pitch and roll before a background that pulls hard."""

SIZES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Sizes of the errors tried, as shares of that."""

DOUBT = 2.0
"""By how much less, as a logarithm, a smaller size may explain a packet: most poses of sums are right."""

MEMORY_PAIRS = 8.0
"""Pairs in which an error forgets itself."""

STRIDE = 3
"""Pairs of which one is asked: its neighbours are off alike."""

LEAST_PX, REACH_PX = 0.01, 4.0
"""Errors below this change no bit; a far array's rim is about so far from its middle."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a look says of its pose's error e: information (4, 4) and score (4,), e = information^-1 score."""

    information: Floats
    score: Floats


@dataclass(frozen=True, slots=True)
class Seen:
    """A packet's glances, weighted, and as looks; None where the array was not seen."""

    glances: Sequence[Glance | None]
    weighted: Sequence[Weighted | None]
    looks: Sequence[Look | None]


def pose_errors(
    seen: Seen, gain: float, noise: float, mean: Floats, variance: Floats, form: PacketFormat, shares: Floats
) -> Floats:
    """Errors (pairs, 4) in x, y, ln pitch and roll of the glances' poses.

    Parameters
    ----------
    seen
        The packet's data pairs.
    gain, noise
        Gray levels of a wide array with all LEDs on, and the variance of a pixel of a difference.
    mean, variance
        (pairs, cells) what is known of each cell.
    form
        The packet's format.
    shares
        (n, n) share of its light that each LED gives.
    """
    known = np.where(variance < KNOWN, mean, 0.0)
    levels = 0.5 * haar.inverse_transform(form.join(known))
    evidence: list[Evidence | None] = [None] * len(known)
    there = [k for k in range(len(known)) if seen.glances[k] is not None and known[k].any()]
    for k in there[::STRIDE]:
        glance, weighted, look = seen.glances[k], seen.weighted[k], seen.looks[k]
        assert glance is not None  # it is there
        assert weighted is not None  # it comes with it
        assert look is not None
        estimate = equalise(look, gain, noise, mean[k], variance[k])
        slopes = weighted.root * _slopes(glance, levels[k] * shares)
        evidence[k] = _evidence(weighted, estimate, slopes, gain, noise)
    return _smoothed(evidence)


def worth_moving(error: Floats) -> bool:
    """Whether a pose's error (4,) is worth looking again: a hundredth of a pixel of the array's rim costs nothing."""
    x, y, ln_pitch, roll = np.abs(error)
    return bool(max(x, y) + REACH_PX * max(ln_pitch, roll) > LEAST_PX)


def _slopes(glance: Glance, levels: Floats) -> Floats:
    """Derivatives of the image of known LEDs (n, n) by x, y, ln pitch and roll, (4, rows, columns)."""
    image = np.empty((6, *glance.change.shape))
    plain.render(glance.middle.full_vector(), levels, float(glance.corner[0]), float(glance.corner[1]), image)
    return image[1:5]


def _evidence(weighted: Weighted, estimate: Estimate, slopes: Floats, gain: float, noise: float) -> Evidence:
    """Fisher's information and score of a look."""
    # score = g H^T W (d - g (B m + o)) / s^2
    score = gain / noise * np.tensordot(slopes, weighted.residual(gain, estimate.mean), 2)
    scale = gain**2 / noise
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
    best = max(likelihood for _, likelihood in tried)
    return next(errors for errors, likelihood in tried if likelihood > best - DOUBT)


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
