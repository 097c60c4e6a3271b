"""Poses sharpened by what is decoded: a bright background may pull the sum's pose away, a difference it cannot.

With the light of the decoded cells known, the difference of a pair tells where the array is. For a small error e of the
pose its likelihood is that of

    d - g (B m + o) = g H e + g B_u (c_u - m_u) + n,   H = d(B_k c_k) / d pose

k the decoded cells and u the others, which the equaliser takes out as far as they can hide an error. Errors of
successive pairs are alike: some stay as long as the background does, others come and go with the shake. Both are taken
for Gauss-Markov processes, of the sizes that explain the packet best.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import block_diag, lu_factor, lu_solve

from heliograph.receive.soft.equalise import KNOWN, products
from heliograph.receive.soft.glance import Floats, Glance
from heliograph.receive.soft.look import Look, Weighted
from heliograph.receive.soft.shares import PULLED
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

SLOW_SIZES, FAST_SIZES = (0.0, 0.03, 0.1, 0.3, 1.0, 2.0), (0.01, 0.03, 0.1, 0.3, 1.0)
"""Sizes tried, as shares of `PULLED`, of errors that stay through a packet and of those that come with the shake."""

DOUBT = 2.0
"""By how much less, as a logarithm, a smaller size may explain a packet: most poses of sums are right."""

SLOW_PAIRS, FAST_PAIRS = 200.0, 8.0
"""Pairs in which such errors forget themselves."""

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
    """A packet's glances, weighted, and as looks; None where the array was not seen.

    The errors (pairs, 4) are what was taken off the poses of sums so far: a prior holds for the whole of it.
    """

    glances: Sequence[Glance | None]
    weighted: Sequence[Weighted | None]
    looks: Sequence[Look | None]
    errors: Floats


def pose_errors(
    seen: Seen, light: tuple[float, float], cells: tuple[Floats, Floats], form: PacketFormat, shares: Floats
) -> Floats:
    """Errors (pairs, 4) in x, y, ln pitch and roll of the poses that sums gave.

    Parameters
    ----------
    seen
        The packet's data pairs.
    light
        Gray levels of a wide array with all LEDs on, and the variance of a pixel of a difference.
    cells
        Mean and variance of each, (pairs, cells).
    form
        The packet's format.
    shares
        (n, n) share of its light that each LED gives.
    """
    (gain, noise), (mean, variance) = light, cells
    # guesses come from the poses that are in doubt
    decided = variance < KNOWN
    known = np.where(decided, mean, 0.0)
    levels = 0.5 * haar.inverse_transform(form.join(known))
    evidence = dict[int, Evidence]()
    there = [k for k in range(len(known)) if seen.glances[k] is not None and known[k].any()]
    for k in there[::STRIDE]:
        glance, weighted, look = seen.glances[k], seen.weighted[k], seen.looks[k]
        assert glance is not None  # it is there
        assert weighted is not None  # it comes with it
        assert look is not None
        slopes = weighted.root * glance.slopes(levels[k] * shares)
        left = weighted.residual(gain, known[k])
        # J = g^2 H^T C^-1 H, s = g H^T C^-1 (d - g (B m + o)), C = s^2 + g^2 B_u B_u^T the noise and the open cells
        images, scale = np.concatenate([slopes, left[None]]), gain**2 / noise
        part = products(weighted, look, images, np.flatnonzero(~decided[k]), scale)
        evidence[k] = Evidence(scale * part[:4, :4], gain / noise * part[:4, 4])
    return _smoothed(evidence, seen.errors)


def worth_moving(error: Floats) -> bool:
    """Whether a pose's error (4,) is worth looking again: a hundredth of a pixel of the array's rim costs nothing."""
    x, y, ln_pitch, roll = np.abs(error)
    return bool(max(x, y) + REACH_PX * max(ln_pitch, roll) > LEAST_PX)


def _smoothed(evidence: dict[int, Evidence], before: Floats) -> Floats:
    """Errors (pairs, 4) most probable by all looks, of the sizes that make the looks most probable.

    `before` (pairs, 4) was taken off the poses that the evidence is about, and is counted in.
    """
    asked = np.array(sorted(evidence))
    if not asked.size:
        return before
    information = block_diag(*(evidence[k].information for k in asked))
    # about the first poses: J (e - e_0) = s
    score = np.concatenate([evidence[k].score for k in asked]) + information @ before[asked].ravel()
    apart = np.abs(np.arange(len(before))[:, None] - asked)
    # of two independent Gauss-Markov processes
    slowly, quickly = np.exp(-apart / SLOW_PAIRS), np.exp(-apart / FAST_PAIRS)
    tried = []
    for slow, fast in sorted(product(SLOW_SIZES, FAST_SIZES), key=lambda sizes: np.hypot(*sizes)):
        alike = slow**2 * slowly + fast**2 * quickly
        there = np.kron(alike[asked], np.diag(PULLED**2))
        # e = P (1 + J P)^-1 s, ln p = s^T e / 2 - ln det(1 + J P) / 2 and a constant
        matrix = np.eye(score.size) + information @ there
        factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        weights = lu_solve(factors, score, check_finite=False)
        # of P (1 + J P)^-1, a covariance, the determinant is positive
        likelihood = 0.5 * (score @ there @ weights - np.log(np.abs(factors[0].diagonal())).sum())
        tried.append((likelihood, alike, weights))
    best = max(likelihood for likelihood, _, _ in tried)
    alike, weights = next((alike, weights) for likelihood, alike, weights in tried if likelihood > best - DOUBT)
    # P of all pairs: the same in x, y, ln pitch and roll but for their sizes
    return np.asarray(alike @ (weights.reshape(-1, 4) * PULLED**2))
