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
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve, solve_triangular

from heliograph.base.arrays import Floats
from heliograph.receive.image.footprint import by_squares, to_grid
from heliograph.receive.observe import kernels
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout

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
        return Brightness(_estimate(information, score), information, score, self.packets + 1)

    def _evidence(self) -> tuple[Floats, Floats]:
        """Copies of information and score, with zeros where nothing was seen yet."""
        if self.score.size:
            return self.information.copy(), self.score.copy()
        count = self.values.size
        return np.zeros((2, count, count)), np.zeros((2, count))


def _estimate(information: Floats, score: Floats) -> Floats:
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
