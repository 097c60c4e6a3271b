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
from heliograph.receive.screen.cells import PARAMETERS, Sample, SearchBudget

MAX_RESPONSE_S = 0.03
"""Maximum time constant of a display in seconds."""

RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns per second to try first: divisors of 60 Hz, and common frame rates of films."""

DISPLAY_RATES = (12.5, 16.7, 25.0, 50.0, 14.4, 18.0, 36.0, 72.0, 18.75, 37.5, 75.0, 10.3, 20.6, 27.5, 33.0, 22.5, 28.8)
"""Patterns per second of displays of 50, 72, 75, 90, 144 and 165 Hz."""

RATE_STEP = 0.03
"""Relative distance of neighbouring rates: ten patterns are then off by a sixth of a pattern at the ends."""

ANY_RATES = tuple(np.exp(np.arange(0.0, np.log(60.0), RATE_STEP)).tolist())
"""Patterns per second, 1 to 60, to try last."""


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

    def pairs(self, times_s: Floats, rows: Floats) -> range:
        """Return the pairs that overlap the exposures of rows in frames."""
        first = self.pair_at(float(times_s[0]) - 3 * self.response_s)
        last = self.pair_at(float(times_s[-1]) + self.row_s * float(rows.max()) + self.exposure_s)
        return range(int(np.floor(first)), int(np.floor(last)) + 1)

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


RatedClock = tuple[float, Clock]
"""Part of the variance that the pairs of a clock leave unexplained, and the clock."""


@dataclass(frozen=True)
class Samples:
    """Light of the cells of an array in some frames, without the gain of the camera."""

    # (frames,) starts of the exposures of row 0 in camera time
    times_s: Floats
    # (frames, n, n) sensor row of each cell
    rows: Floats
    # (frames, n, n) light in any unit, linear
    light: Floats
    # (frames,) inverse variance of the light, in any unit
    weights: Floats


class ClockFitter:
    """Fits clocks to samples, grouped by sensor rows."""

    def __init__(self, samples: Samples, frame_s: float, height: int, row_s: float | None, budget: SearchBudget):
        self._frame_s, self._height, self._row_s, self._budget = frame_s, height, row_s, budget
        n = samples.light.shape[-1]
        order = np.argsort(samples.rows.mean(0).ravel(), kind="stable")
        groups = np.array_split(order, min(PARAMETERS.row_bins, n))
        flat, rows = (values.reshape(len(samples.times_s), -1) for values in (samples.light, samples.rows))
        self._times_s, self._middle_s = samples.times_s, float(samples.times_s.mean())
        self._rows = np.stack([rows[:, g].mean(1) for g in groups])  # (bins, frames)
        self._share = samples.weights[:, None] / samples.weights.sum()
        self._root = np.sqrt(self._share * len(samples.weights))
        centred = [self._root * (flat[:, g] - (self._share * flat[:, g]).sum(0)) for g in groups]
        self._gram = np.stack([light @ light.T for light in centred])  # (bins, frames, frames)
        self._power = float(np.trace(self._gram, axis1=1, axis2=2).sum())

    def unexplained(self, clock: Clock) -> float:
        """Return the fraction of the variance that the pairs of a clock leave unexplained."""
        frames, rows = len(self._times_s), len(self._rows)
        pairs = clock.pairs(self._times_s, self._rows)
        # at least one frame more than unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        # work of a clock and of a product
        self._budget.spend(5000 + 0.008 * rows * frames * len(pairs) * (frames + len(pairs)))
        m = clock.design(self._times_s + clock.row_s * self._rows, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        gram = m.transpose(0, 2, 1) @ m
        loading = 1e-3 * 2 * frames / len(pairs) * np.eye(len(pairs))
        b = m.transpose(0, 2, 1) @ self._gram @ m
        explained = float(np.trace(np.linalg.solve(gram + loading, b), axis1=1, axis2=2).sum())
        left = max(self._power - explained, 0.0) / max(self._power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))

    def search(self, periods: Iterable[float]) -> list[RatedClock]:
        """Search clocks of some pattern periods, the best first."""
        frame_s, length = self._frame_s, float(self._times_s[-1] - self._times_s[0])
        # a readout takes at most a frame period
        readouts = [r for r in PARAMETERS.readouts_s if r <= 1.01 * frame_s]
        rows = [r / self._height for r in readouts] if self._row_s is None else [self._row_s]
        # below 1.7 frame periods some rows never show a single pattern
        tried = [period for period in periods if period >= 1.7 * frame_s and length >= 4 * period]
        if len(tried) > PARAMETERS.best_rates:
            rough = [rows[len(rows) // 2]], [PARAMETERS.rough_exposure * frame_s], PARAMETERS.rough_phases
            best = sorted((self._rough_clocks(period, *rough)[0] for period in tried), key=lambda clock: clock[0])
            tried = [clock.period_s for left, clock in best if left < PARAMETERS.max_rough_unexplained]
        exposures = [exposure * frame_s for exposure in PARAMETERS.exposures]
        clocks = [
            clock
            for period in tried[: PARAMETERS.best_rates]
            for clock in self._rough_clocks(period, rows, exposures, PARAMETERS.phases)[: PARAMETERS.best_clocks]
            # a wrong rate needs no refinement
            if clock[0] < PARAMETERS.max_rough_unexplained
        ]
        clocks = sorted(clocks, key=lambda clock: clock[0])[: 2 * PARAMETERS.best_clocks]
        clocks = sorted((self.refine(clock) for _, clock in clocks), key=lambda clock: clock[0])
        return [self._search_nearby(clocks[0]), *clocks[1:]] if clocks else []

    def _search_nearby(self, first: RatedClock) -> RatedClock:
        """Search a better clock of a nearby rate, as a refinement hardly changes the rate."""
        left, clock = first
        middle_s = clock.start_of(round(clock.pair_at(self._middle_s)))
        for _ in range(3):
            periods = [clock.period_s * factor for factor in (0.985, 0.995, 1.005, 1.015)]
            less, best = self._rated([replace(clock, start_s=middle_s, period_s=period) for period in periods])[0]
            if less >= left:
                break
            left, clock = self.refine(best)
        return (left, clock) if left < 0.7 * first[0] else first

    def _rough_clocks(
        self, period_s: float, rows_s: list[float], exposures_s: list[float], phases: int
    ) -> list[RatedClock]:
        """Try phases, row times and exposures of a rate; return the clocks, the best first."""
        starts_s = float(self._times_s[0]) + 2 * period_s * np.arange(phases) / phases
        return self._rated(
            [
                Clock(start_s, period_s, row, min(exposure, period_s))
                for start_s in starts_s.tolist()
                for row in rows_s
                for exposure in exposures_s
            ]
        )

    def _rated(self, clocks: list[Clock]) -> list[RatedClock]:
        """Rate clocks; return the best first."""
        return sorted(((self.unexplained(clock), clock) for clock in clocks), key=lambda clock: clock[0])

    def refine(self, clock: Clock) -> RatedClock:
        """Minimise the unexplained part from a clock on."""
        from scipy.optimize import minimize

        frame_s, height, row_s = self._frame_s, self._height, self._row_s
        anchor = clock.start_of(round(clock.pair_at(self._middle_s)))
        start = np.array([anchor, clock.row_s, clock.exposure_s, clock.response_s, clock.period_s])
        row_scale = 3e-3 / height if row_s is None else 0.0
        scale = np.array([0.1 * clock.period_s, row_scale, 0.25 * frame_s, 3e-3, 1e-3 * clock.period_s])
        # of row time, exposure and response
        low, high = np.array([0.0, 0.03 * frame_s, 0.0]), np.array([frame_s / height, frame_s, MAX_RESPONSE_S])

        def bounded(values: Floats) -> Clock:
            row, exposure, response = np.clip(values[1:4], low, high).tolist()
            return Clock(float(values[0]), float(values[4]), row, exposure, response)

        def cost(steps: Floats) -> float:
            values = start + steps * scale
            # values outside the bounds cost the excess
            off = np.abs(values[1:4] - np.clip(values[1:4], low, high)) * (height, 1, 1)
            drift = (values[4] / clock.period_s - 1) / 2e-3
            return self.unexplained(bounded(values)) + float(off.sum()) / frame_s + 1e-3 * float(drift) ** 2

        simplex = np.vstack([np.zeros(5), np.eye(5)])
        options = {"maxfev": 120, "xatol": 1e-2, "fatol": 1e-5, "initial_simplex": simplex}
        best = bounded(start + minimize(cost, np.zeros(5), method="Nelder-Mead", options=options).x * scale)
        return self.unexplained(best), best


class SampleBuffer:
    """Recent samples of an array, and the search for the clock of the light in the samples at growing intervals."""

    def __init__(
        self,
        shape: tuple[int, ...],
        frame_s: float,
        period_s: float,
        row_s: float | None,
        find_rate: bool,
        budget: SearchBudget,
    ):
        self._shape, self._frame_s, self._period_s, self._row_s, self._budget = shape, frame_s, period_s, row_s, budget
        # readout direction of upright frames: axis (0 for columns, 1 for rows), and True if the last is read first
        self._readout = 1, False
        self._samples: deque[Sample] = deque()
        usual = [1 / rate for rate in (*RATES, *DISPLAY_RATES) if abs(rate * period_s - 1) > RATE_STEP / 2]
        self._periods = [[period_s], *([usual, [1 / rate for rate in ANY_RATES]] if find_rate else ())]
        self._next_s = -np.inf
        self._group = 0  # group of rates at which the next search starts

    @property
    def first(self) -> Sample:
        """The first sample."""
        return self._samples[0]

    @property
    def last(self) -> Sample:
        """The last sample."""
        return self._samples[-1]

    @property
    def height(self) -> int:
        """Number of sensor rows of a frame."""
        return self._shape[1 - self._readout[0]]

    def rows(self, sample: Sample) -> Floats:
        """Return the number of sensor rows read before each cell."""
        axis, is_reversed = self._readout
        row = sample.centres[..., axis]
        return self.height - 1 - row if is_reversed else row

    def add(self, sample: Sample) -> None:
        """Add a sample."""
        self._samples.append(sample)

    def drop_before(self, time_s: float) -> None:
        """Drop samples before a time, except the last sample."""
        while len(self._samples) > 1 and self.first.time_s < time_s:
            self._samples.popleft()

    def between(self, start_s: float, end_s: float) -> list[Sample]:
        """Return the samples between two times."""
        return [sample for sample in self._samples if start_s <= sample.time_s <= end_s]

    def light_between(self, start_s: float, end_s: float, clock: Clock | None = None) -> Samples:
        """Return the light between two times without the camera gain, which with a clock is constant over a pair."""
        samples = self.between(start_s, end_s)
        light, times_s = np.stack([sample.light for sample in samples]), np.array([s.time_s for s in samples])
        gain = mean = np.maximum(light.mean((1, 2)), TINY)
        if clock is not None:
            reach = self._frame_s / clock.period_s
            near = np.clip(1 + 0.5 * reach - np.abs(times_s[:, None] - times_s) / clock.period_s, 0, reach)
            gain = (near @ mean) / near.sum(1)
            # a switched backlight changes single frames
            gain = np.where(np.abs(mean / gain - 1) > 0.15, mean, gain)
        # a small gain amplifies noise
        weights = np.clip(gain / np.median(gain), 0, 1) ** 2 + TINY
        rows = np.stack([self.rows(sample) for sample in samples])
        return Samples(times_s, rows, light / gain[:, None, None], weights)

    def fitter(self, samples: Samples, budget: SearchBudget | None = None) -> ClockFitter:
        """Return the fitter of clocks to some samples."""
        return ClockFitter(samples, self._frame_s, self.height, self._row_s, budget or SearchBudget())

    def restart_search(self) -> None:
        """Search again at once, after a wrong clock."""
        self._next_s = -np.inf

    def find_clock(self, final: bool = False) -> Clock | None:
        """Return the clock; None without a clock, or before the next search is due."""
        now_s = self.last.time_s
        length = now_s - self.first.time_s
        is_due = final or (now_s >= self._next_s and self._budget.is_left)
        if len(self._samples) < PARAMETERS.min_frames or not is_due:
            return None
        self._next_s = now_s + max(0.3 * length, 4 * self._frame_s)
        # other rates explain a part of a slow light: the nominal rate comes first
        waits = length < PARAMETERS.min_patterns * self._period_s and not final
        best: tuple[float, Clock, float] | None = None
        groups = [0] if waits else [*range(self._group, len(self._periods)), *range(self._group)]
        for group in groups:
            periods, self._group = self._periods[group], group
            if group != groups[0] and not self._budget.is_left:
                break
            fitting = [period for period in periods if length >= PARAMETERS.min_patterns * period]
            candidate = self._search_rates(fitting) if fitting else None
            if candidate is not None and (best is None or candidate[0] < best[0]):
                best = candidate
            if best is not None and best[0] < PARAMETERS.certain_unexplained:
                break
        else:
            self._group = 0
        if best is None:
            self.drop_before(now_s - 12.0)
            return None
        return self._select_readout(*best)

    def _search_rates(self, periods: list[float]) -> tuple[float, Clock, float] | None:
        """Return unexplained part, clock and start of the samples in seconds for the best of some rates."""
        now_s = self.last.time_s
        start_s = now_s - max(2 * min(periods), max(periods)) * PARAMETERS.min_patterns * 1.2
        clocks = self.fitter(self.light_between(start_s, now_s), self._budget).search(periods)
        return (*clocks[0], start_s) if clocks and clocks[0][0] < PARAMETERS.max_unexplained else None

    def _select_readout(self, left: float, clock: Clock, start_s: float) -> Clock:
        """Select the readout direction that explains most: phones may hold the sensor sideways."""
        first, height = self._readout, self.height
        best = left, clock, first
        for readout in ((1, False), (1, True), (0, False), (0, True)):
            self._readout = readout
            start = replace(clock, row_s=clock.row_s * height / self.height)
            samples = self.light_between(start_s, self.last.time_s)
            now, candidate = self.fitter(samples, self._budget).refine(start)
            if now < (1.0 if readout == first else 0.8) * best[0]:
                best = now, candidate, readout
        _, selected, self._readout = best
        return selected
