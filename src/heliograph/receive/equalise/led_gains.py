"""Gains of the LEDs, learnt from headers: LEDs that are dead, stuck or hidden have none.

In the difference of a header and its inverse the background cancels. An LED that does not follow the pattern is missing
there, whether dark, lit or hidden. With Y the header and w the gains of the LEDs, at least 0,

    d = g A diag(w) (2 Y - 1) + n,

the equaliser's problem with diag(w) (2 Y - 1) in place of the data: w follows by linear MMSE around w = 1. A bright
background may have pulled the pose away, and LEDs of a rim would then seem to miss, so the difference that an error of
the pose makes is marginalised.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.brightness import POSE_SPREADS, Brightness
from heliograph.receive.equalise.lmmse import equalise
from heliograph.receive.image.footprint import by_squares, to_grid
from heliograph.receive.image.robust import median_of
from heliograph.receive.observe import kernels
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, noise_beside
from heliograph.receive.observe.statistics import PairStatistics, whiten

LED_GAIN_SPREAD = 0.3
"""Prior standard deviation of an LED's gain about 1: a failed LED is 3.3 of them away."""

FAILED, SOUND = 0.25, 0.65
"""Estimates up to which an LED has the gain 0, and from which on it has 1. Between them the gain rises evenly.

Let headers show one LED by itself with the standard deviation s. The estimate goes k = p / (p + s^2) of the way from 1
to what they show, p being the prior variance `LED_GAIN_SPREAD`^2. Of a sound LED it has the standard deviation k s,
0.15 at most: 0.65 is 2.3 of them below 1. Of a failed LED it is 1 - k on average, below 0.25 where s is below 0.17.
With 0.125 and 0.825 none of 192 codewords is lost, with 0.5 and 0.3 24 are.
"""

CHANGED = 0.5
"""Change of an LED's gain for which the header's pose is fitted again: half of that from a sound to a failed one."""

LIT = 4.0
"""Noise variance inside the array over that beside it, where failed LEDs hide the first.

Photons make it 2.4 in the reference link; more only makes the estimate keep closer to 1.
"""

MODEL = 0.02
"""Error of the image that the affine pose and the Gaussian blur leave, as a fraction of the light.

An LED that is 0.02 px off the grid of the pose changes a pixel by up to 0.02 e^(-1/2) / 0.58 = 2 % of its peak: 0.58 px
is the standard deviation of a blur of 0.5 px with a pixel's own width. Half and twice of it lose none of 192 codewords.
"""

FADE = 0.5
"""Weight of earlier headers for each packet since: hidden LEDs come to light.

All earlier headers together then weigh as much as the new one, 1/2 + 1/4 + ... = 1.
"""

SETTLED = 0.1
"""Correction of the gain, as a fraction of `LED_GAIN_SPREAD`, below which no other one follows.

A tolerance: estimates are then off by less than 0.03, 1/13 of the way from `FAILED` to `SOUND`.
"""

MEDIAN_STEPS, MEDIAN_SCALES = 2, (0.5, 2.0)
"""Most corrections of the gain by the median LED, and bounds of one.

Chosen: the first bounds the time, the others what a header that shows no array does to the gain. With 1, (0.25, 1) and
with 4, (1, 4) none of 192 codewords is lost.
"""


@dataclass(frozen=True)  # without slots, which leave no room for what is cached
class LedGains:
    """Gains of an array's LEDs, and what headers have shown of them."""

    # (n, n) how much of each LED is in sight by headers, 0 to 1; 0 of one that is dead, stuck or hidden
    sight: Floats
    # Brightness of the LEDs by decoded data
    brightness: Brightness
    # Statistics of the headers so far, the gains times the header in place of the data; None before the first
    seen: PairStatistics | None = None

    @classmethod
    def sound(cls, side: int) -> "LedGains":
        """Gains of an array whose LEDs all give their light."""
        return cls.in_sight(np.ones((side, side)))

    @classmethod
    def in_sight(cls, sight: Floats) -> "LedGains":
        """Gains of an array of which nothing but a detection is known."""
        return cls(sight, Brightness.equal(len(sight)))

    @cached_property
    def values(self) -> Floats:
        """(n, n) gains, at least 0: the brightness of what is in sight; all cut-outs of a packet share them."""
        return self.sight * self.brightness.values

    @property
    def told(self) -> "LedGains":
        """The gains without what has shown them."""
        return LedGains(self.sight, self.brightness.told)

    @property
    def doubtful(self) -> bool:
        """Whether any LED seems hidden or failed."""
        return bool((self.sight < 1).any() or (self.brightness.values < FAILED).any())

    def rather(self, sight: Floats) -> "LedGains":
        """The same with other LEDs in sight."""
        return LedGains(sight, self.brightness, self.seen)

    def faded(self) -> "LedGains":
        """Trust earlier headers and packets less, as a packet has gone by."""
        seen = None if self.seen is None else self.seen.scaled(FADE)
        return LedGains(self.sight, self.brightness.faded(), seen)

    def learn(self, cutout: Cutout, header: Floats, gain: float, in_sight: Floats) -> "LearntGains":
        """Learn from a header pair."""
        if not in_sight.any():
            return LearntGains(self, gain, False)
        side, brightness = len(self.values), self.brightness.values
        dark = noise_beside([cutout], side)
        # with failed LEDs a sum does not show its noise
        whitened, noise = whiten(cutout, Noise(LIT * dark, dark), side), LIT * dark + (MODEL * gain) ** 2
        slopes = whitened.root * cutout.slopes(header)
        shown = whitened.without(slopes, np.diag(noise / (gain * POSE_SPREADS) ** 2))
        seen = shown if self.seen is None else self.seen.plus(shown)
        for _ in range(MEDIAN_STEPS):
            # of LEDs that data have shown to be dark a header says nothing
            found = _estimate(seen, header, brightness, gain, noise) / np.maximum(brightness, FAILED)
            # the median LED is a sound one
            scale = min(max(median_of(found[in_sight > 0]), MEDIAN_SCALES[0]), MEDIAN_SCALES[1])
            gain *= scale
            if abs(scale - 1) < SETTLED * LED_GAIN_SPREAD:
                break
        shown_sight = np.clip((found / scale - FAILED) / (SOUND - FAILED), 0, 1)
        shown_sight[brightness < FAILED] = 1.0
        sight = np.where(in_sight > 0, shown_sight, self.sight)
        changed = bool(np.abs(sight - self.sight).max() > CHANGED)
        kept = seen if in_sight.all() and not changed else None
        return LearntGains(LedGains(sight, self.brightness, kept), gain, changed)


@dataclass(frozen=True, slots=True)
class LearntGains:
    """What a header pair adds."""

    # Gains of the LEDs after this header
    led_gains: LedGains
    # Gray levels of the array with all LEDs on, by the LEDs that give their light
    gain: float
    # Whether an LED's gain changed so much that the pose was found with a wrong image: the pair is then to be followed
    # and learnt from once more
    changed: bool


def _estimate(seen: PairStatistics, header: Floats, brightness: Floats, gain: float, noise: float) -> Floats:
    """Gain of each LED, (n, n), by linear MMSE about its brightness."""
    signs = by_squares(header)
    mean = kernels.symbols_of(by_squares(header * brightness))
    # of diag(w) (2 Y - 1) of the variance s^2 the symbols have the variance 4 s^2, T T^T being 1/4
    symbols = equalise(seen, gain, noise, mean, np.full(mean.size, 4 * LED_GAIN_SPREAD**2)).mean
    return to_grid(kernels.leds_of(symbols) / signs)
