"""When each cell of each frame was exposed to which pattern: the light's clock, found from the light alone.

A pair of patterns is 2 + d and 2 - d in levels, so that a cell shows

    y_i = g_i (c + sum_p d_p q(t_i + r y - 2 p T)),   q = w(t) - w(t - T)

w(t) is the mean of one pattern's light over an exposure that begins t after it, t_i the time of frame i, r y that of
the cell's row of pixels, T the pattern period and g_i the camera's gain. Given phase, row time, exposure and response
the d are linear least squares. What they leave unexplained judges the rest: variable projection. No header is needed
for it.

The light of an array's cells in some frames, and how much of it a clock leaves unexplained.

The search of the light's clock: rates and phases that are tried, and the best of them refined.

What is kept of an array: samples of its frames, with the way in which the camera reads its rows out.

When the light's clock is looked for, among which rates, and by which way of reading out.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.screen.cells import Sample, SearchBudget

RESPONSE_S = 0.005
"""Response of a display that a search begins with: 2 to 15 ms."""


@dataclass(frozen=True)
class Clock:
    """What decides which pattern a row sees."""

    # Time of a pair's start by the camera's clock
    start_s: float
    # Pattern period T by the camera's clock
    period_s: float
    # Time from a row of pixels to the next
    row_s: float
    # Exposure of each row of pixels
    exposure_s: float
    # Time constant of the display
    response_s: float = RESPONSE_S

    def pair_at(self, time_s: float) -> float:
        """Return the number of pairs from the start to a time."""
        return (time_s - self.start_s) / (2 * self.period_s)

    def begins(self, pair: float) -> float:
        """Return the time at which a pair begins."""
        return self.start_s + 2 * pair * self.period_s

    def design(self, times_s: Floats, pairs: Sequence[int]) -> Floats:
        """Return q for exposures that begin at some times, (..., pairs)."""
        t = times_s[..., None] - self.start_s - 2 * self.period_s * np.asarray(pairs)
        # q is the second difference of the integral of the step response
        edges = (t, t - self.period_s, t - 2 * self.period_s)
        a, b, c = (self._risen(one + self.exposure_s) - self._risen(one) for one in edges)
        return (a - 2 * b + c) / self.exposure_s

    def _risen(self, t: Floats) -> Floats:
        t, tau = np.maximum(t, 0), max(self.response_s, 1e-5)
        return t + tau * np.expm1(-t / tau)


def pairs_between(clock: Clock, first_s: float, last_s: float, late_s: float = 0.0) -> range:
    """Return the pairs that frames between two times show anything of."""
    first = int(np.floor(clock.pair_at(first_s - 3 * clock.response_s)))
    last = int(np.floor(clock.pair_at(last_s + late_s + clock.exposure_s)))
    return range(first, last + 1)


BINS = 8
"""Groups of cells by row of pixels that are taken at one time. Chosen: an eighth of a frame's readout is 4 ms at
most."""

CLOCK_SAMPLES, PRODUCT_SAMPLES = 5000, 0.008
"""Work of judging a clock, and of a product in it, in `budget.SAMPLES_PER_S`."""

PAIR_LOADING = 1e-3
"""Loading of the least squares, by the power of a frame: a pair that hardly any frame shows must not be made of
noise."""


@dataclass(frozen=True)
class Samples:
    """Light of an array's cells in some frames."""

    # (frames,) starts of the exposures of row 0, by the camera's clock
    times_s: Floats
    # (frames, n, n) row of pixels of each cell
    rows: Floats
    # (frames, n, n) light in any unit, linear
    light: Floats
    # (frames,) inverse variance of the light, in any unit
    weights: Floats

    def between(self, start_s: float, end_s: float) -> "Samples":
        """Return those of frames between two times."""
        kept = (self.times_s >= start_s) & (self.times_s <= end_s)
        return Samples(self.times_s[kept], self.rows[kept], self.light[kept], self.weights[kept])

    def evened(self, gains: Floats) -> "Samples":
        """Return the same without the camera's gain."""
        whole = np.maximum(gains if gains.ndim == 1 else gains.mean((1, 2)), TINY)
        # what is divided by a small gain is noisy
        weights = self.weights * np.clip(whole / np.median(whole), 0, 1) ** 2
        shape = (len(gains), 1, 1) if gains.ndim == 1 else gains.shape
        return replace(self, light=self.light / np.maximum(gains.reshape(shape), TINY), weights=weights + TINY)


class Bins:
    """Samples by groups of rows of pixels, for the search of a clock."""

    def __init__(self, samples: Samples, budget: SearchBudget | None = None):
        self._budget = budget or SearchBudget()
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
        """Return the variance that a clock's pairs leave, as a part of all."""
        frames = len(self.times_s)
        pairs = pairs_between(
            clock, float(self.times_s[0]), float(self.times_s[-1]), clock.row_s * float(self.rows.max())
        )
        # a frame more is needed than there are unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        self._budget.spend(
            CLOCK_SAMPLES + PRODUCT_SAMPLES * len(self.rows) * frames * len(pairs) * (frames + len(pairs))
        )
        m = clock.design(self.times_s + clock.row_s * self.rows, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        gram = m.transpose(0, 2, 1) @ m
        loading = PAIR_LOADING * 2 * frames / len(pairs) * np.eye(len(pairs))
        b = m.transpose(0, 2, 1) @ self.gram @ m
        got = float(np.trace(np.linalg.solve(gram + loading, b), axis1=1, axis2=2).sum())
        left = max(self.power - got, 0.0) / max(self.power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))


PHASES = 16
"""Phases of a pair that are tried: an eighth of a pattern apart, which loses little of a match; they are refined."""

BEST_CLOCKS = 2
"""Clocks of a rate from which a search is refined. Chosen: phase and readout of one may lie on the wrong side."""

READOUTS_S = (0.0, 0.008, 0.016, 0.024)
"""Times for all rows of a frame that are tried: phones take 5 to 30 ms."""

TRIED_EXPOSURES = (0.3, 0.9)
"""Exposures that are tried, in frame periods."""

ROUGH_EXPOSURE, ROUGH_PHASES, BEST_RATES = 0.6, 8, 4
"""Exposure in frame periods and phases by which rates are compared at first, and how many of them are looked at
closely. Chosen: a wrong readout or exposure leaves a right rate ahead of others."""

UNFOLLOWED = 0.85
"""Part of what changes from which a clock that a search begins with is not followed up: of what is no light at all it
is 0.9 to 1.1."""

NEARBY, NEARER_STEPS = (0.985, 0.995, 1.005, 1.015), 3
"""Pattern periods about the best one that are tried, by it, and how often. Chosen: rates that are tried are 3 %
apart."""

MUCH_BETTER = 0.7
"""Part of what is unexplained that a rate nearby must leave at most. Chosen: patterns of a display that skips refreshes
come early and late, which other rates explain by a fifth better."""

LONGEST_READOUT = 1.0
"""Longest readout of a frame in frame periods."""

MOST_PATTERNS_A_FRAME = 1.7
"""Least frames of a pattern: with fewer, no frame of some rows shows a pattern by itself."""


def searched(
    samples: Samples,
    periods: Iterable[float],
    frame_s: float,
    height: int,
    row_s: float | None,
    budget: SearchBudget | None = None,
) -> list[tuple[float, Clock]]:
    """Find clocks that explain what is seen, the best first."""
    bins = Bins(samples, budget)
    readouts = [r for r in READOUTS_S if r <= LONGEST_READOUT * frame_s * 1.01] or [0.0]
    rows = [r / height for r in readouts] if row_s is None else [row_s]
    length = float(samples.times_s[-1] - samples.times_s[0])
    shown = [one for one in periods if one >= MOST_PATTERNS_A_FRAME * frame_s and length >= 4 * one]
    if len(shown) > BEST_RATES:
        rough = [rows[len(rows) // 2]], [ROUGH_EXPOSURE * frame_s]
        first = {one: _begun(bins, one, *rough, ROUGH_PHASES)[0][0] for one in shown}
        shown = sorted((one for one in shown if first[one] < UNFOLLOWED), key=lambda one: first[one])[:BEST_RATES]
    exposures = [part * frame_s for part in TRIED_EXPOSURES]
    begun = [one for period in shown for one in _begun(bins, period, rows, exposures)[:BEST_CLOCKS]]
    # a wrong rate leaves so much that it need not be refined
    begun = sorted((one for one in begun if one[0] < UNFOLLOWED), key=lambda one: one[0])
    found = [refined(bins, clock, frame_s, height, row_s) for _, clock in begun[: 2 * BEST_CLOCKS]]
    found.sort(key=lambda one: one[0])
    if found:
        found[0] = _nearer(bins, *found[0], frame_s, height, row_s)
    return found


def _nearer(
    bins: Bins, left: float, clock: Clock, frame_s: float, height: int, row_s: float | None
) -> tuple[float, Clock]:
    """A better clock of a rate nearby, and what it leaves unexplained: a refined one hardly leaves the rate tried."""
    middle, first = clock.begins(round(clock.pair_at(float(bins.times_s.mean())))), (left, clock)
    for _ in range(NEARER_STEPS):
        tried = [replace(clock, start_s=middle, period_s=clock.period_s * by) for by in NEARBY]
        less, best = min(((bins.unexplained(one), one) for one in tried), key=lambda one: one[0])
        if less >= left:
            break
        left, clock = refined(bins, best, frame_s, height, row_s)
    return (left, clock) if left < MUCH_BETTER * first[0] else first


def _begun(
    bins: Bins, period_s: float, rows_s: list[float], exposures_s: list[float], phases: int = PHASES
) -> list[tuple[float, Clock]]:
    """Clocks of a rate with what they leave unexplained, the best first."""
    tried = [
        Clock(float(bins.times_s[0]) + 2 * period_s * k / phases, period_s, row, min(exposure, period_s))
        for k in range(phases)
        for row in rows_s
        for exposure in exposures_s
    ]
    return sorted(((bins.unexplained(one), one) for one in tried), key=lambda one: one[0])


def refined(
    bins: Bins, clock: Clock, frame_s: float, height: int, row_s: float | None, steps: int = 120
) -> tuple[float, Clock]:
    """Improve a clock by what it leaves unexplained."""
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


FLICKER = 0.15
"""Part by which a frame's light differs from that of the frames around, from which it is the backlight's and not that
of the data: of 16 x 16 cells these differ by 0.03 rms, of 8 x 8 by 0.06."""


@dataclass(frozen=True)
class Readout:
    """The way in which a frame is read out, as pictures that are turned upright show it."""

    # 0 where columns are read one after the other, 1 where rows are
    axis: int
    # Whether the last one is read first
    back: bool
    # Columns or rows of a frame
    length: int

    def rows(self, at: Floats) -> Floats:
        """Return how many rows of the sensor are read before some places."""
        row = at[..., self.axis]
        return self.length - 1 - row if self.back else row


class Kept:
    """Samples of an array that are kept."""

    def __init__(self, shape: tuple[int, ...], frame_s: float):
        self.readouts = [Readout(axis, back, shape[1 - axis]) for axis in (1, 0) for back in (False, True)]
        self.readout = self.readouts[0]
        self.frame_s = frame_s
        self._samples: deque[Sample] = deque()

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def first(self) -> Sample:
        """The first sample that is kept."""
        return self._samples[0]

    @property
    def last(self) -> Sample:
        """The last sample."""
        return self._samples[-1]

    def take(self, sample: Sample) -> None:
        """Keep a sample."""
        self._samples.append(sample)

    def drop_before(self, time_s: float) -> None:
        """Forget samples before a time, but for the last one."""
        while len(self._samples) > 1 and self._samples[0].time_s < time_s:
            self._samples.popleft()

    def between(self, start_s: float, end_s: float) -> list[Sample]:
        """Return the samples between two times."""
        return [one for one in self._samples if start_s <= one.time_s <= end_s]

    def gathered(self, start_s: float, end_s: float) -> Samples:
        """Return the light and the rows of cells between two times."""
        kept = self.between(start_s, end_s)
        return Samples(
            np.array([one.time_s for one in kept]),
            np.stack([self.readout.rows(one.at) for one in kept]),
            np.stack([one.seen.light for one in kept]),
            np.ones(len(kept)),
        )

    def evened(self, start_s: float, end_s: float, clock: Clock) -> Samples:
        """Return the same without the camera's gain, which is even over a pair."""
        samples = self.gathered(start_s, end_s)
        mean, t = samples.light.mean((1, 2)), samples.times_s
        near = np.clip(1.0 + 0.5 * self.frame_s / clock.period_s - np.abs(t[:, None] - t) / clock.period_s, 0, None)
        near = np.minimum(near, self.frame_s / clock.period_s)
        even = (near @ mean) / np.maximum(near.sum(1), TINY)
        # a backlight that is switched shows in single frames
        return samples.evened(np.where(np.abs(mean / np.maximum(even, TINY) - 1) > FLICKER, mean, even))


RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns a second that are tried beside the nominal ones: those that divide a display's 60 Hz, and the commonest
rates of films."""

DISPLAY_RATES = (12.5, 16.7, 25.0, 50.0, 14.4, 18.0, 36.0, 72.0, 18.75, 37.5, 75.0, 10.3, 20.6, 27.5, 33.0, 22.5, 28.8)
"""Patterns a second of displays of 50, 72, 75, 90, 144 and 165 Hz, likewise."""

STEP = 0.03
"""Rates that are tried lie nearer to each other than this, as a fraction. Chosen: over ten patterns the ends are then
off by a sixth of one, from where the right rate is found."""

ANY_RATES = tuple(np.exp(np.arange(0.0, np.log(60.0), STEP)).tolist())
"""Patterns a second that are tried where no usual rate fits, of 1 to 60."""

SEARCH_PAUSE = 0.3
"""Part of the time for which nothing was found that passes to the next search. Chosen: a search takes one or two
seconds."""

MOST_UNEXPLAINED = 0.3
"""Largest part of what changes that a clock may leave unexplained. Of a right one it is 0.003 to 0.1, of a wrong one
0.4 to 1."""

SURELY_EXPLAINED = 0.12
"""The same below which no other rates are tried."""

ENOUGH_PATTERNS, ENOUGH_FRAMES = 10, 16
"""Least patterns and frames from which a clock is found. Chosen: the five numbers of a clock want some pairs of
data."""

LONGEST_SEARCH_S = 6.0
"""Seconds within which a clock is looked for: ten patterns at 2 a second last 5 s."""

BETTER = 0.8
"""Part of what is unexplained that another way of reading out must leave at most. Chosen: of a global shutter all are
alike."""


class ClockSearch:
    """Looks for the light's clock, the more rarely the longer it takes."""

    def __init__(self, period_s: float, row_s: float | None, fixed: bool, budget: SearchBudget):
        self._period_s, self._row_s, self._budget = period_s, row_s, budget
        usual = [1 / rate for rate in (*RATES, *DISPLAY_RATES) if abs(rate * period_s - 1) > STEP / 2]
        self._periods = [[period_s]] if fixed else [[period_s], usual, [1 / rate for rate in ANY_RATES]]
        self._next_s = -np.inf
        self._group = 0  # of rates with which the next search begins

    def again(self) -> None:
        """Look anew: the clock that was found was wrong."""
        self._next_s = -np.inf

    def find(self, kept: Kept, final: bool = False) -> Clock | None:
        """Return the clock, or None where none explains what is seen, or it is too early to look again."""
        now_s = kept.last.time_s
        length = now_s - kept.first.time_s
        if len(kept) < ENOUGH_FRAMES or ((now_s < self._next_s or not self._budget.lasts) and not final):
            return None
        self._next_s = now_s + max(SEARCH_PAUSE * length, 4 * kept.frame_s)
        # others explain a part of a slow light: its own rate has the first word
        waits = length < ENOUGH_PATTERNS * self._period_s and not final
        best: tuple[float, Clock, float] | None = None
        groups = [0] if waits else [*range(self._group, len(self._periods)), *range(self._group)]
        for group in groups:
            periods, self._group = self._periods[group], group
            if group != groups[0] and not self._budget.lasts:
                break
            fit = [p for p in periods if length >= ENOUGH_PATTERNS * p]
            found = self._among(fit, kept) if fit else None
            if found is not None and (best is None or found[0] < best[0]):
                best = found
            if best is not None and best[0] < SURELY_EXPLAINED:
                break
        else:
            self._group = 0
        if best is None:
            kept.drop_before(now_s - 2 * LONGEST_SEARCH_S)
            return None
        left, clock, longest = best
        return self._settled(left, clock, kept, now_s - longest, now_s)

    def _among(self, periods: list[float], kept: Kept) -> tuple[float, Clock, float] | None:
        """The best clock of some rates: what it leaves unexplained, itself, and the seconds by which it was found."""
        longest = max(2 * ENOUGH_PATTERNS * min(periods), ENOUGH_PATTERNS * max(periods)) * 1.2
        samples = kept.gathered(kept.last.time_s - longest, kept.last.time_s)
        samples = samples.evened(samples.light.mean((1, 2)))
        found = searched(samples, periods, kept.frame_s, kept.readout.length, self._row_s, self._budget)
        if not found or found[0][0] >= MOST_UNEXPLAINED:
            return None
        return *found[0], longest

    def _settled(self, left: float, clock: Clock, kept: Kept, start_s: float, end_s: float) -> Clock:
        """Take the way of reading out that explains most: phones film upright pictures with a sensor on its side."""
        first = kept.readout
        best = left, clock, first
        for one in kept.readouts:
            kept.readout = one
            samples = kept.gathered(start_s, end_s)
            bins = Bins(samples.evened(samples.light.mean((1, 2))), self._budget)
            begun = replace(clock, row_s=clock.row_s * first.length / one.length)
            least = best[0] if one is first else BETTER * best[0]
            now, refined_clock = refined(bins, begun, kept.frame_s, one.length, self._row_s)
            if now < least:
                best = now, refined_clock, one
        _, found, kept.readout = best
        return found
