"""Brightness of the LEDs, learnt from decoded data: LEDs of one array differ, and some are dead.

Once symbols are known, the difference of a pair shows how much light each LED gives. Let beta be the
brightness of the LEDs, T c_known their light by the known symbols, sight the fraction of each LED in sight, and c_open
the symbols that are not known. Let e be an error of the pose, which a bright background may have pulled, and F the
derivatives of the image. Then

    d = g (A diag(sight T c_known) beta + o + B_open c_open + F e) + n,

which is linear in beta. Levels are random from pair to pair, so the pairs of a packet separate neighbours that blur has
mixed. c_open and e are marginalised: what they add is noise of known covariance. Normal equations add up over pairs and
packets. Those of every second pair are summed apart, which gives two halves. Errors of the image differ between the
halves. So LEDs count as unequal only where both halves say so.

Gains of the LEDs, learnt from headers: LEDs that are dead, stuck or hidden have none.

In the difference of a header and its inverse the background cancels. An LED that does not follow the pattern is missing
there, whether dark, lit or hidden. With Y the header and w the gains of the LEDs, at least 0,

    d = g A diag(w) (2 Y - 1) + n,

the equaliser's problem with diag(w) (2 Y - 1) in place of the data: w follows by linear MMSE around w = 1. A bright
background may have pulled the pose away, and LEDs of a rim would then seem to miss, so the difference that an error of
the pose makes is marginalised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve, solve_triangular

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import equalise
from heliograph.receive.geometry.fit import median_of
from heliograph.receive.geometry.footprint import by_squares, to_grid
from heliograph.receive.observe import kernels
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, noise_beside
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, whiten

POSE_SPREADS = np.array([0.2, 0.2, 0.004, 0.02])
"""Standard deviations of a pose's errors in x, y (px), ln pitch and roll before a bright background.

Over real footage sums were pulled by up to 0.19 px at 64 to 70 m and 0.4 px at 95 m (docs/measured.md, Tracking).
"""

BRIGHTNESS_SPREAD = 0.3
"""Prior standard deviation of an LED's brightness about 1: the largest spread that is to be read; a dead one is 3.3 of
them away."""

LINEAR_PX = 0.2
"""Error of a pose in px up to which its slope describes what it makes: half the width of an LED's image at 95 m.

With poses off by 0.14 px equal LEDs are found to be equal, with 0.28 px they seem to differ by 0.1 (known data, 95 m).
"""

BRIGHTNESS_FADE = 0.9
"""Weight of earlier packets for each packet since: ten of them count, one second."""

LEAST_BRIGHTNESS, MOST_BRIGHTNESS = 0.02, 3.0
"""Bounds of an estimate.

Chosen: the first keeps a dead LED at a fiftieth, because evidence is divided by the brightness. So the LED can return.
The second bounds what noise adds to an LED of which little is seen: 3 is 6.7 of the prior's standard deviations.
"""

UNEQUAL = 0.05
"""Rms difference from 1 on which the halves of the pairs agree, from which on LEDs count as unequal.

Over the strongest bumps of a recorded drive at 95 m each half differed by 0.07 to 0.17 from equal LEDs; they agreed on
0.034 at most, the root of the mean product.
"""

LEARNING_STRIDE, KNOWN_STRIDE = 3, 12
"""One pair of so many is learnt from.

The first holds at the beginning. The second holds once each LED is known to half of `UNEQUAL`, or once LEDs have seemed
equal for `ENOUGH_PACKETS`. Chosen for speed: at 95 m 16 pairs of one packet show each LED to 3 %.
"""

ENOUGH_PACKETS = 5
"""Packets after which LEDs that seem equal are learnt from fewer pairs, and LEDs that saturate are known no better.

It is half of the ten packets that count by `BRIGHTNESS_FADE`.
"""


@dataclass(frozen=True, slots=True)
class DecodedPair:
    """A pair of which symbols are decoded."""

    # Its statistics, made with the brightness known so far
    statistics: PairStatistics
    # (symbols,) +-1, and 0 for those that are not decoded
    symbols: Floats
    # (4, rows, columns) derivatives F of the decoded symbols' image by x, y, ln pitch and roll, times W^(1/2)
    slopes: Floats
    # Its cut-out, divided by its noise
    whitened: WhitenedCutout

    @property
    def unknown(self) -> NDArray[np.intp]:
        """Numbers of the symbols that are not decoded."""
        return np.flatnonzero(self.symbols == 0)

    def without_nuisance(self, gain: float, noise: float) -> tuple[NDArray[np.float32], Floats]:
        """G and B^T W (d - g o), what undecoded symbols and an error of the pose may have added marginalised."""
        pair, whitened, unknown = self.statistics, self.whitened, self.unknown
        # N = (B_open, F): G - B^T N (N^T N + s^2 / g^2 P^-1)^-1 N^T B
        slopes = self.slopes.reshape(len(self.slopes), -1)
        shown = (whitened.difference - gain * whitened.offset).ravel()
        seen, images = pair.matched - gain * pair.offset, whitened.all_correlated(self.slopes)
        inner = np.block([[pair.gram[unknown][:, unknown], images[unknown]], [images[unknown].T, slopes @ slopes.T]])
        inner += noise / gain**2 * np.diag(np.append(np.ones(unknown.size), POSE_SPREADS**-2))
        across = np.vstack([pair.gram[unknown], images.T])
        both = np.column_stack([across, np.append(seen[unknown], slopes @ shown)]).astype(np.float32)
        # L^-1 (N^T B, N^T d) = (h, h_d): their products are what is taken off
        root = np.linalg.cholesky(inner.astype(np.float32))
        half = solve_triangular(root, both, lower=True, check_finite=False)
        left, taken = half[:, :-1], half[:, -1]
        # the most probable error of the pose, with the decoded symbols' light taken off
        error = solve_triangular(root.T, taken - gain * left @ self.symbols, check_finite=False)[-4:] / gain
        if np.hypot(error[0], error[1]) > LINEAR_PX:
            raise np.linalg.LinAlgError("the pose is too far off")
        return pair.gram - left.T @ left, seen - left.T @ taken


@dataclass(frozen=True, slots=True)
class Brightness:
    """Brightness of an array's LEDs, and what decoded data have shown of it."""

    # (n, n) brightness, 1 for the median LED
    values: Floats
    # (2, n n, n n) sums of the normal equations' matrices over each half of the pairs, ordered as by `by_squares`; (2,
    # 0, 0) before the first pair, and where the brightness alone is told
    information: Floats
    # (2, n n) sums of their right sides; (2, 0) likewise
    score: Floats
    # Packets that were learnt from
    packets: int = 0

    @classmethod
    def equal(cls, side: int) -> "Brightness":
        """LEDs of which nothing is known."""
        return cls(np.ones((side, side)), np.empty((2, 0, 0)), np.empty((2, 0)))

    @property
    def told(self) -> "Brightness":
        """The brightness without what has shown it, which is 2 n^2 times as long; whoever learns on begins anew."""
        return replace(Brightness.equal(len(self.values)), values=self.values)

    @property
    def known(self) -> bool:
        """Whether most LEDs are known to half of `UNEQUAL`."""
        shown = self.information.sum(0).diagonal()
        return bool(shown.size and np.median(shown) > (0.5 * UNEQUAL) ** -2)

    @property
    def equal_so_far(self) -> bool:
        """Whether nothing shows that LEDs differ."""
        return bool((self.values == 1).all())

    @property
    def settled(self) -> bool:
        """Whether LEDs are known to be equal: while all is read nothing more need be learnt."""
        return self.known and self.equal_so_far

    @property
    def learnt(self) -> bool:
        """Whether packets read without it need tell no more: LEDs are known, or enough packets did not show them."""
        return self.known or self.packets >= ENOUGH_PACKETS

    @property
    def stride(self) -> int:
        """Pairs of which one is worth learning from."""
        enough = self.known or (self.packets >= ENOUGH_PACKETS and self.equal_so_far)
        return KNOWN_STRIDE if enough else LEARNING_STRIDE

    def faded(self) -> "Brightness":
        """Trust earlier packets less, as one has gone by."""
        return replace(self, information=BRIGHTNESS_FADE * self.information, score=BRIGHTNESS_FADE * self.score)

    def differs(self, other: "Brightness") -> bool:
        """Whether it is another than what was taken so far, by more than the light of equal LEDs seems to differ."""
        return bool(np.sqrt(np.mean((self.values - other.values) ** 2)) > UNEQUAL)

    def learn(self, pairs: Sequence[DecodedPair], gain: float, noise: float) -> "Brightness":
        """Learn from decoded symbols."""
        if not pairs or gain <= 0:
            return self
        information, score = self._evidence()
        seen_pairs = 0
        inverse = 1 / by_squares(self.values)
        for k, pair in enumerate(pairs):
            try:
                gram, seen = pair.without_nuisance(gain, noise)
            except np.linalg.LinAlgError:
                continue
            # the statistics hold the LEDs' light times their brightness so far
            levels = kernels.leds_of(pair.symbols) * inverse
            # T T^T = 1/4: A^T W A = 16 T G T^T, A^T W d = 4 T B^T W d
            kernels.add_information(gram, levels, gain**2 / noise, information[k % 2])
            score[k % 2] += gain / noise * levels * 4 * kernels.leds_of(seen)
            seen_pairs += 1
        if not seen_pairs:
            return replace(self, packets=self.packets + 1)
        return Brightness(_estimate_brightness(information, score), information, score, self.packets + 1)

    def _evidence(self) -> tuple[Floats, Floats]:
        """Copies of information and score, with zeros where nothing was seen yet."""
        if self.score.size:
            return self.information.copy(), self.score.copy()
        count = self.values.size
        return np.zeros((2, count, count)), np.zeros((2, count))


def _estimate_brightness(information: Floats, score: Floats) -> Floats:
    """Most probable brightness, (n, n), the median LED's being 1; all of them 1 where the halves do not agree."""
    one, other = (_most_probable(*half) for half in zip(information, score, strict=True))
    if np.mean((one - 1) * (other - 1)) < UNEQUAL**2:
        return np.ones_like(to_grid(one))
    both = _most_probable(information.sum(0), score.sum(0))
    return to_grid(np.clip(both, LEAST_BRIGHTNESS, MOST_BRIGHTNESS))


def _most_probable(information: Floats, score: Floats) -> Floats:
    """Most probable brightness by normal equations and the prior, (n n,), the median LED's being 1."""
    prior = BRIGHTNESS_SPREAD**-2
    found = solve(information + prior * np.eye(len(score)), score + prior, assume_a="pos", check_finite=False)
    return np.asarray(found / max(float(np.median(found)), LEAST_BRIGHTNESS))


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
