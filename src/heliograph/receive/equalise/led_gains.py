"""Gains of LEDs, from headers and from decoded data.

Brightness, from decoded data: LEDs of an array differ, and some are dead. Let beta be the brightness of the LEDs,
T c_known the light by the known symbols, sight the visible fraction of each LED, and c_open the unknown symbols. Let e
be an error of the pose, which a bright background may have pulled, and F the derivatives of the image. Then

    d = g (A diag(sight T c_known) beta + o + B_open c_open + F e) + n,

which is linear in beta. Levels are random from pair to pair, so the pairs of a packet separate neighbours mixed by
blur. c_open and e are marginalised. Normal equations add up over pairs and packets, separately for the odd and even
pairs. Errors of the image differ between the halves, so LEDs count as unequal only if both halves show the difference.

Sight, from headers: dead, stuck and occluded LEDs do not follow the pattern. In the difference of a header and the
inverse the background cancels. With Y the header and w the gains of the LEDs, at least 0,

    d = g A diag(w) (2 Y - 1) + n,

the problem of the equaliser with diag(w) (2 Y - 1) in place of the data: w follows by linear MMSE around w = 1. An
error of the pose would make LEDs of a rim seem to miss, and is marginalised.
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


@dataclass(frozen=True, slots=True)
class GainParameters:
    """Tuning of the estimates of LED gains."""

    # Prior standard deviation of an LED's gain about 1; a failed LED is 3.3 of these away
    spread: float = 0.3
    # Standard deviations of errors of a pose in x, y (px), ln pitch and roll before a bright background
    pose_spreads: tuple[float, float, float, float] = (0.2, 0.2, 0.004, 0.02)
    # Error of a pose in px up to which the slopes of the image describe the effect: half an LED's width at 95 m
    max_pose_error_px: float = 0.2
    # Bounds of a brightness; a dead LED keeps the lower one, as evidence is divided by brightness
    min_brightness: float = 0.02
    max_brightness: float = 3.0
    # Rms difference from 1, in both halves of the pairs, from which LEDs count as unequal
    min_difference: float = 0.05
    # Weight of earlier packets for each later packet: about ten packets count
    packet_fade: float = 0.9
    # Pairs per evaluated pair, at first and once the brightness is known
    stride: int = 3
    known_stride: int = 12
    # Packets after which seemingly equal LEDs count as known
    max_packets: int = 5
    # Estimates by headers up to which an LED has the gain 0, and from which it has 1
    max_failed: float = 0.25
    min_sound: float = 0.65
    # Change of a gain after which a header's pose is fitted again: half of the change from sound to failed
    max_change: float = 0.5
    # Noise variance inside the array relative to the background, if failed LEDs hide it
    lit_ratio: float = 4.0
    # Error of the image by the affine pose and the Gaussian blur, relative to the light
    image_error: float = 0.02
    # Weight of earlier headers for each later packet: occluded LEDs become visible again
    header_fade: float = 0.5
    # Corrections of the gain by the median LED at most, bounds of a correction, and the relative size that ends them
    max_corrections: int = 2
    corrections: tuple[float, float] = (0.5, 2.0)
    end_correction: float = 0.03


GAINS = GainParameters()


@dataclass(frozen=True, slots=True)
class DecodedPair:
    """A pair with decoded symbols."""

    # Statistics with the brightness known so far
    statistics: PairStatistics
    # (symbols,) +-1, and 0 for undecoded symbols
    symbols: Floats
    # (4, rows, columns) derivatives F of the decoded symbols' image by x, y, ln pitch and roll, times W^(1/2)
    slopes: Floats
    # Whitened cut-out
    whitened: WhitenedCutout

    def without_nuisance(self, gain: float, noise: float) -> tuple[NDArray[np.float32], Floats]:
        """Compute G and B^T W (d - g o) with undecoded symbols and an error of the pose marginalised."""
        pair, whitened, unknown = self.statistics, self.whitened, np.flatnonzero(self.symbols == 0)
        # N = (B_open, F): G - B^T N (N^T N + s^2 / g^2 P^-1)^-1 N^T B
        slopes = self.slopes.reshape(len(self.slopes), -1)
        light = (whitened.difference - gain * whitened.offset).ravel()
        matched, images = pair.matched - gain * pair.offset, whitened.correlate(self.slopes)
        inner = np.block([[pair.gram[unknown][:, unknown], images[unknown]], [images[unknown].T, slopes @ slopes.T]])
        precision = np.append(np.ones(unknown.size), np.array(GAINS.pose_spreads) ** -2)
        inner += noise / gain**2 * np.diag(precision)
        across = np.vstack([pair.gram[unknown], images.T])
        right = np.column_stack([across, np.append(matched[unknown], slopes @ light)]).astype(np.float32)
        # L^-1 (N^T B, N^T d) = (h, h_d): the products are subtracted
        root = np.linalg.cholesky(inner.astype(np.float32))
        half = solve_triangular(root, right, lower=True, check_finite=False)
        h, h_d = half[:, :-1], half[:, -1]
        # the most probable error of the pose, without the light of the decoded symbols
        error = solve_triangular(root.T, h_d - gain * h @ self.symbols, check_finite=False)[-4:] / gain
        if np.hypot(error[0], error[1]) > GAINS.max_pose_error_px:
            raise np.linalg.LinAlgError("the pose is too far off")
        return pair.gram - h.T @ h, matched - h.T @ h_d


@dataclass(frozen=True, slots=True)
class Brightness:
    """Brightness of an array's LEDs and the evidence of decoded data."""

    # (n, n) brightness, 1 for the median LED
    values: Floats
    # (2, n n, n n) sums of the normal equations' matrices over each half of the pairs, ordered as by `by_squares`;
    # (2, 0, 0) without evidence
    information: Floats
    # (2, n n) sums of the right sides; (2, 0) without evidence
    score: Floats
    # Number of evaluated packets
    packets: int = 0

    @classmethod
    def equal(cls, side: int) -> "Brightness":
        """Brightness of unknown LEDs."""
        return cls(np.ones((side, side)), np.empty((2, 0, 0)), np.empty((2, 0)))

    @property
    def without_evidence(self) -> "Brightness":
        """The brightness without the evidence, which is 2 n^2 times as long."""
        return replace(Brightness.equal(len(self.values)), values=self.values)

    @property
    def known(self) -> bool:
        """True if most LEDs are known to half of the least difference."""
        information = self.information.sum(0).diagonal()
        return bool(information.size and np.median(information) > (0.5 * GAINS.min_difference) ** -2)

    @property
    def seems_equal(self) -> bool:
        """True if no evidence shows that LEDs differ."""
        return bool((self.values == 1).all())

    @property
    def settled(self) -> bool:
        """True if LEDs are known to be equal: complete packets need not be evaluated."""
        return self.known and self.seems_equal

    @property
    def learnt(self) -> bool:
        """True if LEDs are known, or enough packets did not show the brightness."""
        return self.known or self.packets >= GAINS.max_packets

    @property
    def stride(self) -> int:
        """Pairs per pair to evaluate."""
        known = self.known or (self.learnt and self.seems_equal)
        return GAINS.known_stride if known else GAINS.stride

    def faded(self) -> "Brightness":
        """Reduce the weight of earlier packets, once per packet."""
        fade = GAINS.packet_fade
        return replace(self, information=fade * self.information, score=fade * self.score)

    def differs(self, other: "Brightness") -> bool:
        """True if it differs from another by more than the error of equal LEDs."""
        return bool(np.sqrt(np.mean((self.values - other.values) ** 2)) > GAINS.min_difference)

    def learn(self, pairs: Sequence[DecodedPair], gain: float, noise: float) -> "Brightness":
        """Update the brightness from decoded symbols."""
        if not pairs or gain <= 0:
            return self
        count, used = self.values.size, 0
        information, score = np.zeros((2, count, count)), np.zeros((2, count))
        if self.score.size:
            information, score = self.information.copy(), self.score.copy()
        inverse = 1 / by_squares(self.values)
        for k, pair in enumerate(pairs):
            try:
                gram, matched = pair.without_nuisance(gain, noise)
            except np.linalg.LinAlgError:
                continue
            # the statistics hold the light of the LEDs times the brightness so far
            levels = kernels.leds_of(pair.symbols) * inverse
            # T T^T = 1/4: A^T W A = 16 T G T^T, A^T W d = 4 T B^T W d
            kernels.add_information(gram, levels, gain**2 / noise, information[k % 2])
            score[k % 2] += gain / noise * levels * 4 * kernels.leds_of(matched)
            used += 1
        if not used:
            return replace(self, packets=self.packets + 1)
        return Brightness(_estimate_brightness(information, score), information, score, self.packets + 1)


def _estimate_brightness(information: Floats, score: Floats) -> Floats:
    """Estimate the brightness, (n, n), relative to the median LED; 1 for all LEDs if the halves disagree."""
    first, second = (_solve_brightness(*half) for half in zip(information, score, strict=True))
    if np.mean((first - 1) * (second - 1)) < GAINS.min_difference**2:
        return np.ones_like(to_grid(first))
    joint = _solve_brightness(information.sum(0), score.sum(0))
    return to_grid(np.clip(joint, GAINS.min_brightness, GAINS.max_brightness))


def _solve_brightness(information: Floats, score: Floats) -> Floats:
    """Solve normal equations with the prior, (n n,), relative to the median LED."""
    prior = GAINS.spread**-2
    brightness = solve(information + prior * np.eye(len(score)), score + prior, assume_a="pos", check_finite=False)
    return np.asarray(brightness / max(float(np.median(brightness)), GAINS.min_brightness))


@dataclass(frozen=True)  # without slots, for a cached property
class LedGains:
    """Gains of an array's LEDs and the evidence of headers."""

    # (n, n) visible fraction of each LED by headers, 0 to 1; 0 of a dead, stuck or occluded LED
    sight: Floats
    # Brightness of the LEDs by decoded data
    brightness: Brightness
    # Statistics of the headers so far, with the gains times the header in place of the data; None before the first
    header_statistics: PairStatistics | None = None

    @classmethod
    def sound(cls, side: int) -> "LedGains":
        """Gains of an array without failed LEDs."""
        return cls.in_sight(np.ones((side, side)))

    @classmethod
    def in_sight(cls, sight: Floats) -> "LedGains":
        """Gains of an array after the detection."""
        return cls(sight, Brightness.equal(len(sight)))

    @cached_property
    def values(self) -> Floats:
        """(n, n) gains, at least 0: the brightness times the visible fraction; all cut-outs of a packet share them."""
        return self.sight * self.brightness.values

    @property
    def without_evidence(self) -> "LedGains":
        """The gains without the evidence."""
        return LedGains(self.sight, self.brightness.without_evidence)

    @property
    def doubtful(self) -> bool:
        """True if any LED seems occluded or failed."""
        return bool((self.sight < 1).any() or (self.brightness.values < GAINS.max_failed).any())

    def with_visibility(self, sight: Floats) -> "LedGains":
        """Replace the visible fractions of the LEDs."""
        return LedGains(sight, self.brightness, self.header_statistics)

    def faded(self) -> "LedGains":
        """Reduce the weight of earlier headers and packets, once per packet."""
        faded = None if self.header_statistics is None else self.header_statistics.scaled(GAINS.header_fade)
        return LedGains(self.sight, self.brightness.faded(), faded)

    def learn(self, cutout: Cutout, header: Floats, gain: float, in_sight: Floats) -> "LearntGains":
        """Update the gains from a header pair."""
        if not in_sight.any():
            return LearntGains(self, gain, False)
        p, side, brightness = GAINS, len(self.values), self.brightness.values
        # failed LEDs hide the noise of a sum
        dark = noise_beside([cutout], side)
        lit = p.lit_ratio * dark
        whitened, noise = whiten(cutout, Noise(lit, dark), side), lit + (p.image_error * gain) ** 2
        slopes = whitened.root * cutout.slopes(header)
        statistics = whitened.marginalised(slopes, np.diag(noise / (gain * np.array(p.pose_spreads)) ** 2))
        joint = statistics if self.header_statistics is None else self.header_statistics.plus(statistics)
        for _ in range(p.max_corrections):
            # a header shows no LED known to be dark from data
            estimate = _estimate_sight(joint, header, brightness, gain, noise) / np.maximum(brightness, p.max_failed)
            # the median LED is sound
            low, high = p.corrections
            scale = min(max(median_of(estimate[in_sight > 0]), low), high)
            gain *= scale
            if abs(scale - 1) < p.end_correction:
                break
        visible = np.clip((estimate / scale - p.max_failed) / (p.min_sound - p.max_failed), 0, 1)
        visible[brightness < p.max_failed] = 1.0
        sight = np.where(in_sight > 0, visible, self.sight)
        changed = bool(np.abs(sight - self.sight).max() > p.max_change)
        evidence = joint if in_sight.all() and not changed else None
        return LearntGains(LedGains(sight, self.brightness, evidence), gain, changed)


@dataclass(frozen=True, slots=True)
class LearntGains:
    """Gains after a header pair."""

    # Gains of the LEDs after this header
    led_gains: LedGains
    # Gray levels of the array with all LEDs on, by the sound LEDs
    gain: float
    # True if a gain changed so much that the pose came from a wrong image: the pair must be tracked and evaluated again
    changed: bool


def _estimate_sight(pair: PairStatistics, header: Floats, brightness: Floats, gain: float, noise: float) -> Floats:
    """Estimate the gain of each LED, (n, n), by linear MMSE about the brightness."""
    signs = by_squares(header)
    mean = kernels.symbols_of(by_squares(header * brightness))
    # for diag(w) (2 Y - 1) of variance s^2 the symbols have the variance 4 s^2, as T T^T = 1/4
    symbols = equalise(pair, gain, noise, mean, np.full(mean.size, 4 * GAINS.spread**2)).mean
    return to_grid(kernels.leds_of(symbols) / signs)
