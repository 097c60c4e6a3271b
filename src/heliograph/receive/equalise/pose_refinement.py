"""Poses of a packet that was not read whole: where the differences of its pairs have their power.

What shines beside an array pulls the pose that a sum shows. In differences of pattern and inverse nothing but the array
changes: their power, over many pairs of random data, is that of the array with all LEDs on, squared.

Poses refined by decoded data: a bright background may pull the pose of a sum, but not that of a difference.

With the light of the decoded symbols known, the difference of a pair shows where the array is. A small error e of the
pose has the likelihood of

    d - g (B m + o) = g F e + g B_open (c_open - m_open) + n,   F = d(B_known c_known) / d pose,

known being the decoded symbols and open the others, whose light is noise of known colour. Errors of successive pairs
are correlated: some stay as long as the background does, others come and go with the shake. Both are Gauss-Markov
processes, of the sizes that explain the packet best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import block_diag, lu_factor, lu_solve

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.led_gains import POSE_SPREADS, Brightness, DecodedPair, LedGains
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, products
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, whiten
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

PAIRS_TOGETHER = 8
"""Pairs before and after one whose power shows its error too: 17 together show the rim of 16 LEDs to a fifth of a px.

A post passes an LED of an array at 63 m in 3 to 30 pairs, and pulls for as long.
"""

MOST_PX = 4
"""Largest error looked for, in px: cut-outs have as much around the array."""


def align_by_power(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Move each pair to where the power of the differences about it is."""
    matches = [np.zeros((2 * MOST_PX + 1,) * 2) if cutout is None else _match(cutout, led_gains) for cutout in cutouts]
    sums = np.cumsum([np.zeros_like(matches[0]), *matches], axis=0)
    moved, largest = list[Cutout | None](), 0.0
    for k, cutout in enumerate(cutouts):
        if cutout is None:
            moved.append(None)
            continue
        near = sums[min(k + PAIRS_TOGETHER + 1, len(cutouts))] - sums[max(k - PAIRS_TOGETHER, 0)]
        step = _peak(near)
        moved.append(cutout.moved(np.append(step, np.zeros(2))))
        largest = max(largest, float(np.hypot(*step)))
    return moved, largest


def _match(cutout: Cutout, led_gains: Floats) -> Floats:
    """Match of the difference's power and the array's, moved by (row, column) from -`MOST_PX` to `MOST_PX` px."""
    profile = image_of(cutout.shining(led_gains), cutout.middle, cutout.corner, cutout.shape) ** 2
    power = np.pad(np.asarray(cutout.difference, np.float64) ** 2, MOST_PX)
    # so few moves need no Fourier transform, and none of SciPy's modules that have one: they take a second to import
    return np.asarray(np.einsum("ijkl,kl->ij", sliding_window_view(power, profile.shape), profile))


def _peak(match: Floats) -> Floats:
    """Place (x, y) of the largest match in px, between pixels by a parabola."""
    i, j = (min(max(k, 1), 2 * MOST_PX - 1) for k in divmod(int(np.argmax(match)), match.shape[1]))
    return np.array([j + _vertex(match[i, j - 1 : j + 2]), i + _vertex(match[i - 1 : i + 2, j])]) - MOST_PX


def _vertex(three: Floats) -> float:
    """Place of a parabola's largest value through values at -1, 0 and 1."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -1, 1)) if bend < 0 else 0.0


SLOW_SIZES, FAST_SIZES = (0.0, 0.03, 0.1, 0.3, 1.0, 2.0), (0.01, 0.03, 0.1, 0.3, 1.0)
"""Sizes tried, as multiples of `POSE_SPREADS`: of errors that stay through a packet, and of those that shake brings."""

SMALLER_SIZE_MARGIN = 2.0
"""By how much less, as a log likelihood, a smaller size may explain a packet: most poses of sums are right."""

SLOW_PAIRS, FAST_PAIRS = 200.0, 8.0
"""Correlation lengths in pairs: 0.4 s, in which a background passes, and 16 ms, half a period of shake at 30 Hz."""

REFINING_STRIDE = 3
"""Pairs of which one is asked: errors of its neighbours are nearly its own."""

LEAST_PX = 0.01
"""Least error in px at `HALF_SIDE_PX` from the middle for which a pair's statistics are worked out again."""

HALF_SIDE_PX = 4.0
"""Half the side of a far array in px: at 116 m in the reference link."""


@dataclass(frozen=True, slots=True)
class ObservedPair:
    """A pair's cut-out and what follows from it and its poses."""

    # Pixels about the array, and the poses at which it is
    cutout: Cutout
    # The cut-out with noise of one variance
    whitened: WhitenedCutout
    # Sufficient statistics of its symbols
    statistics: PairStatistics
    # (4,) corrections so far of x, y (px), ln pitch and roll (rad)
    error: Floats


@dataclass(frozen=True, slots=True)
class ObservedPacket:
    """A packet's pairs as they were observed, with the poses on which their statistics depend."""

    # One per pair, in the single mode one per pattern; None where the array was not seen
    pairs: Sequence[ObservedPair | None]
    # Variances inside and beside the array in squared gray levels
    noise: Noise
    # Format of the packet; in its single mode no pose is refined
    form: PacketFormat
    # Gains of the LEDs; their brightness is learnt from decoded data, but in the single mode and out of step
    led_gains: LedGains
    # Brightness of the LEDs as it was before this packet
    brightness: Brightness
    # Brightness learnt, by the number of decoded symbols: asked for again, it is not worked out again
    memo: dict[int, Brightness] = field(default_factory=dict)

    @classmethod
    def of(
        cls, cutouts: Sequence[Cutout | None], noise: Noise, form: PacketFormat, led_gains: LedGains
    ) -> "ObservedPacket":
        """Observe cut-outs at the poses that they have."""
        empty = cls([None] * len(cutouts), noise, form, led_gains, led_gains.brightness)
        seen = [None if cutout is None else empty._observe(cutout, np.zeros(4)) for cutout in cutouts]
        return replace(empty, pairs=seen)

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair; None where the array was not seen."""
        return [None if pair is None else pair.statistics for pair in self.pairs]

    @property
    def moved_px(self) -> float:
        """Largest correction of a pose by decoded data, in px at the array's rim; 0 where none was corrected."""
        half = 0.5 * self.form.settings.side
        return max((_moved_px(pair.error, half * pair.cutout.middle.pitch) for pair in self.pairs if pair), default=0.0)

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "ObservedPacket":
        """Correct the poses by what is decoded."""
        if self.form.single:
            # these poses come from decided data already
            return self
        errors = self._pose_errors(mean, variance, gain, noise)
        pairs = [
            None if pair is None else self._corrected(pair, error)
            for pair, error in zip(self.pairs, errors, strict=True)
        ]
        moved = any(after is not before for after, before in zip(pairs, self.pairs, strict=True))
        return replace(self, pairs=pairs, memo={}) if moved else self

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "ObservedPacket":
        """Take the LEDs' brightness that decoded data show."""
        learnt = self.learnt(mean, variance, gain, noise)
        if not learnt.differs(self.led_gains.brightness):
            return self
        with_led_brightness = replace(self, led_gains=replace(self.led_gains, brightness=learnt), memo={})
        pairs = [None if pair is None else with_led_brightness._observe(pair.cutout, pair.error) for pair in self.pairs]
        return replace(with_led_brightness, pairs=pairs)

    def learnt(
        self, mean: Floats, variance: Floats, gain: float, noise: float, stride: int | None = None
    ) -> Brightness:
        """Brightness of the LEDs with the evidence of this packet."""
        decoded = int((variance < KNOWN_VARIANCE).sum())
        if not self._learns or not decoded:
            return self.brightness
        if decoded not in self.memo:
            before = replace(self.brightness, values=self.led_gains.brightness.values)
            pairs = self._decoded(mean, variance, stride or before.stride).values()
            # in fast motion light smears within an exposure, and LEDs of the rim would seem dim
            self.memo[decoded] = before.learn([one for one in pairs if not one.whitened.apart], gain, noise)
        return self.memo[decoded]

    @property
    def _learns(self) -> bool:
        in_step = all(pair is None or pair.cutout.combination is None for pair in self.pairs)
        return not self.form.single and in_step

    def _corrected(self, pair: ObservedPair, error: Floats) -> ObservedPair:
        """Return a pair with its poses corrected by a whole error, (4,); itself where that changes little."""
        step = error - pair.error
        return self._observe(pair.cutout.moved(step), error) if worth_moving(step) else pair

    def _observe(self, cutout: Cutout, error: Floats) -> ObservedPair:
        whitened = whiten(cutout, self.noise, self.form.settings.side, self.led_gains.values)
        return ObservedPair(cutout, whitened, whitened.statistics(), error)

    def _pose_errors(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Floats:
        """Errors (pairs, 4) in x, y, ln pitch and roll of the poses that the sums gave."""
        evidence = dict[int, PoseEvidence]()
        for k, pair in self._decoded(mean, variance, REFINING_STRIDE).items():
            left = pair.whitened.residual(gain, pair.symbols)
            # J = g^2 F^T C^-1 F, q = g F^T C^-1 (d - g (B m + o)), C = s^2 + g^2 B_open B_open^T
            images, scale = np.concatenate([pair.slopes, left[None]]), gain**2 / noise
            part = products(pair.whitened, pair.statistics, images, pair.unknown, scale)
            evidence[k] = PoseEvidence(scale * part[:4, :4], gain / noise * part[:4, 4])
        before = np.array([np.zeros(4) if pair is None else pair.error for pair in self.pairs])
        return smoothed_errors(evidence, before)

    def _decoded(self, mean: Floats, variance: Floats, stride: int) -> dict[int, DecodedPair]:
        """Pairs of which symbols are decoded, by number, one of so many."""
        # only decoded symbols count: guesses come from the poses that are in doubt
        known = np.where(variance < KNOWN_VARIANCE, mean, 0.0)
        there = [(k, pair) for k, pair in enumerate(self.pairs) if pair is not None and known[k].any()][::stride]
        levels = 0.5 * haar.inverse_transform(self.form.join(known[[k for k, _ in there]]))
        pairs = {}
        for (k, pair), level in zip(there, levels, strict=True):
            slopes = pair.whitened.root * pair.cutout.slopes(level * pair.cutout.shining(self.led_gains.values))
            pairs[k] = DecodedPair(pair.statistics, known[k], slopes, pair.whitened)
        return pairs


@dataclass(frozen=True, slots=True)
class PoseEvidence:
    """Likelihood of a pose's error e, whose estimate is information^-1 score."""

    # Fisher information J, (4, 4), of x, y (px), ln pitch and roll (rad)
    information: Floats
    # Q, (4,): slope of the log likelihood by these errors at e = 0
    score: Floats


def worth_moving(error: Floats) -> bool:
    """Whether a pose's error is worth new statistics."""
    return _moved_px(error, HALF_SIDE_PX) > LEAST_PX


def _moved_px(error: Floats, half_px: float) -> float:
    """Px by which an error (4,) of a pose moves the rim of an array, half its side in px."""
    x, y, ln_pitch, roll = np.abs(error)
    return float(max(x, y) + half_px * max(ln_pitch, roll))


def smoothed_errors(evidence: dict[int, PoseEvidence], before: Floats) -> Floats:
    """Most probable errors of a packet's poses, the sizes of the two processes being those that fit best."""
    asked = np.array(sorted(evidence))
    if not asked.size:
        return before
    information = block_diag(*(evidence[k].information for k in asked))
    # about the first poses: J (e - e_0) = q
    score = np.concatenate([evidence[k].score for k in asked]) + information @ before[asked].ravel()
    apart = np.abs(np.arange(len(before))[:, None] - asked)
    # two independent Gauss-Markov processes
    slowly, quickly = np.exp(-apart / SLOW_PAIRS), np.exp(-apart / FAST_PAIRS)
    tried = []
    for slow, fast in sorted(product(SLOW_SIZES, FAST_SIZES), key=lambda sizes: np.hypot(*sizes)):
        covariance = slow**2 * slowly + fast**2 * quickly
        asked_covariance = np.kron(covariance[asked], np.diag(POSE_SPREADS**2))
        # e = P (1 + J P)^-1 q, ln likelihood = q^T e / 2 - ln det(1 + J P) / 2 and a constant
        matrix = np.eye(score.size) + information @ asked_covariance
        factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        weights = lu_solve(factors, score, check_finite=False)
        # P (1 + J P)^-1 is a covariance, so the determinant is positive
        likelihood = 0.5 * (score @ asked_covariance @ weights - np.log(np.abs(factors[0].diagonal())).sum())
        tried.append((likelihood, covariance, weights))
    best = max(likelihood for likelihood, _, _ in tried)
    covariance, weights = next((c, w) for likelihood, c, w in tried if likelihood > best - SMALLER_SIZE_MARGIN)
    # P of all pairs: the same in x, y, ln pitch and roll but for their sizes
    return np.asarray(covariance @ (weights.reshape(-1, 4) * POSE_SPREADS**2))
