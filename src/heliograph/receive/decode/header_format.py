"""Header pairs: the amplitude of a header, and the format of the packet, read coherently from the cells.

Let A_1 and A_2 be the light of each cell of the header, with all LEDs on, in each pixel of the two frames of a
header pair, and v the cells' alternation. The difference of the frames is

    d = g (A_1 (1 + v) / 2 - A_2 (1 - v) / 2) + n = g (B v + o) + n,   B = (A_1 + A_2) / 2,   o = (A_1 - A_2) 1 / 2.

v is +-1. Where a bit of the format's word is 1 it is +-1/2 in the later pairs, or in combined frames
`Combination.dimmed`. The format follows from the v with the largest explained power of d at the best gain g:

    max over formats and g of 2 g <d, B v + o> - g^2 |B v + o|^2.

An occlusion dims a cell too, but in the first pair as well, which has no dimmed cells. So the first pair gives the
brightness h of each cell, near 1 under noise, and h v replaces v.

A camera out of step shows dimmed cells in some of its frames only. Then each frame counts separately: r_k = g A v_k + b
+ n with v_k from the clock and a constant background b, which cancels with the mean.
"""

from functools import lru_cache

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.detect.candidate import cell_images
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.kernels import LEAST_VARIANCE
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, cut_out, window_around
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.sync.combine import Combination
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader
from heliograph.signal.formats import AGREED, ALL_MODES, DIMMED, readable, words
from heliograph.signal.header import CELLS, dimmed_leds, header_cells, header_levels

CELL_COUNT = CELLS * CELLS


def header_weights(identity: int, form: int, side: int, combination: Combination | None) -> Floats:
    """Return luminances of a header less the inverse, (n, n): +-1, or +-1/2 in dimmed cells of a pair in step."""
    signs = header_levels(identity, side) / 2.0 - 1.0
    contrast, light = combination.dimmed if combination else (DIMMED, 0.0)
    return np.where(dimmed_leds(form, side), contrast * signs + light, signs)


def header_score(pair: FramePair, pose: Pose, weights: Floats, gain: float) -> float:
    """Return the amplitude of a header over the array's light, about 1."""
    up, down = header_amplitudes((pair.pattern, pair.inverted), pose, weights)
    return float(up - down) / max(gain, TINY)


@lru_cache(maxsize=1)
def _words() -> Floats:
    """Return the words of all formats as floating-point numbers, (2048, 16)."""
    return words(ALL_MODES).astype(np.float64)


class FormatReader:
    """Reader of the format in a packet's header."""

    def __init__(self, identity: int, side: int, data_pairs: int):
        self._side, self._readable = side, readable(data_pairs)
        self._cells = header_cells(identity).reshape(CELL_COUNT).astype(np.float64)
        self._first: tuple[FramePair, tuple[Pose, Pose]] | None = None
        # statistics of the pairs for the light of the cells
        self._pairs: dict[int, PairStatistics] = {}
        # moments of each format and distance of the frames of a header out of step
        self._frames: tuple[Floats, float] | None = None

    def add_pair(self, number: int, pair: FramePair, poses: tuple[Pose, Pose], led_gains: Floats) -> None:
        """Add a header pair."""
        if number == 0:
            self._first = pair, poses
            return
        self._pairs[number] = self._measure(pair, poses, led_gains)
        if self._first is not None:
            # the gains of LEDs have improved
            self._pairs[0] = self._measure(*self._first, led_gains)

    def add_frames(self, header: MeasuredHeader, led_gains: Floats) -> None:
        """Replace the pairs by the frames of a header out of step: any of them may show dimmed cells."""
        a = cell_images(led_gains, header.pose, header.corner, header.images.shape[1:])
        gram, matched = a @ a.T, header.images.reshape(len(header.images), -1) @ a.T
        # v_k = light + alternation / 2 of +-1
        full, dimmed = (
            light[:, None] + 0.5 * alternation[:, None] * self._cells
            for light, alternation in zip(header.light, header.alternation, strict=True)
        )
        v = np.where(words(ALL_MODES)[:, None], dimmed, full)
        v -= v.mean(1, keepdims=True)
        moments = np.stack([np.einsum("fki,ki->f", v, matched), ((v @ gram) * v).sum((1, 2))])
        changes = np.diff(header.light, axis=0), 0.5 * np.diff(header.alternation, axis=0)
        self._frames = moments, float(sum(change.var() * change.size for change in changes) * gram.diagonal().max())

    def decide_format(self, gain: float) -> int:
        """Decide on the format's number, 0 to 2047; the agreed format if no later header pair was added."""
        if self._frames is not None:
            (match, norm), distance = self._frames
            # the background is unknown
            unexplained = 0.0
        elif not self._pairs:
            return AGREED.number
        else:
            brightness = _brightness(self._pairs[0], self._cells, gain) if 0 in self._pairs else np.ones(CELL_COUNT)
            dimmed = {number: _dimmed(number, pair) for number, pair in self._pairs.items()}
            match, norm = np.sum(
                [_moments(pair, dimmed[k], self._cells, brightness) for k, pair in self._pairs.items()], axis=0
            )
            # largest change of power by a dimmed cell, in units of g^2
            distance = sum(
                ((1 - contrast) ** 2 + light**2) * float(self._pairs[k].gram.diagonal().max())
                for k, (contrast, light) in dimmed.items()
            )
            unexplained = sum(map(_unexplained, self._pairs.values()))
        # the best gain of each format: g = <d, B v + o> / |B v + o|^2
        g = np.maximum(match, 0) / np.maximum(norm, TINY) if self._frames or 0 in self._pairs else gain
        explained = 2 * g * match - g**2 * norm
        # another format than the agreed format needs a surplus. Two words of the Reed-Muller code RM(2, 4) differ in 4
        # cells, which may be hidden: a quarter of the distance is halfway. A bar in motion resembles dimmed cells too
        margin = float(np.max(g)) ** 2 * distance + 0.5 * unexplained
        explained[AGREED.number] += margin
        # an unreadable mode needs the same margin, or noise makes the reader ignore a packet
        explained[~self._readable] -= margin
        return int(np.argmax(explained))

    def _measure(self, pair: FramePair, poses: tuple[Pose, Pose], led_gains: Floats) -> PairStatistics:
        """Measure the statistics of a pair for the light of the cells, with equal weights of all pixels."""
        window = window_around(Pose.midway(*poses), self._side, RIM_PX)
        up, down = (cut_out(frame, window).ravel() for frame in (pair.pattern, pair.inverted))
        first, second = (cell_images(led_gains, pose, window[:2], window[:1:-1]) for pose in poses)
        b, o, d = 0.5 * (first + second), 0.5 * (first - second).sum(0), up - down
        powers = float(d @ o), float(o @ o), float(d @ d), d.size
        return PairStatistics(b @ b.T, b @ d, b @ o, *powers, pair.combination)


def _dimmed(number: int, pair: PairStatistics) -> tuple[float, float]:
    """Return contrast and light of dimmed cells; the first pair in step has none."""
    return pair.combination.dimmed if pair.combination else (DIMMED if number else 1.0, 0.0)


def _unexplained(pair: PairStatistics) -> float:
    """Return the power of d beyond the cells' span, which holds for hidden cells too."""
    return max(pair.power - float(pair.matched @ np.linalg.lstsq(pair.gram, pair.matched, rcond=None)[0]), 0.0)


def _moments(pair: PairStatistics, dimmed: tuple[float, float], cells: Floats, brightness: Floats) -> Floats:
    """Compute <d, B v + o> and |B v + o|^2 of each format, (2, formats); `cells` (16,) are +-1."""
    contrast, light = dimmed
    # v = a + W b, W being the words
    a, b, word = cells * brightness, ((contrast - 1) * cells + light) * brightness, _words()
    match = a @ pair.matched + pair.cross + word @ (b * pair.matched)
    linear = word @ (2 * b * (pair.gram @ a + pair.offset))
    squares = np.einsum("fi,fi->f", word @ (b[:, None] * pair.gram * b), word)
    return np.stack([match, (a @ (pair.gram @ a + 2 * pair.offset) + pair.offset_power) + linear + squares])


def _brightness(pair: PairStatistics, cells: Floats, gain: float) -> Floats:
    """Estimate the brightness (16,) of each cell, 0 or more, from a pair with no dimmed cells."""
    if gain <= 0:
        return np.ones(CELL_COUNT)
    # h = argmin |d - g (B C h + o)|^2 / s^2 + |h - 1|^2 / 0.3^2, C = diag(cells); cells may be partly hidden
    noise = max(_unexplained(pair) / max(pair.pixels - CELL_COUNT, 1), LEAST_VARIANCE)
    prior = noise / (0.3 * gain) ** 2
    matrix = cells[:, None] * pair.gram * cells + prior * np.eye(CELL_COUNT)
    return np.maximum(np.linalg.solve(matrix, cells * (pair.matched / gain - pair.offset) + prior), 0.0)
