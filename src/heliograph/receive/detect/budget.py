"""Token bucket of the search: a scene in which much alternates must not make a camera wait.

The bucket counts work and not time, so every machine reads a film alike. Each frame of a pattern refills the bucket,
and each search may use a share of the fill level. The lower the level, the more a search skips: first familiar
blocks and candidates unlike a header, then blocks searched lately, at last everything. A search that cannot
afford all blocks takes the blocks of greatest novelty: their alternation over the running mean of earlier searches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    COARSE,
    Blocks,
    Change,
    CoarseResult,
    SearchParameters,
    SearchRegion,
    coarse_search,
)
from heliograph.receive.detect.header_bank import Headers
from heliograph.receive.detect.kernels import BLOCK_PX


@dataclass(frozen=True, kw_only=True)
class NoveltyParameters:
    """Thresholds on the alternation of a block over the baseline, and the averaging of the baseline.

    Over data of five levels a header alternates 1.9 to 2.5 times as much, over on-off data 1.2 to 2 times.
    """

    # Least ratio of a novel block at a high level and at a low level of the bucket
    min_ratio: float = 1.2
    max_ratio: float = 1.4
    # Least ratio of a strongly novel block
    strong_ratio: float = 1.4
    # Blocks of a side of the mean: few LEDs of a near array lie in three blocks
    window: int = 5
    # True if a block stays novel for a second search, perhaps the first with all of a header
    repeats: bool = True
    # Searches of a new place in which every block is novel
    warmup_searches: int = 3
    # Weight of a search in the baseline
    weight: float = 1 / 8
    # Ratio from which on the baseline follows at once: an array came into sight
    reset_ratio: float = 4.0


@dataclass(frozen=True, kw_only=True)
class BudgetParameters:
    """Sizes of the token bucket, and levels as fractions of the capacity."""

    # Work in a ms of the reference machine; the unit is a place of the coarse search
    work_per_ms: float = 180_000.0
    # Work of a candidate's fit
    fit_work: float = 200_000.0
    # Work of each pixel of a searched region
    pixel_work: float = 0.4
    # Work of a block, fits included, before the first search, and weight of a search in the running mean
    block_work: float = 3000.0
    block_weight: float = 1 / 8
    # Share of a core above any need, and the share for films
    unbounded_share: float = 1e6
    film_share: float = 2.0
    # Live camera: capacity in s of refill, initial deficit in ms, and the full level
    live_capacity_s: float = 3.0
    initial_deficit_ms: float = 90.0
    live_full_level: float = 0.95
    # Film, from this share on: least capacity in work and in s of refill, and the full level
    min_film_share: float = 1.0
    film_capacity: float = 160e6
    film_capacity_s: float = 0.25
    film_full_level: float = 0.9
    # Below the high level candidates must resemble a header
    high_level: float = 0.75
    # Below the low level blocks searched in the last `research_packets` are skipped
    low_level: float = 0.5
    research_packets: float = 0.5
    # Below this level no search begins
    min_level: float = 0.05
    # Largest share of the fill level for a search; more above the high level (live) or the low level (film)
    search_share: float = 0.05
    surplus_share: float = 0.25
    # Correlation below which a candidate resembles no header
    min_score: float = 0.6
    # Cap of the novelty in the ranking, and standard deviation in blocks of the ranking's window
    max_novelty: float = 4.0
    novelty_sigma: float = 2.0


BUDGET = BudgetParameters()


class NoveltyFilter:
    """Running baseline of the alternation about each block, to find blocks above it."""

    def __init__(self, parameters: NoveltyParameters, packet_searches: float = 50.0):
        self._parameters, self._packet_searches = parameters, packet_searches
        self._mean = self._before = self._waits = np.zeros((0, 0), np.float32)
        self._searched, self._origin = np.zeros((0, 0), bool), (0, 0)
        self._searches = self._quiet = 0

    def record_quiet(self) -> None:
        """Record a search of frames with no busy block."""
        self._quiet += 1

    def novel_blocks(self, change: Change, origin: tuple[int, int], depletion: float) -> tuple[Blocks, Change, Change]:
        """Update the baseline; return novel blocks, each block's novelty, and packets since each block's search."""
        parameters = self._parameters
        around = np.asarray(cv2.blur(change, (parameters.window, parameters.window)), np.float32)
        if (around.shape, origin) != (self._mean.shape, self._origin):
            self._mean, self._origin, self._searches = around * np.float32(self._quiet == 0), origin, 0
            self._before = np.zeros_like(around)
            self._waits, self._searched = np.full_like(around, np.inf), np.zeros(around.shape, bool)
        if self._quiet:
            self._mean = self._mean * np.float32((1 - parameters.weight) ** self._quiet)
            self._before = np.zeros_like(around)
        self._waits += (self._quiet + 1) / self._packet_searches
        self._searches, self._quiet = self._searches + self._quiet + 1, 0
        novelty = np.asarray(around / np.maximum(self._mean, np.float32(TINY)), np.float32)
        kept = np.where(novelty > parameters.reset_ratio, np.float32(1), np.float32(parameters.weight))
        self._mean = self._mean + kept * (around - self._mean)
        min_ratio = parameters.min_ratio + depletion * (parameters.max_ratio - parameters.min_ratio)
        novel = (novelty > min_ratio) | (self._searches <= parameters.warmup_searches)
        before, self._before = self._before, novelty
        if parameters.repeats:
            novel, novelty = novel | (before > parameters.max_ratio), np.maximum(novelty, before)
        return novel, novelty, self._waits

    def record_searched(self, blocks: Blocks) -> None:
        """Record the blocks of this search; the wait begins with the next search, perhaps for the rest of a header."""
        self._waits[self._searched], self._searched = 0, blocks


@dataclass(frozen=True, slots=True)
class SearchLoad:
    """Work of the searches, with the skipped candidates and blocks.

    Attributes
    ----------
    fitted
        Fitted candidates.
    dropped
        Candidates with no fit or fewer fits, for want of work.
    blocks
        Busy blocks of 8 x 8 pixels skipped for want of work.
    work
        Work done, in places of the coarse search.
    """

    fitted: int = 0
    dropped: int = 0
    blocks: int = 0
    work: float = 0.0

    @property
    def left_out(self) -> int:
        """Number of skipped candidates and blocks."""
        return self.dropped + self.blocks

    def __add__(self, other: "SearchLoad") -> "SearchLoad":
        """Add two loads."""
        return SearchLoad(
            self.fitted + other.fitted,
            self.dropped + other.dropped,
            self.blocks + other.blocks,
            self.work + other.work,
        )

    def __sub__(self, other: "SearchLoad") -> "SearchLoad":
        """Return the load since an earlier load."""
        return self + SearchLoad(-other.fitted, -other.dropped, -other.blocks, -other.work)


class TokenBucket:
    """Token bucket of work for the searches of a stream of frames."""

    def __init__(self, cpu_share: float, period_s: float, parameters: BudgetParameters = BUDGET):
        self.parameters, per_s = parameters, cpu_share * 1e3 * parameters.work_per_ms
        self._is_film = cpu_share >= parameters.min_film_share
        if self._is_film:
            self.capacity = max(parameters.film_capacity, parameters.film_capacity_s * per_s)
            self._full_level, deficit = parameters.film_full_level, 0.0
        else:
            self.capacity, self._full_level = parameters.live_capacity_s * per_s, parameters.live_full_level
            # no baseline exists yet, and data of an array would all be fitted
            deficit = min(
                parameters.initial_deficit_ms * parameters.work_per_ms, 2 * (1 - self._full_level) * self.capacity
            )
        self._rate, self._left = per_s * period_s, self.capacity - deficit
        # running mean of a block's work, blocks of the current search, and work done before
        self._block_work, self._blocks, self._work_before = parameters.block_work, 0, 0.0
        self._is_novel = self._expects_array = False
        # work left at the end of the current search
        self._end = 0.0
        self.load = SearchLoad()

    @property
    def is_full(self) -> bool:
        """True if every block may be searched and every candidate fitted."""
        return self._left > self._full_level * self.capacity

    @property
    def is_high(self) -> bool:
        """True above the high level."""
        return self._left > self.parameters.high_level * self.capacity

    @property
    def is_low(self) -> bool:
        """True below the low level."""
        return self._left < self.parameters.low_level * self.capacity

    @property
    def depletion(self) -> float:
        """Place between the high level (0) and the low level (1)."""
        high, low = self.parameters.high_level * self.capacity, self.parameters.low_level * self.capacity
        return min(max((high - self._left) / (high - low), 0.0), 1.0)

    @property
    def _allowance(self) -> float:
        """Work allowed to a search."""
        surplus = self._left - self.parameters.low_level * self.capacity
        if not self._is_film:
            surplus = self.parameters.surplus_share * (self._left - self.parameters.high_level * self.capacity)
        return max(self.parameters.search_share * self._left, surplus)

    @property
    def coarse_work(self) -> float:
        """Work allowed to a coarse search: half of the search, as fits follow."""
        return 0.5 * (self._left - self._end)

    def refill(self) -> None:
        """Add the work of a pattern."""
        self._left = min(self._left + self._rate, self.capacity)

    def charge(self, work: float) -> None:
        """Take work out of the bucket; the end of a search may overdraw it."""
        self._left -= work
        self.load = replace(self.load, work=self.load.work + work)

    def charge_fits(self, count: int = 1) -> None:
        """Take the work of fits out of the bucket."""
        self.charge(count * self.parameters.fit_work)

    def affordable_blocks(self, share: float = 1.0) -> int:
        """Return the number of affordable blocks of the next search, at least 1."""
        # two patterns of refill keep the rest for a near array, with more work in each block
        work = 2 * self._rate if self.is_low else self._allowance
        return max(1, int(share * work / self._block_work))

    def choose_blocks(self, busy: Blocks, novel: Blocks, novelty: Change, waits: Change, share: float = 1.0) -> Blocks:
        """Choose the blocks of the next search, and count the skipped blocks."""
        if self.is_full:
            return busy
        eligible = busy & novel
        if self.is_low:
            eligible &= waits > self.parameters.research_packets
        chosen = self._most_novel(eligible, novelty, self.affordable_blocks(share))
        if not self.is_high:
            self.skip_blocks(int(np.count_nonzero(busy) - np.count_nonzero(chosen)))
        return chosen

    def _most_novel(self, blocks: Blocks, novelty: Change, count: int) -> Blocks:
        """Keep the blocks of greatest novelty, the middle of an area first, as the rim has the same ratio."""
        places = np.flatnonzero(blocks)
        if places.size <= count:
            return blocks
        rank = np.where(blocks, np.minimum(novelty, self.parameters.max_novelty), 0)
        rank = cv2.GaussianBlur(rank, (0, 0), self.parameters.novelty_sigma)
        out = np.zeros_like(blocks)
        out.ravel()[places[np.argsort(-rank.ravel()[places], kind="stable")[:count]]] = True
        return out

    def try_start(self, busy: Blocks, is_novel: bool = False, share: float = 1.0) -> bool:
        """Return True if a search of busy blocks begins; otherwise count the blocks as skipped."""
        self._is_novel, self._expects_array = is_novel, False
        if self._blocks:
            work = (self.load.work - self._work_before) / self._blocks
            self._block_work += self.parameters.block_weight * (work - self._block_work)
        self._blocks, self._work_before = int(np.count_nonzero(busy)), self.load.work
        if not self._blocks:
            return False
        self._end = self._left - share * self._allowance
        if self._left >= self.parameters.min_level * self.capacity:
            return True
        self.skip_blocks(self._blocks)
        self._blocks = 0
        return False

    def try_fit(self, score: float = 1.0) -> bool:
        """Return True if a candidate may be fitted, and count it as fitted, or as dropped for want of work."""
        is_lenient = self.is_full or self._expects_array or (self._is_novel and self.is_high)
        if abs(score) < self.parameters.min_score and not is_lenient:
            if not self.is_high:
                self.skip_candidate()
            return False
        if self._left <= self._end:
            self.skip_candidate()
            return False
        self.load = replace(self.load, fitted=self.load.fitted + 1)
        return True

    def expect_array(self) -> None:
        """Fit all candidates in the rest of this search, as an array is in sight."""
        self._expects_array = True

    def skip_candidate(self) -> None:
        """Count a skipped candidate."""
        self.load = replace(self.load, dropped=self.load.dropped + 1)

    def skip_blocks(self, count: int) -> None:
        """Count skipped busy blocks."""
        self.load = replace(self.load, blocks=self.load.blocks + count)


class BlockSelector:
    """Choice of the busy blocks of a search within a budget.

    Data differ for a search from an inverse on, so even and odd frames have separate baselines.
    """

    def __init__(self, budget: TokenBucket, parameters: NoveltyParameters, packet_patterns: int):
        self._budget, self._parameters = budget, parameters
        self._filters = tuple(NoveltyFilter(parameters, packet_patterns / 2) for _ in range(2))

    def select(
        self, means: Change, busy: Blocks, frame: Frame, eligible: Blocks | None = None, share: float = 1.0
    ) -> tuple[Blocks, bool]:
        """Return the eligible busy blocks to search, and True if any is strongly novel."""
        eligible = busy if eligible is None else eligible
        novelty_filter = self._filters[frame.index % 2]
        if not busy.any():
            novelty_filter.record_quiet()
            return eligible, False
        novel, novelty, waits = novelty_filter.novel_blocks(means, frame.origin, self._budget.depletion)
        chosen = self._budget.choose_blocks(eligible, novel, novelty, waits, share)
        novelty_filter.record_searched(chosen)
        return chosen, bool((chosen & (novelty > self._parameters.strong_ratio)).any())


class BudgetedSearch:
    """Coarse search for a set of headers within a budget; each search goes on where the last broke off."""

    def __init__(self, parameters: SearchParameters, headers: Headers, budget: TokenBucket):
        self.parameters, self.headers, self.sides = parameters, headers, parameters.sides()
        self.has_compared = True
        self._budget = budget
        # blocks at which the regions broke off, row and column on the sensor
        self._next = list[tuple[int, int]]()

    def search(self, regions: Sequence[SearchRegion]) -> list[Floats]:
        """Return the best candidates of each region, rows of `CoarseResult`."""
        out, begun, left = list[Floats](), self._next, self._budget.coarse_work
        self.has_compared, self._next = False, []
        max_imbalance = 2.0 if self._budget.is_high else COARSE.max_imbalance
        for k, region in enumerate(regions):
            busy, (x, y) = region.busy, region.first.origin
            begin = _first_block(begun, region, len(regions) == 1)
            max_work = left / (len(regions) - k)
            result, work = CoarseResult(), 0.0
            if max_work > 0:
                cells, min_distance = self.headers.cells, self.headers.min_distance
                result = coarse_search(
                    region, self.parameters, cells, self.sides, min_distance, begin, max_work, max_imbalance
                )
                work = self._budget.parameters.pixel_work * region.change.size + result.work
            self._budget.charge(work)
            left -= work
            self.has_compared |= result.compared > 0
            out.append(result.rows)
            if result.passed < busy.size:
                skipped = (begin + np.arange(result.passed, busy.size)) % busy.size
                self._budget.skip_blocks(int(np.count_nonzero(busy.ravel()[skipped])))
                down, across = divmod(int(skipped[0]), busy.shape[1])
                self._next.append((down + y // BLOCK_PX, across + x // BLOCK_PX))
                self.has_compared = True
        return out


def _first_block(begun: Sequence[tuple[int, int]], region: SearchRegion, is_only: bool) -> int:
    """Return the number of the block at which the last search broke off; 0 if this region does not hold it.

    A single region may hold another piece of the row.
    """
    (rows, columns), (x, y) = region.busy.shape, region.first.origin
    for row, column in begun:
        down, across = row - y // BLOCK_PX, column - x // BLOCK_PX
        if 0 <= down < rows and (is_only or 0 <= across < columns):
            return down * columns + min(max(across, 0), columns - 1)
    return 0
