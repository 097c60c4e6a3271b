"""The format a packet's header names, read coherently from the cells of its pairs.

With A_1 and A_2 what each cell of the header, all its LEDs on, gives each pixel in the two frames of a header pair, and
v the cells' alternation, the difference of the frames is

    d = g (A_1 (1 + v) / 2 - A_2 (1 - v) / 2) + n = g (B v + o) + n,   B = (A_1 + A_2) / 2,   o = (A_1 - A_2) 1 / 2

v is +-1 but where a bit of the format's word is 1: there it is +-1/2 in the later pairs, or what combined frames show
of it, see `Mix.dimmed`. The format is the one whose v, with the gain g that suits it best, explains most of d:

    max over formats and g of 2 g <d, B v + o> - g^2 |B v + o|^2

A camera that is not in step shows dimmed cells in some of its frames only. There each frame is taken by itself, r_k =
g A v_k + b + n with v_k from the clock and b the same in all, which is taken off by their mean.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive import kernels
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft.mix import mix_of
from heliograph.signal.formats import AGREED, DIMMED, Format, format_of, words
from heliograph.signal.header import CELLS, header_cells

Floats = NDArray[np.float64]

COUNT = CELLS * CELLS

MARGIN_PX = 2.0
"""Pixels beyond the array that are used: its rim shines there."""

UNDECIDED = 0.25
"""Share of two words' difference below which a header does not tell them apart."""


@dataclass(frozen=True, slots=True)
class _Pair:
    """What a header pair says.

    Attributes
    ----------
    dimmed
        Contrast and light of its dimmed cells.
    gram, seen, offset
        B^T B, B^T d and B^T o.
    cross, drift
        d^T o and o^T o.
    """

    dimmed: tuple[float, float]
    gram: Floats
    seen: Floats
    offset: Floats
    cross: float
    drift: float

    @property
    def telling(self) -> float:
        """Most that one dimmed cell changes, in squares of the gain, dark or lit."""
        contrast, light = self.dimmed
        return ((1 - contrast) ** 2 + light**2) * float(self.gram.diagonal().max())

    def moments(self, cells: Floats) -> Floats:
        """<d, B v + o> and |B v + o|^2 of each format, (2, formats)."""
        contrast, light = self.dimmed
        v = np.where(words(), contrast * cells + light, cells)
        match, norm = v @ self.seen + self.cross, np.einsum("fi,ij,fj->f", v, self.gram, v)
        return np.stack([match, norm + 2 * v @ self.offset + self.drift])


@dataclass(frozen=True, slots=True)
class HeaderFrames:
    """Frames of a header by a camera out of step.

    Attributes
    ----------
    images
        (frames, rows, columns) about the array.
    corner
        (x, y) on the sensor of the first pixel.
    pose
        The array's.
    alternation
        (2, frames) how much of the header less its inverse each shows, -1 to 1: of cells that are not dimmed, and of
        those that are.
    light
        (2, frames) mean light of these cells.
    """

    images: NDArray[np.float32]
    corner: tuple[int, int]
    pose: Pose
    alternation: Floats
    light: Floats


@dataclass(frozen=True, slots=True)
class _Frames:
    """What frames out of step say.

    Attributes
    ----------
    frames
        They.
    gram, seen
        A^T A, and A^T r of each, (frames, 16).
    """

    frames: HeaderFrames
    gram: Floats
    seen: Floats

    @property
    def telling(self) -> float:
        """See `_Pair`."""
        shown = np.diff(self.frames.light, axis=0), 0.5 * np.diff(self.frames.alternation, axis=0)
        return float(sum(part.var() * part.size for part in shown) * self.gram.diagonal().max())

    def moments(self, cells: Floats) -> Floats:
        """See `_Pair`."""
        # v_k = light + alternation / 2 of +-1
        full, dimmed = (
            light[:, None] + 0.5 * alternation[:, None] * cells
            for light, alternation in zip(self.frames.light, self.frames.alternation, strict=True)
        )
        v = np.where(words()[:, None], dimmed, full)
        v -= v.mean(1, keepdims=True)
        match = np.einsum("fki,ki->f", v, self.seen)
        return np.stack([match, ((v @ self.gram) * v).sum((1, 2))])


class NameReader:
    """Reads the format of one packet.

    Parameters
    ----------
    identity
        The array's.
    side
        LEDs in a row.
    """

    def __init__(self, identity: int, side: int):
        self._side = side
        self._cells = header_cells(identity).reshape(COUNT).astype(np.float64)
        self._masks = np.kron(np.eye(COUNT).reshape(COUNT, CELLS, CELLS), np.ones((side // CELLS, side // CELLS)))
        self._first: tuple[Frame, Frame, tuple[Pose, Pose]] | None = None
        self._pairs: dict[int, _Pair | _Frames] = {}

    def take(
        self, pair: int, pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], shares: Floats | None = None
    ) -> None:
        """Take header pair number `pair` of the packet, the array at `poses` in its two frames.

        Of its light each LED gives a share (n, n): hidden cells are not dimmed ones. The first pair itself tells it, so
        that the gain is taken from that pair when a later one comes.
        """
        if pair == 0:
            self._first = pattern, inverted, poses
            return
        shares = np.ones((self._side, self._side)) if shares is None else shares
        self._pairs[pair] = self._seen_of(DIMMED, pattern, inverted, poses, shares)
        if self._first is not None:
            self._pairs[0] = self._seen_of(1.0, *self._first, shares)

    def take_frames(self, frames: HeaderFrames, shares: Floats) -> None:
        """Take a whole header out of step in place of its pairs; of its light each LED gives a share (n, n)."""
        a = self._images(frames.pose, shares, *frames.corner, frames.images.shape[1:])
        self._pairs = {0: _Frames(frames, a @ a.T, frames.images.reshape(len(frames.images), -1) @ a.T)}

    def named(self, gain: float) -> Format:
        """The format named; without a later header pair the agreed one.

        Parameters
        ----------
        gain
            Gray levels of a wide array with all LEDs on, taken where the first pair was not seen.
        """
        if not self._pairs:
            return AGREED
        match, norm = np.sum([pair.moments(self._cells) for pair in self._pairs.values()], axis=0)
        g = np.maximum(match, 0) / np.maximum(norm, 1e-9) if 0 in self._pairs else gain
        explained = 2 * g * match - g**2 * norm
        # two words differ by four dimmed cells at least: where those are hidden it is the agreed format
        explained[AGREED.number] += UNDECIDED * float(np.max(g)) ** 2 * 4 * sum(p.telling for p in self._pairs.values())
        return format_of(int(np.argmax(explained)))

    def _seen_of(
        self, contrast: float, pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], shares: Floats
    ) -> _Pair:
        """What a pair says whose dimmed cells have a contrast in step."""
        x0, y0, cols, rows = window_around(Pose.between(*poses), self._side, MARGIN_PX)
        up, down = (cut_out(frame, x0, y0, cols, rows).ravel() for frame in (pattern, inverted))
        first, second = (self._images(pose, shares, x0, y0, (rows, cols)) for pose in poses)
        b, o, d = 0.5 * (first + second), 0.5 * (first - second).sum(0), up - down
        mix = mix_of(pattern)
        dimmed = mix.dimmed if mix else (contrast, 0.0)
        return _Pair(dimmed, b @ b.T, b @ d, b @ o, float(d @ o), float(o @ o))

    def _images(self, pose: Pose, shares: Floats, x0: int, y0: int, shape: tuple[int, int]) -> Floats:
        """Image of each cell with all its LEDs on, (16, pixels)."""
        out, images = np.empty((6, *shape)), np.empty((COUNT, shape[0] * shape[1]))
        for mask, image in zip(self._masks, images, strict=True):
            kernels.render(pose.full_vector(), mask * shares, float(x0), float(y0), out)
            image[:] = out[0].ravel()
        return images
