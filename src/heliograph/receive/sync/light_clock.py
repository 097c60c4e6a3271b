"""What the frames around a header show of it: how much of the header, and how bright the array is.

The light's clock in the camera's time, measured by each header and carried on between headers.

Three things show the phase of a frame:

- How much of the header less its inverse it shows, -1 to 1: the mean over the exposure of a square wave that is 0
  outside the header.
- Cells that are dimmed to signal a format: they are dark in the last slot of a pattern, or lit in the first. The
  fraction of such cells is estimated too.
- The array's brightness: PWM lights random data brightly at the start of a pattern and dimly at its end (15, 11, 5 and
  1 sixteenths of the LEDs in the four slots), but a header evenly.

For all frames around a header they are compared with what a grid of starts and exposures would give. The likelihood
over the grid is the measurement. The exposure is constant, so its log likelihoods add up from header to header; the
start goes into a Kalman filter of time and rate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import HALF_LIT, cut_out, window_around
from heliograph.receive.sync.combine import SlotLight
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import SignalSettings

CLIPPED = 0.02
"""Fraction of an array's pixels at full scale from which on its brightness is not used.

While 2 % of the pixels clip, each by no more than it shows, the brightness is wrong by 2 %: less than the 3 % by which
random data change it (`DEVIATION` of `light_clock`). Half and twice of it lose none of 192 codewords.
"""

MOVING_PX = 0.5
"""Motion in px from frame to frame at which the brightness counts half in power: what lies about an array moves past.

At 1.4 px a bright background changed it by a tenth of the light within a header; at rest random data do by 3 %.
"""

SURROUNDINGS_PX = 3.0
"""Pixels around the array against which its brightness is measured: five times the blur of the reference link."""


@dataclass(frozen=True, slots=True)
class HeaderAmplitudes:
    """What the frames around a header show."""

    # (frames,) starts of the exposures in seconds
    times_s: Floats
    # (frames,) amplitude of the header in gray levels, negative for its inverse
    alternation: Floats
    # (frames,) light of the array in gray levels, but for a constant
    brightness: Floats
    # Whether pixels were at full scale; the brightness is then not used
    clipped: bool = False
    # Weight of the brightness, 0 to 1: less where the array moves
    trust: float = 1.0


def header_amplitudes(frames: list[Frame], poses: list[Pose], lit: Floats) -> HeaderAmplitudes:
    """Measure what the frames around a header show."""
    seen = [_seen(frame, pose, lit) for frame, pose in zip(frames, poses, strict=True)]
    gram, matched = np.array([one.gram for one in seen]), np.array([one.matched for one in seen])
    # where only lit LEDs or only dark ones are left, the two images are one: the pseudo-inverse decides
    header = np.einsum("fi,fi->f", np.linalg.pinv(gram, RCOND, hermitian=True)[:, 0], matched)
    # of the background, which may move, only what blur mixes in counts
    light = (matched[:, 1] - header * gram[:, 0, 1]) / np.maximum(gram[:, 1, 1], TINY)
    places = np.array([(pose.x, pose.y) for pose in poses])
    moved = float(np.median(np.hypot(*np.diff(places, axis=0).T))) if len(poses) > 1 else 0.0
    return HeaderAmplitudes(
        np.array([f.time_s for f in frames]),
        header,
        light,
        max(one.clipped for one in seen) > CLIPPED,
        1 / float(np.hypot(1, moved / MOVING_PX)),
    )


class _Seen(NamedTuple):
    """Inner products (3, 3) of images of the header, of the array all on and of an even background.

    Those with a frame's pixels, (3,), and the fraction of the array's pixels that clip.
    """

    gram: Floats
    matched: Floats
    clipped: float


def _seen(frame: Frame, pose: Pose, lit: Floats) -> _Seen:
    """What a frame shows of the array."""
    from heliograph.receive.geometry.footprint import images_of  # Numba is slow to import

    window = window_around(pose, len(lit), SURROUNDINGS_PX)
    x0, y0, width, height = window
    pixels = cut_out(frame, window).ravel()
    on, off = images_of(np.abs(lit), lit < 0, 2, pose, (x0, y0), (height, width)).reshape(2, -1)
    columns = np.stack([on - off, on + off, np.ones(pixels.size)])
    full, all_on, clipped = pixels >= frame.full_scale, columns[1], 0.0
    if full.any():
        clipped = float(full[all_on >= HALF_LIT * all_on.max()].mean())
    return _Seen(columns @ columns.T, columns @ pixels, clipped)


PATTERNS_AROUND = 2
"""Patterns before and after a header whose frames count too: its two ends say most about the start."""

DEVIATION = 0.03
"""Standard deviation of random data projected on a header, and of their brightness, as a fraction of the light.

A pair's levels have the standard deviation 1/2 in their difference; over 256 LEDs that is 1/2 / 16.
"""

EXPOSURES = 20
"""Exposures of the grid, up to the whole frame period; steps of 5 % change a header's amplitude by at most 5 %."""

LONGER, WHOLE_PERIOD = 20.0, 3.0
"""Prior log odds of long exposures.

They rise evenly from 0 at no exposure to `LONGER` at the whole frame period, which alone gets `WHOLE_PERIOD` more.

Exposures of any length about the middle of a pattern, or about its end, give the same header and the same brightness.
Among these the prior prefers the longest. Both are small against the evidence of one header, which is hundreds.
"""

LIKELY = 1.92
"""Log likelihood below the largest within which an exposure is told: 95 % of the time the true one is (chi-square)."""

GIVEN_UP = 40.0
"""Log odds against an exposure from which on the grid leaves it out: its weight is below 1e-17."""

STARTS = 121
"""Most starts of the grid: 1/48 T_b apart for a first header; later no more than steps of `LEAST_DEVIATION` need."""

FIRST_REACH = 1.25
"""Patterns by which the start may differ from the detection's: one for frames that straddle, and a quarter."""

LATER_DEVIATIONS, LEAST_REACH, MOST_REACH = 6.0, 0.1, 0.5
"""Reach of the grid of later headers: standard deviations of the predicted start, and its bounds in patterns."""

RATE = 2.5e-4
"""Prior standard deviation of the light's rate against the camera's: both quartz clocks may be 200 ppm off."""

RATE_WALK = 6.3e-8
"""Random walk of that rate per square root of a pattern: 2e-6 in a second at 1000 patterns/s, as quartz drifts."""

EXPLAINED = 0.7
"""Least part of the power in a header's amplitudes that the header must explain; of clutter it explains less.

Eight frames about a header of four patterns show 16 numbers. Of white noise a model of 4 parameters explains about a
quarter; of a header in clear sight nearly all is explained. With 0.85 and with 0.4 none of 192 codewords is lost.
"""

LEAST_DEVIATION = 0.004
"""Least standard deviation of a measured start in T_b, and step of a later header's grid: what the model leaves out.

It is below the 0.005 to 0.02 T_b to which one header gives the start.
"""

GAP_PATTERNS = 1.5
"""Time between two frames in patterns from which on one is missing: halfway between one pattern and two."""


# the upper triangle of a symmetric matrix (3, 3), and how often each of its elements counts in v M v
_ROWS, _COLS = np.triu_indices(3)
_TIMES = np.where(_ROWS == _COLS, 1.0, 2.0)


class LightClock:
    """The light's clock in the camera's time."""

    def __init__(
        self, start_s: float, period_s: float, signal: SignalSettings, identity: int, exposure_s: float | None = None
    ):
        self._signal = signal
        # of each word: the fraction of cells it dims, and how many more of them are lit than dark
        cells = words() / words().shape[1]
        self._dimmed = np.unique(np.stack([cells.sum(1), cells @ header_cells(identity).ravel()], axis=1), axis=0)
        self._light = SlotLight(signal.slot_order)
        self.start_s = start_s
        self.rate = 0.0
        self.gain = 0.0
        self.explained = 0.0
        self._pattern = 0
        self._covariance = np.diag([0.0, RATE**2])
        self._measured = False
        self._longest = longest = min(period_s / signal.pattern_period_s, 1.0)
        self._exposures = longest * np.linspace(1 / EXPOSURES, 1.0, EXPOSURES)
        self._exposure_s = exposure_s
        if exposure_s is not None:
            self._exposures = np.array([min(exposure_s / signal.pattern_period_s, longest)])
        self._evidence = LONGER * self._exposures / longest
        self._evidence[-1] += WHOLE_PERIOD
        self._prior = self._evidence
        self.exposure = self._mean_exposure()

    @property
    def period_s(self) -> float:
        """Pattern period in seconds of the camera's clock."""
        return self._signal.pattern_period_s * (1 + self.rate)

    @property
    def deviation(self) -> float:
        """Standard deviation in T_b of the patterns' starts, by the last header."""
        return math.sqrt(self._covariance[0, 0]) / self.period_s

    @property
    def exposure_range(self) -> tuple[float, float]:
        """Exposures in T_b between which the light puts it, 95 % of the time, without what is expected beforehand."""
        whole = self._exposures > (1 - 0.5 / EXPOSURES) * self._longest
        likely = self._evidence - LONGER * self._exposures / self._longest - WHOLE_PERIOD * whole
        told = self._exposures[likely >= likely.max() - LIKELY]
        half_step = 0.5 * self._longest / EXPOSURES if self._exposure_s is None else 0.0
        return float(told[0]) - half_step, min(float(told[-1]) + half_step, self._longest)

    def time_s(self, pattern: float) -> float:
        """Start of a pattern in seconds, by the camera's clock."""
        return self.start_s + (pattern - self._pattern) * self.period_s

    def pattern_at(self, time_s: float) -> float:
        """Patterns from the start of the detection's header to a time."""
        return self._pattern + (time_s - self.start_s) / self.period_s

    def patterns_at(self, times_s: Sequence[float]) -> list[float]:
        """The same of several times, (times,)."""
        pattern, start_s, period_s = self._pattern, self.start_s, self.period_s
        return [pattern + (time_s - start_s) / period_s for time_s in times_s]

    def header(self, starts: Floats, dimmed: float) -> tuple[Floats, Floats]:
        """What frames show of a header."""
        edges, wave, bright = self._header(dimmed)
        shown, light = _mean_over(starts, self.exposure, edges, np.stack([wave, bright]))
        return shown, 0.5 + light

    def measure(self, amplitudes: HeaderAmplitudes, pattern: int, again: bool = False) -> bool:
        """Correct the clock by a header."""
        self._move(pattern)
        spread, gain = self.deviation, self.gain
        reach = min(max(LATER_DEVIATIONS * spread, LEAST_REACH), MOST_REACH) if self._measured else FIRST_REACH
        offset = np.linspace(-reach, reach, min(2 * math.ceil(reach / LEAST_DEVIATION) + 1, STARTS))
        likely = self._evidence > self._evidence.max() - GIVEN_UP
        self._exposures, self._evidence = self._exposures[likely], self._evidence[likely]
        self._prior = self._prior[likely]
        cost = self._cost(amplitudes, offset)
        if self._measured and self.explained < EXPLAINED:
            self.gain = gain
            return False
        if again:
            self._evidence, self._measured = self._prior, False
        if self._measured:
            cost = cost + 0.5 * (offset / max(spread, LEAST_DEVIATION)) ** 2
        else:
            cost = cost - self._in_step(amplitudes.times_s, offset)
        by_exposure = -cost.min(1) + np.log(np.exp(cost.min(1)[:, None] - cost).sum(1))
        self._evidence = self._evidence + by_exposure - by_exposure.max()
        self.exposure = self._mean_exposure()
        chance = np.exp((self._evidence - self._evidence.max() - by_exposure)[:, None] - cost)
        chance = chance.sum(0) / chance.sum()
        mean = float(chance @ offset)
        variance = float(chance @ (offset - mean) ** 2) + LEAST_DEVIATION**2
        self._take(mean * self.period_s, variance * self.period_s**2)
        return True

    def _mean_exposure(self) -> float:
        chance = np.exp(self._evidence - self._evidence.max())
        return float(chance @ self._exposures / chance.sum())

    def _in_step(self, times_s: Floats, offset: Floats) -> Floats:
        """Prior log odds of starts (offsets,) where frames about a first header are missing, which may say little.

        The camera is as likely in step as not, so one start has the weight of all others together.
        """
        steps = np.diff(times_s) / self.period_s
        odds = np.zeros(len(offset))
        if np.abs(steps - np.round(steps)).max() < STEP_TOLERANCE and steps.max() > GAP_PATTERNS:
            late = float((times_s[0] - self.start_s) / self.period_s)
            odds[np.argmin(np.abs(offset - (late - round(late))))] = np.log(len(offset))
        return odds

    def _move(self, pattern: int) -> None:
        """Predict the start of the header at a pattern."""
        steps = pattern - self._pattern
        nominal = steps * self._signal.pattern_period_s
        self.start_s, self._pattern = self.time_s(pattern), pattern
        move = np.array([[1.0, nominal], [0.0, 1.0]])
        self._covariance = move @ self._covariance @ move.T + np.diag([0.0, RATE_WALK**2 * steps])

    def _take(self, error_s: float, variance: float) -> None:
        """Correct start and rate by an error of the predicted start, whose variance is the posterior's."""
        if not self._measured:
            self.start_s += error_s
            self._covariance[0, 0] = variance
            self._measured = True
            return
        prior = self._covariance[0, 0]
        # the likelihood held the prior: x += P H^T S^-1 (posterior - prior), P += K (C - S) K^T
        kalman_gain = self._covariance[:, 0] / prior
        self.start_s += error_s
        self.rate += float(kalman_gain[1]) * error_s
        self._covariance = self._covariance + np.outer(kalman_gain, kalman_gain) * (min(variance, prior) - prior)

    def _cost(self, amplitudes: HeaderAmplitudes, offset: Floats) -> Floats:
        """Negative log likelihood (exposures, offsets) of starts `offset` patterns after the predicted start."""
        place = (amplitudes.times_s - self.start_s) / self.period_s
        wave, light = self._model(place - offset[:, None])
        alternation, brighter = 2 * amplitudes.alternation, amplitudes.brightness - amplitudes.brightness.mean()
        # a header of gain g: alternation g wave / 2, brightness g light and a constant, both linear in what is dimmed
        energy, count = float(alternation @ alternation), len(place)
        match, norm = wave @ alternation, _products(wave)
        if not amplitudes.clipped:
            trust, light = amplitudes.trust**2, light - light.mean(-1, keepdims=True)
            match, norm = match + trust * (light @ brighter), norm + trust * _products(light)
            energy, count = energy + trust * float(brighter @ brighter), 2 * count
        # v match and v norm v of every word's v = (1, part, lit)
        words, grid = np.column_stack([np.ones(len(self._dimmed)), self._dimmed]), match.shape[1:]
        m = np.maximum(words @ match.reshape(3, -1), 0)
        n = np.maximum((words[:, _ROWS] * words[:, _COLS] * _TIMES) @ norm.reshape(len(_ROWS), -1), TINY)
        explained, gains = m**2 / n, m / n
        word = explained.argmax(0)[None]
        left, gain = (np.take_along_axis(one, word, 0).reshape(grid) for one in (energy - explained, gains))
        best = np.unravel_index(np.argmin(left), grid)
        # whatever the model does not explain counts as noise
        freedom = max(count - 4, 1)
        self.gain = float(gain[best])
        self.explained = 1 - float(left[best]) / max(energy, TINY)
        variance = max((DEVIATION * self.gain) ** 2, float(left[best]) / freedom, TINY)
        return np.asarray(0.5 * left / variance)

    def _model(self, starts: Floats) -> tuple[Floats, Floats]:
        """Twice the alternation, and the brightness, of a header of gain 1, and what dimming adds to each.

        `starts` is (offsets, frames), the result (3, exposures, offsets, frames) each, as `_dimmings` has them.
        """
        edges, waves, brights = self._dimmings
        shown = _mean_over(starts[None], self._exposures[:, None, None], edges, np.concatenate([waves, brights]))
        return shown[: len(waves)], shown[len(waves) :]

    @cached_property
    def _dimmings(self) -> tuple[Floats, Floats, Floats]:
        """Edges of `_header`, and its waves and brightnesses, (3, slots).

        First those without dimmed cells, then what is added to them where all are dimmed, and where lit ones are dimmed
        more than dark.
        """
        (edges, *first), *others = (self._header(*way) for way in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
        waves, brights = map(np.stack, zip(first, *(shown for _, *shown in others), strict=True))
        # means over exposures are linear in them
        waves[1:] -= waves[0]
        brights[1:] -= brights[0]
        return edges, waves, brights

    def _header(self, part: float, lit: float = 0.0) -> tuple[Floats, Floats, Floats]:
        """Edges of slots in patterns from a header's start, the header less its inverse, and the mean light less 1/2.

        A fraction `part` of its cells is dimmed in all pairs but the first; the fraction of lit dimmed cells less that
        of dark dimmed ones is `lit`. In slots that show no dimmed cell that much light is missing.
        """
        count = 2 * self._signal.header_pairs
        first, patterns = -PATTERNS_AROUND - 2, count + 2 * PATTERNS_AROUND + 4
        edges = first + np.arange(patterns * SLOTS + 1) / SLOTS
        number = np.floor(edges[:-1] + TINY).astype(int)
        inside, later = (number >= 0) & (number < count), (number >= 2) & (number < count)
        contrast, light = (np.tile(values, patterns) for values in self._light.dimmed)
        wave = np.where(inside, np.where(number % 2, -1.0, 1.0), 0.0)
        # where more lit cells are dimmed than dark ones, the light their slots have or miss looks like the header
        wave = np.where(later, (1 - part + part * contrast) * wave + 2 * lit * (light - 0.5), wave)
        bright = np.where(inside, 0.0, np.tile(self._light.mean[:SLOTS] - 0.5, patterns))
        missing = 0.5 * lit * (1 - contrast) * np.where(number % 2, -1.0, 1.0)
        return edges, wave, np.where(later, part * (light - 0.5) - missing, bright)


def _mean_over(starts: Floats, exposure: Floats | float, edges: Floats, values: Floats) -> Floats:
    """Means over exposures of functions that are constant between even edges and 0 outside.

    Starts and exposures, of as many dimensions or one number, broadcast; `values` is (functions, slots), the result
    (functions, ...).
    """
    step, none = edges[1] - edges[0], np.zeros((len(values), 1))
    # in each slot a start and a slope; from the last edge on the integral stays as it is
    integral, slopes = np.hstack([none, np.cumsum(values, axis=1)]), np.hstack([values, none])

    def up_to(times: Floats) -> Floats:
        place = np.clip((times - edges[0]) / step, 0, len(edges) - 1)
        slot = place.astype(np.intp)
        return np.asarray(integral[:, slot] + (place - slot) * slopes[:, slot])

    return np.asarray((up_to(starts + exposure) - up_to(starts)) * (step / exposure))


def _products(shown: Floats) -> Floats:
    """Inner products over the frames of (3, exposures, offsets, frames), the upper triangle (6, exposures, offsets)."""
    return np.stack([np.einsum("eof,eof->eo", shown[a], shown[b]) for a, b in zip(_ROWS, _COLS, strict=True)])
