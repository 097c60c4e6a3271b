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
from dataclasses import replace
from itertools import product
from math import inf

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import block_diag, lu_factor, lu_solve

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.led_gains import POSE_SPREADS, DecodedPair, LedGains
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, products
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.observe.cutout import Cutout, Cutouts, Noise
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, whiten
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

MAX_PX = 4  # largest error of `align_by_power`: the margin of cut-outs around the array


def align_by_power(cutouts: Cutouts, led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Move each pair to the power of the differences of 17 pairs around; return also the largest step in px."""
    matches = [np.zeros((2 * MAX_PX + 1,) * 2) if cutout is None else _match(cutout, led_gains) for cutout in cutouts]
    sums = np.cumsum([np.zeros_like(matches[0]), *matches], axis=0)
    # 17 pairs show the rim of 16 LEDs to a fifth of a px; a post passes an LED in 3 to 30 pairs
    steps = [_peak(sums[min(k + 9, len(cutouts))] - sums[max(k - 8, 0)]) for k in range(len(cutouts))]
    moved = [cutout and cutout.moved(np.append(step, [0, 0])) for cutout, step in zip(cutouts, steps, strict=True)]
    sizes = (float(np.hypot(*step)) for cutout, step in zip(cutouts, steps, strict=True) if cutout is not None)
    return moved, max(sizes, default=0.0)


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


# Fisher information J, (4, 4), of a pose's error e in x, y (px), ln pitch and roll, and q, (4,), the slope of the log
# likelihood at e = 0: the estimate is J^-1 q
PoseEvidence = tuple[Floats, Floats]


class ObservedPacket:
    """Observed pairs of a packet; poses and LED gains follow from decoded symbols.

    Noise has the variances inside the array and in the background, in squared gray levels.
    """

    def __init__(self, cutouts: Cutouts, noise: Noise, form: PacketFormat, led_gains: LedGains, max_level: float = inf):
        self.cutouts, self.noise, self.form, self.led_gains = cutouts, noise, form, led_gains
        # largest gray level of the sensor
        self.max_level = max_level
        # a pair each, in the single mode a pattern; None without the array
        self.pairs = [None if cutout is None else self._observe(cutout) for cutout in cutouts]
        # corrections so far of x, y (px), ln pitch and roll (rad), (pairs, 4)
        self._errors = np.zeros((len(cutouts), 4))

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair; None without the array."""
        return [None if pair is None else pair.statistics for pair in self.pairs]

    def refine_poses(self, mean: Floats, variance: Floats, gain: float, noise: float) -> bool:
        """Correct the poses by decoded symbols; return True if any moves."""
        if self.form.single:
            # these poses come from decided data already
            return False
        moved, errors = False, self._estimate_errors(mean, variance, gain, noise)
        for k, (pair, step) in enumerate(zip(self.pairs, errors - self._errors, strict=True)):
            if pair is not None and is_significant(step):
                self.pairs[k], self._errors[k], moved = self._observe(pair.cutout.moved(step)), errors[k], True
        return moved

    def apply_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> bool:
        """Apply the brightness of the LEDs from decoded symbols; return True if it changes."""
        learnt = self.learn_gains(mean, variance, gain, noise)
        if not learnt.differs(self.led_gains):
            return False
        self.led_gains = replace(self.led_gains, brightness=learnt.brightness)
        self.pairs = [None if pair is None else self._observe(pair.cutout) for pair in self.pairs]
        return True

    def learn_gains(
        self, mean: Floats, variance: Floats, gain: float, noise: float, stride: int | None = None
    ) -> LedGains:
        """Return the gains of the LEDs with the evidence of this packet; of synchronous pairs only."""
        if self.form.single or any(pair and pair.cutout.combination for pair in self.pairs):
            return self.led_gains
        pairs = self._decoded_pairs(mean, variance, stride or self.led_gains.stride).values()
        # in fast motion light smears within an exposure, and LEDs of the rim would seem dim
        return self.led_gains.learn_data([pair for pair in pairs if not pair[0].cutout.apart], gain, noise)

    def _observe(self, cutout: Cutout) -> WhitenedCutout:
        return whiten(cutout, self.noise, self.form.settings.side, self.led_gains.values)

    def _estimate_errors(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Floats:
        """Estimate errors (pairs, 4) in x, y, ln pitch and roll of the tracked poses."""
        evidence = dict[int, PoseEvidence]()
        # neighbours have nearly the same error
        for k, (whitened, symbols, slopes) in self._decoded_pairs(mean, variance, stride=3).items():
            # J = g^2 F^T C^-1 F, q = g F^T C^-1 (d - g (B m + o)), C = s^2 + g^2 B_open B_open^T
            images, scale = np.concatenate([slopes, whitened.residual(gain, symbols)[None]]), gain**2 / noise
            part = products(whitened, images, np.flatnonzero(symbols == 0), scale)
            evidence[k] = scale * part[:4, :4], gain / noise * part[:4, 4]
        return smoothed_errors(evidence, self._errors)

    def _decoded_pairs(self, mean: Floats, variance: Floats, stride: int) -> dict[int, DecodedPair]:
        """Collect every stride-th pair with decoded symbols, by number."""
        # decoded symbols only: guesses come from the poses in doubt
        known = np.where(variance < KNOWN_VARIANCE, mean, 0.0)
        decoded = [(k, pair) for k, pair in enumerate(self.pairs) if pair is not None and known[k].any()][::stride]
        levels = 0.5 * haar.inverse_transform(self.form.join(known[[k for k, _ in decoded]]))
        pairs = {}
        for (k, pair), level in zip(decoded, levels, strict=True):
            slopes = pair.root * pair.cutout.slopes(level * pair.cutout.shining(self.led_gains.values))
            pairs[k] = pair, known[k], slopes
        return pairs


def is_significant(error: Floats) -> bool:
    """True if an error of a pose (4,) requires new statistics: 0.01 px at the rim of a far array, 4 px wide."""
    x, y, ln_pitch, roll = np.abs(error)
    return bool(max(x, y) + 4 * max(ln_pitch, roll) > 0.01)


def smoothed_errors(evidence: dict[int, PoseEvidence], before: Floats) -> Floats:
    """Estimate the errors of a packet's poses with the best sizes of the two processes."""
    observed = np.array(sorted(evidence))
    if not observed.size:
        return before
    information = block_diag(*(evidence[k][0] for k in observed))
    # about the first poses: J (e - e_0) = q
    score = np.concatenate([evidence[k][1] for k in observed]) + information @ before[observed].ravel()
    lag, variances = np.abs(np.arange(len(before))[:, None] - observed), POSE_SPREADS**2
    # two Gauss-Markov processes: a background passes in 0.4 s, half a period of shake at 30 Hz takes 16 ms
    slowly, quickly = np.exp(-lag / 200), np.exp(-lag / 8)
    # sizes of both, relative to `POSE_SPREADS`
    sizes = product((0.0, 0.03, 0.1, 0.3, 1.0, 2.0), (0.01, 0.03, 0.1, 0.3, 1.0))
    candidates = []
    for slow, fast in sorted(sizes, key=lambda both: np.hypot(*both)):
        covariance = slow**2 * slowly + fast**2 * quickly
        prior = np.kron(covariance[observed], np.diag(variances))
        # e = P (1 + J P)^-1 q, ln likelihood = q^T e / 2 - ln det(1 + J P) / 2 and a constant
        matrix = np.eye(score.size) + information @ prior
        factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        weights = lu_solve(factors, score, check_finite=False)
        # P (1 + J P)^-1 is a covariance, so the determinant is positive
        likelihood = 0.5 * (score @ prior @ weights - np.log(np.abs(factors[0].diagonal())).sum())
        candidates.append((likelihood, covariance, weights))
    # the smallest sizes with nearly the best likelihood: most poses of sums are right
    best = max(likelihood for likelihood, _, _ in candidates)
    covariance, weights = next((c, w) for likelihood, c, w in candidates if likelihood > best - 2.0)
    # P of all pairs: the same in x, y, ln pitch and roll except for the sizes
    return np.asarray(covariance @ (weights.reshape(-1, 4) * variances))
