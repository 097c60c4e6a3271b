"""Pairs of patterns by least squares, cell by cell, for a clock that is known."""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.screen.clock import Clock, pairs_between
from heliograph.receive.screen.samples import BINS, PAIR_LOADING, Samples


@dataclass(frozen=True)
class Solved:
    """Pairs of patterns as least squares give them."""

    # Numbers of the pairs
    pairs: range
    # (pairs, n, n) d in the light's unit
    change: Floats
    # (pairs, n, n) variance of d by that of one sample
    variance: Floats
    # (n, n) mean light c of each cell
    light: Floats
    # (frames, n, n) what is not explained
    left: Floats


def solved(samples: Samples, clock: Clock, weights: Floats | None = None) -> Solved:
    """Solve the pairs of all cells."""
    frames, n = len(samples.times_s), samples.light.shape[-1]
    late = clock.row_s * float(samples.rows.max())
    pairs = pairs_between(clock, float(samples.times_s[0]), float(samples.times_s[-1]), late)
    w = samples.weights / samples.weights.mean() * (1.0 if weights is None else weights)
    y = samples.light.reshape(frames, -1).T  # (cells, frames)
    # cells of one row of the array, or fewer, share their times
    at = samples.times_s + clock.row_s * samples.rows.reshape(frames, -1).T
    change, variance = np.empty((len(pairs), n * n)), np.empty((len(pairs), n * n))
    light, left = np.empty(n * n), np.empty((frames, n * n))
    order = np.argsort(at[:, 0] if frames else at, kind="stable")
    for group in np.array_split(order, max(n, 2 * BINS)):
        m = np.concatenate([np.ones((frames, 1)), clock.design(at[group].mean(0), pairs)], axis=1)
        mw = m * w[:, None]
        loading = PAIR_LOADING * 2 * frames / len(pairs) * np.eye(len(pairs) + 1)
        loading[0, 0] = 0
        gram = mw.T @ m + loading
        inverse = np.linalg.inv(gram)
        x = inverse @ (mw.T @ y[group].T)
        light[group], change[:, group] = x[0], x[1:]
        variance[:, group] = np.diag(inverse)[1:, None]
        left[:, group] = y[group].T - m @ x
    shape = (n, n)
    return Solved(
        pairs,
        change.reshape(-1, *shape),
        variance.reshape(-1, *shape),
        light.reshape(shape),
        left.reshape(-1, *shape),
    )
