"""Packets of a screen array: pairs by least squares for a known clock, headers among the pairs, and decoding."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import SettingsError
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.geometry.pose import ORIENTATIONS, Orientation, Shape
from heliograph.receive.packet import MIN_PAIRS_SEEN, Codeword, Packet, ok_flags, packet_status
from heliograph.receive.screen.cells import PARAMETERS, Sample, SearchBudget
from heliograph.receive.screen.clock import Clock, SampleBuffer, Samples
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.formats import AGREED, ALL_MODES, DIMMED, SHORT_PAIRS, known_format, words
from heliograph.signal.header import CELLS, all_header_cells
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

# numbers of pairs, d and its variance relative to a sample (pairs, n, n), and mean light c of each cell (n, n)
PairSolution = tuple[range, Floats, Floats, Floats]


def solve_pairs(
    samples: Samples, clock: Clock, light: Floats, weights: Floats | float = 1.0
) -> tuple[PairSolution, Floats]:
    """Solve the pairs of all cells by least squares of the light; return also the residual, (frames, n, n)."""
    frames, n = len(samples.times_s), light.shape[-1]
    pairs = clock.pairs(samples.times_s, samples.rows)
    w = samples.weights / samples.weights.mean() * weights
    rows = samples.rows.reshape(frames, -1)
    order = np.argsort(rows[0], kind="stable")
    rows, y = rows[:, order], light.reshape(frames, -1)[:, order]
    # mean light and changes of the pairs; variances of both
    x, variance, residual = (np.empty((count, n * n)) for count in (len(pairs) + 1, len(pairs) + 1, frames))
    # cells of a group of rows share the times: 1 to 2 ms of readout
    size = -(-n * n // min(max(n, 2 * PARAMETERS.row_bins), 4 * PARAMETERS.row_bins))
    for group in (slice(start, start + size) for start in range(0, n * n, size)):
        at = samples.times_s + clock.row_s * rows[:, group].mean(1)
        m = np.concatenate([np.ones((frames, 1)), clock.design(at, pairs)], axis=1)
        mw = m * w[:, None]
        loading = 1e-3 * 2 * frames / len(pairs) * np.eye(len(pairs) + 1)
        loading[0, 0] = 0
        inverse = np.linalg.inv(mw.T @ m + loading)
        x[:, group] = inverse @ (mw.T @ y[:, group])
        variance[:, group] = np.diag(inverse)[:, None]
        residual[:, group] = y[:, group] - m @ x[:, group]
    back = np.argsort(order)
    x, variance, residual = (values[:, back].reshape(-1, n, n) for values in (x, variance, residual))
    return (pairs, x[1:], variance[1:], x[0]), residual


def solve_with_gains(samples: Samples, clock: Clock) -> PairSolution:
    """Solve the pairs with the gain of each row, and reduced weights of outlier frames."""
    light = samples.light
    solution, residual = solve_pairs(samples, clock, light)
    # each step removes three quarters of the remaining bands
    for _ in range(3):
        fitted = light - residual
        # gain of a frame by the contrast, as data change the mean, with a weight of a gain of 1
        observed, known = (values - values.mean((1, 2), keepdims=True) for values in (light, fitted))
        power = (known**2).sum((1, 2), keepdims=True)
        held = 0.3 * max(float(np.median(power)), TINY)
        contrast = ((observed * known).sum((1, 2), keepdims=True) + held) / (power + held)
        light = light / np.clip(contrast, 0.5, 2.0)
        gain = (light * fitted).sum(2, keepdims=True) / np.maximum((fitted**2).sum(2, keepdims=True), TINY)
        light = light / np.clip(gain, 0.5, 2.0)
        rms = np.sqrt((residual**2).mean((1, 2)))
        # a frame of four times the median counts half
        weights = 1 / (1 + (rms / (4 * max(float(np.median(rms)), TINY))) ** 4)
        solution, residual = solve_pairs(samples, clock, light, weights)
    return solution


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


def header_pairs(change: Floats, paired: bool) -> Floats:
    """Return the pairs that begin at each solved pair, or at each solved pattern but the last."""
    return change if paired else (change[:-1] - change[1:]) / 2


def find_headers(change: Floats, pairs: int, step: int = 1) -> list[ScreenHeader]:
    """Find headers of a number of pairs, the best first; a header takes every step-th pair."""
    n = change.shape[-1]
    cells = _header_cells(change / np.maximum(np.linalg.norm(change, axis=(1, 2), keepdims=True), TINY)) * n
    known = all_header_cells()
    headers: list[ScreenHeader] = []
    for orientation in ORIENTATIONS:
        turned = np.stack([orientation.turned(header) for header in known]) / CELLS
        # correlation over all cells, (pairs, identities)
        match = np.einsum("pij,kij->pk", cells, turned) / CELLS
        # the weakest pair of a header counts; a format dims the later pairs
        weakest = match[: max(len(match) - (pairs - 1) * step, 0)].copy()
        for later in range(step, pairs * step, step):
            weakest = np.minimum(weakest, match[later : later + len(weakest)] / 0.9)
        headers += [
            ScreenHeader(int(p), int(k), orientation, float(weakest[p, k]))
            for p, k in np.argwhere(weakest > PARAMETERS.min_correlation)
        ]
    return sorted(headers, key=lambda header: -header.score)


def read_format(header: ScreenHeader, change: Floats, pairs: int, step: int = 1) -> int:
    """Return the number of the format of a header, 0 to 2047."""
    if pairs < 2:
        return 0
    read = change[header.place : header.place + pairs * step : step]
    upright = np.stack([header.orientation.upright(pair) for pair in read])
    cells = _header_cells(upright).reshape(pairs, -1)
    # a dimmed cell has half the contrast of the first pair
    expected = np.where(words(ALL_MODES), DIMMED, 1.0) * cells[0]
    return int(np.argmin(((expected - cells[1:].mean(0)) ** 2).sum(1)))


def _header_cells(change: Floats) -> Floats:
    """Average pairs over the cells of headers, (pairs, CELLS, CELLS)."""
    size = change.shape[-1] // CELLS
    return change.reshape(-1, CELLS, size, CELLS, size).mean((2, 4))


class PacketAssembler:
    """Assembles and decodes packets from samples."""

    def __init__(
        self, signal: SignalSettings, settings: ReceiveSettings, frame_s: float, shape: Shape, budget: SearchBudget
    ):
        self._signal, self._calibration, self._budget = signal, settings.calibration, budget
        self._options = Decoding(settings.decode.algorithm or "log-map", settings.decode.iterations)
        self._buffer = SampleBuffer(shape, frame_s, signal.pattern_period_s, settings.screen, budget)
        self.clock: Clock | None = None
        # start and header of the packet in progress; the last header if not visible
        self.start_s: float | None = None
        self.header: ScreenHeader | None = None
        self._form = AGREED
        self._searched_s = -np.inf
        self._without_header = 0  # packets

    def push(self, sample: Sample) -> Iterator[tuple[Packet, Floats]]:
        """Add the sample of the next frame; yield the completed packets with the changes of the data pairs."""
        self._buffer.add(sample)
        if self.clock is None:
            self.clock = self._buffer.find_clock()
        yield from self._decode_complete(sample.time_s)

    def finish(self) -> Iterator[tuple[Packet, Floats]]:
        """Yield the packet in progress if most of the packet was visible."""
        if self.clock is None:
            self.clock = self._buffer.find_clock(final=True)
        yield from self._decode_complete(self._buffer.last.time_s, final=True)

    def pair_times_s(self, pair: int) -> tuple[float, float] | None:
        """Return the best frame times for the patterns of a data pair of the packet in progress; None without."""
        if self.clock is None or self.start_s is None or pair >= self._data_pairs:
            return None
        late_s = self.clock.exposure_s / 2 + self.clock.row_s * float(self._buffer.rows(self._buffer.last).mean())
        first = self.start_s + 2 * (self._signal.header_pairs + pair) * self.clock.period_s - late_s
        return first + 0.5 * self.clock.period_s, first + 1.5 * self.clock.period_s

    @property
    def _data_pairs(self) -> int:
        """Number of data pairs of the packet in progress."""
        return SHORT_PAIRS if self._form.mode == "short" else self._signal.data_pairs

    def _decode_complete(self, now_s: float, final: bool = False) -> Iterator[tuple[Packet, Floats]]:
        """Yield the packets completed by a time."""
        while (clock := self.clock) is not None:
            late_s = clock.row_s * self._buffer.height + clock.exposure_s + 2 * clock.response_s
            if self.start_s is None:
                if not self._find_header(clock, now_s - late_s, final):
                    return
                continue
            end_s = self.start_s + 2 * (self._signal.header_pairs + self._data_pairs) * clock.period_s
            is_complete = now_s >= end_s + late_s
            if not (is_complete or final) or now_s - self.start_s < MIN_PAIRS_SEEN * (end_s - self.start_s):
                return
            yield from self._decode_next(clock, self.start_s, end_s)
            if not is_complete:
                return

    def _find_header(self, clock: Clock, now_s: float, final: bool) -> bool:
        """Search for a header among the complete pairs; return True if found."""
        step = 2 * clock.period_s
        if now_s < self._searched_s + 2 * step and not final:
            return False
        first_s = max(self._buffer.first.time_s, self._searched_s - 4 * step)
        if now_s - first_s < 3 * step:
            return False
        self._searched_s = now_s
        samples = self._samples(first_s, now_s + step, self._budget)
        if samples is None:
            return False
        left, clock = samples.refine(clock)
        if left > PARAMETERS.max_unexplained and len(samples.times_s) >= PARAMETERS.min_frames:
            # wrong clock: half the period explains a single header too
            self.clock = None
            return False
        (pairs, change, _, _), _ = solve_pairs(samples, clock, samples.light)
        change = header_pairs(change, clock.paired)
        # a small part of the first pair may be cut off
        starts = np.array([clock.start_of(pair) for pair in pairs])[: len(change)]
        complete = np.flatnonzero((starts >= first_s - 0.45 * step) & (starts + step <= now_s))
        headers = find_headers(change[complete], self._signal.header_pairs, 2 - clock.paired)
        if not headers:
            # the next search starts here
            self._buffer.drop_before(now_s - 4 * step)
            return False
        good = [header for header in headers if header.score > headers[0].score - 0.1]
        best = min(good, key=lambda header: (header.place, -header.score))
        self.start_s = float(starts[complete[best.place]])
        self._set_header(best, change[complete], clock.paired)
        self.clock = replace(clock, start_s=self.start_s, paired=self._form.mode != "single")
        return True

    def _samples(self, start_s: float, end_s: float, budget: SearchBudget) -> Samples | None:
        """Return the light between two times; None for too few samples."""
        is_enough = len(self._buffer.between(start_s, end_s)) >= PARAMETERS.min_frames // 2
        return self._buffer.light_between(start_s, end_s, budget) if is_enough else None

    def _set_header(self, header: ScreenHeader, change: Floats, paired: bool) -> None:
        """Set the header of the packet in progress, with the format."""
        self.header, self._without_header = header, 0
        self._form = known_format(read_format(header, change, self._signal.header_pairs, 2 - paired), SHORT_PAIRS)

    def _decode_next(self, start: Clock, start_s: float, end_s: float) -> Iterator[tuple[Packet, Floats]]:
        """Decode the packet between two times."""
        around_s, self.start_s = 2 * start.period_s, None
        # packets are decoded at any cost
        samples = self._samples(start_s - around_s, end_s + around_s, SearchBudget())
        if samples is None:
            return
        _, clock = samples.refine(start)
        solution, first = solve_with_gains(samples, clock), round(clock.pair_at(start_s))
        numbers, change, _, _ = solution
        headers = self._packet_headers(header_pairs(change, clock.paired), first - numbers[0], clock.paired)
        if not headers:
            return
        if clock.paired and self._form.mode == "single":
            yield from self._decode_next(replace(start, paired=False), start_s, end_s)
            return
        packets = [self._decode(header, solution, clock) for header in headers]
        packet, upright, self.header = max(packets, key=lambda decoded: sum(ok_flags(decoded[0].layers)))
        self.start_s = clock.start_of(first + (self._signal.header_pairs + self._data_pairs) * (2 - clock.paired))
        self.clock = replace(clock, start_s=self.start_s, paired=self._form.mode != "single")
        yield packet, upright
        self._buffer.drop_before(self.start_s - 8 * clock.period_s)

    def _packet_headers(self, change: Floats, place: int, paired: bool) -> list[ScreenHeader]:
        """Return the possible headers of the packet at a place; empty after too many packets without a header."""
        if place < 0:
            return []  # the start was not visible
        pairs, step = self._signal.header_pairs, 2 - paired
        found = find_headers(change[place : place + (pairs - 1) * step + 1], pairs, step)
        headers = [replace(header, place=place) for header in found]
        if headers:
            self._set_header(headers[0], change, paired)
            return [header for header in headers if header.score > headers[0].score - 0.03]
        self._without_header += 1
        if self.header is None or self._without_header > 1:
            return []
        return [replace(self.header, place=place, score=0.0)]

    def _decode(
        self, header: ScreenHeader, solution: PairSolution, clock: Clock
    ) -> tuple[Packet, Floats, ScreenHeader]:
        """Decode a packet by a header; return the packet, the upright changes of the data pairs and the header."""
        (numbers, solved, variances, light), pairs, n = solution, self._data_pairs, self._signal.side
        step, single = 2 - clock.paired, self._form.mode == "single"
        first, last = (header.place + (self._signal.header_pairs + pair) * step for pair in (0, pairs))
        # patterns of the single mode, or pairs
        solved, each = (solved, 1) if single else (header_pairs(solved, clock.paired), step)
        visible = solved[first:last:each] / np.maximum(light, 0.05)
        change = np.zeros(((last - first) // each, n, n))
        seen = np.zeros(len(change), bool)
        change[: len(visible)] = [header.orientation.upright(pair) for pair in visible]
        # a pair without frames has a large variance
        variance = variances[first : first + each * len(visible) : each].mean((1, 2))
        seen[: len(visible)] = variance < 10 * float(np.median(variances))
        reason, layers = "", dict[str, tuple[Codeword, ...]]()
        try:
            form = PacketFormat(replace(self._signal, data_pairs=pairs), self._form)
            layers = decode_packet(change, seen, form, header.identity, self._options)
        except SettingsError as error:
            reason = str(error)
        start_s, end_s = (clock.start_of(numbers[0] + place) for place in (header.place, last))
        samples = self._buffer.between(start_s, end_s) or [self._buffer.last]
        pose, pairs_seen = samples[0].place.pose(n), float(seen.mean())
        packet = Packet(
            identity=header.identity,
            status=packet_status(layers, header.score, pairs_seen),
            start_time_s=start_s,
            first_frame=samples[0].index,
            last_frame=samples[-1].index,
            pose=pose,
            distance_m=self._calibration.distance_m(pose),
            header_score=header.score,
            track_score=float(np.clip(1 - samples[0].misfit ** 2, 0, 1)),
            pairs_seen=pairs_seen,
            layers=layers,
            format=self._form,
            orientation=header.orientation,
            reason=reason,
        )
        return packet, change, header
