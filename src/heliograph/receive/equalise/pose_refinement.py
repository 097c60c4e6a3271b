"""Poses refined from the differences of pairs, which a bright background cannot pull, unlike sums.

If a packet was not decoded completely: the power of the differences over many pairs of random data is that of the array
with all LEDs on, squared, and shows the position.

With decoded symbols, the difference of a pair shows the pose. A small error e of the pose has the likelihood of

    d - g (B m + o) = g F e + g B_open (c_open - m_open) + n,   F = d(B_known c_known) / d pose,

known being the decoded symbols and open the others, whose light is noise of known colour. Errors of successive pairs
are correlated: a background pulls for long, and shake briefly. Both are Gauss-Markov processes, of the sizes that
explain the packet best.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import block_diag, lu_factor, lu_solve

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.led_gains import GAINS, Brightness, DecodedPair, LedGains
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, products
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, whiten
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

MAX_PX = 4  # largest error of `align_by_power`: the margin of cut-outs around the array


def align_by_power(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Move each pair to the power of the differences of 17 pairs around; return also the largest step in px."""
    matches = [np.zeros((2 * MAX_PX + 1,) * 2) if cutout is None else _match(cutout, led_gains) for cutout in cutouts]
    sums = np.cumsum([np.zeros_like(matches[0]), *matches], axis=0)
    # 17 pairs show the rim of 16 LEDs to a fifth of a px; a post passes an LED in 3 to 30 pairs
    moved, largest = list[Cutout | None](), 0.0
    for k, cutout in enumerate(cutouts):
        if cutout is None:
            moved.append(None)
            continue
        step = _peak(sums[min(k + 9, len(cutouts))] - sums[max(k - 8, 0)])
        moved.append(cutout.moved(np.append(step, np.zeros(2))))
        largest = max(largest, float(np.hypot(*step)))
    return moved, largest


def _match(cutout: Cutout, led_gains: Floats) -> Floats:
    """Correlate the power of the difference with that of the array, moved by up to `MAX_PX` rows and columns."""
    profile = image_of(cutout.shining(led_gains), cutout.middle, cutout.corner, cutout.shape) ** 2
    power = np.pad(np.asarray(cutout.difference, np.float64) ** 2, MAX_PX)
    # few moves need no Fourier transform, which takes a second to import
    return np.asarray(np.einsum("ijkl,kl->ij", sliding_window_view(power, profile.shape), profile))


def _peak(match: Floats) -> Floats:
    """Locate the maximum (x, y) in px, between pixels by a parabola."""
    i, j = (min(max(k, 1), 2 * MAX_PX - 1) for k in divmod(int(np.argmax(match)), match.shape[1]))
    return np.array([j + _vertex(match[i, j - 1 : j + 2]), i + _vertex(match[i - 1 : i + 2, j])]) - MAX_PX


def _vertex(values: Floats) -> float:
    """Locate the maximum of a parabola through values at -1, 0 and 1."""
    curvature = values[0] - 2 * values[1] + values[2]
    return float(np.clip(0.5 * (values[0] - values[2]) / curvature, -1, 1)) if curvature < 0 else 0.0


@dataclass(frozen=True, slots=True)
class RefinementParameters:
    """Tuning of the refinement by decoded data."""

    # Sizes to try for errors of a packet's length and for errors by shake, relative to `GainParameters.pose_spreads`
    slow_sizes: tuple[float, ...] = (0.0, 0.03, 0.1, 0.3, 1.0, 2.0)
    fast_sizes: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3, 1.0)
    # Log likelihood by which a smaller size may explain a packet worse: most poses of sums are right
    smaller_margin: float = 2.0
    # Correlation lengths in pairs: 0.4 s, in which a background passes, and 16 ms, half a period of shake at 30 Hz
    slow_pairs: float = 200.0
    fast_pairs: float = 8.0
    # Pairs per evaluated pair: neighbours have nearly the same error
    stride: int = 3
    # Least step in px, at half the side of a far array from the centre, after which statistics are computed again
    min_step_px: float = 0.01
    half_side_px: float = 4.0


REFINEMENT = RefinementParameters()

# Fisher information J, (4, 4), of a pose's error e in x, y (px), ln pitch and roll, and q, (4,), the slope of the log
# likelihood at e = 0: the estimate is J^-1 q
PoseEvidence = tuple[Floats, Floats]


@dataclass(frozen=True, slots=True)
class ObservedPair:
    """A cut-out, and the statistics at the corrected poses."""

    # Pixels around the array, and the corrected poses
    cutout: Cutout
    # Whitened cut-out
    whitened: WhitenedCutout
    # Sufficient statistics of the symbols
    statistics: PairStatistics
    # (4,) corrections so far of x, y (px), ln pitch and roll (rad)
    error: Floats


@dataclass(frozen=True, slots=True)
class ObservedPacket:
    """Observed pairs of a packet with the poses behind the statistics."""

    # One per pair, in the single mode per pattern; None without the array
    pairs: Sequence[ObservedPair | None]
    # Variances inside the array and in the background, in squared gray levels
    noise: Noise
    # Format of the packet; in the single mode no pose is refined
    form: PacketFormat
    # Gains of the LEDs; except in the single mode and in unsynchronised packets, decoded data update the brightness
    led_gains: LedGains
    # Brightness of the LEDs before this packet
    brightness: Brightness
    # Cache of the estimated brightness by the number of decoded symbols
    memo: dict[int, Brightness] = field(default_factory=dict)

    @classmethod
    def of(
        cls, cutouts: Sequence[Cutout | None], noise: Noise, form: PacketFormat, led_gains: LedGains
    ) -> "ObservedPacket":
        """Observe cut-outs at the tracked poses."""
        empty = cls([None] * len(cutouts), noise, form, led_gains, led_gains.brightness)
        pairs = [None if cutout is None else empty._observe(cutout, np.zeros(4)) for cutout in cutouts]
        return replace(empty, pairs=pairs)

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair; None without the array."""
        return [None if pair is None else pair.statistics for pair in self.pairs]

    @property
    def moved_px(self) -> float:
        """Largest correction of a pose by decoded data, in px at the rim of the array."""
        half = 0.5 * self.form.settings.side
        return max((_moved_px(pair.error, half * pair.cutout.middle.pitch) for pair in self.pairs if pair), default=0.0)

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "ObservedPacket":
        """Correct the poses by decoded symbols."""
        if self.form.single:
            # these poses come from decided data already
            return self
        errors = self._estimate_errors(mean, variance, gain, noise)
        pairs = [pair and self._correct(pair, error) for pair, error in zip(self.pairs, errors, strict=True)]
        moved = any(after is not before for after, before in zip(pairs, self.pairs, strict=True))
        return replace(self, pairs=pairs, memo={}) if moved else self

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "ObservedPacket":
        """Apply the brightness of the LEDs from decoded data."""
        brightness = self.estimate_brightness(mean, variance, gain, noise)
        if not brightness.differs(self.led_gains.brightness):
            return self
        packet = replace(self, led_gains=replace(self.led_gains, brightness=brightness), memo={})
        return replace(packet, pairs=[pair and packet._observe(pair.cutout, pair.error) for pair in self.pairs])

    def estimate_brightness(
        self, mean: Floats, variance: Floats, gain: float, noise: float, stride: int | None = None
    ) -> Brightness:
        """Estimate the brightness of the LEDs with the evidence of this packet."""
        decoded = int((variance < KNOWN_VARIANCE).sum())
        synchronous = all(pair is None or pair.cutout.combination is None for pair in self.pairs)
        if self.form.single or not synchronous or not decoded:
            return self.brightness
        if decoded not in self.memo:
            before = replace(self.brightness, values=self.led_gains.brightness.values)
            pairs = self._decoded_pairs(mean, variance, stride or before.stride).values()
            # in fast motion light smears within an exposure, and LEDs of the rim would seem dim
            self.memo[decoded] = before.learn([pair for pair in pairs if not pair.whitened.apart], gain, noise)
        return self.memo[decoded]

    def _correct(self, pair: ObservedPair, error: Floats) -> ObservedPair:
        """Correct the poses of a pair by the total error, (4,), unless that changes little."""
        step = error - pair.error
        return self._observe(pair.cutout.moved(step), error) if is_significant(step) else pair

    def _observe(self, cutout: Cutout, error: Floats) -> ObservedPair:
        whitened = whiten(cutout, self.noise, self.form.settings.side, self.led_gains.values)
        return ObservedPair(cutout, whitened, whitened.statistics(), error)

    def _estimate_errors(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Floats:
        """Estimate errors (pairs, 4) in x, y, ln pitch and roll of the tracked poses."""
        evidence = dict[int, PoseEvidence]()
        for k, pair in self._decoded_pairs(mean, variance, REFINEMENT.stride).items():
            residual = pair.whitened.residual(gain, pair.symbols)
            # J = g^2 F^T C^-1 F, q = g F^T C^-1 (d - g (B m + o)), C = s^2 + g^2 B_open B_open^T
            images, scale = np.concatenate([pair.slopes, residual[None]]), gain**2 / noise
            unknown = np.flatnonzero(pair.symbols == 0)
            part = products(pair.whitened, pair.statistics, images, unknown, scale)
            evidence[k] = scale * part[:4, :4], gain / noise * part[:4, 4]
        before = np.array([np.zeros(4) if pair is None else pair.error for pair in self.pairs])
        return smoothed_errors(evidence, before)

    def _decoded_pairs(self, mean: Floats, variance: Floats, stride: int) -> dict[int, DecodedPair]:
        """Collect every stride-th pair with decoded symbols, by number."""
        # decoded symbols only: guesses come from the poses in doubt
        known = np.where(variance < KNOWN_VARIANCE, mean, 0.0)
        decoded = [(k, pair) for k, pair in enumerate(self.pairs) if pair is not None and known[k].any()][::stride]
        levels = 0.5 * haar.inverse_transform(self.form.join(known[[k for k, _ in decoded]]))
        pairs = {}
        for (k, pair), level in zip(decoded, levels, strict=True):
            slopes = pair.whitened.root * pair.cutout.slopes(level * pair.cutout.shining(self.led_gains.values))
            pairs[k] = DecodedPair(pair.statistics, known[k], slopes, pair.whitened)
        return pairs


def is_significant(error: Floats) -> bool:
    """True if an error of a pose (4,) requires new statistics."""
    return _moved_px(error, REFINEMENT.half_side_px) > REFINEMENT.min_step_px


def _moved_px(error: Floats, half_px: float) -> float:
    """Distance in px by which an error (4,) of a pose moves the rim of an array."""
    x, y, ln_pitch, roll = np.abs(error)
    return float(max(x, y) + half_px * max(ln_pitch, roll))


def smoothed_errors(evidence: dict[int, PoseEvidence], before: Floats) -> Floats:
    """Estimate the errors of a packet's poses with the best sizes of the two processes."""
    observed = np.array(sorted(evidence))
    if not observed.size:
        return before
    information = block_diag(*(evidence[k][0] for k in observed))
    # about the first poses: J (e - e_0) = q
    score = np.concatenate([evidence[k][1] for k in observed]) + information @ before[observed].ravel()
    lag = np.abs(np.arange(len(before))[:, None] - observed)
    p, variances = REFINEMENT, np.array(GAINS.pose_spreads) ** 2
    # two independent Gauss-Markov processes
    slowly, quickly = np.exp(-lag / p.slow_pairs), np.exp(-lag / p.fast_pairs)
    candidates = []
    for slow, fast in sorted(product(p.slow_sizes, p.fast_sizes), key=lambda sizes: np.hypot(*sizes)):
        covariance = slow**2 * slowly + fast**2 * quickly
        prior = np.kron(covariance[observed], np.diag(variances))
        # e = P (1 + J P)^-1 q, ln likelihood = q^T e / 2 - ln det(1 + J P) / 2 and a constant
        matrix = np.eye(score.size) + information @ prior
        factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        weights = lu_solve(factors, score, check_finite=False)
        # P (1 + J P)^-1 is a covariance, so the determinant is positive
        likelihood = 0.5 * (score @ prior @ weights - np.log(np.abs(factors[0].diagonal())).sum())
        candidates.append((likelihood, covariance, weights))
    best = max(likelihood for likelihood, _, _ in candidates)
    # the smallest sizes with nearly the best likelihood
    covariance, weights = next((c, w) for likelihood, c, w in candidates if likelihood > best - p.smaller_margin)
    # P of all pairs: the same in x, y, ln pitch and roll except for the sizes
    return np.asarray(covariance @ (weights.reshape(-1, 4) * variances))
