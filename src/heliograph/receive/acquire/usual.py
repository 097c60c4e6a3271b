"""What usually alternates where, against which a header stands out."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY

LEAST_SURGE, SURGE, OOK_SURGE = 1.2, 1.4, 1.1
"""Least alternation of a block and those about it, over what is usual there, of a header: the first where there is
most time to search, the second where there is least; and beside data of OOK.

Of patterns of data p, q and so on, 0 to 1, four frames show p + q - 1 where a search begins with a pattern, and
(4 - p - 6 q - r) / 4 where it begins with an inverse; a header shows -1 and 1, or 7/8 of that. In the mean that is 2.5
and 1.9 times as much as data of five even levels, and 2.0 and 1.2 times as much as data that are on or off. Of those
that are 0.4 patterns out of step it is 1.4 times with five levels; from there on `straddled` finds them. Near arrays
have few LEDs in three blocks, so their data vary: with 1.4 alone "soft" never found three of 54 arrays alone, 17 to
22 m away and a third of a pattern out of step. With 1.2 alone it did not find one beside what flickers for long.
"""

EARLY_SEARCHES = 3
"""Searches of a place seen first in which nothing is usual yet: they may see a header."""

USUAL_WEIGHT = 1 / 8
"""Weight of a search in what is usual: eight of them count, a sixth of a packet of 100 patterns."""

ANEW = 4.0
"""Alternation of a block and those about it, over what is usual there, from which on it is there anew: more than a
header's over data. It is usual at once: else data surge for ten searches where an array comes into sight."""

AROUND_BLOCKS = 5
"""Blocks of a side over which the mean is taken: of a near array three have few LEDs, whose data often surge by
chance."""


class Surge(NamedTuple):
    """What alternates about each block, in parts of what is usual there."""

    # (blocks down, blocks across), of a search; very large where usually nothing alternates
    now: NDArray[np.float32]
    # (blocks down, blocks across), of the search before; 0 where nothing alternated then, or the place was another one
    before: NDArray[np.float32]
    # Whether the place is so new that nothing is usual in it
    early: bool
    # (blocks down, blocks across), packets since the block was last searched
    waits: NDArray[np.float32]


class Usual:
    """How much alternates about each block, in the mean of the last searches."""

    def __init__(self, around: int, packet_searches: float = 50.0):
        self._around, self._mean, self._origin = around, np.zeros((0, 0), np.float32), (0, 0)
        self._before = self._waits = self._mean
        self._searched = np.zeros((0, 0), bool)
        self._searches = self._calm = 0
        self._packet_searches = packet_searches

    def calm(self) -> None:
        """Take it that nothing alternates in the frames of a search: that takes no time, and is so nearly always."""
        self._calm += 1

    def surge(self, change: NDArray[np.float32], origin: tuple[int, int]) -> Surge:
        """Take what alternates in the frames of a search, and compare it with what usually does."""
        around = np.asarray(cv2.blur(change, (self._around, self._around)), np.float32)
        if (around.shape, origin) != (self._mean.shape, self._origin):
            self._mean, self._origin, self._searches = around * np.float32(self._calm == 0), origin, 0
            self._before = np.zeros_like(around)
            self._waits, self._searched = np.full_like(around, np.inf), np.zeros(around.shape, bool)
        if self._calm:
            self._mean = self._mean * np.float32((1 - USUAL_WEIGHT) ** self._calm)
            self._before = np.zeros_like(around)
        self._waits += (self._calm + 1) / self._packet_searches
        self._searches, self._calm = self._searches + self._calm + 1, 0
        now = np.asarray(around / np.maximum(self._mean, np.float32(TINY)), np.float32)
        kept = np.where(now > ANEW, np.float32(1), np.float32(USUAL_WEIGHT))
        self._mean = self._mean + kept * (around - self._mean)
        surge, self._before = Surge(now, self._before, self._searches <= EARLY_SEARCHES, self._waits), now
        return surge

    def searched(self, blocks: NDArray[np.bool_]) -> None:
        """Take the blocks that are searched now; the next search may see the rest of a header in them."""
        self._waits[self._searched], self._searched = 0, blocks


class UsualAlternation:
    """Where as much more alternates than usual as in a header, and that soon before."""

    def __init__(self, modulation: str, packet_searches: float = 50.0):
        self._least, self._most = (OOK_SURGE, OOK_SURGE) if modulation == "ook" else (LEAST_SURGE, SURGE)
        self._usual = Usual(AROUND_BLOCKS, packet_searches)
        self.searched = self._usual.searched

    def calm(self) -> None:
        """Take it that nothing alternates; see `Usual`."""
        self._usual.calm()

    def surges(
        self, change: NDArray[np.float32], origin: tuple[int, int], scarcity: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float32]]:
        """Take what alternates in the frames of a search; tell where that is as much more than usual as a header's.

        A search that sees a header too late to fit it leaves it to the next one, in which it surges no more: so what
        surged by the most that is asked for, or strikes, does so for one more search.
        """
        now, before, early, waits = self._usual.surge(change, origin)
        least = self._least + scarcity * (self._most - self._least)
        novelty = np.maximum(now, before)
        return (now > least) | (before > self._most) | early, novelty > SURGE, novelty, waits
