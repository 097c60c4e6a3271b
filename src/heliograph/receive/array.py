"""One array's reception: pairs in step with its header, gathered to packets."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import CLEAR, Detection, project
from heliograph.receive.packets import Codeword, Packet, Status
from heliograph.receive.pose import Pose
from heliograph.receive.reading import Reading, Setup
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.header import signalling_levels
from heliograph.signal.pwm import light_centroids

HEADER_SEEN = 0.5
"""Least alternation of a header, as a share of the array's luminance."""

RELEARN = 3
"""Most times a header pair is looked at."""


@dataclass(slots=True)
class _Gathered:
    """What has been read of the current packet."""

    reading: Reading
    seen: NDArray[np.bool_]
    frames: list[int] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    header: list[float] = field(default_factory=list)


class ArrayReceiver:
    """Follows an array from its detection on and reads its packets.

    Parameters
    ----------
    detection
        Where and when its header was found.
    setup
        What it shares with the receiver.
    reading
        Reads the data of the first packet, and tells what reads those that follow.
    """

    def __init__(self, detection: Detection, setup: Setup, reading: Reading):
        self.identity = detection.identity
        self.found = detection
        self._proven = False
        self._form, self._settings, self._observe = setup.form, setup.settings, setup.observe
        signal = setup.form.settings
        self.tracker = Tracker(detection, signal.side, self._settings.track)
        self._start_s = detection.start_time_s
        mean, _ = light_centroids(signal.slot_order)
        self._sum_late_s = (mean - 0.5) * signal.pattern_period_s
        self._held: Frame | None = None
        self._pair = 0
        self._packet = self._empty(reading)
        self._failed = False
        self._now_s = detection.time_s

    @property
    def sure(self) -> bool:
        """Whether it is an array: a codeword was right, or its header left no doubt."""
        even = self.found.regularity >= self._settings.detect.hidden_regularity
        return self._proven or (self.found.score >= CLEAR and even)

    def expects(self, detection: Detection) -> bool:
        """Whether a header is its own, where one was due."""
        packets = (detection.start_time_s - self._start_s) / self._form.settings.packet_s
        off_s = abs(packets - round(packets)) * self._form.settings.packet_s
        return detection.identity == self.identity and off_s < 0.5 * self._form.settings.pattern_period_s

    @property
    def done(self) -> bool:
        """Whether the array is out of sight, or what was followed is no array."""
        return self._failed or self._now_s - self.tracker.last_seen_s > self._settings.track.coast_s

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take a frame; yield the packet it completes."""
        self._now_s = max(self._now_s, frame.time_s)
        number = self._pattern_number(frame.time_s)
        if number < 0:
            return
        if number % 2 == 0:
            # the pair of a frame still held lacks its inverse
            yield from self._advance(number // 2)
            self._held = frame
            return
        yield from self._advance(number // 2)
        if self._held is not None and self._pattern_number(self._held.time_s) == number - 1:
            self._read(self._held, frame)
        self._held = None
        if self._pair_in_packet(number // 2) == self._pairs - 1 and self._packet.frames:
            yield self._finish()

    def flush(self) -> Iterator[Packet]:
        """Yield the packet in progress if at least half of its data was seen."""
        if self._packet.seen.mean() >= 0.5:
            yield self._finish()

    @property
    def _pairs(self) -> int:
        return self._form.settings.packet_patterns // 2

    def _pattern_number(self, time_s: float) -> int:
        return round((time_s - self._start_s) / self._form.settings.pattern_period_s)

    def _pair_in_packet(self, pair: int) -> int:
        return pair % self._pairs

    def _advance(self, pair: int) -> Iterator[Packet]:
        """Account for pairs that no frames came for; a packet may end among them."""
        end = self._pair - self._pair_in_packet(self._pair) + self._pairs
        if pair >= end and self._packet.frames:
            self._pair = end - 1
            yield self._finish()
        self._pair = pair

    def _read(self, pattern: Frame, inverted: Frame) -> None:
        """Track a pair, then read its data or its header."""
        packet, place = self._packet, self._pair_in_packet(self._pair) - self._form.settings.header_pairs
        if place < 0:
            tracked = self.tracker.follow(pattern, inverted)
        else:
            # all LEDs show in a pair's sum; of data without inverses only its reading knows what shows
            tracked = packet.reading.follow(pattern, inverted, self.tracker, self._late_s(pattern))
        packet.frames += [pattern.index, inverted.index]
        packet.scores.append(tracked.fit.score)
        packet.poses.append(tracked.state.pose)
        self._observe("track", {"identity": self.identity, "frame": pattern.index, "tracked": tracked})
        if place < 0:
            self._read_header(place + self._form.settings.header_pairs, pattern, inverted, tracked)
        elif tracked.seen:
            packet.reading.take(place, pattern, inverted, tracked, self.tracker)
            packet.seen[place] = True

    def _late_s(self, pattern: Frame) -> float:  # noqa: ARG002 - combined frames carry their own
        """By how much the light of a data pair's sum comes after the middle of the exposures."""
        return self._sum_late_s

    def _read_header(self, pair: int, pattern: Frame, inverted: Frame, tracked: TrackedPair) -> None:
        """Read what header pair `pair` names, and sharpen the pose by it."""
        packet = self._packet
        if tracked.seen:
            packet.reading.take_header(pair, pattern, inverted, self.tracker)
        # the later pairs are dimmed where a format is named
        weights = self._header_weights(packet.reading.named.number if pair else 0, pattern)
        packet.header.append(self._alternation(pattern, inverted, tracked, weights * self.tracker.shares))
        if tracked.seen:
            self._learn(pattern, inverted, weights)

    def _header_weights(self, number: int, pattern: Frame) -> NDArray[np.float64]:  # noqa: ARG002 - combined frames'
        """Levels (n, n) of a header less its inverse that names a format: +-1, or +-1/2 where it is dimmed."""
        return signalling_levels(self.identity, number, self._form.settings.side) / 2.0 - 1.0

    def _learn(self, pattern: Frame, inverted: Frame, weights: NDArray[np.float64]) -> None:
        """Let tracker and reading learn from a header pair; again while they find what changes the pose."""
        for _ in range(RELEARN):
            self.tracker.refine(pattern, inverted, weights)
            if not self._packet.reading.learn(pattern, inverted, weights, self.tracker):
                break
            self.tracker.again(pattern, inverted)

    def _alternation(
        self, pattern: Frame, inverted: Frame, tracked: TrackedPair, weights: NDArray[np.float64]
    ) -> float:
        """How much of the header the pair shows, as a share of the array's luminance."""
        pose = tracked.state.pose
        change = project(pattern, pose, weights) - project(inverted, pose, weights)
        return change / max(self.tracker.gain, 1e-6)

    def _finish(self) -> Packet:
        """Decode what was gathered and begin the next packet."""
        packet, self._packet = self._packet, self._empty(self._packet.reading.following())
        layers = packet.reading.decode()
        header = float(np.mean(packet.header)) if packet.header else 0.0
        status = _status(layers, header, float(packet.seen.mean()))
        # neither header nor a right codeword: no array, or out of step; it is found anew by its next header
        self._proven |= status in ("ok", "partial")
        self._failed = status in ("no_header", "no_array")
        result = self._packet_value(packet, status, layers, header)
        self._observe("decode", {"identity": self.identity, "packet": result, **packet.reading.shown()})
        return result

    def _packet_value(
        self, packet: _Gathered, status: Status, layers: dict[str, tuple[Codeword, ...]], header: float
    ) -> Packet:
        calibration, form = self._settings.calibration, self._form.settings
        pose = packet.poses[len(packet.poses) // 2]
        start = self._start_s + (self._pair - self._pair_in_packet(self._pair)) * 2 * form.pattern_period_s
        return Packet(
            identity=self.identity,
            status=status,
            start_time_s=start,
            first_frame=packet.frames[0],
            last_frame=packet.frames[-1],
            pose=pose,
            # pinhole: pitch_px = f p / (Z pixel)
            distance_m=calibration.focal_m * calibration.pitch_m / (pose.frontal_pitch * calibration.pixel_m),
            header_score=header,
            track_score=float(np.mean(packet.scores)),
            pairs_seen=float(packet.seen.mean()),
            layers=layers,
            named=packet.reading.named,
        )

    def _empty(self, reading: Reading) -> _Gathered:
        return _Gathered(reading, np.zeros(self._form.settings.data_pairs, dtype=bool))


def _status(layers: dict[str, tuple[Codeword, ...]], header: float, seen: float) -> Status:
    good = [word.status == "ok" for words in layers.values() for word in words]
    if any(good):
        return "ok" if all(good) else "partial"
    if seen < 0.5:
        return "no_array"
    return "crc_fail" if header >= HEADER_SEEN else "no_header"
