"""What usually alternates where, against which a header stands out.

What searches may cost: a scene in which much alternates must not make a camera wait.

Work is counted and not timed, so a film is read alike on every machine. Each frame of a pattern brings some work to be
done, and what is not used is kept for an array that comes into sight. One search takes a part of that. When a
twentieth is used up, blocks are left out in which nothing is like a header just now (`usual`), and candidates that are
little like one unless much more alternates than usual; when a quarter is, such candidates in any case; when half is,
blocks that were searched less than half a packet ago. A search that cannot afford all blocks takes those in which most
alternates compared with what usually does. Frames that were not searched are not kept, as newer ones take their place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    ANY_SIDED,
    MAX_ONE_SIDED,
    NOT_SEARCHED,
    SearchParameters,
    SearchRegion,
    coarse_search,
)
from heliograph.receive.detect.header_bank import Headers
from heliograph.receive.detect.kernels import BLOCK_PX

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


class Novelty(NamedTuple):
    """What alternates about each block, in parts of what is usual there."""

    # (blocks down, blocks across), of a search; very large where usually nothing alternates
    now: NDArray[np.float32]
    # (blocks down, blocks across), of the search before; 0 where nothing alternated then, or the place was another one
    before: NDArray[np.float32]
    # Whether the place is so new that nothing is usual in it
    early: bool
    # (blocks down, blocks across), packets since the block was last searched
    waits: NDArray[np.float32]


class RunningBaseline:
    """How much alternates about each block, in the mean of the last searches."""

    def __init__(self, around: int, packet_searches: float = 50.0):
        self._around, self._mean, self._origin = around, np.zeros((0, 0), np.float32), (0, 0)
        self._before = self._waits = self._mean
        self._searched = np.zeros((0, 0), bool)
        self._searches = self._calm = 0
        self._packet_searches = packet_searches

    def record_quiet(self) -> None:
        """Take it that nothing alternates in the frames of a search: that takes no time, and is so nearly always."""
        self._calm += 1

    def novelty_of(self, change: NDArray[np.float32], origin: tuple[int, int]) -> Novelty:
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
        novelty_of, self._before = Novelty(now, self._before, self._searches <= EARLY_SEARCHES, self._waits), now
        return novelty_of

    def searched(self, blocks: NDArray[np.bool_]) -> None:
        """Take the blocks that are searched now; the next search may see the rest of a header in them."""
        self._waits[self._searched], self._searched = 0, blocks


class NoveltyFilter:
    """Where as much more alternates than usual as in a header, and that soon before."""

    def __init__(self, modulation: str, packet_searches: float = 50.0):
        self._least, self._most = (OOK_SURGE, OOK_SURGE) if modulation == "ook" else (LEAST_SURGE, SURGE)
        self._usual = RunningBaseline(AROUND_BLOCKS, packet_searches)
        self.searched = self._usual.searched

    def record_quiet(self) -> None:
        """Take it that nothing alternates; see `RunningBaseline`."""
        self._usual.record_quiet()

    def novel_blocks(
        self, change: NDArray[np.float32], origin: tuple[int, int], scarcity: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float32]]:
        """Take what alternates in the frames of a search; tell where that is as much more than usual as a header's.

        A search that sees a header too late to fit it leaves it to the next one, in which it surges no more: so what
        surged by the most that is asked for, or strikes, does so for one more search.
        """
        now, before, early, waits = self._usual.novelty_of(change, origin)
        least = self._least + scarcity * (self._most - self._least)
        novelty = np.maximum(now, before)
        return (now > least) | (before > self._most) | early, novelty > SURGE, novelty, waits


WORK_PER_MS = 180_000.0
"""Places looked at in a ms, on the machine of `docs/performance.md`."""

FIT_WORK = 200_000.0
"""Work of a fit of a candidate: 1.1 ms."""

PIXEL_WORK = 0.4
"""Work of combining frames and summing them up, for each pixel of the part that is searched: 1.2 ns, and as much again
for what else a search does. With 0.22 what flickers all over took a fifth more than the bound, with 0.8 a tenth less.
"""

SAVED_S = 3.0
"""Seconds whose work is kept at most: with the default setting 162 million places, or 0.9 s of a core.

With 2 s four of 48 arrays were not found that came into sight soon after something began to flicker beside them, with
3 s none (docs/performance.md).
"""

UNBOUNDED_PART = 1e6
"""Part of a core's time that no search takes: stands for no bound."""

FILM_PART = 2.0
"""Part of a core's time, of the camera's, that searching a film takes on average: 2 ms for each pattern of 1 ms."""

PATIENT_PART, PATIENT_AMPLE_PART, PATIENT_WORK, PATIENT_S = 1.0, 0.9, 160e6, 0.25
"""Share of a core above which a search need not keep up with a camera; the part that then stands for `AMPLE_PART`. Such
a search saves this much work, or the work of this many seconds if that is more, and may spend half of it at once."""

BLOCK_WORK, BLOCKS_WEIGHT = 3000.0, 1 / 8
"""Expected work of a block, fits included, before the first search, and weight of one search in the running mean."""

BEGIN_PART = 1 / 20
"""Part of it that must be there for a search to begin: searches now and then, which fit what they find, are worth more
than many that break off at once."""

NEW_PART = 1 / 2
"""Part of it that is kept for what is new and like an array."""

SEARCH_PART = 1 / 20
"""Part of what is left that one search takes at most, but for `LAVISH_PART`: with the default setting 34 ms at three
quarters, 2 ms where hardly any is left.

To look for a turned array 25 m away takes more than 9 ms: with so little none was found.
"""

PLENTY_PART = 3 / 4
"""Part of it above which a search may take more than that, and fits all candidates where much more alternates than
usual."""

AMPLE_PART = 19 / 20
"""Part of it above which all blocks that alternate are searched, and all candidates fitted: with less, data of an array
before its first header would be all the time, and frames wait for that (docs/performance.md)."""

MAX_NOVELTY, AREA_BLOCKS = 4.0, 2.0
"""Greatest novelty that counts, and standard deviation in blocks of the window in which novelty is summed up: the
middle of an array must be among the blocks, and its rim changes by the same ratio."""

RESEARCH_PACKETS = 0.5
"""Packets for which blocks that were searched in vain are left out where less than half of the work is there."""

FIRST_SHORT_MS = 90.0
"""Work in ms that is not there at first, so that less is left than `AMPLE_PART`, a tenth used up with the default
setting: nothing is usual yet, and all data of an array would be fitted. Of less that is kept it is a tenth too."""

LITTLE_SCORE = 0.6
"""Correlation with a header, before any fit, below which a candidate is little like one.

In 120 films of an array 20 to 140 m away, yawed, rolled and out of step at random, 4 % of those that became clear
detections had less, and 97 % of 13,315 that did not: light of data, mostly.
"""

LAVISH_PART = 1 / 4
"""Part of what is above it that one search takes at most: that of an array just come into sight takes up to 10 million
places, a quarter of the 40 million that are there when nothing is used up. The first of a film takes up to 7."""


@dataclass(frozen=True, slots=True)
class SearchLoad:
    """What searches did and left out."""

    # Candidates fitted to what alternates, well or not
    fitted: int = 0
    # Candidates found and not fitted, or not as far as they might be, for want of time
    dropped: int = 0
    # Blocks of 8 x 8 pixels in which something alternated, and which were not searched for want of time
    blocks: int = 0
    # Work done, in places looked at
    work: float = 0.0

    @property
    def left_out(self) -> int:
        """Candidates and blocks left out."""
        return self.dropped + self.blocks

    def __add__(self, other: "SearchLoad") -> "SearchLoad":
        """Both together."""
        return SearchLoad(
            self.fitted + other.fitted,
            self.dropped + other.dropped,
            self.blocks + other.blocks,
            self.work + other.work,
        )

    def __sub__(self, other: "SearchLoad") -> "SearchLoad":
        """What came since another."""
        return self + SearchLoad(-other.fitted, -other.dropped, -other.blocks, -other.work)


class Budget:
    """Work that the searches of a stream of frames may do."""

    def __init__(self, cpu_share: float, period_s: float):
        per_s = cpu_share * 1e3 * WORK_PER_MS
        self.bounded = cpu_share < UNBOUNDED_PART
        self._rate, self._most, self._ample_part = per_s * period_s, SAVED_S * per_s, AMPLE_PART
        short = min(FIRST_SHORT_MS * WORK_PER_MS, 2 * (1 - AMPLE_PART) * self._most)
        self._is_patient = cpu_share >= PATIENT_PART
        if self._is_patient:
            self._most, self._ample_part, short = max(PATIENT_WORK, PATIENT_S * per_s), PATIENT_AMPLE_PART, 0.0
        self._left = self._most - short
        # work of a block in the mean, blocks of the last search, and work done before it
        self._block_work, self._blocks, self._spent = BLOCK_WORK, 0, 0.0
        self._strikes = self._expects = False
        # what the search leaves that has begun
        self._end = 0.0
        self.load = SearchLoad()

    def begins(self, busy: NDArray[np.bool_], strikes: bool = False, share: float = 1.0) -> bool:
        """Whether a search begins; else its blocks count as left out."""
        self._strikes, self._expects = strikes, False
        if self._blocks:
            spent = (self.load.work - self._spent) / self._blocks
            self._block_work += BLOCKS_WEIGHT * (spent - self._block_work)
        self._blocks, self._spent = int(np.count_nonzero(busy)), self.load.work
        if not self._blocks:
            return False
        self._end = self._left - share * self._allowance
        lasts = self._left >= BEGIN_PART * self._most
        if not lasts:
            self.leave(self._blocks)
            self._blocks = 0
        return lasts

    @property
    def _allowance(self) -> float:
        """Work that one search may do."""
        above = self._left - NEW_PART * self._most
        if not self._is_patient:
            above = LAVISH_PART * (self._left - PLENTY_PART * self._most)
        return max(SEARCH_PART * self._left, above)

    def blocks(self, share: float = 1.0) -> int:
        """Blocks that the next search can afford, at least one."""
        # what two patterns bring, so that enough is left for a near array, whose blocks cost more than others
        work = 2 * self._rate if self.short else self._allowance
        return max(1, int(share * work / self._block_work))

    @property
    def coarse(self) -> float:
        """Work that a coarse search may do: half of what the search may, as candidates are to be fitted too."""
        return 0.5 * (self._left - self._end)

    @property
    def ample(self) -> bool:
        """Whether hardly anything is used up: blocks are searched in which nothing is like a header."""
        return self._left > self._ample_part * self._most

    @property
    def plenty(self) -> bool:
        """Whether less than a quarter is used up."""
        return self._left > PLENTY_PART * self._most

    @property
    def scarcity(self) -> float:
        """How much is used up of what lies between `plenty` and `short`, 0 to 1."""
        plenty, short = PLENTY_PART * self._most, NEW_PART * self._most
        return min(max((plenty - self._left) / (plenty - short), 0.0), 1.0)

    @property
    def short(self) -> bool:
        """Whether no more is left than what is kept for that which is new and like an array."""
        return self._left < NEW_PART * self._most

    def earn(self) -> None:
        """Take the work of a pattern more."""
        self._left = min(self._left + self._rate, self._most)

    def spend(self, work: float) -> None:
        """Do work; a search may end with less than nothing left."""
        self._left -= work
        self.load += SearchLoad(work=work)

    def fit(self, score: float = 1.0) -> bool:
        """Whether a candidate may be fitted; it counts as fitted or, where that is for want of time, as dropped."""
        if abs(score) < LITTLE_SCORE and not (self.ample or self._expects or (self._strikes and self.plenty)):
            if not self.plenty:
                self.drop()
            return False
        fits = self._left > self._end
        if fits:
            self.load += SearchLoad(fitted=1)
        else:
            self.drop()
        return fits

    def expect(self) -> None:
        """Know that there is an array: in the search that has begun candidates are fitted however little like one."""
        self._expects = True

    def drop(self) -> None:
        """Count a candidate that is looked at no further."""
        self.load += SearchLoad(dropped=1)

    def choose(
        self,
        busy: NDArray[np.bool_],
        novel_blocks: NDArray[np.bool_],
        novelty: NDArray[np.float32],
        waits: NDArray[np.float32],
        share: float = 1.0,
    ) -> NDArray[np.bool_]:
        """Choose the blocks that the next search looks at; those left out for want of time are counted."""
        if self.ample:
            return busy
        eligible = busy & novel_blocks
        if self.short:
            eligible &= waits > RESEARCH_PACKETS
        chosen = _most_novel(eligible, novelty, self.blocks(share))
        if not self.plenty:
            self.leave(int(np.count_nonzero(busy) - np.count_nonzero(chosen)))
        return chosen

    def leave(self, blocks: int) -> None:
        """Count busy blocks that were not searched."""
        self.load += SearchLoad(blocks=blocks)


class BudgetedSearch:
    """Coarse search for some headers within a budget; where it breaks off, the next one goes on."""

    def __init__(self, parameters: SearchParameters, headers: Headers, budget: Budget):
        self.parameters, self.headers, self.sides = parameters, headers, parameters.sides()
        self.compared = True
        self._budget = budget
        # where on the sensor parts broke off, row and column of the block
        self._next = list[tuple[int, int]]()

    def candidates(self, parts: Sequence[SearchRegion]) -> list[NDArray[np.float64]]:
        """Best candidates of each part, (candidates, 5) as `coarse.Searched` has them."""
        parameters, out, begun = self.parameters, list[NDArray[np.float64]](), self._next
        self.compared, self._next, most = False, [], self._budget.coarse
        one_sided = ANY_SIDED if self._budget.plenty else MAX_ONE_SIDED
        for k, (change, busy, frame) in enumerate(parts):
            begin, count = _begin(begun, busy, frame, len(parts) == 1), busy.size
            limit, cells, apart = most / (len(parts) - k), self.headers.cells, self.headers.apart
            found, work = NOT_SEARCHED, 0.0
            if limit > 0:
                found = coarse_search(
                    change, busy, frame, parameters, cells, self.sides, apart, begin, limit, one_sided
                )
                work = PIXEL_WORK * change.size + found.work
            self._budget.spend(work)
            most -= work
            self.compared |= found.compared > 0
            out.append(found.rows)
            if found.passed < count:
                left = (begin + np.arange(found.passed, count)) % count
                self._budget.leave(int(np.count_nonzero(busy.ravel()[left])))
                down, across = divmod(int(left[0]), busy.shape[1])
                self._next.append((down + frame.origin[1] // BLOCK_PX, across + frame.origin[0] // BLOCK_PX))
                self.compared = True
        return out


def _begin(begun: Sequence[tuple[int, int]], busy: NDArray[np.bool_], frame: Frame, alone: bool) -> int:
    """Number of the block to begin with: that at which the last search broke off, if these frames show it.

    A part that is alone may show another piece of the row in which it was.
    """
    (rows, columns), (x, y) = busy.shape, frame.origin
    for row, column in begun:
        down, across = row - y // BLOCK_PX, column - x // BLOCK_PX
        if 0 <= down < rows and (alone or 0 <= across < columns):
            return down * columns + min(max(across, 0), columns - 1)
    return 0


def _most_novel(blocks: NDArray[np.bool_], novelty: NDArray[np.float32], count: int) -> NDArray[np.bool_]:
    """Keep the blocks of greatest novelty, the middle of an area first; of equal ones the first, row by row."""
    chosen = np.flatnonzero(blocks)
    if chosen.size <= count:
        return blocks
    rank = cv2.GaussianBlur(np.where(blocks, np.minimum(novelty, MAX_NOVELTY), 0), (0, 0), AREA_BLOCKS)
    best = chosen[np.argsort(-rank.ravel()[chosen], kind="stable")[:count]]
    out = np.zeros_like(blocks)
    out.ravel()[best] = True
    return out
