"""Token bucket of the search: a scene in which much alternates must not make a camera wait.

The bucket counts work and not time, so every machine reads a film alike. Each frame of a pattern refills the bucket,
and each search may use a share of the fill level. The lower the level, the more a search skips: first blocks without
novelty and candidates unlike a header, at last everything. A search that cannot afford all blocks takes the blocks of
greatest novelty: their alternation over the running mean of earlier searches.
"""

from operator import add, sub
from typing import NamedTuple

import cv2
import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import Blocks, Change

WORK_PER_MS = 180_000.0  # work in a ms of the reference machine; the unit is a place of the coarse search
FIT_WORK = 200_000.0  # work of a candidate's fit


class NoveltyFilter:
    """Running baseline of the alternation about each block, to find blocks above it.

    Over data of five levels a header alternates 1.9 to 2.5 times as much, over on-off data 1.2 to 2 times.
    """

    # Least ratio of a strongly novel block
    STRONG = 1.4

    def __init__(self, min_ratio: float = 1.2, max_ratio: float = 1.4, window: int = 5, repeats: bool = True):
        # least ratio of a novel block while work is ample and scarce; blocks of a side of the mean, as few LEDs of a
        # near array lie in three blocks; True if a block stays novel for a second search, perhaps the first with all
        # of a header
        self._min_ratio, self._max_ratio, self._window, self._repeats = min_ratio, max_ratio, window, repeats
        self._mean = self._before = np.zeros((0, 0), np.float32)
        self._origin, self._searches, self._quiet = (0, 0), 0, 0

    def record_quiet(self) -> None:
        """Record a search of frames with no busy block."""
        self._quiet += 1

    def novel_blocks(self, change: Change, origin: tuple[int, int], is_scarce: bool) -> tuple[Blocks, Change]:
        """Update the baseline; return the novel blocks, and the novelty of each block."""
        around = np.asarray(cv2.blur(change, (self._window, self._window)), np.float32)
        weight = np.float32(1 / 8)
        if (around.shape, origin) != (self._mean.shape, self._origin):
            self._mean, self._origin, self._searches = around * np.float32(self._quiet == 0), origin, 0
            self._before = np.zeros_like(around)
        if self._quiet:
            self._mean = self._mean * (1 - weight) ** self._quiet
            self._before = np.zeros_like(around)
        self._searches, self._quiet = self._searches + self._quiet + 1, 0
        novelty = np.asarray(around / np.maximum(self._mean, np.float32(TINY)), np.float32)
        # the baseline follows an array that comes into sight at once
        self._mean = self._mean + np.where(novelty > 4, np.float32(1), weight) * (around - self._mean)
        novel = novelty > (self._max_ratio if is_scarce else self._min_ratio)
        before, self._before = self._before, novelty
        if self._repeats:
            novel, novelty = novel | (before > self._max_ratio), np.maximum(novelty, before)
        # three searches of a new place warm up
        return novel | (self._searches <= 3), novelty


class SearchLoad(NamedTuple):
    """Work of the searches, with the skipped candidates and blocks."""

    #: Fitted candidates.
    fitted: int = 0
    #: Candidates with no fit or fewer fits, for want of work.
    dropped: int = 0
    #: Busy blocks of 8 x 8 pixels skipped for want of work.
    blocks: int = 0
    #: Work done, in places of the coarse search.
    work: float = 0.0

    @property
    def left_out(self) -> int:
        """Number of skipped candidates and blocks."""
        return self.dropped + self.blocks

    def __add__(self, other: tuple[object, ...]) -> "SearchLoad":
        """Add two loads."""
        return SearchLoad._make(map(add, self, other))

    def __sub__(self, other: "SearchLoad") -> "SearchLoad":
        """Return the load since an earlier load."""
        return SearchLoad._make(map(sub, self, other))


class TokenBucket:
    """Token bucket of work for the searches of a stream of frames."""

    def __init__(self, cpu_share: float, period_s: float):
        # work refilled per pattern; the bucket holds the work of 3 s at most, and of a quarter second at least
        self._refill, per_s = cpu_share * 1e3 * WORK_PER_MS * period_s, cpu_share * 1e3 * WORK_PER_MS
        self.capacity = max(min(160e6, 3 * per_s), 0.25 * per_s)
        # a film can wait. A live camera knows no baseline at first, and data of an array would all be fitted
        is_film = cpu_share >= 1
        # a search of all rolls takes a tenth
        self._high = (0.9 if is_film else 0.95) * self.capacity
        self._scarce, self._low = 0.725 * self.capacity, 0.5 * self.capacity
        self._search_share = 0.5 if is_film else 0.05
        self.level = self.capacity if is_film else 0.9 * self.capacity
        # running mean of a block's work, blocks of the current search, and work done before
        self._block_work, self._blocks, self._work_before = 3000.0, 0, 0.0
        self._is_novel = False
        # level at the end of the current search
        self._end = 0.0
        self.load = SearchLoad()

    @property
    def is_high(self) -> bool:
        """True if every block may be searched and every candidate fitted."""
        return self.level > self._high

    @property
    def is_scarce(self) -> bool:
        """True if skipped blocks and candidates count as skipped for want of work."""
        return self.level < self._scarce

    @property
    def is_low(self) -> bool:
        """True if searches get little more than the refill."""
        return self.level < self._low

    @property
    def coarse_work(self) -> float:
        """Work allowed to a coarse search: half of the search, as fits follow."""
        return 0.5 * (self.level - self._end)

    def refill(self) -> None:
        """Add the work of a pattern."""
        self.level = min(self.level + self._refill, self.capacity)

    def charge(self, work: float) -> None:
        """Take work out of the bucket; the end of a search may overdraw it."""
        self.level -= work
        self.load += SearchLoad(work=work)

    def affordable_blocks(self) -> int:
        """Return the number of affordable blocks of the next search, at least 1."""
        # two patterns of refill keep the rest for a near array, with more work in each block
        work = 2 * self._refill if self.is_low else self._search_share * self.level
        return max(1, int(work / self._block_work))

    def start_search(
        self, baseline: NoveltyFilter, means: Change, busy: Blocks, frame: Frame, eligible: Blocks | None = None
    ) -> Blocks:
        """Choose the eligible busy blocks of the next search; none if no search begins."""
        if self._blocks:
            work = (self.load.work - self._work_before) / self._blocks
            self._block_work += (work - self._block_work) / 8
        self._blocks, self._work_before = 0, self.load.work
        chosen = busy if eligible is None else eligible
        if not np.count_nonzero(busy):
            baseline.record_quiet()
            return chosen
        novel, novelty = baseline.novel_blocks(means, frame.origin, self.is_scarce)
        if not self.is_high:
            count, is_affordable = np.count_nonzero(chosen), self.level > 0
            chosen = self._most_novel(chosen & novel, novelty) if is_affordable else np.zeros_like(chosen)
            if self.is_scarce:
                self.skip(blocks=int(count - np.count_nonzero(chosen)))
        self._is_novel = bool((chosen & (novelty > baseline.STRONG)).any())
        self._blocks, self._end = int(np.count_nonzero(chosen)), (1 - self._search_share) * self.level
        return chosen

    def _most_novel(self, blocks: Blocks, novelty: Change) -> Blocks:
        """Keep the affordable blocks of greatest novelty, the middle of an area first, as the rim has the same."""
        places, count = np.flatnonzero(blocks), self.affordable_blocks()
        if places.size <= count:
            return blocks
        rank = cv2.GaussianBlur(np.where(blocks, np.minimum(novelty, 4), 0), (0, 0), 2.0)
        out = np.zeros_like(blocks)
        out.ravel()[places[np.argsort(-rank.ravel()[places], kind="stable")[:count]]] = True
        return out

    def try_fit(self, score: float = 1.0) -> bool:
        """Return True if a candidate may be fitted, and count it as fitted, or as dropped for want of work."""
        # correlations below 0.6 resemble no header
        is_unlike = abs(score) < 0.6 and not self.is_high and (self.is_scarce or not self._is_novel)
        if is_unlike or self.level <= self._end:
            if self.is_scarce or not is_unlike:
                self.skip(candidates=1)
            return False
        self.load += SearchLoad(fitted=1)
        return True

    def skip(self, candidates: int = 0, blocks: int = 0) -> None:
        """Count skipped candidates and busy blocks."""
        self.load += SearchLoad(dropped=candidates, blocks=blocks)
