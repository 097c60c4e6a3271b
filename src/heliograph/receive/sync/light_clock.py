"""Clock of the light in camera time, measured by each header and predicted between headers.

Three effects show the phase of a frame:

- The amplitude of the header less the inverse, -1 to 1: the mean over the exposure of a square wave that is 0 outside
  the header.
- Cells that are dimmed to signal a format: dark in the last slot of a pattern, or lit in the first. The fraction of
  dimmed cells is estimated as well.
- The brightness of the array: for random data PWM lights 15, 11, 5 and 1 sixteenths of the LEDs in the four slots, for
  a header half of the LEDs in each slot.

All frames around a header are compared with a grid of starts and exposures. The exposure is constant, so the log
likelihoods of all headers add up; the start updates a Kalman filter of time and rate.
"""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.footprint import footprints, sum_of_leds, to_quarters
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import HALF_LIT, cut_out, window_around
from heliograph.receive.sync.combine import dimmed_light, slot_light
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import SignalSettings

PATTERNS_AROUND = 2  # patterns to measure before and after a header: both ends of the header show the start

# minimum part of the power of the amplitudes that a header explains; of white noise about a quarter is explained
MIN_EXPLAINED = 0.7

# model error in patterns: minimum standard deviation of a measured start, and step of later grids
MIN_DEVIATION = 0.004


# Frames around a header: starts of the exposures in seconds, amplitude of the header in gray levels, negative for the
# inverse, light of the array in gray levels up to a constant, (frames,) each, and the weight of that light, 0 to 1:
# smaller for a moving array, 0 if pixels are clipped
HeaderAmplitudes = tuple[Floats, Floats, Floats, float]


def measure_amplitudes(frames: list[Frame], poses: list[Pose], lit: Floats) -> HeaderAmplitudes:
    """Measure the amplitudes of a header in the frames around the header."""
    projections = [_project(frame, pose, lit) for frame, pose in zip(frames, poses, strict=True)]
    gram, matched, clipped = (np.array(values) for values in zip(*projections, strict=True))
    # the images are equal if only lit or only dark LEDs are visible: the pseudo-inverse decides
    header = np.einsum("fi,fi->f", np.linalg.pinv(gram, RCOND, hermitian=True)[:, 0], matched)
    # the background may move: only the part mixed in by blur counts
    light = (matched[:, 1] - header * gram[:, 0, 1]) / np.maximum(gram[:, 1, 1], TINY)
    places = np.array([(pose.x, pose.y) for pose in poses])
    moved = float(np.median(np.hypot(*np.diff(places, axis=0).T))) if len(poses) > 1 else 0.0
    # the background moves too: 1 / sqrt(2) at half a pixel per frame
    trust = 0.0 if clipped.max() > 0.02 else 1 / float(np.hypot(1, moved / 0.5))
    return np.array([frame.time_s for frame in frames]), header, light, trust


def _project(frame: Frame, pose: Pose, lit: Floats) -> tuple[Floats, Floats, float]:
    """Project a frame on images of the header, of the array with all LEDs on and of an even background.

    Returns the Gram matrix (3, 3), the inner products (3,) and the fraction of clipped array pixels.
    """
    # five times the blur of the reference link
    window = window_around(pose, len(lit), 3.0)
    x0, y0, width, height = window
    pixels = cut_out(frame, window).ravel()
    light = footprints.__wrapped__(pose, (x0, y0), (height, width), len(lit))
    images = [sum_of_leds(to_quarters(levels), light).ravel() for levels in (lit, np.abs(lit))]
    columns = np.stack([*images, np.ones(pixels.size)])
    full, all_on, clipped = pixels >= frame.full_scale, columns[1], 0.0
    if full.any():
        clipped = float(full[all_on >= HALF_LIT * all_on.max()].mean())
    return columns @ columns.T, columns @ pixels, clipped


# upper triangle of a symmetric matrix M (3, 3), and the multiplicity of each element in v M v
_ROWS, _COLS = np.triu_indices(3)
_TIMES = np.where(_ROWS == _COLS, 1.0, 2.0)


class LightClock:
    """Clock of the light in camera time."""

    def __init__(
        self, start_s: float, period_s: float, signal: SignalSettings, identity: int, exposure_s: float | None = None
    ):
        self._signal = signal
        # per word of a format: fraction of dimmed cells, and fraction of lit less fraction of dark dimmed cells
        cells = words() / words().shape[1]
        self._dimmed = np.unique(np.stack([cells.sum(1), cells @ header_cells(identity).ravel()], axis=1), axis=0)
        self.start_s = start_s
        self.rate = 0.0
        self.gain = 0.0
        self.explained = 0.0
        self._pattern = 0
        # of start and relative rate: two quartz clocks of 200 ppm
        self._covariance = np.diag([0.0, 2.5e-4**2])
        self._measured = False
        self._longest = longest = min(period_s / signal.pattern_period_s, 1.0)
        count, largest = (
            (20, longest) if exposure_s is None else (1, min(exposure_s / signal.pattern_period_s, longest))
        )
        self._exposures = largest * np.arange(1, count + 1) / count
        self._half_step = 0.5 * largest / count if exposure_s is None else 0.0
        # log odds: equal evidence favours long exposures, and that of the entire frame period
        self._prior = self._evidence = 20.0 * self._exposures / longest
        self._prior[-1] += 3.0
        self.exposure = self._mean_exposure()

    @property
    def period_s(self) -> float:
        """Pattern period in seconds of camera time."""
        return self._signal.pattern_period_s * (1 + self.rate)

    @property
    def deviation(self) -> float:
        """Standard deviation in T_b of the pattern starts after the last header."""
        return math.sqrt(self._covariance[0, 0]) / self.period_s

    @property
    def exposure_range(self) -> tuple[float, float]:
        """95 % interval of the exposure in T_b, without the prior."""
        likelihood = self._evidence - self._prior
        # chi-square
        likely = self._exposures[likelihood >= likelihood.max() - 1.92]
        return float(likely[0]) - self._half_step, min(float(likely[-1]) + self._half_step, self._longest)

    def time_s(self, pattern: float) -> float:
        """Return the start of a pattern in seconds of camera time."""
        return self.start_s + (pattern - self._pattern) * self.period_s

    def pattern_at(self, time_s: float) -> float:
        """Convert a time to patterns since the start of the detected header."""
        return self._pattern + (time_s - self.start_s) / self.period_s

    def starts(self, frames: Sequence[Frame]) -> Floats:
        """Return the starts of exposures in patterns since the start of the detected header."""
        return self._pattern + (np.array([frame.time_s for frame in frames]) - self.start_s) / self.period_s

    def predict_header(self, starts: Floats, dimmed: float) -> tuple[Floats, Floats]:
        """Predict header amplitude and mean light of frames, for a fraction of dimmed cells."""
        edges, waves, brights = self._header_terms
        terms = np.stack([waves[0] + dimmed * waves[1], brights[0] + dimmed * brights[1]])
        amplitude, light = _mean_over(starts, self.exposure, edges, terms)
        return amplitude, 0.5 + light

    def measure(self, amplitudes: HeaderAmplitudes, pattern: int, again: bool = False) -> bool:
        """Correct the clock by a header; return False for a rejected header."""
        steps = pattern - self._pattern
        move = np.array([[1.0, steps * self._signal.pattern_period_s], [0.0, 1.0]])
        self.start_s, self._pattern = self.time_s(pattern), pattern
        # random walk of the rate: 2e-6 in a second at 1000 patterns/s
        self._covariance = move @ self._covariance @ move.T + np.diag([0.0, 6.3e-8**2 * steps])
        spread, gain = self.deviation, self.gain
        # a pattern and a quarter at first, for frames half a pattern late
        reach = min(max(6 * spread, 0.1), 0.5) if self._measured else 1.25
        offset = np.linspace(-reach, reach, min(2 * math.ceil(reach / MIN_DEVIATION) + 1, 121))
        likely = self._evidence > self._evidence.max() - 40.0
        self._exposures, self._evidence = self._exposures[likely], self._evidence[likely]
        self._prior = self._prior[likely]
        cost = self._cost(amplitudes, offset)
        if self._measured and self.explained < MIN_EXPLAINED:
            self.gain = gain
            return False
        if again:
            self._evidence, self._measured = self._prior, False
        if self._measured:
            cost = cost + 0.5 * (offset / max(spread, MIN_DEVIATION)) ** 2
        by_exposure = -cost.min(1) + np.log(np.exp(cost.min(1)[:, None] - cost).sum(1))
        self._evidence = self._evidence + by_exposure - by_exposure.max()
        self.exposure = self._mean_exposure()
        chance = np.exp((self._evidence - self._evidence.max() - by_exposure)[:, None] - cost)
        chance = chance.sum(0) / chance.sum()
        mean = float(chance @ offset)
        variance = float(chance @ (offset - mean) ** 2) + MIN_DEVIATION**2
        self._update(mean * self.period_s, variance * self.period_s**2)
        return True

    def _mean_exposure(self) -> float:
        chance = np.exp(self._evidence - self._evidence.max())
        return float(chance @ self._exposures / chance.sum())

    def _update(self, error_s: float, variance: float) -> None:
        """Correct start and rate by the error of the predicted start and the posterior variance."""
        self.start_s += error_s
        if not self._measured:
            self._covariance[0, 0], self._measured = variance, True
            return
        prior = self._covariance[0, 0]
        # the likelihood includes the prior: x += P H^T S^-1 (posterior - prior), P += K (C - S) K^T
        kalman_gain = self._covariance[:, 0] / prior
        self.rate += float(kalman_gain[1]) * error_s
        self._covariance = self._covariance + np.outer(kalman_gain, kalman_gain) * (min(variance, prior) - prior)

    def _cost(self, amplitudes: HeaderAmplitudes, offset: Floats) -> Floats:
        """Return negative log likelihoods (exposures, offsets) of starts relative to the predicted start."""
        times_s, alternation, brightness, trust = amplitudes
        place = (times_s - self.start_s) / self.period_s
        edges, waves, brights = self._header_terms
        starts, exposures = (place - offset[:, None])[None], self._exposures[:, None, None]
        # twice the alternation and the brightness of a header of gain 1, (3, exposures, offsets, frames) each
        wave, light = np.split(_mean_over(starts, exposures, edges, np.concatenate([waves, brights])), 2)
        alternation, brighter = 2 * alternation, brightness - brightness.mean()
        # gain g: alternation g wave / 2, brightness g light plus a constant, both linear in the dimmed fractions
        energy, count = float(alternation @ alternation), len(place)
        match, norm = wave @ alternation, _products(wave)
        if trust:
            trust, light = trust**2, light - light.mean(-1, keepdims=True)
            match, norm = match + trust * (light @ brighter), norm + trust * _products(light)
            energy, count = energy + trust * float(brighter @ brighter), 2 * count
        # v match and v norm v of every word's v = (1, part, lit)
        words, grid = np.column_stack([np.ones(len(self._dimmed)), self._dimmed]), match.shape[1:]
        m = np.maximum(words @ match.reshape(3, -1), 0)
        n = np.maximum((words[:, _ROWS] * words[:, _COLS] * _TIMES) @ norm.reshape(len(_ROWS), -1), TINY)
        explained, gains = m**2 / n, m / n
        word = explained.argmax(0)[None]
        left, gain = (np.take_along_axis(values, word, 0).reshape(grid) for values in (energy - explained, gains))
        best = np.unravel_index(np.argmin(left), grid)
        # the unexplained power is noise
        freedom = max(count - 4, 1)
        self.gain = float(gain[best])
        self.explained = 1 - float(left[best]) / max(energy, TINY)
        # random data deviate by 1/2 / 16 of the light
        variance = max((0.03 * self.gain) ** 2, float(left[best]) / freedom, TINY)
        return np.asarray(0.5 * left / variance)

    @cached_property
    def _header_terms(self) -> tuple[Floats, Floats, Floats]:
        """Slot edges in patterns, the header less the inverse, and the mean light less 1/2, (3, slots) each.

        Terms: without dimmed cells, added by dimmed cells, and added by an excess of lit dimmed cells. The first pair
        has no dimmed cells.
        """
        count, order = 2 * self._signal.header_pairs, self._signal.slot_order
        first, patterns = -PATTERNS_AROUND - 2, count + 2 * PATTERNS_AROUND + 4
        edges = first + np.arange(patterns * SLOTS + 1) / SLOTS
        number = np.floor(edges[:-1] + TINY).astype(int)
        inside, later = (number >= 0) & (number < count), (number >= 2) & (number < count)
        contrast, light, mean = (
            np.tile(values[:SLOTS], patterns) for values in (*dimmed_light(order), slot_light(order)[1])
        )
        sign = np.where(number % 2, -1.0, 1.0)
        # an excess of lit dimmed cells changes the light like the header
        waves = np.stack([inside * sign, later * (contrast - 1) * sign, later * (2 * light - 1)])
        brights = np.stack([~inside * (mean - 0.5), later * (light - 0.5), later * 0.5 * (contrast - 1) * sign])
        return edges, waves, brights


def _mean_over(starts: Floats, exposure: Floats | float, edges: Floats, values: Floats) -> Floats:
    """Average functions that are constant between equidistant edges, and 0 outside, over exposures.

    Starts and exposures broadcast; `values` is (functions, slots), the result (functions, ...).
    """
    step, none = edges[1] - edges[0], np.zeros((len(values), 1))
    # the integral is linear in each slot and constant after the last edge
    integral, slopes = np.hstack([none, np.cumsum(values, axis=1)]), np.hstack([values, none])

    def integrate(times: Floats) -> Floats:
        place = np.clip((times - edges[0]) / step, 0, len(edges) - 1)
        slot = place.astype(np.intp)
        return np.asarray(integral[:, slot] + (place - slot) * slopes[:, slot])

    return np.asarray((integrate(starts + exposure) - integrate(starts)) * (step / exposure))


def _products(terms: Floats) -> Floats:
    """Return the inner products over frames of (3, exposures, offsets, frames): upper triangle (6, ...)."""
    return np.stack([np.einsum("eof,eof->eo", terms[a], terms[b]) for a, b in zip(_ROWS, _COLS, strict=True)])
