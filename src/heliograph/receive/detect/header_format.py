"""Format signalling: the format that a packet's header names, read coherently from the cells of its pairs.

Let A_1 and A_2 be the light that each cell of the header, all its LEDs on, gives each pixel in the two frames of a
header pair, and v the cells' alternation. The difference of the frames is

    d = g (A_1 (1 + v) / 2 - A_2 (1 - v) / 2) + n = g (B v + o) + n,   B = (A_1 + A_2) / 2,   o = (A_1 - A_2) 1 / 2.

v is +-1. Where a bit of the format's word is 1 it is +-1/2 in the later pairs, or in combined frames
`Combination.dimmed`. The format is the one whose v, with the gain g that fits it best, explains most of d:

    max over formats and g of 2 g <d, B v + o> - g^2 |B v + o|^2.

What hides a cell in part dims it too, but in the first pair as well, which has no dimmed cells. So the first pair gives
each cell's own brightness h, near 1 where noise says little, and h v stands for v.

A camera out of step shows dimmed cells in some of its frames only. There each frame counts by itself: r_k = g A v_k + b
+ n with v_k from the clock and a background b that is the same in all frames and leaves with their mean.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry.footprint import images_of
from heliograph.receive.geometry.kernels import LEAST_VARIANCE
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, Window, cut_out, window_around
from heliograph.receive.sync.pairing import FramePair, HeaderFrames
from heliograph.signal.formats import AGREED, ALL_MODES, DIMMED, readable, words
from heliograph.signal.header import CELLS, header_cells

CELL_COUNT = CELLS * CELLS

LEAST_DISTANCE = 4
"""Cells in which two words of the Reed-Muller code RM(2, 4) differ at least."""

UNDECIDED = 0.25
"""Least power by which another format must explain more than the agreed one, over that in which two words differ.

Halfway between two words it is 1/4 of their squared distance: nearer ones cannot be distinguished.
"""


UNEXPLAINED = 0.5
"""Least power by which another format must explain more than the agreed one, as a fraction of what no cells explain.

What moves before an array leaves light in a difference, and some of it resembles dimmed cells. Of 144 bright bars that
move by 1 to 3 px a frame before an array at 80 m, 3 name a wrong format so, and 27 without this and without the cells'
brightness.
"""

CELL_SPREAD = 0.3
"""Standard deviation of a cell's brightness about 1 before the first pair is looked at.

A tolerance: LEDs next to those that are known to be hidden may be hidden too, a third of a cell or so.
"""


@dataclass(frozen=True, slots=True)
class _PairEvidence:
    """What a header pair says of the format."""

    # Contrast and light of its dimmed cells
    dimmed: tuple[float, float]
    # gram, matched, offset: b^T B, B^T d and B^T o
    gram: Floats
    matched: Floats
    offset: Floats
    # cross, offset_power: d^T o and o^T o
    cross: float
    offset_power: float
    # Power of d that is no light of cells, in squared gray levels
    unexplained: float
    # Pixels of d
    pixels: int

    @property
    def distance(self) -> float:
        """Largest power that one dimmed cell changes, in units of g^2."""
        contrast, light = self.dimmed
        return ((1 - contrast) ** 2 + light**2) * float(self.gram.diagonal().max())

    def moments(self, cells: Floats, brightness: Floats) -> Floats:
        """<d, B v + o> and |B v + o|^2 of each format, (2, formats); `cells` (16,) of the header, +-1."""
        contrast, light = self.dimmed
        # v = a + W b, W being the words
        a, b, word = cells * brightness, ((contrast - 1) * cells + light) * brightness, _words()
        match = a @ self.matched + self.cross + word @ (b * self.matched)
        linear = word @ (2 * b * (self.gram @ a + self.offset))
        squares = np.einsum("fi,fi->f", word @ (b[:, None] * self.gram * b), word)
        constant = a @ (self.gram @ a + 2 * self.offset) + self.offset_power
        return np.stack([match, constant + linear + squares])

    def brightness(self, cells: Floats, gain: float) -> Floats:
        """Brightness (16,) of each cell, 0 or more, by a pair without dimmed ones; `gain` is that of the array."""
        if gain <= 0:
            return np.ones(CELL_COUNT)
        # h = argmin |d - g (B C h + o)|^2 / s^2 + |h - 1|^2 / spread^2, C = diag(cells)
        noise = max(self.unexplained / max(self.pixels - CELL_COUNT, 1), LEAST_VARIANCE)
        held = noise / (gain * CELL_SPREAD) ** 2
        matrix = cells[:, None] * self.gram * cells + held * np.eye(CELL_COUNT)
        return np.maximum(np.linalg.solve(matrix, cells * (self.matched / gain - self.offset) + held), 0.0)


@dataclass(frozen=True, slots=True)
class _FramesEvidence:
    """What frames out of step say of the format."""

    # The frames of the header
    frames: HeaderFrames
    # gram, matched: a^T A, and A^T r of each frame, (frames, 16)
    gram: Floats
    matched: Floats
    unexplained: ClassVar[float] = 0.0  # there the background is one of the unknowns

    @property
    def distance(self) -> float:
        """See `_PairEvidence`."""
        shown = np.diff(self.frames.light, axis=0), 0.5 * np.diff(self.frames.alternation, axis=0)
        return float(sum(part.var() * part.size for part in shown) * self.gram.diagonal().max())

    def brightness(self, cells: Floats, gain: float) -> Floats:  # noqa: ARG002 - dimmed frames are among these
        """See `_PairEvidence`; here 1, as no frame is known to show no dimmed cells."""
        return np.ones(CELL_COUNT)

    def moments(self, cells: Floats, brightness: Floats) -> Floats:
        """See `_PairEvidence`."""
        # v_k = light + alternation / 2 of +-1
        full, dimmed = (
            light[:, None] + 0.5 * alternation[:, None] * cells
            for light, alternation in zip(self.frames.light, self.frames.alternation, strict=True)
        )
        v = np.where(words(ALL_MODES)[:, None], dimmed, full) * brightness
        v -= v.mean(1, keepdims=True)
        match = np.einsum("fki,ki->f", v, self.matched)
        return np.stack([match, ((v @ self.gram) * v).sum((1, 2))])


@lru_cache(maxsize=1)
def _words() -> Floats:
    """Words of all formats as floating-point numbers, (2048, 16)."""
    return words(ALL_MODES).astype(np.float64)


class FormatReader:
    """Reads the format of one packet from its header."""

    def __init__(self, identity: int, side: int, data_pairs: int):
        self._side, self._readable = side, readable(data_pairs)
        self._cells = header_cells(identity).reshape(CELL_COUNT).astype(np.float64)
        self._cell_of_led = np.kron(
            np.arange(CELL_COUNT).reshape(CELLS, CELLS), np.ones((side // CELLS, side // CELLS), np.int64)
        )
        self._first: tuple[FramePair, tuple[Pose, Pose]] | None = None
        self._evidence: dict[int, _PairEvidence | _FramesEvidence] = {}

    def take(self, number: int, pair: FramePair, poses: tuple[Pose, Pose], led_gains: Floats) -> None:
        """Take a header pair."""
        if number == 0:
            self._first = pair, poses
            return
        self._evidence[number] = self._of_pair(DIMMED, pair, poses, led_gains)
        if self._first is not None:
            # the gains of LEDs are known better now
            self._evidence[0] = self._of_pair(1.0, *self._first, led_gains)

    def take_frames(self, frames: HeaderFrames, led_gains: Floats) -> None:
        """Take a whole header out of step in place of its pairs."""
        rows, cols = frames.images.shape[1:]
        a = self._images(frames.pose, led_gains, (*frames.corner, cols, rows))
        matched = frames.images.reshape(len(frames.images), -1) @ a.T
        self._evidence = {0: _FramesEvidence(frames, a @ a.T, matched)}

    def number(self, gain: float) -> int:
        """Decide on the format's number, 0 to 2047; the agreed one's where no later header pair was seen."""
        if not self._evidence:
            return AGREED.number
        first = self._evidence.get(0)
        brightness = np.ones(CELL_COUNT) if first is None else first.brightness(self._cells, gain)
        match, norm = np.sum([one.moments(self._cells, brightness) for one in self._evidence.values()], axis=0)
        # the best gain of each format: g = <d, B v + o> / |B v + o|^2
        g = np.maximum(match, 0) / np.maximum(norm, TINY) if 0 in self._evidence else gain
        explained = 2 * g * match - g**2 * norm
        # two words differ in LEAST_DISTANCE cells at least: where these are hidden it is the agreed format
        least = LEAST_DISTANCE * sum(one.distance for one in self._evidence.values())
        unexplained = sum(one.unexplained for one in self._evidence.values())
        margin = UNDECIDED * float(np.max(g)) ** 2 * least + UNEXPLAINED * unexplained
        explained[AGREED.number] += margin
        # a mode that cannot be read must show as clearly: noise alone must not have a packet ignored
        explained[~self._readable] -= margin
        return int(np.argmax(explained))

    def _of_pair(self, contrast: float, pair: FramePair, poses: tuple[Pose, Pose], led_gains: Floats) -> _PairEvidence:
        """What a pair says whose dimmed cells have a contrast in step."""
        window = window_around(Pose.midway(*poses), self._side, RIM_PX)
        up, down = (cut_out(frame, window).ravel() for frame in (pair.pattern, pair.inverted))
        first, second = (self._images(pose, led_gains, window) for pose in poses)
        b, o, d = 0.5 * (first + second), 0.5 * (first - second).sum(0), up - down
        dimmed = pair.combination.dimmed if pair.combination else (contrast, 0.0)
        gram, matched = b @ b.T, b @ d
        # |d|^2 less that of its part in the cells' span, whatever cells are hidden
        unexplained = max(float(d @ d - matched @ np.linalg.lstsq(gram, matched, rcond=None)[0]), 0.0)
        return _PairEvidence(dimmed, gram, matched, b @ o, float(d @ o), float(o @ o), unexplained, d.size)

    def _images(self, pose: Pose, led_gains: Floats, window: Window) -> Floats:
        """Image of each cell with all its LEDs on, (16, pixels)."""
        x0, y0, cols, rows = window
        images = images_of(led_gains, self._cell_of_led, CELL_COUNT, pose, (x0, y0), (rows, cols))
        return images.reshape(CELL_COUNT, -1)
