"""Blocks that have alternated for long and shown no array: where there is little time, new ones come first."""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.acquire.budget import Budget

OLD_PACKETS = 2.2
"""Packets for which a block may alternate before it is old: an array shows a header in each.

It comes into sight at any pattern of a packet. With half of a packet six of nine such arrays beside what flickers were
not found at all. An array behind a post alternates for longer; while half of what is kept is left, that is searched.
"""

CALM_PATTERNS = 4
"""Patterns in which a block must not alternate to make up for one in which it did."""


class OldBlocks:
    """How long blocks have alternated and shown no array: where there is little time, new ones come first.

    Parameters
    ----------
    budget
        What searches may cost.
    packet_patterns
        Patterns of a packet, header included.
    """

    def __init__(self, budget: Budget, packet_patterns: int):
        self._budget = budget
        self._old = CALM_PATTERNS * round(OLD_PACKETS * packet_patterns)
        self._origin, self._last = (0, 0), 0
        # (blocks down, blocks across), CALM_PATTERNS for each pattern in which it alternated
        self._age = np.zeros((0, 0), np.int32)

    def left_out(
        self,
        busy: NDArray[np.bool_],
        telling: NDArray[np.bool_],
        frame: Frame,
        patterns: int,
        among: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.bool_]:
        """Leave out blocks in which nothing is like a header and, where there is little time, old ones.

        What is left out for want of time is counted. To be asked once for the frames of a search. Where it is not
        asked, nothing alternates.

        Parameters
        ----------
        busy
            (blocks down, blocks across), whether an array may have its centre there and none is followed.
        telling
            (blocks down, blocks across), whether that and what is beside it is like a header, or there is time for all.
        frame
            The first of the frames, for place and number.
        patterns
            Patterns since the frames of the search before, at most.
        among
            (blocks down, blocks across), whether a block comes into question otherwise; None for all.

        Returns
        -------
        The blocks to be searched.
        """
        sought = busy if among is None else busy & among
        if busy.shape != self._age.shape or frame.origin != self._origin:
            self._origin, self._age = frame.origin, np.zeros(busy.shape, np.int32)
        passed, self._last = max(frame.index - self._last, 0), frame.index
        patterns = min(patterns, passed)
        grown = np.where(busy, CALM_PATTERNS * patterns - (passed - patterns), -passed)
        self._age = np.clip(self._age + grown, 0, 2 * self._old).astype(np.int32)
        left = sought & telling
        if self._budget.short:
            left &= self._age <= self._old
        if not self._budget.plenty:
            self._budget.leave(int(np.count_nonzero(sought) - np.count_nonzero(left)))
        return left
