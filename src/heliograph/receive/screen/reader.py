"""Packets of one array as its frames come: the light's clock, headers, and where packets begin and end."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.coming import ENOUGH_SEEN
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.image.orientation import Orientation
from heliograph.receive.screen.budget import SearchBudget
from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.clock_search import ENOUGH_FRAMES, MOST_UNEXPLAINED, ClockSearch
from heliograph.receive.screen.follow import Sample
from heliograph.receive.screen.headers import TIES, HeaderSeen, headers, named_format
from heliograph.receive.screen.packet import ReadPacket, decoded, solved_evenly
from heliograph.receive.screen.pairs import Solved, solved
from heliograph.receive.screen.readout import Kept
from heliograph.receive.screen.samples import Bins, Samples
from heliograph.receive.screen.timing import refined
from heliograph.receive.settings import ScreenSettings
from heliograph.signal.formats import AGREED, SHORT_PAIRS, Format, format_of
from heliograph.signal.settings import SignalSettings

PARTLY = 0.45
"""Part of a pair that a film's start may cut off: of its first pattern a tenth is left at least."""

FEWEST_LOST = 2
"""Packets without a header after which it is looked for anew."""


@dataclass(frozen=True)
class Coming:
    """The packet that is being shown."""

    # Its header, or that of the packet before where its own was not seen
    header: HeaderSeen
    # Time at which it begins
    start_s: float
    # Pattern period T by the camera's clock
    period_s: float
    # By how much the middle of the array's exposure comes after a frame's time
    late_s: float
    # header_pairs, data_pairs: how many pairs its header and its data have
    header_pairs: int
    data_pairs: int

    def times_s(self, pair: int) -> tuple[float, float]:
        """Return the times of the frames that show best the two patterns of a data pair."""
        first = self.start_s + 2 * (self.header_pairs + pair) * self.period_s - self.late_s
        return first + 0.5 * self.period_s, first + 1.5 * self.period_s


class PacketReading:
    """Reads packets from samples as they come."""

    def __init__(
        self,
        signal: SignalSettings,
        options: Decoding,
        frame_s: float,
        shape: tuple[int, ...],
        screen: ScreenSettings,
        budget: SearchBudget,
    ):
        self._signal, self._options = signal, options
        self._row_s, self._budget = screen.row_time_s, budget
        self._kept = Kept(shape, frame_s)
        self._search = ClockSearch(signal.pattern_period_s, screen.row_time_s, not screen.find_rate, budget)
        self._clock: Clock | None = None
        self._searched_s = -np.inf
        self._next: float | None = None  # time at which the next packet begins
        self._header: HeaderSeen | None = None
        self._begun: HeaderSeen | None = None  # that of the packet that is coming
        self._form = AGREED
        self._lost = 0
        self._orientation: Orientation | None = None

    @property
    def is_named(self) -> bool:
        """True if a header was seen."""
        return self._begun is not None

    @property
    def clocked(self) -> bool:
        """Whether the light's clock is known."""
        return self._clock is not None

    @property
    def coming(self) -> Coming | None:
        """The packet that is being shown; None while no header is seen."""
        if self._clock is None or self._next is None or self._begun is None:
            return None
        late = self._clock.exposure_s / 2
        late += self._clock.row_s * float(self._kept.readout.rows(self._kept.last.at).mean())
        head, data = self._signal.header_pairs, self._pairs
        return Coming(self._begun, self._next, self._clock.period_s, late, head, data)

    def take(self, sample: Sample) -> Iterator[ReadPacket]:
        """Take what the next frame shows; yield the packets that it completes."""
        self._kept.take(sample)
        if self._clock is None:
            self._clock = self._search.find(self._kept)
        yield from self._read(sample.time_s)

    def finish(self) -> Iterator[ReadPacket]:
        """Yield the packet in progress if enough of it was seen."""
        if self._clock is None:
            self._clock = self._search.find(self._kept, final=True)
        yield from self._read(self._kept.last.time_s, final=True)

    def shown(self, packet: ReadPacket) -> list[Sample]:
        """Return the samples that show a packet, or the last one where none does."""
        return self._kept.between(packet.start_s, packet.end_s) or [self._kept.last]

    def _read(self, now_s: float, final: bool = False) -> Iterator[ReadPacket]:
        """Packets that are complete at a time."""
        while (clock := self._clock) is not None:
            late = clock.row_s * self._kept.readout.length + clock.exposure_s + 2 * clock.response_s
            if self._next is None:
                if not self._find_header(clock, now_s - late, final):
                    return
                continue
            pairs = self._signal.header_pairs + self._pairs
            end = self._next + 2 * pairs * clock.period_s
            if now_s < end + late and not final:
                return
            if now_s - self._next < ENOUGH_SEEN * (end - self._next):
                return
            yield from self._packet(clock, self._next, end)
            if final and now_s < end + late:
                return

    @property
    def _pairs(self) -> int:
        return SHORT_PAIRS if self._form.mode == "short" else self._signal.data_pairs

    def _find_header(self, clock: Clock, now_s: float, final: bool) -> bool:
        """Look for a header among the pairs that are complete."""
        step = 2 * clock.period_s
        if now_s < self._searched_s + 2 * step and not final:
            return False
        first = max(self._kept.first.time_s, self._searched_s - 4 * step)
        if now_s - first < 3 * step:
            return False
        self._searched_s = now_s
        samples = self._samples(first, now_s + step, clock)
        if samples is None:
            return False
        bins = Bins(samples, self._budget)
        left, clock = refined(bins, clock, self._kept.frame_s, self._kept.readout.length, self._row_s)
        if left > MOST_UNEXPLAINED and len(samples.times_s) >= ENOUGH_FRAMES:
            # a header alone is explained by half its rate's period too
            self._clock = None
            self._search.again()
            return False
        pairs = solved(samples, clock)
        whole = [
            k
            for k, p in enumerate(pairs.pairs)
            if clock.begins(p) >= first - PARTLY * step and clock.begins(p + 1) <= now_s
        ]
        found = headers(pairs.change[whole[0] : whole[-1] + 1], self._signal.header_pairs) if whole else []
        if not found:
            # the next search begins there
            self._kept.drop_before(now_s - 4 * step)
            return False
        best = min((one for one in found if one.score > found[0].score - 0.1), key=lambda one: (one.place, -one.score))
        self._next = clock.begins(pairs.pairs[whole[0]] + best.place)
        self._clock = replace(clock, start_s=self._next)
        self._lost, self._begun = 0, best
        self._form = self._named(best, pairs.change[whole[0] :])
        return True

    def _samples(self, start_s: float, end_s: float, clock: Clock) -> Samples | None:
        """Samples between two times without the camera's gain; None if they are too few."""
        enough = len(self._kept.between(start_s, end_s)) >= ENOUGH_FRAMES // 2
        return self._kept.evened(start_s, end_s, clock) if enough else None

    def _named(self, header: HeaderSeen, change: Floats) -> Format:
        try:
            return format_of(named_format(header, change, self._signal.header_pairs))
        except ValueError:
            return AGREED

    def _packet(self, clock: Clock, start_s: float, end_s: float) -> Iterator[ReadPacket]:
        around = 2 * clock.period_s
        samples = self._samples(start_s - around, end_s + around, clock)
        if samples is None:
            self._next = None
            return
        _, clock = refined(Bins(samples), clock, self._kept.frame_s, self._kept.readout.length, self._row_s)
        yield from self._taken(solved_evenly(samples, clock), clock, round(clock.pair_at(start_s)))

    def _taken(self, found: Solved, clock: Clock, first: int) -> Iterator[ReadPacket]:
        """The packet that begins with a pair."""
        place = first - found.pairs[0]
        head = self._signal.header_pairs
        ties = self._ties(found, place, head) if place >= 0 else []  # below 0 its beginning was not seen
        if not ties:
            self._next = None
            return
        signal = replace(self._signal, data_pairs=self._pairs)
        tried = [decoded(one, self._form, found, clock, signal, self._options) for one in ties]
        packet = max(tried, key=lambda one: one.good)
        self._next = clock.begins(first + head + self._pairs)
        self._clock = replace(clock, start_s=self._next)
        if packet.good:
            self._orientation = packet.header.orientation
            self._begun = self._header = packet.header
        yield packet
        self._kept.drop_before(self._next - 8 * clock.period_s)

    def _ties(self, found: Solved, place: int, head: int) -> list[HeaderSeen]:
        """Headers that the packet at a place may have; none where too many were not seen."""
        seen = [one for one in headers(found.change[place : place + head], head) if one.place == 0]
        if seen:
            self._begun = self._header = replace(seen[0], place=place)
            self._lost = 0
            self._form = self._named(self._header, found.change)
            ties = [replace(one, place=place) for one in seen if one.score > seen[0].score - TIES]
            return [one for one in ties if one.orientation == self._orientation] or ties
        self._lost += 1
        if self._header is None or self._lost >= FEWEST_LOST:
            return []
        return [replace(self._header, place=place, score=0.0)]
