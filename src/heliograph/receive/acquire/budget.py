"""What searches may cost: a scene in which much alternates must not make a camera wait.

Work is counted and not timed, so a film is read alike on every machine. Each pattern brings some work to be done, and
what is not used is kept for an array that comes into sight. One search takes a small part of that, shared out evenly to
the sizes and headers that it looks for. When a quarter is used up, blocks are left out in which nothing is like a
header just now; when half is, those too that have alternated for longer than a packet, and candidates that are little
like an array. Frames that were not searched are not kept for later, as newer ones take their place.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.acquire.coarse import BLOCK_PX, SearchParameters, coarse_search
from heliograph.receive.acquire.hypotheses import Headers

WORK_PER_MS = 180_000.0
"""Places looked at in a ms, on the machine of `docs/performance.md`."""

FIT_WORK = 200_000.0
"""Work of a fit of a candidate: 1.1 ms."""

PIXEL_WORK = 0.8
"""Work of combining frames and summing them up, for each pixel of the part that is searched: 4.4 ns of a whole frame,
whose sums do not fit into the processor's cache."""

SAVED_S = 3.0
"""Seconds whose work is kept at most: with the default setting 162 million places, or 0.9 s of a core.

With 2 s four of 48 arrays were not found that came into sight soon after something began to flicker beside them, with
3 s none. Of 44 passages behind posts none lost a codeword with 1.5 s (docs/performance.md).
"""

UNBOUNDED_PART = 1e6
"""Part of a core's time that no search takes: stands for no bound."""

OLD_PACKETS = 1.2
"""Packets for which a block may alternate before it is old: an array shows a header in each.

It comes into sight at any pattern of a packet. With half of a packet six of nine such arrays beside what flickers were
not found at all. An array behind a post alternates for longer; while half of what is kept is left, that is searched.
"""

CALM_PATTERNS = 4
"""Patterns in which a block must not alternate to make up for one in which it did."""

BEGIN_PART = 1 / 20
"""Part of it that must be there for a search to begin: searches now and then, which fit what they find, are worth more
than many that break off at once."""

NEW_PART = 1 / 2
"""Part of it that is kept for what is new and like an array."""

SEARCH_PART = 1 / 100
"""Part of it that one search takes at most, once the rest is used up: with the default setting 9 ms.

A patch of 64 px that begins to flicker takes more. Half of it lost a packet behind a post.
"""

PLENTY_PART = 3 / 4
"""Part of it above which a search may take more than that, and looks at all that alternates."""

LAVISH_PART = 1 / 4
"""Part of what is above it that one search takes at most: that of an array just come into sight takes up to 10 million
places, a quarter of the 40 million that are there at first."""


@dataclass(frozen=True, slots=True)
class SearchLoad:
    """What searches did and left out.

    Attributes
    ----------
    fitted
        Candidates fitted to what alternates, well or not.
    dropped
        Candidates found and not fitted, or not as far as they might be.
    blocks
        Blocks of 8 x 8 pixels in which something alternated, and which were not searched.
    work
        Work done, in places looked at.
    """

    fitted: int = 0
    dropped: int = 0
    blocks: int = 0
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
    """Work that the searches of a stream of frames may do.

    Parameters
    ----------
    busy_part
        Part of a core's time that they may take on average, above 0, by `WORK_PER_MS`.
    period_s
        Time from pattern to pattern in s.

    Attributes
    ----------
    bounded
        Whether there is a bound at all.
    load
        What they did and left out so far.
    """

    def __init__(self, busy_part: float, period_s: float):
        per_s = busy_part * 1e3 * WORK_PER_MS
        self.bounded = busy_part < UNBOUNDED_PART
        self._rate, self._most = per_s * period_s, SAVED_S * per_s
        self._left = self._most
        # what was left when a search began, what it may take, its parts, how many have begun, and what each leaves
        self._begun = self._allowed = 0.0
        self._parts, self._part, self._end = 1, 0, 0.0
        self.load = SearchLoad()

    def begins(self, busy: NDArray[np.bool_]) -> bool:
        """Whether a search begins, as one part until it is shared out; else its blocks count as left out.

        Parameters
        ----------
        busy
            (blocks down, blocks across), whether an array may have its centre there.
        """
        if not (blocks := np.count_nonzero(busy)):
            return False
        self._begun = self._left
        self._allowed = max(SEARCH_PART * self._most, LAVISH_PART * (self._left - PLENTY_PART * self._most))
        self.share(1)
        lasts = self._left >= BEGIN_PART * self._most
        if not lasts:
            self.leave(int(blocks))
        return lasts

    def share(self, parts: int) -> None:
        """Share a search out to parts; what one does not use, later ones may.

        Parameters
        ----------
        parts
            How many, 1 or more; `part` begins each.
        """
        self._parts, self._end = parts, self._begun
        self.passed(0)

    def passed(self, parts: int) -> None:
        """Have so many parts behind it, begun or not.

        Parameters
        ----------
        parts
            How many, at least 0.
        """
        self._part = parts

    def part(self) -> None:
        """Begin the next part of a search."""
        self._part += 1
        self._end = self._begun - self._allowed * self._part / self._parts

    @property
    def coarse(self) -> float:
        """Work that a coarse search may do: half of the part's, as its candidates are to be fitted too."""
        return 0.5 * (self._left - self._end)

    @property
    def plenty(self) -> bool:
        """Whether so much is left that all is searched."""
        return self._left > PLENTY_PART * self._most

    @property
    def short(self) -> bool:
        """Whether no more is left than what is kept for that which is new and like an array."""
        return self._left < NEW_PART * self._most

    def earn(self) -> None:
        """Take the work of a pattern more."""
        self._left = min(self._left + self._rate, self._most)

    def spend(self, work: float) -> None:
        """Do work; a search may end with less than nothing left.

        Parameters
        ----------
        work
            Work done, in places looked at.
        """
        self._left -= work
        self.load += SearchLoad(work=work)

    def fit(self) -> bool:
        """Whether a candidate may be fitted; it counts as fitted or as dropped."""
        fits = self._left > self._end
        if fits:
            self.load += SearchLoad(fitted=1)
        else:
            self.drop()
        return fits

    def drop(self) -> None:
        """Count a candidate that is looked at no further."""
        self.load += SearchLoad(dropped=1)

    def leave(self, blocks: int) -> None:
        """Count busy blocks that were not searched.

        Parameters
        ----------
        blocks
            How many of them, at least 0.
        """
        self.load += SearchLoad(blocks=blocks)


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
        self._old = CALM_PATTERNS * ceil(OLD_PACKETS * packet_patterns)
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
        """Where there is little time, leave out old blocks, and those in which nothing is like a header; count them.

        To be asked once for the frames of a search. Where it is not asked, nothing alternates.

        Parameters
        ----------
        busy
            (blocks down, blocks across), whether an array may have its centre there and none is followed.
        telling
            (blocks down, blocks across), whether that and what is beside it is like a header.
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
        if self._budget.plenty:
            return sought
        left = sought & telling
        if self._budget.short:
            left &= self._age <= self._old
        self._budget.leave(int(np.count_nonzero(sought) - np.count_nonzero(left)))
        return left


class BoundedSearch:
    """Coarse search for some headers within a budget; where it breaks off, the next one goes on.

    Parameters
    ----------
    parameters
        What is looked for.
    headers
        Those looked for, each with what it may mean.
    budget
        What it may cost.

    Attributes
    ----------
    compared
        Whether the last search found anything like enough to a header to be compared, True before the first; if not,
        nothing is like other headers either.
    """

    def __init__(self, parameters: SearchParameters, headers: Headers, budget: Budget):
        self.parameters, self.headers, self.sides = parameters, headers, parameters.sides()
        self.compared = True
        self._budget = budget
        # where on the sensor the next search begins, row and column of its block
        self._next = 0, 0

    def candidates(self, change: NDArray[np.float32], busy: NDArray[np.bool_], frame: Frame) -> NDArray[np.float64]:
        """Best candidates, (candidates, 5) as `coarse.Searched` has them.

        Parameters
        ----------
        change
            (rows, columns) gray levels of what alternates.
        busy
            (blocks down, blocks across), whether an array may have its centre there.
        frame
            The first of the frames, for place and full scale.
        """
        begin, count, limit = self._begin(busy, frame), busy.size, self._budget.coarse
        found = coarse_search(
            change,
            busy,
            frame,
            self.parameters,
            self.headers.cells,
            self.sides,
            self.headers.apart,
            begin,
            limit,
        )
        self._budget.spend(PIXEL_WORK * change.size + found.work)
        self.compared, self._next = found.compared > 0, (0, 0)
        if found.passed < count:
            left = (begin + np.arange(found.passed, count)) % count
            self._budget.leave(int(np.count_nonzero(busy.ravel()[left])))
            down, across = divmod(int(left[0]), busy.shape[1])
            self._next = down + frame.origin[1] // BLOCK_PX, across + frame.origin[0] // BLOCK_PX
            self.compared = True
        return found.rows

    def _begin(self, busy: NDArray[np.bool_], frame: Frame) -> int:
        """Number of the block to begin with: that at which the last search broke off, if these frames show it."""
        (rows, columns), (x, y) = busy.shape, frame.origin
        down, across = self._next[0] - y // BLOCK_PX, self._next[1] - x // BLOCK_PX
        return down * columns + min(max(across, 0), columns - 1) if 0 <= down < rows else 0
