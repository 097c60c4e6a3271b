"""The format a packet's header names, read coherently from the cells of its later pairs.

With A_1 and A_2 what each cell of the header, all its LEDs on, gives each pixel in the two frames of a header pair, and
v the cells' alternation (+-1, or +-1/2 where a bit of the word is 1, or what combined frames show of it: `Mix.dimmed`),
the difference of the frames is

    d = g (A_1 (1 + v) / 2 - A_2 (1 - v) / 2) + n = g (B v + o) + n,   B = (A_1 + A_2) / 2,   o = (A_1 - A_2) 1 / 2

The first pair, whose v is the identity's, gives g; of the later ones the format is the one whose v has the least
|d - g (B v + o)|^2.
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
    """What a later header pair says: contrast and light of its dimmed cells, B^T B, B^T d and B^T o."""

    dimmed: tuple[float, float]
    gram: Floats
    seen: Floats
    offset: Floats

    def cost(self, cells: Floats, g: float) -> Floats:
        """Of each format |d - g (B v + o)|^2 but for what is the same in all, less the more probable."""
        contrast, light = self.dimmed
        v = np.where(words(), contrast * cells + light, cells)
        cost = g * np.einsum("fi,ij,fj->f", v, self.gram, v) - 2 * v @ (self.seen - g * self.offset)
        return np.asarray(np.sign(g) * cost)


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
        self._moments = np.zeros(2)
        self._later: list[_Pair] = []

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
        each, offset, change = self._seen_of(pattern, inverted, poses, shares)
        mix = mix_of(pattern)
        self._later.append(_Pair(mix.dimmed if mix else (DIMMED, 0.0), each @ each.T, each @ change, each @ offset))
        if self._first is not None:
            each, offset, change = self._seen_of(*self._first, shares)
            shown = self._cells @ each + offset
            self._moments[:] = change @ shown, shown @ shown

    def named(self, gain: float) -> Format:
        """The format named; without a later header pair the agreed one.

        Parameters
        ----------
        gain
            Gray levels of a wide array with all LEDs on, taken where the first pair was not seen.
        """
        if not self._later:
            return AGREED
        g = self._moments[0] / self._moments[1] if self._moments[1] > 0 else gain
        cost = sum((pair.cost(self._cells, g) for pair in self._later), np.zeros(len(words())))
        # two words differ by four dimmed cells, g max B^T B together: where those are hidden it is the agreed format
        cost[AGREED.number] -= UNDECIDED * abs(g) * np.sum([pair.gram.diagonal() for pair in self._later], axis=0).max()
        return format_of(int(np.argmin(cost)))

    def _seen_of(
        self, pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], shares: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """B (16, pixels), the cells' images as rows; o and d (pixels,)."""
        x0, y0, cols, rows = window_around(Pose.between(*poses), self._side, MARGIN_PX)
        up, down = (cut_out(frame, x0, y0, cols, rows).ravel() for frame in (pattern, inverted))
        first, second = (self._images(pose, shares, x0, y0, (rows, cols)) for pose in poses)
        return 0.5 * (first + second), 0.5 * (first - second).sum(0), up - down

    def _images(self, pose: Pose, shares: Floats, x0: int, y0: int, shape: tuple[int, int]) -> Floats:
        """Image of each cell with all its LEDs on, (16, pixels)."""
        out, images = np.empty((6, *shape)), np.empty((COUNT, shape[0] * shape[1]))
        for mask, image in zip(self._masks, images, strict=True):
            kernels.render(pose.full_vector(), mask * shares, float(x0), float(y0), out)
            image[:] = out[0].ravel()
        return images
