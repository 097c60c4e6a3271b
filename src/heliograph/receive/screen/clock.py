"""Clock of the light of a screen, estimated from the light of the cells.

A pair of patterns has the levels 2 + d and 2 - d, so that a cell shows

    y_i = g_i (c + sum_p d_p q(t_i + r y - 2 p T)),   q = w(t) - w(t - T)

with the mean light w(t) of a pattern over an exposure from t on, the time t_i of frame i, the row time r, the
sensor row y of the cell, the pattern period T and the gain g_i of the camera. Without inverses, in the single mode,
q = w(t) with a period of T. Given phase, row time, exposure and response, the d are linear least squares; the residual
judges the other parameters (variable projection). No header is needed.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.screen.cells import PARAMETERS, Sample, SearchBudget
from heliograph.receive.settings import ScreenSettings

# patterns per second to try first: divisors of 60 Hz, and common frame rates of films
RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)

# patterns per second, 1 to 60, to try last: ten patterns are then off by a sixth of a pattern at the ends
ANY_RATES = tuple(np.exp(np.arange(0.0, np.log(60.0), 0.03)).tolist())


@dataclass(frozen=True)
class Clock:
    """Timing of the light and of the exposures."""

    # Start of a pair, or of a pattern without inverses, in camera time
    start_s: float
    # Pattern period T in camera time
    period_s: float
    # Time from a row of pixels to the next
    row_s: float
    # Exposure of each row of pixels
    exposure_s: float
    # Time constant of the display: 2 to 15 ms
    response_s: float = 0.005
    # True for pairs of pattern and inverse
    paired: bool = True

    @property
    def step_s(self) -> float:
        """Duration of a pair, or of a pattern without inverses."""
        return (1 + self.paired) * self.period_s

    def pair_at(self, time_s: float) -> float:
        """Convert a time to pairs since the start."""
        return (time_s - self.start_s) / self.step_s

    def start_of(self, pair: float) -> float:
        """Return the start of a pair in seconds."""
        return self.start_s + pair * self.step_s

    def pairs(self, times_s: Floats, rows: Floats) -> range:
        """Return the pairs that overlap the exposures of rows in frames."""
        first = self.pair_at(float(times_s[0]) - 3 * self.response_s)
        last = self.pair_at(float(times_s[-1]) + self.row_s * float(rows.max()) + self.exposure_s)
        return range(int(np.floor(first)), int(np.floor(last)) + 1)

    def design(self, times_s: Floats, pairs: Sequence[int]) -> Floats:
        """Return q for exposures that begin at given times, (..., pairs)."""
        t = times_s[..., None] - self.start_s - self.step_s * np.asarray(pairs)
        # differences of the integral of the step response: the first is -w, the second q of a pair
        edges = [t - k * self.period_s for k in range(2 + self.paired)]
        lit = np.stack([self._ramp(edge + self.exposure_s) - self._ramp(edge) for edge in edges])
        return np.asarray((-1) ** (1 + self.paired) * np.diff(lit, 1 + self.paired, axis=0)[0]) / self.exposure_s

    def _ramp(self, t: Floats) -> Floats:
        """Return the integral of the step response of the display."""
        t, tau = np.maximum(t, 0), max(self.response_s, 1e-5)
        return t + tau * np.expm1(-t / tau)


RatedClock = tuple[float, Clock]  # part of the variance that the pairs of a clock leave unexplained, and the clock

# frame period in s, number of sensor rows, and row time in s; None if the row time is unknown
Sensor = tuple[float, int, float | None]


class Samples:
    """Light of the cells of an array in some frames, without the gain of the camera; fits clocks to the light."""

    def __init__(
        self, times_s: Floats, rows: Floats, light: Floats, weights: Floats, sensor: Sensor, budget: SearchBudget
    ):
        # (frames,) starts of the exposures of row 0 in camera time; (frames, n, n) sensor row of each cell
        self.times_s, self.rows = times_s, rows
        # (frames, n, n) light, linear, and (frames,) inverse variance of the light, in any unit
        self.light, self.weights = light, weights
        (self._frame_s, self._height, self._row_s), self._budget = sensor, budget
        order = np.argsort(rows.mean(0).ravel(), kind="stable")
        groups = np.array_split(order, min(PARAMETERS.row_bins, light.shape[-1]))
        flat, flat_rows = (values.reshape(len(times_s), -1) for values in (light, rows))
        self._bins = np.stack([flat_rows[:, g].mean(1) for g in groups])  # (bins, frames) sensor rows
        self._share = weights[:, None] / weights.sum()
        self._root = np.sqrt(self._share * len(weights))
        centred = [self._root * (flat[:, g] - (self._share * flat[:, g]).sum(0)) for g in groups]
        self._gram = np.stack([light @ light.T for light in centred])  # (bins, frames, frames)
        self._power = float(np.trace(self._gram, axis1=1, axis2=2).sum())

    def unexplained(self, clock: Clock) -> float:
        """Return the fraction of the variance that the pairs of a clock leave unexplained."""
        frames, rows = len(self.times_s), len(self._bins)
        pairs = clock.pairs(self.times_s, self._bins)
        # at least one frame more than unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        # work of a clock and of a product
        self._budget.spend(5000 + 0.008 * rows * frames * len(pairs) * (frames + len(pairs)))
        gram, b = self._products(clock, pairs)
        explained = float(np.trace(np.linalg.solve(gram, b), axis1=1, axis2=2).sum())
        left = max(self._power - explained, 0.0) / max(self._power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))

    def _products(self, clock: Clock, pairs: range) -> tuple[Floats, Floats]:
        """Return the products of the pairs, loaded, and of the pairs with the light, (bins, pairs, pairs)."""
        m = clock.design(self.times_s + clock.row_s * self._bins, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        transposed = m.transpose(0, 2, 1)
        loading = 1e-3 * 2 * len(self.times_s) / len(pairs) * np.eye(len(pairs))
        return transposed @ m + loading, transposed @ self._gram @ m

    def repetition(self, clock: Clock) -> float:
        """Return the median correlation of every other pattern with the next: 1 for pairs of any rate."""
        gram, b = self._products(clock, clock.pairs(self.times_s, self._bins))
        power = np.linalg.solve(gram, np.linalg.solve(gram, b).transpose(0, 2, 1)).sum(0)
        scale = np.sqrt(np.maximum(np.diag(power), TINY))  # patterns without light
        correlation = np.abs(np.diag(power, 1)) / (scale[1:] * scale[:-1])
        return max(float(np.median(correlation[start::2])) for start in (0, 1))

    def search(self, periods: Iterable[float], paired: bool = True) -> list[RatedClock]:
        """Search clocks of some pattern periods, the best first."""
        frame_s, length = self._frame_s, float(self.times_s[-1] - self.times_s[0])
        # phones take 5 to 30 ms for all rows, and at most a frame period
        readouts = [readout_s for readout_s in (0.0, 0.008, 0.016, 0.024) if readout_s <= 1.01 * frame_s]
        rows = [r / self._height for r in readouts] if self._row_s is None else [self._row_s]
        # below 1.7 frame periods some rows never show a single pattern
        tried = [period for period in periods if period >= 1.7 * frame_s and length >= 4 * period]
        if not paired or len(tried) > PARAMETERS.best_rates:
            rough = [rows[len(rows) // 2]], [0.6 * frame_s], 8, paired
            best = sorted((self._rough_clocks(period, *rough)[0] for period in tried), key=lambda clock: clock[0])
            limit = PARAMETERS.max_rough_unexplained if paired else PARAMETERS.max_unexplained
            tried = [clock.period_s for left, clock in best if left < limit]
        exposures = [0.3 * frame_s, 0.9 * frame_s]
        clocks = [
            clock
            for period in tried[: PARAMETERS.best_rates]
            for clock in self._rough_clocks(period, rows, exposures, 16, paired)[: PARAMETERS.best_clocks]
            # a wrong rate needs no refinement
            if clock[0] < PARAMETERS.max_rough_unexplained
        ]
        # a step of a pattern has only one good phase
        clocks = sorted(clocks, key=lambda clock: clock[0])[: 2 * PARAMETERS.best_clocks if paired else 1]
        return sorted((self.refine(clock) for _, clock in clocks), key=lambda clock: clock[0])

    def _rough_clocks(
        self, period_s: float, rows_s: list[float], exposures_s: list[float], phases: int, paired: bool
    ) -> list[RatedClock]:
        """Try phases, row times and exposures of a rate; return the clocks, the best first."""
        starts_s = (float(self.times_s[0]) + (1 + paired) * period_s * np.arange(phases) / phases).tolist()
        clocks = [
            Clock(start_s, period_s, row, min(exposure, period_s), paired=paired)
            for start_s, row, exposure in product(starts_s, rows_s, exposures_s)
        ]
        return sorted(((self.unexplained(clock), clock) for clock in clocks), key=lambda clock: clock[0])

    def refine(self, clock: Clock) -> RatedClock:
        """Minimise the unexplained part from a clock on."""
        from scipy.optimize import minimize

        frame_s, height, row_s = self._frame_s, self._height, self._row_s
        anchor = clock.start_of(round(clock.pair_at(float(self.times_s.mean()))))
        start = np.array([anchor, clock.row_s, clock.exposure_s, clock.response_s, clock.period_s])
        row_scale = 3e-3 / height if row_s is None else 0.0
        scale = np.array([0.1 * clock.period_s, row_scale, 0.25 * frame_s, 3e-3, 1e-3 * clock.period_s])
        # of row time, exposure and response
        low, high = np.array([0.0, 0.03 * frame_s, 0.0]), np.array([frame_s / height, frame_s, 0.03])

        def bounded(values: Floats) -> Clock:
            row, exposure, response = np.clip(values[1:4], low, high).tolist()
            return Clock(float(values[0]), float(values[4]), row, exposure, response, clock.paired)

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
        self, shape: tuple[int, ...], frame_s: float, period_s: float, settings: ScreenSettings, budget: SearchBudget
    ):
        self._shape, self._frame_s, self._period_s, self._budget = shape, frame_s, period_s, budget
        self._row_s = settings.row_time_s
        # readout direction of upright frames: axis (0 for columns, 1 for rows), and True if the last is read first
        self._readout = 1, False
        self._samples: deque[Sample] = deque()
        usual = [1 / rate for rate in RATES if abs(rate * period_s - 1) > 0.015]
        others = [(usual, True), ([1 / rate for rate in ANY_RATES], True)] if settings.find_rate else []
        # rates to try in turn, and True for pairs
        self._searches = [([period_s], True), ([period_s], False), *others]
        self._next_s = -np.inf

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

    def light_between(self, start_s: float, end_s: float, budget: SearchBudget) -> Samples:
        """Return the light between two times without the camera gain; fits of clocks spend the budget."""
        samples = self.between(start_s, end_s)
        light = np.stack([sample.light for sample in samples])
        gain = np.maximum(light.mean((1, 2)), TINY)
        # a small gain amplifies noise
        weights = np.clip(gain / np.median(gain), 0, 1) ** 2 + TINY
        rows = np.stack([self.rows(sample) for sample in samples])
        times_s = np.array([sample.time_s for sample in samples])
        sensor = self._frame_s, self.height, self._row_s
        return Samples(times_s, rows, light / gain[:, None, None], weights, sensor, budget)

    def find_clock(self, final: bool = False) -> Clock | None:
        """Return the clock; None without a clock, or before the next search is due."""
        now_s = self.last.time_s
        length = now_s - self.first.time_s
        is_due = final or (now_s >= self._next_s and self._budget.is_left)
        if len(self._samples) < PARAMETERS.min_frames or not is_due:
            return None
        # other rates explain a part of a slow light: the nominal rate comes first
        waits = length < PARAMETERS.min_patterns * self._period_s and not final
        best: tuple[float, Clock, float] | None = None
        for rates in self._searches[: 1 if waits else None]:
            best = min(filter(None, (best, self._search_rates(*rates))), key=lambda rated: rated[0], default=None)
            if (best is not None and best[0] < PARAMETERS.certain_unexplained) or not self._budget.is_left:
                break
        if best is None:
            self._next_s = now_s + max(0.3 * length, 4 * self._frame_s)
            self.drop_before(now_s - 12.0)
            return None
        # if the clock turns out to be wrong, search again at once
        self._next_s = -np.inf
        return self._select_readout(*best)

    def _search_rates(self, periods: list[float], paired: bool) -> tuple[float, Clock, float] | None:
        """Return unexplained part, clock and start of the samples in seconds for the best of some rates."""
        now_s = self.last.time_s
        periods = [period for period in periods if now_s - self.first.time_s >= PARAMETERS.min_patterns * period]
        if not periods:
            return None
        start_s = now_s - max(2 * min(periods), max(periods)) * PARAMETERS.min_patterns * 1.2
        samples = self.light_between(start_s, now_s, self._budget)
        clocks = samples.search(periods, paired)
        limit = PARAMETERS.max_unexplained if paired else PARAMETERS.certain_unexplained
        if not clocks or clocks[0][0] >= limit:
            return None
        # slower pairs look like patterns that repeat
        is_repeated = not paired and samples.repetition(clocks[0][1]) > PARAMETERS.max_repetition
        return None if is_repeated else (*clocks[0], start_s)

    def _select_readout(self, left: float, clock: Clock, start_s: float) -> Clock:
        """Select the readout direction that explains most: phones may hold the sensor sideways."""
        first, height = self._readout, self.height
        best = left, clock, first
        for readout in ((1, False), (1, True), (0, False), (0, True)):
            self._readout = readout
            start = replace(clock, row_s=clock.row_s * height / self.height)
            now, candidate = self.light_between(start_s, self.last.time_s, self._budget).refine(start)
            if now < (1.0 if readout == first else 0.8) * best[0]:
                best = now, candidate, readout
        _, selected, self._readout = best
        return selected
