"""When each cell of each frame was exposed to which pattern: the light's clock, found from the light alone.

A pair of patterns is 2 + d and 2 - d in levels, so that a cell shows

    y_i = g_i (c + sum_p d_p q(t_i + r y - 2 p T)),   q = w(t) - w(t - T)

w(t) is the mean of one pattern's light over an exposure that begins t after it, t_i the time of frame i, r y that of
the cell's row of pixels, T the pattern period and g_i the camera's gain. Given phase, row time, exposure and response
the d are linear least squares. What they leave unexplained judges the rest: variable projection. No header is needed
for it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats

BINS = 8
"""Groups of cells by row of pixels that are taken at one time. Chosen: an eighth of a frame's readout is 4 ms at
most."""

PHASES = 16
"""Phases of a pair that are tried: an eighth of a pattern apart, which loses little of a match; they are refined."""

BEST_CLOCKS = 2
"""Clocks of a rate from which a search is refined. Chosen: phase and readout of one may lie on the wrong side."""

READOUTS_S = (0.0, 0.008, 0.016, 0.024)
"""Times for all rows of a frame that are tried: phones take 5 to 30 ms."""

TRIED_EXPOSURES = (0.3, 0.9)
"""Exposures that are tried, in frame periods."""

RESPONSE_S = 0.005
"""Response of a display that a search begins with: 2 to 15 ms."""

PAIR_LOADING = 1e-3
"""Loading of the least squares, by the power of a frame: a pair that hardly any frame shows must not be made of
noise."""

LONGEST_READOUT = 1.0
"""Longest readout of a frame in frame periods."""


@dataclass(frozen=True)
class Clock:
    """What decides which pattern a row sees.

    Attributes
    ----------
    start_s
        Time of a pair's start by the camera's clock.
    period_s
        Pattern period T by the camera's clock.
    row_s
        Time from a row of pixels to the next.
    exposure_s
        Exposure of each row of pixels.
    response_s
        Time constant of the display.
    """

    start_s: float
    period_s: float
    row_s: float
    exposure_s: float
    response_s: float = RESPONSE_S

    def pair_at(self, time_s: float) -> float:
        """Return the number of pairs from the start to a time.

        Parameters
        ----------
        time_s
            Time by the camera's clock.
        """
        return (time_s - self.start_s) / (2 * self.period_s)

    def begins(self, pair: float) -> float:
        """Return the time at which a pair begins.

        Parameters
        ----------
        pair
            Number of the pair.
        """
        return self.start_s + 2 * pair * self.period_s

    def design(self, times_s: Floats, pairs: Sequence[int]) -> Floats:
        """Return q for exposures that begin at some times, (..., pairs).

        Parameters
        ----------
        times_s
            (...) starts of exposures.
        pairs
            Numbers of the pairs that are asked for.
        """
        t = times_s[..., None] - self.start_s - 2 * self.period_s * np.asarray(pairs)
        # q is the second difference of the integral of the step response
        edges = (t, t - self.period_s, t - 2 * self.period_s)
        a, b, c = (self._risen(one + self.exposure_s) - self._risen(one) for one in edges)
        return (a - 2 * b + c) / self.exposure_s

    def _risen(self, t: Floats) -> Floats:
        t, tau = np.maximum(t, 0), max(self.response_s, 1e-5)
        return t + tau * np.expm1(-t / tau)


@dataclass(frozen=True)
class Samples:
    """Light of an array's cells in some frames.

    Attributes
    ----------
    times_s
        (frames,) starts of the exposures of row 0, by the camera's clock.
    rows
        (frames, n, n) row of pixels of each cell.
    light
        (frames, n, n) light in any unit, linear.
    weights
        (frames,) inverse variance of the light, in any unit.
    """

    times_s: Floats
    rows: Floats
    light: Floats
    weights: Floats

    def between(self, start_s: float, end_s: float) -> "Samples":
        """Return those of frames between two times.

        Parameters
        ----------
        start_s, end_s
            First and last time.
        """
        kept = (self.times_s >= start_s) & (self.times_s <= end_s)
        return Samples(self.times_s[kept], self.rows[kept], self.light[kept], self.weights[kept])

    def evened(self, gains: Floats) -> "Samples":
        """Return the same without the camera's gain.

        Parameters
        ----------
        gains
            (frames,) or (frames, n, n) gain.
        """
        whole = np.maximum(gains if gains.ndim == 1 else gains.mean((1, 2)), TINY)
        # what is divided by a small gain is noisy
        weights = self.weights * np.clip(whole / np.median(whole), 0, 1) ** 2
        shape = (len(gains), 1, 1) if gains.ndim == 1 else gains.shape
        return replace(self, light=self.light / np.maximum(gains.reshape(shape), TINY), weights=weights + TINY)


class Bins:
    """Samples by groups of rows of pixels, for the search of a clock.

    Parameters
    ----------
    samples
        What is seen, the camera's gain taken out.
    """

    def __init__(self, samples: Samples):
        n = samples.light.shape[-1]
        y = samples.rows.mean(0).ravel()
        order = np.argsort(y, kind="stable")
        groups = np.array_split(order, min(BINS, n))
        flat, rows = (one.reshape(len(samples.times_s), -1) for one in (samples.light, samples.rows))
        self.times_s = samples.times_s
        self.rows = np.stack([rows[:, g].mean(1) for g in groups])  # (bins, frames)
        self._share = samples.weights[:, None] / samples.weights.sum()
        self._root = np.sqrt(self._share * len(samples.weights))
        seen = [self._root * (flat[:, g] - (self._share * flat[:, g]).sum(0)) for g in groups]
        self.gram = np.stack([one @ one.T for one in seen])  # (bins, frames, frames)
        self.power = float(np.trace(self.gram, axis1=1, axis2=2).sum())

    def unexplained(self, clock: Clock) -> float:
        """Return the variance that a clock's pairs leave, as a part of all.

        Parameters
        ----------
        clock
            The clock to be judged.
        """
        frames = len(self.times_s)
        pairs = pairs_between(
            clock, float(self.times_s[0]), float(self.times_s[-1]), clock.row_s * float(self.rows.max())
        )
        # a frame more is needed than there are unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        m = clock.design(self.times_s + clock.row_s * self.rows, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        gram = m.transpose(0, 2, 1) @ m
        loading = PAIR_LOADING * 2 * frames / len(pairs) * np.eye(len(pairs))
        b = m.transpose(0, 2, 1) @ self.gram @ m
        got = float(np.trace(np.linalg.solve(gram + loading, b), axis1=1, axis2=2).sum())
        left = max(self.power - got, 0.0) / max(self.power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))


def pairs_between(clock: Clock, first_s: float, last_s: float, late_s: float = 0.0) -> range:
    """Return the pairs that frames between two times show anything of.

    Parameters
    ----------
    clock
        The light's clock, with response and exposure.
    first_s, last_s
        Times of the first and the last frame.
    late_s
        By how much the lowest row is later than the first.
    """
    first = int(np.floor(clock.pair_at(first_s - 3 * clock.response_s)))
    last = int(np.floor(clock.pair_at(last_s + late_s + clock.exposure_s)))
    return range(first, last + 1)


def searched(
    samples: Samples, periods: Iterable[float], frame_s: float, height: int, row_s: float | None
) -> list[tuple[float, Clock]]:
    """Find clocks that explain what is seen, the best first.

    Parameters
    ----------
    samples
        What is seen, the camera's gain taken out.
    periods
        Pattern periods in question in s.
    frame_s
        Frame period in s.
    height
        Rows of a frame.
    row_s
        Time from row to row where it is known; None to find it.

    Returns
    -------
    Some clocks with what they leave unexplained, refined; none where a film could show none of the periods.
    """
    bins, found, begun = Bins(samples), list[tuple[float, Clock]](), list[tuple[float, Clock]]()
    readouts = [r for r in READOUTS_S if r <= LONGEST_READOUT * frame_s * 1.01] or [0.0]
    rows = [r / height for r in readouts] if row_s is None else [row_s]
    for period in periods:
        if period < MOST_PATTERNS_A_FRAME * frame_s or samples.times_s[-1] - samples.times_s[0] < 4 * period:
            continue
        tried = [
            Clock(float(samples.times_s[0]) + 2 * period * k / PHASES, period, row, min(part * frame_s, period))
            for k in range(PHASES)
            for row in rows
            for part in TRIED_EXPOSURES
        ]
        ranked = sorted(((bins.unexplained(one), k) for k, one in enumerate(tried)))
        begun += [(left, tried[k]) for left, k in ranked[:BEST_CLOCKS]]
    begun.sort(key=lambda one: one[0])
    # a wrong rate leaves so much that it need not be refined
    for _, clock in begun[: 2 * BEST_CLOCKS]:
        found.append(refined(bins, clock, frame_s, height, row_s))
    return sorted(found, key=lambda one: one[0])


MOST_PATTERNS_A_FRAME = 1.7
"""Least frames of a pattern: with fewer, no frame of some rows shows a pattern by itself."""


def refined(
    bins: Bins, clock: Clock, frame_s: float, height: int, row_s: float | None, steps: int = 120
) -> tuple[float, Clock]:
    """Improve a clock by what it leaves unexplained.

    Parameters
    ----------
    bins
        What is seen, by groups of rows.
    clock
        Clock to begin with.
    frame_s
        Frame period in s.
    height
        Rows of a frame.
    row_s
        Time from row to row where it is known; None to find it.
    steps
        Most evaluations of a clock.

    Returns
    -------
    What it leaves unexplained, and the clock.
    """
    from scipy.optimize import minimize

    middle = float(bins.times_s.mean())
    anchor = clock.begins(round(clock.pair_at(middle)))
    scale = np.array([0.1 * clock.period_s, 3e-3 / height, 0.25 * frame_s, 3e-3, 1e-3 * clock.period_s])

    def made(v: Floats) -> Clock:
        start, row, exposure, response, period = v * scale
        return Clock(
            anchor + start,
            clock.period_s + period,
            clock.row_s + (row if row_s is None else 0.0),
            clock.exposure_s + exposure,
            clock.response_s + response,
        )

    def cost(v: Floats) -> float:
        one = made(v)
        # what no device does costs as much as it is off
        off = max(0.0, -one.row_s * height) + max(0.0, one.row_s * height - LONGEST_READOUT * frame_s)
        off += max(0.0, 0.03 * frame_s - one.exposure_s) + max(0.0, one.exposure_s - frame_s)
        off += max(0.0, -one.response_s) + max(0.0, one.response_s - 0.03)
        bounded = replace(
            one,
            row_s=float(np.clip(one.row_s, 0, LONGEST_READOUT * frame_s / height)),
            exposure_s=float(np.clip(one.exposure_s, 0.03 * frame_s, frame_s)),
            response_s=float(np.clip(one.response_s, 0, 0.03)),
        )
        drift = (one.period_s / clock.period_s - 1) / 2e-3
        return bins.unexplained(bounded) + off / frame_s + 1e-3 * drift**2

    found = minimize(
        cost,
        np.zeros(5),
        method="Nelder-Mead",
        options={"maxfev": steps, "xatol": 1e-2, "fatol": 1e-5, "initial_simplex": np.vstack([np.zeros(5), np.eye(5)])},
    )
    one = made(found.x)
    one = replace(
        one,
        row_s=float(np.clip(one.row_s, 0, LONGEST_READOUT * frame_s / height)),
        exposure_s=float(np.clip(one.exposure_s, 0.03 * frame_s, frame_s)),
        response_s=float(np.clip(one.response_s, 0, 0.03)),
    )
    return bins.unexplained(one), one


@dataclass(frozen=True)
class Solved:
    """Pairs of patterns as least squares give them.

    Attributes
    ----------
    pairs
        Numbers of the pairs.
    change
        (pairs, n, n) d in the light's unit.
    variance
        (pairs, n, n) variance of d by that of one sample.
    light
        (n, n) mean light c of each cell.
    left
        (frames, n, n) what is not explained.
    """

    pairs: range
    change: Floats
    variance: Floats
    light: Floats
    left: Floats


def solved(samples: Samples, clock: Clock, weights: Floats | None = None) -> Solved:
    """Solve the pairs of all cells.

    Parameters
    ----------
    samples
        What is seen, the camera's gain taken out.
    clock
        The light's clock, as `refined` gives it.
    weights
        (frames,) how far each frame is trusted, 0 to 1; None for all alike.
    """
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
