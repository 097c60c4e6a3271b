"""Packets of a screen array: pairs by least squares for a known clock, headers among the pairs, and decoding."""

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
    PARAMETERS as CLOCK,
)
from heliograph.receive.screen.clock import (
    Clock,
    ClockSearch,
    RowBins,
    SampleBuffer,
    Samples,
    pairs_between,
    refine_clock,
)
from heliograph.receive.settings import ScreenSettings
from heliograph.signal.formats import AGREED, ALL_MODES, DIMMED, SHORT_PAIRS, Format, format_of, words
from heliograph.signal.header import CELLS, all_header_cells
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True)
class PacketParameters:
    """Parameters of the packets of a screen."""

    # Minimum correlation of a pair with a header: six standard deviations of random data of 8 x 8 cells
    min_correlation: float = 0.75
    # Maximum difference of the correlations of headers with ambiguous orientation
    max_tie: float = 0.03
    # Iterations of the row gains; each removes three quarters of the remaining bands
    gain_steps: int = 3
    # Weight of a gain of 1, relative to the contrast of a frame
    unit_gain: float = 0.3
    # Misfit of a frame, relative to the median, at which the frame counts half
    outlier: float = 4.0
    # Variance of a missing pair, relative to the median
    max_variance: float = 10.0
    # Part of a pair before the start of a film
    max_cut: float = 0.45
    # Packets without a header after which the header is searched again
    max_lost: int = 2


PARAMETERS = PacketParameters()


@dataclass(frozen=True)
class PairSolution:
    """Pairs of patterns by least squares."""

    # Numbers of the pairs
    pairs: range
    # (pairs, n, n) d in the unit of the light
    change: Floats
    # (pairs, n, n) variance of d, relative to a sample
    variance: Floats
    # (n, n) mean light c of each cell
    light: Floats
    # (frames, n, n) residual
    residual: Floats


def solve_pairs(samples: Samples, clock: Clock, weights: Floats | None = None) -> PairSolution:
    """Solve the pairs of all cells by least squares."""
    frames, n = len(samples.times_s), samples.light.shape[-1]
    late = clock.row_s * float(samples.rows.max())
    pairs = pairs_between(clock, float(samples.times_s[0]), float(samples.times_s[-1]), late)
    w = samples.weights / samples.weights.mean() * (1.0 if weights is None else weights)
    y = samples.light.reshape(frames, -1).T  # (cells, frames)
    # cells of a group of rows share the times
    at = samples.times_s + clock.row_s * samples.rows.reshape(frames, -1).T
    change, variance = np.empty((len(pairs), n * n)), np.empty((len(pairs), n * n))
    light, residual = np.empty(n * n), np.empty((frames, n * n))
    order = np.argsort(at[:, 0] if frames else at, kind="stable")
    for group in np.array_split(order, max(n, 2 * CLOCK.row_bins)):
        m = np.concatenate([np.ones((frames, 1)), clock.design(at[group].mean(0), pairs)], axis=1)
        mw = m * w[:, None]
        loading = CLOCK.loading * 2 * frames / len(pairs) * np.eye(len(pairs) + 1)
        loading[0, 0] = 0
        gram = mw.T @ m + loading
        inverse = np.linalg.inv(gram)
        x = inverse @ (mw.T @ y[group].T)
        light[group], change[:, group] = x[0], x[1:]
        variance[:, group] = np.diag(inverse)[1:, None]
        residual[:, group] = y[group].T - m @ x
    shape = (n, n)
    change, variance = change.reshape(-1, *shape), variance.reshape(-1, *shape)
    return PairSolution(pairs, change, variance, light.reshape(shape), residual.reshape(-1, *shape))


@dataclass(frozen=True)
class ScreenHeader:
    """A header among pairs."""

    # Number of the first pair among the solved pairs
    place: int
    # Number of the array, 0 to 29
    identity: int
    # Orientation of the array in the camera
    orientation: Orientation
    # Correlation with the header, 0 to 1; 0 for an assumed header
    score: float


def find_headers(change: Floats, pairs: int) -> list[ScreenHeader]:
    """Find headers of a number of pairs, the best first."""
    n = change.shape[-1]
    centred = change / np.maximum(np.linalg.norm(change, axis=(1, 2), keepdims=True), TINY)
    cells = centred.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4)) * n
    known = all_header_cells()
    headers: list[ScreenHeader] = []
    for orientation in ORIENTATIONS:
        turned = np.stack([orientation.turned(header) for header in known]) / CELLS
        # correlation over all cells, (pairs, identities)
        match = np.einsum("pij,kij->pk", cells, turned) / CELLS
        # the weakest pair of a header counts; a format dims the later pairs
        weakest = match[: len(match) - pairs + 1].copy()
        for later in range(1, pairs):
            weakest = np.minimum(weakest, match[later : later + len(weakest)] / 0.9)
        headers += [
            ScreenHeader(int(p), int(k), orientation, float(weakest[p, k]))
            for p, k in np.argwhere(weakest > PARAMETERS.min_correlation)
        ]
    headers.sort(key=lambda header: -header.score)
    return headers


def read_format(header: ScreenHeader, change: Floats, pairs: int) -> int:
    """Return the number of the format of a header, 0 to 2047."""
    if pairs < 2:
        return 0
    n = change.shape[-1]
    upright = np.stack([header.orientation.upright(pair) for pair in change[header.place : header.place + pairs]])
    cells = upright.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4))
    first, later = cells[0].ravel(), cells[1:].mean(0).ravel()
    # a dimmed cell has half the contrast of the first pair
    expected = np.where(words(ALL_MODES), DIMMED, 1.0) * first
    return int(np.argmin(((expected - later) ** 2).sum(1)))


@dataclass(frozen=True)
class ScreenPacket:
    """A decoded packet."""

    # Header, of score 0 if not visible
    header: ScreenHeader
    # Format of the header
    form: Format
    # Reason why no codeword was decoded, else empty
    reason: str
    # Codewords by layer, empty if not decoded
    words: Words
    # start_s, end_s: start and end in camera time
    start_s: float
    end_s: float
    # (pairs, n, n) differences of the data pairs, upright
    change: Floats
    # (pairs,) True for visible data pairs
    seen: Floats

    @property
    def n_ok(self) -> int:
        """Number of correct codewords."""
        return sum(word.status == "ok" for words in self.words.values() for word in words)


def solve_with_gains(samples: Samples, clock: Clock) -> PairSolution:
    """Solve the pairs with the gain of each row, and reduced weights of outlier frames."""
    solution = solve_pairs(samples, clock)
    for _ in range(PARAMETERS.gain_steps):
        fitted = samples.light - solution.residual
        contrast = _contrast_gains(samples.light, fitted)[:, None, None]
        samples = replace(samples, light=samples.light / contrast)
        gain = (samples.light * fitted).sum(2, keepdims=True) / np.maximum((fitted**2).sum(2, keepdims=True), TINY)
        samples = replace(samples, light=samples.light / np.clip(gain, 0.5, 2.0))
        rms = np.sqrt((solution.residual**2).mean((1, 2)))
        weights = 1 / (1 + (rms / (PARAMETERS.outlier * max(float(np.median(rms)), TINY))) ** 4)
        solution = solve_pairs(samples, clock, weights)
    return solution


def _contrast_gains(light: Floats, fitted: Floats) -> Floats:
    """Estimate the gain of each frame by the contrast, as data change the mean."""
    observed, known = (values - values.mean((1, 2), keepdims=True) for values in (light, fitted))
    power = (known**2).sum((1, 2))
    held = PARAMETERS.unit_gain * max(float(np.median(power)), TINY)
    return np.clip(((observed * known).sum((1, 2)) + held) / (power + held), 0.5, 2.0)


def decode_pairs(
    header: ScreenHeader, form: Format, solution: PairSolution, clock: Clock, signal: SignalSettings, options: Decoding
) -> ScreenPacket:
    """Decode a packet."""
    pairs, n = signal.data_pairs, signal.side
    first = header.place + signal.header_pairs
    visible = solution.change[first : first + pairs] / np.maximum(solution.light, 0.05)
    change, seen = np.zeros((pairs, n, n)), np.zeros(pairs, bool)
    change[: len(visible)] = visible
    # a pair without frames has a large variance
    variance, typical = solution.variance[first : first + pairs].mean((1, 2)), float(np.median(solution.variance))
    seen[: len(visible)] = variance < PARAMETERS.max_variance * typical
    upright = np.stack([header.orientation.upright(pair) for pair in change])
    reason, words = "", {}
    if form.mode == "single":
        reason = "the receiver screen reads only pairs of patterns, this packet is of the single mode"
    else:
        try:
            words = decode_packet(upright, seen, PacketFormat(signal, form), header.identity, options)
        except SettingsError as error:
            reason = str(error)
    start = clock.start_of(solution.pairs[0] + header.place)
    end = clock.start_of(solution.pairs[0] + first + pairs)
    return ScreenPacket(header, form, reason, words, start, end, upright, seen)


@dataclass(frozen=True)
class CurrentPacket:
    """The packet in progress."""

    # Header, or the header of the previous packet if not visible
    header: ScreenHeader
    # Start in camera time
    start_s: float
    # Pattern period T in camera time
    period_s: float
    # Delay of the mean exposure of the array after the time of a frame
    late_s: float
    # header_pairs, data_pairs: numbers of pairs of header and data
    header_pairs: int
    data_pairs: int

    def times_s(self, pair: int) -> tuple[float, float]:
        """Return the best frame times for the two patterns of a data pair."""
        first = self.start_s + 2 * (self.header_pairs + pair) * self.period_s - self.late_s
        return first + 0.5 * self.period_s, first + 1.5 * self.period_s


class PacketAssembler:
    """Assembles and decodes packets from samples."""

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
        self._buffer = SampleBuffer(shape, frame_s)
        self._search = ClockSearch(signal.pattern_period_s, screen.row_time_s, not screen.find_rate, budget)
        self._clock: Clock | None = None
        self._searched_s = -np.inf
        self._next_s: float | None = None  # start of the next packet
        self._last_header: ScreenHeader | None = None
        self._header: ScreenHeader | None = None  # header of the packet in progress
        self._form = AGREED
        self._lost = 0
        self._orientation: Orientation | None = None

    @property
    def has_header(self) -> bool:
        """True after the first header."""
        return self._header is not None

    @property
    def has_clock(self) -> bool:
        """True if the clock of the light is known."""
        return self._clock is not None

    @property
    def current(self) -> CurrentPacket | None:
        """The packet in progress; None without a header."""
        if self._clock is None or self._next_s is None or self._header is None:
            return None
        late_s = self._clock.exposure_s / 2
        late_s += self._clock.row_s * float(self._buffer.readout.rows(self._buffer.last.at).mean())
        pairs = self._signal.header_pairs, self._data_pairs
        return CurrentPacket(self._header, self._next_s, self._clock.period_s, late_s, *pairs)

    def push(self, sample: Sample) -> Iterator[ScreenPacket]:
        """Add the sample of the next frame; yield the completed packets."""
        self._buffer.add(sample)
        if self._clock is None:
            self._clock = self._search.find(self._buffer)
        yield from self._decode_complete(sample.time_s)

    def finish(self) -> Iterator[ScreenPacket]:
        """Yield the packet in progress if most of the packet was visible."""
        if self._clock is None:
            self._clock = self._search.find(self._buffer, final=True)
        yield from self._decode_complete(self._buffer.last.time_s, final=True)

    def samples_of(self, packet: ScreenPacket) -> list[Sample]:
        """Return the samples of a packet, or the last sample."""
        return self._buffer.between(packet.start_s, packet.end_s) or [self._buffer.last]

    def _decode_complete(self, now_s: float, final: bool = False) -> Iterator[ScreenPacket]:
        """Yield the packets completed by a time."""
        while (clock := self._clock) is not None:
            late_s = clock.row_s * self._buffer.readout.length + clock.exposure_s + 2 * clock.response_s
            if self._next_s is None:
                if not self._find_header(clock, now_s - late_s, final):
                    return
                continue
            pairs = self._signal.header_pairs + self._data_pairs
            end_s = self._next_s + 2 * pairs * clock.period_s
            if now_s < end_s + late_s and not final:
                return
            if now_s - self._next_s < MIN_PAIRS_SEEN * (end_s - self._next_s):
                return
            yield from self._decode_next(clock, self._next_s, end_s)
            if final and now_s < end_s + late_s:
                return

    @property
    def _data_pairs(self) -> int:
        """Number of data pairs of the packet in progress."""
        return SHORT_PAIRS if self._form.mode == "short" else self._signal.data_pairs

    def _find_header(self, clock: Clock, now_s: float, final: bool) -> bool:
        """Search for a header among the complete pairs; return True if found."""
        step = 2 * clock.period_s
        if now_s < self._searched_s + 2 * step and not final:
            return False
        first_s = max(self._buffer.first.time_s, self._searched_s - 4 * step)
        if now_s - first_s < 3 * step:
            return False
        self._searched_s = now_s
        samples = self._samples(first_s, now_s + step, clock)
        if samples is None:
            return False
        left, clock = self._refine(samples, clock, self._budget)
        if left > CLOCK.max_unexplained and len(samples.times_s) >= CLOCK.min_frames:
            # wrong clock: half the period explains a single header too
            self._clock = None
            self._search.restart()
            return False
        solution = solve_pairs(samples, clock)
        complete = [
            k
            for k, p in enumerate(solution.pairs)
            if clock.start_of(p) >= first_s - PARAMETERS.max_cut * step and clock.start_of(p + 1) <= now_s
        ]
        change = solution.change[complete[0] : complete[-1] + 1] if complete else solution.change[:0]
        headers = find_headers(change, self._signal.header_pairs) if complete else []
        if not headers:
            # the next search starts here
            self._buffer.drop_before(now_s - 4 * step)
            return False
        good = [header for header in headers if header.score > headers[0].score - 0.1]
        best = min(good, key=lambda header: (header.place, -header.score))
        self._next_s = clock.start_of(solution.pairs[complete[0]] + best.place)
        self._clock = replace(clock, start_s=self._next_s)
        self._lost, self._header = 0, best
        self._form = self._format(best, solution.change[complete[0] :])
        return True

    def _samples(self, start_s: float, end_s: float, clock: Clock) -> Samples | None:
        """Return the samples between two times without the gain of the camera; None for too few samples."""
        is_enough = len(self._buffer.between(start_s, end_s)) >= CLOCK.min_frames // 2
        return self._buffer.normalised_between(start_s, end_s, clock) if is_enough else None

    def _refine(self, samples: Samples, clock: Clock, budget: SearchBudget | None = None) -> tuple[float, Clock]:
        """Refine a clock by samples; return the unexplained part and the clock."""
        bins, buffer = RowBins(samples, budget), self._buffer
        return refine_clock(bins, clock, buffer.frame_s, buffer.readout.length, self._row_s)

    def _format(self, header: ScreenHeader, change: Floats) -> Format:
        """Return the format of a header, or the agreed format."""
        try:
            return format_of(read_format(header, change, self._signal.header_pairs))
        except ValueError:
            return AGREED

    def _decode_next(self, clock: Clock, start_s: float, end_s: float) -> Iterator[ScreenPacket]:
        """Decode the packet between two times."""
        around_s, header_pairs = 2 * clock.period_s, self._signal.header_pairs
        samples = self._samples(start_s - around_s, end_s + around_s, clock)
        if samples is None:
            self._next_s = None
            return
        _, clock = self._refine(samples, clock)
        solution, first = solve_with_gains(samples, clock), round(clock.pair_at(start_s))
        place = first - solution.pairs[0]
        # a negative place: the start was not visible
        headers = self._packet_headers(solution, place, header_pairs) if place >= 0 else []
        if not headers:
            self._next_s = None
            return
        signal = replace(self._signal, data_pairs=self._data_pairs)
        packets = [decode_pairs(header, self._form, solution, clock, signal, self._options) for header in headers]
        packet = max(packets, key=lambda candidate: candidate.n_ok)
        self._next_s = clock.start_of(first + header_pairs + self._data_pairs)
        self._clock = replace(clock, start_s=self._next_s)
        if packet.n_ok:
            self._orientation = packet.header.orientation
            self._header = self._last_header = packet.header
        yield packet
        self._buffer.drop_before(self._next_s - 8 * clock.period_s)

    def _packet_headers(self, solution: PairSolution, place: int, pairs: int) -> list[ScreenHeader]:
        """Return the possible headers of the packet at a place; empty after too many packets without a header."""
        headers = find_headers(solution.change[place : place + pairs], pairs)
        headers = [replace(header, place=place) for header in headers if header.place == 0]
        if headers:
            self._header = self._last_header = headers[0]
            self._lost = 0
            self._form = self._format(headers[0], solution.change)
            ties = [header for header in headers if header.score > headers[0].score - PARAMETERS.max_tie]
            return [header for header in ties if header.orientation == self._orientation] or ties
        self._lost += 1
        if self._last_header is None or self._lost >= PARAMETERS.max_lost:
            return []
        return [replace(self._last_header, place=place, score=0.0)]
