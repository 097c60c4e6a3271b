"""When the patterns are: the light's clock against the camera's, measured by each header and carried on between.

How much of the header less its inverse a frame shows, from -1 to 1, is the mean of a square wave over the exposure,
which is 0 outside of the header. And PWM lights an array brightly at the start of a pattern and dimly at its end (15,
11, 5 and 1 sixteenths of the LEDs in the slots of random data), but evenly through a header, but where cells are
dimmed to name a format: what part of them is, is found along. Both are compared, for all frames around a header, with
what starts and exposures between bounds would give; the likelihood over both is the measurement. The exposure stays,
so its likelihoods multiply from header to header. The start goes into a Kalman filter of time and rate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft.mix import SlotLight
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

AROUND = 2
"""Patterns before and after a header whose frames are looked at too: at its ends most is learned."""

DEVIATION = 0.03
"""Standard deviation of what random data look like as a header, and of their brightness: 1/4 of each LED, over 256."""

EXPOSURES = 20
"""Exposures tried, up to the whole frame period."""

LONGER, WHOLE = 20.0, 3.0
"""Log odds beforehand of an exposure of the whole frame period against one of none, and on top of them of the very
whole. Exposures of any length about the middle of a pattern, or about its end, look the same in headers and have the
same brightness: the longest is taken."""

GIVEN_UP = 40.0
"""Log odds against an exposure from which on it is not tried any more."""

STARTS = 121
"""Starts of the header tried."""

REACH = 1.25
"""Patterns either way that the start may differ from the detection's."""

RATE = 2.5e-4
"""Standard deviation of the light's rate against the camera's before it is measured: both may be 200 ppm off."""

RATE_WALK = 2e-6
"""Its random walk per square root of a second."""

EXPLAINED = 0.7
"""Share of what frames show of a header that it must explain: the rest is clutter, or the array is dark."""

LEAST_DEVIATION = 0.004
"""Least standard deviation of a measured start in T_b."""

CLIPPED = 0.02
"""Share of an array's pixels at full scale from which on its brightness is not used."""

MARGIN_PX = 3.0
"""Surroundings of the array against which its brightness is measured."""


@dataclass(frozen=True, slots=True)
class HeaderView:
    """What the frames around a header show.

    Attributes
    ----------
    times_s
        (frames,) starts of the exposures.
    alternation
        (frames,) the header less its inverse in gray levels.
    brightness
        (frames,) the array in gray levels, but for a constant.
    clipped
        Whether pixels were at full scale: the brightness of a near array tells nothing then.
    """

    times_s: Floats
    alternation: Floats
    brightness: Floats
    clipped: bool = False


class Clock:
    """The light's clock in the camera's time.

    Parameters
    ----------
    start_s
        When a header roughly began.
    period_s
        The camera's frame period.
    signal
        What the light speaks.
    identity
        The array's: its header is the one looked at.
    exposure_s
        The camera's exposure where it is known, else None.
    """

    def __init__(
        self, start_s: float, period_s: float, signal: SignalSettings, identity: int, exposure_s: float | None = None
    ):
        self._signal = signal
        # what words dim of the header: the part of its cells, and what of them is lit less what is dark
        cells = words() / words().shape[1]
        self._dimmed = np.unique(np.stack([cells.sum(1), cells @ header_cells(identity).ravel()], axis=1), axis=0)
        self._light = SlotLight(signal.slot_order)
        self.start_s = start_s
        """Start of the last header that was due, as measured or, where it was not seen, as predicted."""
        self.rate = 0.0
        """Its pattern period is longer by this share than the nominal one."""
        self.gain = 0.0
        """Light of the array with all LEDs on in the last header, in gray levels."""
        self.explained = 0.0
        """Share of what the frames around the last header show that the header explains, in squares."""
        self._pattern = 0
        self._covariance = np.diag([0.0, RATE**2])
        self._measured = False
        longest = min(period_s / signal.pattern_period_s, 1.0)
        self._exposures = longest * np.linspace(1 / EXPOSURES, 1.0, EXPOSURES)
        if exposure_s is not None:
            self._exposures = np.array([min(exposure_s / signal.pattern_period_s, longest)])
        self._evidence = LONGER * self._exposures / longest
        self._evidence[-1] += WHOLE
        self._beforehand = self._evidence

    @property
    def period_s(self) -> float:
        """Pattern period by the camera's clock."""
        return self._signal.pattern_period_s * (1 + self.rate)

    @property
    def deviation(self) -> float:
        """Standard deviation of the patterns' starts by the last header, in T_b."""
        return float(np.sqrt(self._covariance[0, 0])) / self.period_s

    @property
    def exposure(self) -> float:
        """Exposure in T_b."""
        chance = np.exp(self._evidence - self._evidence.max())
        return float(chance @ self._exposures / chance.sum())

    def time_s(self, pattern: float) -> float:
        """Time of a pattern's start, patterns counted from the header of the detection."""
        return self.start_s + (pattern - self._pattern) * self.period_s

    def place(self, time_s: float | Floats) -> Floats:
        """Patterns since the header of the detection began."""
        return np.asarray(self._pattern + (np.asarray(time_s) - self.start_s) / self.period_s)

    def header(self, starts: Floats, dimmed: float) -> tuple[Floats, Floats]:
        """What frames show of a header, a part of whose cells is dimmed in all pairs but the first.

        Parameters
        ----------
        starts
            (frames,) starts of the exposures, in patterns from the header's.
        dimmed
            That part.

        Returns
        -------
        How much of the header less its inverse each shows, -1 to 1, and the mean light, (frames,) each.
        """
        edges, wave, bright = self._header(dimmed)
        shown, light = (_mean_over(starts, self.exposure, edges, values) for values in (wave, bright))
        return shown, 0.5 + light

    def measure(self, view: HeaderView, pattern: int, again: bool = False) -> bool:
        """Take the header that begins with a pattern.

        Parameters
        ----------
        view
            What frames show of it.
        pattern
            Its first.
        again
            Whether it is the first header once more, seen with better poses: what it told before counts only for where
            to look.

        Returns
        -------
        Whether a header was seen; if not, the clock goes on as it was.
        """
        self._move(pattern)
        spread, gain = self.deviation, self.gain
        reach = min(max(6 * spread, 0.1), 0.5) if self._measured else REACH
        offset = np.linspace(-reach, reach, STARTS)
        likely = self._evidence > self._evidence.max() - GIVEN_UP
        self._exposures, self._evidence = self._exposures[likely], self._evidence[likely]
        self._beforehand = self._beforehand[likely]
        cost = self._cost(view, offset)
        if self._measured and self.explained < EXPLAINED:
            self.gain = gain
            return False
        if again:
            self._evidence, self._measured = self._beforehand, False
        if self._measured:
            cost = cost + 0.5 * (offset / max(spread, LEAST_DEVIATION)) ** 2
        by_exposure = -cost.min(1) + np.log(np.exp(cost.min(1)[:, None] - cost).sum(1))
        self._evidence = self._evidence + by_exposure - by_exposure.max()
        chance = np.exp((self._evidence - self._evidence.max() - by_exposure)[:, None] - cost)
        chance = chance.sum(0) / chance.sum()
        mean = float(chance @ offset)
        variance = float(chance @ (offset - mean) ** 2) + LEAST_DEVIATION**2
        self._take(mean * self.period_s, variance * self.period_s**2)
        return True

    def _move(self, pattern: int) -> None:
        """Predict the start of the header at a pattern."""
        steps = pattern - self._pattern
        nominal = steps * self._signal.pattern_period_s
        self.start_s, self._pattern = self.time_s(pattern), pattern
        move = np.array([[1.0, nominal], [0.0, 1.0]])
        self._covariance = move @ self._covariance @ move.T + np.diag([0.0, RATE_WALK**2 * nominal])

    def _take(self, error_s: float, variance: float) -> None:
        """Correct start and rate by a start measured; the variance is that of the posterior."""
        if not self._measured:
            self.start_s += error_s
            self._covariance[0, 0] = variance
            self._measured = True
            return
        prior = self._covariance[0, 0]
        # the likelihood held the prior: x += K S^-1 (posterior - prior) as in `PoseState.condition`
        gain = self._covariance[:, 0] / max(prior, 1e-30)
        self.start_s += error_s
        self.rate += float(gain[1]) * error_s
        self._covariance = self._covariance + np.outer(gain, gain) * (min(variance, prior) - prior)

    def _cost(self, view: HeaderView, offset: Floats) -> Floats:
        """Negative log likelihood (exposures, offsets) of starts `offset` patterns after the predicted one."""
        place = (view.times_s - self.start_s) / self.period_s
        starts = place - offset[:, None]
        shown = np.concatenate([2 * view.alternation, view.brightness - view.brightness.mean()])
        # a header of gain g: alternation g wave / 2, brightness g bright and a constant, linear in what is dimmed
        model = np.stack([self._model(starts, *dim) for dim in ((0, 0), (1, 0), (0, 1))])
        if view.clipped:
            shown, model = shown[: len(place)], model[..., : len(place)]
        model[1:] -= model[0]
        match, norm = model @ shown, np.einsum("aeof,beof->abeo", model, model)
        energy, left, gain = float((shown**2).sum()), np.full(match.shape[1:], np.inf), np.zeros(match.shape[1:])
        for part, lit in self._dimmed:
            v = np.array([1.0, part, lit])
            m, n = np.maximum(np.tensordot(v, match, 1), 0), np.maximum(np.einsum("a,b,abeo->eo", v, v, norm), 1e-9)
            better = energy - m**2 / n < left
            left[better], gain[better] = (energy - m**2 / n)[better], (m / n)[better]
        best = np.unravel_index(np.argmin(left), left.shape)
        # what the model leaves unexplained counts as noise
        freedom = max(len(shown) - 4, 1)
        self.gain = float(gain[best])
        self.explained = 1 - float(left[best]) / max(energy, 1e-9)
        variance = max((DEVIATION * self.gain) ** 2, float(left[best]) / freedom, 1e-9)
        return np.asarray(0.5 * left / variance)

    def _model(self, starts: Floats, part: float, lit: float) -> Floats:
        """What frames that start at `starts` (offsets, frames) show of a header of gain 1, dimmed as in `_header`.

        Returns
        -------
        Twice its alternation and its brightness but for a constant, (exposures, offsets, 2 frames).
        """
        edges, wave, bright = self._header(part, lit)
        exposures = self._exposures[:, None, None]
        light = _mean_over(starts, exposures, edges, bright)
        light -= light.mean(-1, keepdims=True)
        return np.concatenate([_mean_over(starts, exposures, edges, wave), light], axis=-1)

    def _header(self, part: float, lit: float = 0.0) -> tuple[Floats, Floats, Floats]:
        """Slots' edges in patterns from its start, the header less its inverse, and the mean light less 1/2.

        A part of its cells is dimmed in all pairs but the first, `lit` more of them lit cells than dark ones: in slots
        that show no dimmed cell so many of the others are missing.
        """
        count = 2 * self._signal.header_pairs
        first, patterns = -AROUND - 2, count + 2 * AROUND + 4
        edges = first + np.arange(patterns * SLOTS + 1) / SLOTS
        number = np.floor(edges[:-1] + 1e-9).astype(int)
        inside, later = (number >= 0) & (number < count), (number >= 2) & (number < count)
        contrast, light = (np.tile(values, patterns) for values in self._light.dimmed)
        wave = np.where(inside, np.where(number % 2, -1.0, 1.0), 0.0)
        # where more lit cells are dimmed than dark ones, light that their slots have or miss looks like the header
        wave = np.where(later, (1 - part + part * contrast) * wave + 2 * lit * (light - 0.5), wave)
        bright = np.where(inside, 0.0, np.tile(self._light.mean[:SLOTS] - 0.5, patterns))
        missing = 0.5 * lit * (1 - contrast) * np.where(number % 2, -1.0, 1.0)
        return edges, wave, np.where(later, part * (light - 0.5) - missing, bright)


def view_header(frames: list[Frame], poses: list[Pose], lit: Floats) -> HeaderView:
    """Measure what frames show.

    Parameters
    ----------
    frames
        Those around a header.
    poses
        The array's in each.
    lit
        (n, n) the header, +-1; 0 where it is hidden.
    """
    shown = np.array([_shown(frame, pose, lit) for frame, pose in zip(frames, poses, strict=True)])
    return HeaderView(np.array([f.time_s for f in frames]), shown[:, 0], shown[:, 1], shown[:, 2].max() > CLIPPED)


def _shown(frame: Frame, pose: Pose, lit: Floats) -> Floats:
    """Amplitudes of the header and of the array all on before an even background; the share of its pixels that clip."""
    from heliograph.receive import kernels  # Numba is slow to import

    x0, y0, width, height = window_around(pose, len(lit), MARGIN_PX)
    cut = cut_out(frame, x0, y0, width, height)
    model = np.empty((2, 6, height, width))
    kernels.render(pose.full_vector(), lit, float(x0), float(y0), model[0])
    kernels.render(pose.full_vector(), np.abs(lit), float(x0), float(y0), model[1])
    columns = np.stack([model[0, 0].ravel(), model[1, 0].ravel(), np.ones(cut.size)], axis=1)
    inside = model[1, 0] >= 0.5 * model[1, 0].max()
    clipped = (cut[inside] >= frame.full_scale).mean()
    # where only lit LEDs or only dark ones are left the two images are one
    return np.append(np.linalg.lstsq(columns, cut.ravel(), rcond=1e-6)[0][:2], clipped)


def _mean_over(starts: Floats, exposure: Floats | float, edges: Floats, values: Floats) -> Floats:
    """Mean over exposures of a function that is constant between edges and 0 outside of them.

    Exposures are one, or as many as broadcast against their starts.
    """
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(edges))])
    return np.asarray((np.interp(starts + exposure, edges, integral) - np.interp(starts, edges, integral)) / exposure)
