"""Packets of one array: the light's clock, headers, and the codewords that the pairs hold."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import SettingsError
from heliograph.receive.coming import ENOUGH_SEEN
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.image.orientation import Orientation
from heliograph.receive.packets import Words
from heliograph.receive.screen.follow import Sample
from heliograph.receive.screen.headers import TIES, HeaderSeen, headers, named_format
from heliograph.receive.screen.timing import Bins, Clock, Samples, Solved, refined, searched, solved
from heliograph.signal.formats import AGREED, SHORT_PAIRS, Format, format_of
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns a second that are tried beside the nominal ones: those that divide a display's 60 Hz, and the commonest
rates of films."""

MOST_UNEXPLAINED = 0.3
"""Largest part of what changes that a clock may leave unexplained. Of a right one it is 0.003 to 0.1, of a wrong one
0.4 to 1."""

ENOUGH_PATTERNS, ENOUGH_FRAMES = 10, 16
"""Least patterns and frames from which a clock is found. Chosen: the five numbers of a clock want some pairs of
data."""

LONGEST_SEARCH_S = 6.0
"""Seconds within which a clock is looked for: ten patterns at 2 a second last 5 s."""

PARTLY = 0.45
"""Part of a pair that a film's start may cut off: of its first pattern a tenth is left at least."""

GAIN_STEPS = 3
"""Times that the gain of each row is estimated anew. Chosen: each takes three quarters of what is left of bands."""

UNIT_GAIN = 0.3
"""Weight of a gain of 1, by the power of a frame's contrast: a frame between pattern and inverse has none. Chosen."""

FLICKER = 0.15
"""Part by which a frame's light differs from that of the frames around, from which it is the backlight's and not that
of the data: of 16 x 16 cells these differ by 0.03 rms, of 8 x 8 by 0.06."""

OUTLIER = 4.0
"""Misfit of a frame, by the median one, from which it does not count: repeated by the camera, or shaken."""

FEWEST_LOST = 2
"""Packets without a header after which it is looked for anew."""


@dataclass(frozen=True)
class ReadPacket:
    """A packet as it was read.

    Attributes
    ----------
    header
        Its header, of score 0 where it was not seen.
    form
        The format that it names.
    reason
        Why nothing was read, empty otherwise.
    words
        Codewords by layer, empty where nothing was read.
    start_s, end_s
        Times between which it was shown, by the camera's clock.
    first, last
        The first and the last sample that shows something of it.
    change
        (pairs, n, n) differences of its data pairs, upright.
    seen
        (pairs,) whether a data pair was seen.
    clock
        The light's clock as the packet showed it.
    noise
        Rms of what a cell shows that the pairs do not explain, in levels.
    """

    header: HeaderSeen
    form: Format
    reason: str
    words: Words
    start_s: float
    end_s: float
    first: Sample
    last: Sample
    change: Floats
    seen: Floats
    clock: Clock
    noise: float


@dataclass(frozen=True)
class Readout:
    """The way in which a frame is read out, as pictures that are turned upright show it.

    Attributes
    ----------
    axis
        0 where columns are read one after the other, 1 where rows are.
    back
        Whether the last one is read first.
    length
        Columns or rows of a frame.
    """

    axis: int
    back: bool
    length: int

    def rows(self, at: Floats) -> Floats:
        """Return how many rows of the sensor are read before some places.

        Parameters
        ----------
        at
            (..., 2) x and y in px.
        """
        row = at[..., self.axis]
        return self.length - 1 - row if self.back else row


BETTER = 0.8
"""Part of what is unexplained that another way of reading out must leave at most. Chosen: of a global shutter all are
alike."""


class PacketReading:
    """Reads packets from samples as they come.

    Parameters
    ----------
    signal
        The light's signal; its period and number of data pairs are first guesses alone.
    options
        How codewords are decoded.
    frame_s
        Frame period in s.
    shape
        Rows and columns of a frame.
    row_s
        Time from row to row; None to find it.
    fixed
        Whether the nominal pattern rate alone is tried.
    """

    def __init__(
        self,
        signal: SignalSettings,
        options: Decoding,
        frame_s: float,
        shape: tuple[int, ...],
        row_s: float | None,
        fixed: bool,
    ):
        self._signal, self._options = signal, options
        self._frame_s, self._row_s = frame_s, row_s
        self._readouts = [Readout(axis, back, shape[1 - axis]) for axis in (1, 0) for back in (False, True)]
        self._readout = self._readouts[0]
        others = [] if fixed else [1 / rate for rate in RATES if abs(rate * signal.pattern_period_s - 1) > 0.02]
        self._periods = [[signal.pattern_period_s], others]
        self._samples: deque[Sample] = deque()
        self._clock: Clock | None = None
        self._tried_s = 0.0
        self._searched_s = -np.inf
        self._next: float | None = None  # time at which the next packet begins
        self._header: HeaderSeen | None = None
        self._form = AGREED
        self._lost = 0
        self._orientation: Orientation | None = None

    @property
    def clocked(self) -> bool:
        """Whether the light's clock is known."""
        return self._clock is not None

    def take(self, sample: Sample) -> Iterator[ReadPacket]:
        """Take what the next frame shows; yield the packets that it completes.

        Parameters
        ----------
        sample
            What it shows; frames come in the order of time.
        """
        self._samples.append(sample)
        if self._clock is None:
            self._find_clock()
        yield from self._read(sample.time_s)

    def finish(self) -> Iterator[ReadPacket]:
        """Yield the packet in progress if enough of it was seen."""
        if self._clock is None:
            self._find_clock(final=True)
        if self._samples:
            yield from self._read(self._samples[-1].time_s, final=True)

    def _find_clock(self, final: bool = False) -> None:
        first, last = self._samples[0].time_s, self._samples[-1].time_s
        length = last - first
        # the longer it takes the rarer it is tried
        if length < 1.3 * self._tried_s and not final:
            return
        self._tried_s = max(length, 4 * self._frame_s)
        # others explain a part of a slow light: its own rate has the first word
        waits = length < ENOUGH_PATTERNS * self._signal.pattern_period_s and not final
        for periods in self._periods[: 1 if waits else 2]:
            fit = [p for p in periods if length >= ENOUGH_PATTERNS * p]
            if not fit or len(self._samples) < ENOUGH_FRAMES:
                continue
            longest = max(2 * ENOUGH_PATTERNS * min(fit), ENOUGH_PATTERNS * max(fit)) * 1.2
            samples = self._gathered(last - longest, last)
            samples = samples.evened(samples.light.mean((1, 2)))
            found = searched(samples, fit, self._frame_s, self._readout.length, self._row_s)
            if found and found[0][0] < MOST_UNEXPLAINED:
                self._settle_readout(*found[0], last - longest, last)
                return
        if length > LONGEST_SEARCH_S * 2:
            self._drop_before(last - LONGEST_SEARCH_S)
            self._tried_s = 0.0

    def _settle_readout(self, left: float, clock: Clock, start_s: float, end_s: float) -> None:
        """Take the way of reading out that explains most: phones film upright pictures with a sensor on its side."""
        first = self._readout
        best = left, clock, first
        for one in self._readouts:
            self._readout = one
            samples = self._gathered(start_s, end_s)
            bins = Bins(samples.evened(samples.light.mean((1, 2))))
            begun = replace(clock, row_s=clock.row_s * first.length / one.length)
            least = best[0] if one is first else BETTER * best[0]
            now, refined_clock = refined(bins, begun, self._frame_s, one.length, self._row_s)
            if now < least:
                best = now, refined_clock, one
        _, self._clock, self._readout = best

    def _gathered(self, start_s: float, end_s: float) -> Samples:
        kept = [one for one in self._samples if start_s <= one.time_s <= end_s]
        return Samples(
            np.array([one.time_s for one in kept]),
            np.stack([self._readout.rows(one.at) for one in kept]),
            np.stack([one.seen.light for one in kept]),
            np.ones(len(kept)),
        )

    def _drop_before(self, time_s: float) -> None:
        while len(self._samples) > 1 and self._samples[0].time_s < time_s:
            self._samples.popleft()

    def _read(self, now_s: float, final: bool = False) -> Iterator[ReadPacket]:
        """Packets that are complete at a time."""
        while (clock := self._clock) is not None:
            late = clock.row_s * self._readout.length + clock.exposure_s + 2 * clock.response_s
            if self._next is None:
                if not self._find_header(now_s - late, final):
                    return
                continue
            pairs = self._signal.header_pairs + self._pairs
            end = self._next + 2 * pairs * clock.period_s
            if now_s < end + late and not final:
                return
            if now_s - self._next < ENOUGH_SEEN * (end - self._next):
                return
            yield from self._packet(self._next, end)
            if final and now_s < end + late:
                return

    @property
    def _pairs(self) -> int:
        return SHORT_PAIRS if self._form.mode == "short" else self._signal.data_pairs

    def _find_header(self, now_s: float, final: bool) -> bool:
        """Look for a header among the pairs that are complete."""
        clock = self._clock
        assert clock is not None
        step = 2 * clock.period_s
        if now_s < self._searched_s + 2 * step and not final:
            return False
        first = max(self._samples[0].time_s, self._searched_s - 4 * step)
        if now_s - first < 3 * step:
            return False
        self._searched_s = now_s
        samples = self._evened(first, now_s + step, clock)
        left, clock = refined(Bins(samples), clock, self._frame_s, self._readout.length, self._row_s)
        if left > MOST_UNEXPLAINED and len(samples.times_s) >= ENOUGH_FRAMES:
            # a header alone is explained by half its rate's period too
            self._clock, self._tried_s = None, 0.0
            return False
        pairs = solved(samples, clock)
        whole = [
            k
            for k, p in enumerate(pairs.pairs)
            if clock.begins(p) >= first - PARTLY * step and clock.begins(p + 1) <= now_s
        ]
        if not whole:
            return False
        found = headers(pairs.change[whole[0] : whole[-1] + 1], self._signal.header_pairs)
        if not found:
            return False
        best = min((one for one in found if one.score > found[0].score - 0.1), key=lambda one: (one.place, -one.score))
        self._clock = replace(clock, start_s=clock.begins(pairs.pairs[whole[0]] + best.place))
        self._next = self._clock.start_s
        self._lost = 0
        self._form = self._named(best, pairs.change[whole[0] :])
        return True

    def _named(self, header: HeaderSeen, change: Floats) -> Format:
        try:
            return format_of(named_format(header, change, self._signal.header_pairs))
        except ValueError:
            return AGREED

    def _evened(self, start_s: float, end_s: float, clock: Clock) -> Samples:
        """Samples between two times without the camera's gain, which is even over a pair."""
        samples = self._gathered(start_s, end_s)
        mean, t = samples.light.mean((1, 2)), samples.times_s
        near = np.clip(1.0 + 0.5 * self._frame_s / clock.period_s - np.abs(t[:, None] - t) / clock.period_s, 0, None)
        near = np.minimum(near, self._frame_s / clock.period_s)
        even = (near @ mean) / np.maximum(near.sum(1), TINY)
        # a backlight that is switched shows in single frames
        return samples.evened(np.where(np.abs(mean / np.maximum(even, TINY) - 1) > FLICKER, mean, even))

    def _packet(self, start_s: float, end_s: float) -> Iterator[ReadPacket]:
        clock, around = self._clock, 2 * self._clock.period_s  # type: ignore[union-attr]
        assert clock is not None
        samples = self._evened(start_s - around, end_s + around, clock)
        if len(samples.times_s) < ENOUGH_FRAMES // 2:
            self._next = None
            return
        _, clock = refined(Bins(samples), clock, self._frame_s, self._readout.length, self._row_s)
        found = self._solved(samples, clock)
        yield from self._taken(found, clock)

    def _solved(self, samples: Samples, clock: Clock) -> Solved:
        """Pairs with the gain of each row, and without frames that do not fit."""
        weights = np.ones(len(samples.times_s))
        found = solved(samples, clock)
        for _ in range(GAIN_STEPS):
            fitted = samples.light - found.left
            contrast = _contrast_gain(samples.light, fitted)[:, None, None]
            samples = replace(samples, light=samples.light / contrast)
            gain = (samples.light * fitted).sum(2, keepdims=True) / np.maximum((fitted**2).sum(2, keepdims=True), TINY)
            gain = np.clip(gain, 0.5, 2.0)
            samples = replace(samples, light=samples.light / gain)
            rms = np.sqrt((found.left**2).mean((1, 2)))
            weights = 1 / (1 + (rms / (OUTLIER * max(float(np.median(rms)), TINY))) ** 4)
            found = solved(samples, clock, weights)
        return found

    def _taken(self, found: Solved, clock: Clock) -> Iterator[ReadPacket]:
        first = round(clock.pair_at(self._next or 0.0))
        place = first - found.pairs[0]
        head = self._signal.header_pairs
        if place < 0:  # its beginning was not seen
            self._next = None
            return
        seen = [one for one in headers(found.change[place : place + head], head) if one.place == 0]
        if seen:
            self._header, self._lost = replace(seen[0], place=place), 0
            self._form = self._named(self._header, found.change)
            ties = [replace(one, place=place) for one in seen if one.score > seen[0].score - TIES]
            if self._orientation is not None:
                ties = [one for one in ties if one.orientation == self._orientation] or ties
        else:
            self._lost += 1
            if self._header is None or self._lost >= FEWEST_LOST:
                self._next = None
                return
            ties = [replace(self._header, place=place, score=0.0)]
        packet = max((self._decoded(one, found, clock) for one in ties), key=_good)
        self._next = clock.begins(first + head + self._pairs)
        self._clock = replace(clock, start_s=self._next)
        if _good(packet):
            self._orientation = packet.header.orientation
            self._header = packet.header
        yield packet
        self._drop_before(self._next - 8 * clock.period_s)

    def _decoded(self, header: HeaderSeen, found: Solved, clock: Clock) -> ReadPacket:
        head, pairs, n = self._signal.header_pairs, self._pairs, self._signal.side
        first = header.place + head
        light = np.maximum(found.light, 0.05)
        change = np.zeros((pairs, n, n))
        seen = np.zeros(pairs, bool)
        there = found.change[first : first + pairs] / light
        change[: len(there)] = there
        # a pair of which the frames show next to nothing has a large variance
        typical = float(np.median(found.variance))
        seen[: len(there)] = found.variance[first : first + pairs].mean((1, 2)) < 10 * typical
        upright = np.stack([header.orientation.upright(one) for one in change])
        reason, words = "", {}
        form = self._form
        try:
            signal = replace(self._signal, data_pairs=pairs)
            if form.mode == "single":
                raise SettingsError(
                    "the receiver screen reads pairs of patterns alone, this packet is of the single mode"
                )
            layout = PacketFormat(signal, form)
            words = decode_packet(upright, seen, layout, header.identity, self._options)
        except SettingsError as error:
            reason = str(error)
        start = clock.begins(found.pairs[0] + header.place)
        end = clock.begins(found.pairs[0] + first + pairs)
        shown = [one for one in self._samples if start <= one.time_s <= end] or [self._samples[-1]]
        noise = float(np.sqrt(np.mean(found.left**2)) / max(float(np.mean(found.light)), TINY)) * 2
        return ReadPacket(header, form, reason, words, start, end, shown[0], shown[-1], upright, seen, clock, noise)


def _contrast_gain(light: Floats, fitted: Floats) -> Floats:
    """Gain of each frame by its contrast: its mean may be that of the data."""
    seen, known = (one - one.mean((1, 2), keepdims=True) for one in (light, fitted))
    power = (known**2).sum((1, 2))
    held = UNIT_GAIN * max(float(np.median(power)), TINY)
    return np.clip(((seen * known).sum((1, 2)) + held) / (power + held), 0.5, 2.0)


def _good(packet: ReadPacket) -> int:
    """Codewords of a packet that are right."""
    return sum(word.status == "ok" for words in packet.words.values() for word in words)
