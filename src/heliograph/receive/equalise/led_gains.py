"""Gains of LEDs: the visible fraction by headers times the brightness by decoded data.

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
from heliograph.receive.geometry.footprint import to_grid, to_quarters
from heliograph.receive.observe.cutout import Cutout, Noise, noise_beside
from heliograph.receive.observe.statistics import (
    PairStatistics,
    WhitenedCutout,
    leds_of,
    transform_gram,
    transform_quarters,
    whiten,
)

# standard deviations of errors of a pose in x, y (px), ln pitch and roll before a bright background
POSE_SPREADS = np.array([0.2, 0.2, 0.004, 0.02])

SPREAD = 0.3  # prior standard deviation of an LED's gain about 1; a failed LED is 3.3 of these away
MIN_DIFFERENCE = 0.05  # rms difference from 1, in both halves of the pairs, from which LEDs count as unequal
MAX_FAILED = 0.25  # gain by headers, or brightness, up to which an LED counts as failed

# Evidence of decoded data on the brightness: sums over each half of the pairs of the normal equations' matrices,
# (2, n n, n n), and right sides, (2, n n), ordered as by `to_quarters`
DataEvidence = tuple[Floats, Floats]

# A whitened cut-out, symbols (symbols,) of +-1 and 0 for undecoded symbols, and derivatives F (4, rows, columns) of the
# decoded symbols' image by x, y, ln pitch and roll, times W^(1/2)
DecodedPair = tuple[WhitenedCutout, Floats, Floats]


@dataclass(frozen=True)  # without slots, for a cached property
class LedGains:
    """Gains of an array's LEDs with the evidence of headers and data."""

    # (n, n) visible fraction of each LED by headers, 0 to 1; 0 of a dead, stuck or occluded LED
    sight: Floats
    # (n, n) brightness by decoded data, 1 for the median LED
    brightness: Floats
    # Statistics of the headers so far, with the gains times the header in place of the data; None before the first
    headers: PairStatistics | None = None
    # Evidence of decoded data; None before the first
    data: DataEvidence | None = None
    # Number of packets evaluated for the brightness
    packets: int = 0

    @classmethod
    def sound(cls, side: int) -> "LedGains":
        """Gains of an array without failed LEDs."""
        return cls(np.ones((side, side)), np.ones((side, side)))

    @cached_property
    def values(self) -> Floats:
        """(n, n) gains, at least 0: the brightness times the visible fraction; all cut-outs of a packet share them."""
        return self.sight * self.brightness

    @property
    def without_evidence(self) -> "LedGains":
        """The gains without the evidence, which is 3 n^2 times as long."""
        return LedGains(self.sight, self.brightness)

    @property
    def doubtful(self) -> bool:
        """True if any LED seems occluded or failed."""
        return bool((self.sight < 1).any() or (self.brightness < MAX_FAILED).any())

    @property
    def known(self) -> bool:
        """True if data show most LEDs to half of the least difference."""
        least = (0.5 * MIN_DIFFERENCE) ** -2
        return self.data is not None and bool(np.median(self.data[0].sum(0).diagonal()) > least)

    @property
    def learnt(self) -> bool:
        """True if most LEDs are known, or five packets did not show them."""
        return self.known or self.packets >= 5

    @property
    def stride(self) -> int:
        """Pairs per pair to evaluate."""
        return 12 if self.learnt else 3

    def faded(self) -> "LedGains":
        """Reduce the weight of earlier headers, so that occluded LEDs return, and of packets, of which ten count."""
        headers, fade = self.headers and self.headers.scaled(0.5), 0.9
        return replace(self, headers=headers, data=self.data and (fade * self.data[0], fade * self.data[1]))

    def differs(self, other: "LedGains") -> bool:
        """True if the brightness differs from another by more than the error of equal LEDs."""
        return bool(np.sqrt(np.mean((self.brightness - other.brightness) ** 2)) > MIN_DIFFERENCE)

    def learn_data(self, pairs: Sequence[DecodedPair], gain: float, noise: float) -> "LedGains":
        """Update the brightness from decoded symbols."""
        if not pairs or gain <= 0:
            return self
        count, used = self.brightness.size, 0
        before = self.data or (np.zeros((2, count, count)), np.zeros((2, count)))
        information, score = before[0].copy(), before[1].copy()
        inverse = 1 / to_quarters(self.brightness)
        for k, pair in enumerate(pairs):
            try:
                gram, matched = _without_nuisance(*pair, gain, noise)
            except np.linalg.LinAlgError:
                continue
            # the statistics hold the light of the LEDs times the brightness so far
            levels = leds_of(pair[1]) * inverse
            # T T^T = 1/4: A^T W A = 16 T G T^T, A^T W d = 4 T B^T W d
            information[k % 2] += 16 * gain**2 / noise * np.outer(levels, levels) * transform_gram(gram)
            score[k % 2] += gain / noise * levels * 4 * leds_of(matched)
            used += 1
        if not used:
            return replace(self, packets=self.packets + 1)
        brightness, data = _estimate_brightness(information, score), (information, score)
        return replace(self, brightness=brightness, data=data, packets=self.packets + 1)

    def learn_header(
        self, cutout: Cutout, header: Floats, gain: float, visible: Floats
    ) -> tuple["LedGains", float, bool]:
        """Update the visible fractions from a header pair.

        Returns also the gain by the sound LEDs, and True if an LED changed so much that the pose came from a wrong
        image: the pair must be tracked and evaluated again.
        """
        if not visible.any():
            return self, gain, False
        side = len(self.values)
        # failed LEDs hide the noise of a sum: four times that of the background
        dark = noise_beside([cutout], side)
        # the affine pose and the Gaussian blur err by 2 % of the light
        whitened, noise = whiten(cutout, Noise(4 * dark, dark), side), 4 * dark + (0.02 * gain) ** 2
        slopes = whitened.root * cutout.slopes(header)
        statistics = whitened.marginalised(slopes, np.diag(noise / (gain * POSE_SPREADS) ** 2))
        joint = statistics if self.headers is None else self.headers.plus(statistics)
        # for diag(w) (2 Y - 1) of variance s^2 the symbols have the variance 4 s^2, as T T^T = 1/4
        signs, variance = to_quarters(header), np.full(header.size, 4 * SPREAD**2)
        mean = transform_quarters(to_quarters(header * self.brightness))
        for _ in range(2):
            symbols = equalise(joint, gain, noise, mean, variance).mean
            # a header shows no LED known to be dark from data
            estimate = to_grid(leds_of(symbols) / signs) / np.maximum(self.brightness, MAX_FAILED)
            # the median LED is sound
            scale = min(max(float(np.median(estimate[visible > 0])), 0.5), 2.0)
            gain *= scale
            if abs(scale - 1) < 0.03:
                break
        sight = np.clip((estimate / scale - MAX_FAILED) / (0.65 - MAX_FAILED), 0, 1)
        sight[self.brightness < MAX_FAILED] = 1.0
        sight = np.where(visible > 0, sight, self.sight)
        # half of the change from sound to failed
        changed = bool(np.abs(sight - self.sight).max() > 0.5)
        return replace(self, sight=sight, headers=joint if visible.all() and not changed else None), gain, changed


def update_brightness(led_gains: LedGains | None, learnt: LedGains | None) -> LedGains | None:
    """Return LED gains with the brightness learnt from the packets before, which count less."""
    faded = learnt and learnt.faded()
    if faded is None or led_gains is None:
        return faded or led_gains
    return replace(led_gains, brightness=faded.brightness, data=faded.data, packets=faded.packets)


def _without_nuisance(
    whitened: WhitenedCutout, symbols: Floats, slopes: Floats, gain: float, noise: float
) -> tuple[NDArray[np.float32], Floats]:
    """Compute G and B^T W (d - g o) of a decoded pair, undecoded symbols and an error of the pose marginalised."""
    # N = (B_open, F): G - B^T N (N^T N + s^2 / g^2 P^-1)^-1 N^T B
    pair, unknown, flat = whitened.statistics, np.flatnonzero(symbols == 0), slopes.reshape(len(slopes), -1)
    light = (whitened.difference - gain * whitened.offset).ravel()
    matched, images = pair.matched - gain * pair.offset, whitened.correlate(slopes)
    inner = np.block([[pair.gram[unknown][:, unknown], images[unknown]], [images[unknown].T, flat @ flat.T]])
    precision = np.append(np.ones(unknown.size), POSE_SPREADS**-2)
    inner += noise / gain**2 * np.diag(precision)
    across = np.vstack([pair.gram[unknown], images.T])
    right = np.column_stack([across, np.append(matched[unknown], flat @ light)]).astype(np.float32)
    # L^-1 (N^T B, N^T d) = (h, h_d): the products are subtracted
    root = np.linalg.cholesky(inner.astype(np.float32))
    half = solve_triangular(root, right, lower=True, check_finite=False)
    h, h_d = half[:, :-1], half[:, -1]
    # the most probable error of the pose, without the light of the decoded symbols
    error = solve_triangular(root.T, h_d - gain * h @ symbols, check_finite=False)[-4:] / gain
    # the slopes of the image describe errors of up to half an LED's width at 95 m
    if np.hypot(error[0], error[1]) > 0.2:
        raise np.linalg.LinAlgError("the pose is too far off")
    return pair.gram - h.T @ h, matched - h.T @ h_d


def _estimate_brightness(information: Floats, score: Floats) -> Floats:
    """Estimate the brightness, (n, n), relative to the median LED; 1 for all LEDs if the halves disagree."""
    first, second = (_solve_brightness(*half) for half in zip(information, score, strict=True))
    if np.mean((first - 1) * (second - 1)) < MIN_DIFFERENCE**2:
        return np.ones_like(to_grid(first))
    # evidence is divided by brightness: a dead LED keeps some
    return to_grid(np.clip(_solve_brightness(information.sum(0), score.sum(0)), 0.02, 3.0))


def _solve_brightness(information: Floats, score: Floats) -> Floats:
    """Solve normal equations with the prior, (n n,), relative to the median LED."""
    prior = SPREAD**-2
    brightness = solve(information + prior * np.eye(len(score)), score + prior, assume_a="pos", check_finite=False)
    return np.asarray(brightness / max(float(np.median(brightness)), 0.02))
