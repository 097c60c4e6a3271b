"""Pairs of patterns by least squares, cell by cell, for a clock that is known.

Headers among solved pairs: whose array it is, how the camera sees it, and the format that it names.

A packet of solved pairs: gains taken out, frames that do not fit left out, and its codewords decoded.

Packets of one array as its frames come: the light's clock, headers, and where packets begin and end.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import SettingsError
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.geometry.pose import ORIENTATIONS, Orientation
from heliograph.receive.packet import MIN_PAIRS_SEEN, Words
from heliograph.receive.screen.cells import Sample, SearchBudget
from heliograph.receive.screen.clock import (
    BINS,
    ENOUGH_FRAMES,
    MOST_UNEXPLAINED,
    PAIR_LOADING,
    Bins,
    Clock,
    ClockSearch,
    Kept,
    Samples,
    pairs_between,
    refined,
)
from heliograph.receive.settings import ScreenSettings
from heliograph.signal.formats import AGREED, ALL_MODES, DIMMED, SHORT_PAIRS, Format, format_of, words
from heliograph.signal.header import CELLS, all_header_cells
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True)
class Solved:
    """Pairs of patterns as least squares give them."""

    # Numbers of the pairs
    pairs: range
    # (pairs, n, n) d in the light's unit
    change: Floats
    # (pairs, n, n) variance of d by that of one sample
    variance: Floats
    # (n, n) mean light c of each cell
    light: Floats
    # (frames, n, n) what is not explained
    left: Floats


def solved(samples: Samples, clock: Clock, weights: Floats | None = None) -> Solved:
    """Solve the pairs of all cells."""
    frames, n = len(samples.times_s), samples.light.shape[-1]
    late = clock.row_s * float(samples.rows.max())
    pairs = pairs_between(clock, float(samples.times_s[0]), float(samples.times_s[-1]), late)
    w = samples.weights / samples.weights.mean() * (1.0 if weights is None else weights)
    y = samples.light.reshape(frames, -1).T  # (cells, frames)
    # cells of one row of the array, or fewer, share their times
    at = samples.times_s + clock.row_s * samples.rows.reshape(frames, -1).T
    change, variance = np.empty((len(pairs), n * n)), np.empty((len(pairs), n * n))
    light, left = np.empty(n * n), np.empty((frames, n * n))
    order = np.argsort(at[:, 0] if frames else at, kind="stable")
    for group in np.array_split(order, max(n, 2 * BINS)):
        m = np.concatenate([np.ones((frames, 1)), clock.design(at[group].mean(0), pairs)], axis=1)
        mw = m * w[:, None]
        loading = PAIR_LOADING * 2 * frames / len(pairs) * np.eye(len(pairs) + 1)
        loading[0, 0] = 0
        gram = mw.T @ m + loading
        inverse = np.linalg.inv(gram)
        x = inverse @ (mw.T @ y[group].T)
        light[group], change[:, group] = x[0], x[1:]
        variance[:, group] = np.diag(inverse)[1:, None]
        left[:, group] = y[group].T - m @ x
    shape = (n, n)
    return Solved(
        pairs,
        change.reshape(-1, *shape),
        variance.reshape(-1, *shape),
        light.reshape(shape),
        left.reshape(-1, *shape),
    )


LEAST_MATCH = 0.75
"""Least correlation of a pair with a header. A pair of random data of 8 x 8 cells has a standard deviation of 0.125,
and is compared with 240 turned headers: six of them are 0.75."""

TIES = 0.03
"""Correlations this near are of headers that look alike in several orientations; the data tell which is right."""


@dataclass(frozen=True)
class HeaderSeen:
    """A header among pairs."""

    # Number of its first pair among those solved
    place: int
    # Number of the array, 0 to 29
    identity: int
    # How the camera sees it
    orientation: Orientation
    # Correlation with the header, 0 to 1
    score: float
    # Number of the format, 0 to 2047; 0 where the header has one pair
    form: int = 0


def headers(change: Floats, pairs: int) -> list[HeaderSeen]:
    """Find headers among pairs, the surest first."""
    n = change.shape[-1]
    centred = change / np.maximum(np.linalg.norm(change, axis=(1, 2), keepdims=True), TINY)
    cells = centred.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4)) * n
    known = all_header_cells()
    found = []
    for orientation in ORIENTATIONS:
        turned = np.stack([orientation.turned(one) for one in known]) / CELLS
        # correlation over all cells of the array, (pairs, identities)
        match = np.einsum("pij,kij->pk", cells, turned) / CELLS
        # of several pairs of a header the weakest counts; a format dims the later ones
        whole = match[: len(match) - pairs + 1].copy()
        for later in range(1, pairs):
            whole = np.minimum(whole, match[later : later + len(whole)] / 0.9)
        found += [
            HeaderSeen(int(p), int(k), orientation, float(whole[p, k])) for p, k in np.argwhere(whole > LEAST_MATCH)
        ]
    found.sort(key=lambda one: -one.score)
    return found


def named_format(header: HeaderSeen, change: Floats, pairs: int) -> int:
    """Return the number of the format that a header names, 0 to 2047."""
    if pairs < 2:
        return 0
    n = change.shape[-1]
    upright = np.stack([header.orientation.upright(one) for one in change[header.place : header.place + pairs]])
    cells = upright.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4))
    first, later = cells[0].ravel(), cells[1:].mean(0).ravel()
    # a dimmed cell has half the contrast that it had in the first pair
    shown = np.where(words(ALL_MODES), DIMMED, 1.0) * first
    return int(np.argmin(((shown - later) ** 2).sum(1)))


GAIN_STEPS = 3
"""Times that the gain of each row is estimated anew. Chosen: each takes three quarters of what is left of bands."""

UNIT_GAIN = 0.3
"""Weight of a gain of 1, by the power of a frame's contrast: a frame between pattern and inverse has none. Chosen."""

OUTLIER = 4.0
"""Misfit of a frame, by the median one, from which it does not count: repeated by the camera, or shaken."""


@dataclass(frozen=True)
class ReadPacket:
    """A packet as it was read."""

    # Its header, of score 0 where it was not seen
    header: HeaderSeen
    # The format that it names
    form: Format
    # Why nothing was read, empty otherwise
    reason: str
    # Codewords by layer, empty where nothing was read
    words: Words
    # start_s, end_s: times between which it was shown, by the camera's clock
    start_s: float
    end_s: float
    # (pairs, n, n) differences of its data pairs, upright
    change: Floats
    # (pairs,) whether a data pair was seen
    seen: Floats

    @property
    def good(self) -> int:
        """Codewords that are right."""
        return sum(word.status == "ok" for words in self.words.values() for word in words)


def solved_evenly(samples: Samples, clock: Clock) -> Solved:
    """Solve pairs with the gain of each row, and without frames that do not fit."""
    found = solved(samples, clock)
    for _ in range(GAIN_STEPS):
        fitted = samples.light - found.left
        contrast = _contrast_gain(samples.light, fitted)[:, None, None]
        samples = replace(samples, light=samples.light / contrast)
        gain = (samples.light * fitted).sum(2, keepdims=True) / np.maximum((fitted**2).sum(2, keepdims=True), TINY)
        samples = replace(samples, light=samples.light / np.clip(gain, 0.5, 2.0))
        rms = np.sqrt((found.left**2).mean((1, 2)))
        weights = 1 / (1 + (rms / (OUTLIER * max(float(np.median(rms)), TINY))) ** 4)
        found = solved(samples, clock, weights)
    return found


def _contrast_gain(light: Floats, fitted: Floats) -> Floats:
    """Gain of each frame by its contrast: its mean may be that of the data."""
    seen, known = (one - one.mean((1, 2), keepdims=True) for one in (light, fitted))
    power = (known**2).sum((1, 2))
    held = UNIT_GAIN * max(float(np.median(power)), TINY)
    return np.clip(((seen * known).sum((1, 2)) + held) / (power + held), 0.5, 2.0)


def decoded(
    header: HeaderSeen, form: Format, found: Solved, clock: Clock, signal: SignalSettings, options: Decoding
) -> ReadPacket:
    """Decode a packet."""
    pairs, n = signal.data_pairs, signal.side
    first = header.place + signal.header_pairs
    there = found.change[first : first + pairs] / np.maximum(found.light, 0.05)
    change, seen = np.zeros((pairs, n, n)), np.zeros(pairs, bool)
    change[: len(there)] = there
    # a pair of which the frames show next to nothing has a large variance
    typical = float(np.median(found.variance))
    seen[: len(there)] = found.variance[first : first + pairs].mean((1, 2)) < 10 * typical
    upright = np.stack([header.orientation.upright(one) for one in change])
    reason, words = "", {}
    if form.mode == "single":
        reason = "the receiver screen reads pairs of patterns alone, this packet is of the single mode"
    else:
        try:
            words = decode_packet(upright, seen, PacketFormat(signal, form), header.identity, options)
        except SettingsError as error:
            reason = str(error)
    start = clock.begins(found.pairs[0] + header.place)
    end = clock.begins(found.pairs[0] + first + pairs)
    return ReadPacket(header, form, reason, words, start, end, upright, seen)


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
            if now_s - self._next < MIN_PAIRS_SEEN * (end - self._next):
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
