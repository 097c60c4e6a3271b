"""Clock of the light of a screen, estimated from the light of the cells.

A pair of patterns has the levels 2 + d and 2 - d, so that a cell shows

    y_i = g_i (c + sum_p d_p q(t_i + r y - 2 p T)),   q = w(t) - w(t - T)

with the mean light w(t) of a pattern over an exposure from t on, the time t_i of frame i, the row time r, the
sensor row y of the cell, the pattern period T and the gain g_i of the camera. Given phase, row time, exposure and
response, the d are linear least squares; the residual judges the other parameters (variable projection). No header is
needed.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.screen.cells import Sample, SearchBudget

MAX_RESPONSE_S = 0.03
"""Maximum time constant of a display in seconds."""


@dataclass(frozen=True)
class ClockParameters:
    """Parameters of the clock search; exposures and readouts in frame periods."""

    # Groups of cells by sensor row that share a time: 4 ms of readout at most
    row_bins: int = 8
    # Work of a clock, and of a product in the solution, in samples
    clock_samples: int = 5000
    product_samples: float = 0.008
    # Loading of the least squares, relative to the power of a frame
    loading: float = 1e-3
    # Phases of a pair per rate, and for the comparison of many rates
    phases: int = 16
    rough_phases: int = 8
    # Exposures to try, and the exposure for the comparison of many rates
    exposures: tuple[float, float] = (0.3, 0.9)
    rough_exposure: float = 0.6
    # Readout times of all rows in seconds to try: phones take 5 to 30 ms
    readouts_s: tuple[float, ...] = (0.0, 0.008, 0.016, 0.024)
    # Closely compared rates, and refined clocks per rate
    best_rates: int = 4
    best_clocks: int = 2
    # Maximum unexplained part for a refinement; without a light 0.9 to 1.1 is unexplained
    max_rough_unexplained: float = 0.85
    # Relative periods to try near the best, how often, and the required reduction of the unexplained part
    nearby: tuple[float, ...] = (0.985, 0.995, 1.005, 1.015)
    nearby_steps: int = 3
    nearby_gain: float = 0.7
    # Maximum readout of a frame, and minimum exposure
    max_readout: float = 1.0
    min_exposure: float = 0.03
    # Minimum pattern period in frame periods: some rows would never show a single pattern
    min_period: float = 1.7
    # Deviation of the light of a frame from the neighbours above which the backlight flickers
    flicker: float = 0.15
    # Pause until the next search, as a part of the time searched so far
    pause_share: float = 0.3
    # Maximum unexplained part of a clock: 0.003 to 0.1 for the right clock, 0.4 to 1 for others
    max_unexplained: float = 0.3
    # Unexplained part below which no other rates are tried
    certain_unexplained: float = 0.12
    # Minimum number of patterns and of frames for a clock
    min_patterns: int = 10
    min_frames: int = 16
    # Duration of the kept samples in seconds
    max_search_s: float = 12.0
    # Required reduction of the unexplained part for another readout direction
    readout_gain: float = 0.8


PARAMETERS = ClockParameters()


@dataclass(frozen=True)
class Clock:
    """Timing of the light and of the exposures."""

    # Start of a pair in camera time
    start_s: float
    # Pattern period T in camera time
    period_s: float
    # Time from a row of pixels to the next
    row_s: float
    # Exposure of each row of pixels
    exposure_s: float
    # Time constant of the display: 2 to 15 ms
    response_s: float = 0.005

    def pair_at(self, time_s: float) -> float:
        """Convert a time to pairs since the start."""
        return (time_s - self.start_s) / (2 * self.period_s)

    def start_of(self, pair: float) -> float:
        """Return the start of a pair in seconds."""
        return self.start_s + 2 * pair * self.period_s

    def design(self, times_s: Floats, pairs: Sequence[int]) -> Floats:
        """Return q for exposures that begin at given times, (..., pairs)."""
        t = times_s[..., None] - self.start_s - 2 * self.period_s * np.asarray(pairs)
        # q is the second difference of the integral of the step response
        edges = (t, t - self.period_s, t - 2 * self.period_s)
        a, b, c = (self._ramp(edge + self.exposure_s) - self._ramp(edge) for edge in edges)
        return (a - 2 * b + c) / self.exposure_s

    def _ramp(self, t: Floats) -> Floats:
        """Return the integral of the step response of the display."""
        t, tau = np.maximum(t, 0), max(self.response_s, 1e-5)
        return t + tau * np.expm1(-t / tau)


def pairs_between(clock: Clock, first_s: float, last_s: float, late_s: float = 0.0) -> range:
    """Return the pairs that overlap exposures between two times."""
    first = int(np.floor(clock.pair_at(first_s - 3 * clock.response_s)))
    last = int(np.floor(clock.pair_at(last_s + late_s + clock.exposure_s)))
    return range(first, last + 1)


@dataclass(frozen=True)
class Samples:
    """Light of the cells of an array in some frames."""

    # (frames,) starts of the exposures of row 0 in camera time
    times_s: Floats
    # (frames, n, n) sensor row of each cell
    rows: Floats
    # (frames, n, n) light in any unit, linear
    light: Floats
    # (frames,) inverse variance of the light, in any unit
    weights: Floats

    def without_gain(self, gains: Floats) -> "Samples":
        """Divide the light by the gain of each frame."""
        gains = np.maximum(gains, TINY)
        # a small gain amplifies noise
        weights = self.weights * np.clip(gains / np.median(gains), 0, 1) ** 2
        return replace(self, light=self.light / gains[:, None, None], weights=weights + TINY)


class RowBins:
    """Samples grouped by sensor rows, for the search of a clock."""

    def __init__(self, samples: Samples, budget: SearchBudget | None = None):
        self._budget = budget or SearchBudget()
        n = samples.light.shape[-1]
        y = samples.rows.mean(0).ravel()
        order = np.argsort(y, kind="stable")
        groups = np.array_split(order, min(PARAMETERS.row_bins, n))
        flat, rows = (values.reshape(len(samples.times_s), -1) for values in (samples.light, samples.rows))
        self.times_s = samples.times_s
        self.rows = np.stack([rows[:, g].mean(1) for g in groups])  # (bins, frames)
        self._share = samples.weights[:, None] / samples.weights.sum()
        self._root = np.sqrt(self._share * len(samples.weights))
        centred = [self._root * (flat[:, g] - (self._share * flat[:, g]).sum(0)) for g in groups]
        self.gram = np.stack([light @ light.T for light in centred])  # (bins, frames, frames)
        self.power = float(np.trace(self.gram, axis1=1, axis2=2).sum())

    def unexplained(self, clock: Clock) -> float:
        """Return the fraction of the variance that the pairs of a clock leave unexplained."""
        frames, rows = len(self.times_s), len(self.rows)
        late_s = clock.row_s * float(self.rows.max())
        pairs = pairs_between(clock, float(self.times_s[0]), float(self.times_s[-1]), late_s)
        # at least one frame more than unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        products = rows * frames * len(pairs) * (frames + len(pairs))
        self._budget.spend(PARAMETERS.clock_samples + PARAMETERS.product_samples * products)
        m = clock.design(self.times_s + clock.row_s * self.rows, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        gram = m.transpose(0, 2, 1) @ m
        loading = PARAMETERS.loading * 2 * frames / len(pairs) * np.eye(len(pairs))
        b = m.transpose(0, 2, 1) @ self.gram @ m
        explained = float(np.trace(np.linalg.solve(gram + loading, b), axis1=1, axis2=2).sum())
        left = max(self.power - explained, 0.0) / max(self.power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))


def search_clocks(
    samples: Samples,
    periods: Iterable[float],
    frame_s: float,
    height: int,
    row_s: float | None,
    budget: SearchBudget | None = None,
) -> list[tuple[float, Clock]]:
    """Search clocks for the samples; return the unexplained parts and the clocks, the best first."""
    bins, parameters = RowBins(samples, budget), PARAMETERS
    readouts = [r for r in parameters.readouts_s if r <= parameters.max_readout * frame_s * 1.01] or [0.0]
    rows = [r / height for r in readouts] if row_s is None else [row_s]
    length = float(samples.times_s[-1] - samples.times_s[0])
    tried = [period for period in periods if period >= parameters.min_period * frame_s and length >= 4 * period]
    if len(tried) > parameters.best_rates:
        rough = [rows[len(rows) // 2]], [parameters.rough_exposure * frame_s], parameters.rough_phases
        unexplained = {period: _rough_clocks(bins, period, *rough)[0][0] for period in tried}
        tried = [period for period in tried if unexplained[period] < parameters.max_rough_unexplained]
        tried = sorted(tried, key=lambda period: unexplained[period])[: parameters.best_rates]
    exposures = [exposure * frame_s for exposure in parameters.exposures]
    rough_clocks = [
        clock
        for period in tried
        for clock in _rough_clocks(bins, period, rows, exposures, parameters.phases)[: parameters.best_clocks]
    ]
    # a wrong rate needs no refinement
    rough_clocks = [clock for clock in rough_clocks if clock[0] < parameters.max_rough_unexplained]
    rough_clocks.sort(key=lambda clock: clock[0])
    best = rough_clocks[: 2 * parameters.best_clocks]
    clocks = [refine_clock(bins, clock, frame_s, height, row_s) for _, clock in best]
    clocks.sort(key=lambda clock: clock[0])
    if clocks:
        clocks[0] = _search_nearby(bins, *clocks[0], frame_s, height, row_s)
    return clocks


def _search_nearby(
    bins: RowBins, left: float, clock: Clock, frame_s: float, height: int, row_s: float | None
) -> tuple[float, Clock]:
    """Search a better clock of a nearby rate, as a refinement hardly changes the rate."""
    middle, first = clock.start_of(round(clock.pair_at(float(bins.times_s.mean())))), (left, clock)
    for _ in range(PARAMETERS.nearby_steps):
        tried = [replace(clock, start_s=middle, period_s=clock.period_s * factor) for factor in PARAMETERS.nearby]
        less, best = _sorted_clocks(bins, tried)[0]
        if less >= left:
            break
        left, clock = refine_clock(bins, best, frame_s, height, row_s)
    return (left, clock) if left < PARAMETERS.nearby_gain * first[0] else first


def _rough_clocks(
    bins: RowBins, period_s: float, rows_s: list[float], exposures_s: list[float], phases: int
) -> list[tuple[float, Clock]]:
    """Try phases, row times and exposures of a rate; return unexplained parts and clocks, the best first."""
    start_s = float(bins.times_s[0])
    tried = [
        Clock(start_s + 2 * period_s * k / phases, period_s, row, min(exposure, period_s))
        for k in range(phases)
        for row in rows_s
        for exposure in exposures_s
    ]
    return _sorted_clocks(bins, tried)


def _sorted_clocks(bins: RowBins, clocks: list[Clock]) -> list[tuple[float, Clock]]:
    """Return the unexplained parts and the clocks, the best first."""
    return sorted(((bins.unexplained(clock), clock) for clock in clocks), key=lambda clock: clock[0])


def refine_clock(
    bins: RowBins, clock: Clock, frame_s: float, height: int, row_s: float | None, max_evaluations: int = 120
) -> tuple[float, Clock]:
    """Minimise the unexplained part from a clock on; return the unexplained part and the clock."""
    from scipy.optimize import minimize

    anchor = clock.start_of(round(clock.pair_at(float(bins.times_s.mean()))))
    scale = np.array([0.1 * clock.period_s, 3e-3 / height, 0.25 * frame_s, 3e-3, 1e-3 * clock.period_s])
    max_readout_s, min_exposure_s = PARAMETERS.max_readout * frame_s, PARAMETERS.min_exposure * frame_s

    def clock_at(v: Floats) -> Clock:
        start, row, exposure, response, period = v * scale
        return Clock(
            anchor + start,
            clock.period_s + period,
            clock.row_s + (row if row_s is None else 0.0),
            clock.exposure_s + exposure,
            clock.response_s + response,
        )

    def bounded(free: Clock) -> Clock:
        return replace(
            free,
            row_s=float(np.clip(free.row_s, 0, max_readout_s / height)),
            exposure_s=float(np.clip(free.exposure_s, min_exposure_s, frame_s)),
            response_s=float(np.clip(free.response_s, 0, MAX_RESPONSE_S)),
        )

    def cost(v: Floats) -> float:
        free = clock_at(v)
        # values outside the bounds cost the excess
        off = max(0.0, -free.row_s * height) + max(0.0, free.row_s * height - max_readout_s)
        off += max(0.0, min_exposure_s - free.exposure_s) + max(0.0, free.exposure_s - frame_s)
        off += max(0.0, -free.response_s) + max(0.0, free.response_s - MAX_RESPONSE_S)
        drift = (free.period_s / clock.period_s - 1) / 2e-3
        return bins.unexplained(bounded(free)) + off / frame_s + 1e-3 * drift**2

    simplex = np.vstack([np.zeros(5), np.eye(5)])
    options = {"maxfev": max_evaluations, "xatol": 1e-2, "fatol": 1e-5, "initial_simplex": simplex}
    best = bounded(clock_at(minimize(cost, np.zeros(5), method="Nelder-Mead", options=options).x))
    return bins.unexplained(best), best


@dataclass(frozen=True)
class RowTiming:
    """Readout direction of upright frames."""

    # 0 if columns are read one after the other, 1 for rows
    axis: int
    # True if the last row is read first
    is_reversed: bool
    # Number of columns or rows of a frame
    length: int

    def rows(self, at: Floats) -> Floats:
        """Return the number of sensor rows read before given places."""
        row = at[..., self.axis]
        return self.length - 1 - row if self.is_reversed else row


class SampleBuffer:
    """Recent samples of an array."""

    def __init__(self, shape: tuple[int, ...], frame_s: float):
        self.readouts = [RowTiming(axis, back, shape[1 - axis]) for axis in (1, 0) for back in (False, True)]
        self.readout = self.readouts[0]
        self.frame_s = frame_s
        self._samples: deque[Sample] = deque()

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def first(self) -> Sample:
        """The first sample."""
        return self._samples[0]

    @property
    def last(self) -> Sample:
        """The last sample."""
        return self._samples[-1]

    def add(self, sample: Sample) -> None:
        """Add a sample."""
        self._samples.append(sample)

    def drop_before(self, time_s: float) -> None:
        """Drop samples before a time, except the last sample."""
        while len(self._samples) > 1 and self._samples[0].time_s < time_s:
            self._samples.popleft()

    def between(self, start_s: float, end_s: float) -> list[Sample]:
        """Return the samples between two times."""
        return [sample for sample in self._samples if start_s <= sample.time_s <= end_s]

    def light_between(self, start_s: float, end_s: float) -> Samples:
        """Return the light and the rows of the cells between two times."""
        samples = self.between(start_s, end_s)
        return Samples(
            np.array([sample.time_s for sample in samples]),
            np.stack([self.readout.rows(sample.at) for sample in samples]),
            np.stack([sample.fit.light for sample in samples]),
            np.ones(len(samples)),
        )

    def normalised_between(self, start_s: float, end_s: float, clock: Clock) -> Samples:
        """Return the light between two times without the gain of the camera, which is constant over a pair."""
        samples = self.light_between(start_s, end_s)
        mean, t = samples.light.mean((1, 2)), samples.times_s
        near = np.clip(1.0 + 0.5 * self.frame_s / clock.period_s - np.abs(t[:, None] - t) / clock.period_s, 0, None)
        near = np.minimum(near, self.frame_s / clock.period_s)
        smooth = (near @ mean) / np.maximum(near.sum(1), TINY)
        # a switched backlight changes single frames
        is_flicker = np.abs(mean / np.maximum(smooth, TINY) - 1) > PARAMETERS.flicker
        return samples.without_gain(np.where(is_flicker, mean, smooth))


RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns per second to try first: divisors of 60 Hz, and common frame rates of films."""

DISPLAY_RATES = (12.5, 16.7, 25.0, 50.0, 14.4, 18.0, 36.0, 72.0, 18.75, 37.5, 75.0, 10.3, 20.6, 27.5, 33.0, 22.5, 28.8)
"""Patterns per second of displays of 50, 72, 75, 90, 144 and 165 Hz."""

RATE_STEP = 0.03
"""Relative distance of neighbouring rates: ten patterns are then off by a sixth of a pattern at the ends."""

ANY_RATES = tuple(np.exp(np.arange(0.0, np.log(60.0), RATE_STEP)).tolist())
"""Patterns per second, 1 to 60, to try last."""


class ClockSearch:
    """Search for the clock of the light, at growing intervals."""

    def __init__(self, period_s: float, row_s: float | None, is_fixed: bool, budget: SearchBudget):
        self._period_s, self._row_s, self._budget = period_s, row_s, budget
        usual = [1 / rate for rate in (*RATES, *DISPLAY_RATES) if abs(rate * period_s - 1) > RATE_STEP / 2]
        self._periods = [[period_s]] if is_fixed else [[period_s], usual, [1 / rate for rate in ANY_RATES]]
        self._next_s = -np.inf
        self._group = 0  # group of rates at which the next search starts

    def restart(self) -> None:
        """Search again at once, after a wrong clock."""
        self._next_s = -np.inf

    def find(self, samples: SampleBuffer, final: bool = False) -> Clock | None:
        """Return the clock; None without a clock, or before the next search is due."""
        now_s, parameters = samples.last.time_s, PARAMETERS
        length = now_s - samples.first.time_s
        is_due = final or (now_s >= self._next_s and self._budget.is_left)
        if len(samples) < parameters.min_frames or not is_due:
            return None
        self._next_s = now_s + max(parameters.pause_share * length, 4 * samples.frame_s)
        # other rates explain a part of a slow light: the nominal rate comes first
        waits = length < parameters.min_patterns * self._period_s and not final
        best: tuple[float, Clock, float] | None = None
        groups = [0] if waits else [*range(self._group, len(self._periods)), *range(self._group)]
        for group in groups:
            periods, self._group = self._periods[group], group
            if group != groups[0] and not self._budget.is_left:
                break
            fitting = [period for period in periods if length >= parameters.min_patterns * period]
            candidate = self._search_rates(fitting, samples) if fitting else None
            if candidate is not None and (best is None or candidate[0] < best[0]):
                best = candidate
            if best is not None and best[0] < parameters.certain_unexplained:
                break
        else:
            self._group = 0
        if best is None:
            samples.drop_before(now_s - parameters.max_search_s)
            return None
        left, clock, length_s = best
        return self._select_readout(left, clock, samples, now_s - length_s, now_s)

    def _search_rates(self, periods: list[float], buffer: SampleBuffer) -> tuple[float, Clock, float] | None:
        """Return unexplained part, clock and duration of the samples in seconds for the best of some rates."""
        length_s = max(2 * min(periods), max(periods)) * PARAMETERS.min_patterns * 1.2
        samples = buffer.light_between(buffer.last.time_s - length_s, buffer.last.time_s)
        samples = samples.without_gain(samples.light.mean((1, 2)))
        clocks = search_clocks(samples, periods, buffer.frame_s, buffer.readout.length, self._row_s, self._budget)
        if not clocks or clocks[0][0] >= PARAMETERS.max_unexplained:
            return None
        return *clocks[0], length_s

    def _select_readout(self, left: float, clock: Clock, buffer: SampleBuffer, start_s: float, end_s: float) -> Clock:
        """Select the readout direction that explains most: phones may hold the sensor sideways."""
        first = buffer.readout
        best = left, clock, first
        for readout in buffer.readouts:
            buffer.readout = readout
            samples = buffer.light_between(start_s, end_s)
            bins = RowBins(samples.without_gain(samples.light.mean((1, 2))), self._budget)
            start = replace(clock, row_s=clock.row_s * first.length / readout.length)
            least = best[0] if readout is first else PARAMETERS.readout_gain * best[0]
            now, candidate = refine_clock(bins, start, buffer.frame_s, readout.length, self._row_s)
            if now < least:
                best = now, candidate, readout
        _, selected, buffer.readout = best
        return selected
