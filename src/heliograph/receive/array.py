"""What an array's pairs give of a packet beside its data: when and where it was seen, and how well.

One array's receiver: its frames paired, followed, and gathered to packets.
"""

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.decode.worker import (
    ENOUGH_SEEN,
    HEADER_SEEN,
    Decoders,
    Lesson,
    PendingPacket,
    ReadHeader,
    SharedLesson,
    Study,
    UndecodedPacket,
    Work,
    glanced,
)
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import Observer, TrackEvent
from heliograph.receive.geometry.pose import Orientation, Pose, rim_distance
from heliograph.receive.geometry.view import CAMERA, View
from heliograph.receive.packet import Packet
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.sync.light_clock import PATTERNS_AROUND
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, Pairing, PoseAt, UnpairedFrame
from heliograph.receive.sync.slips import SlipWatch
from heliograph.receive.track.track import Track, TrackedPair, check_pose
from heliograph.receive.track.tracker import Tracker
from heliograph.receive.track.unpaired_frames import MAX_DISTANCE_PAIRS
from heliograph.signal.formats import Format
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings


class PacketReader(Protocol):
    """Reads one packet of an array."""

    @property
    def format(self) -> Format:
        """The packet's format, as far as its header has shown it."""

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> ReadHeader:
        """Read a header pair.

        Parameters
        ----------
        number
            Its number in the header, from 0.
        pair
            Frames of the header and its inverse.
        tracked
            The array in them, as their sum shows it.
        """

    def end_header(self, header: MeasuredHeader) -> None:
        """Take a whole header that a camera out of step saw.

        Parameters
        ----------
        header
            The gain it showed, its frames combined to one pair, and the frames one by one.
        """

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Find the array in a pair of data.

        Parameters
        ----------
        pair
            Frames of a pattern and its inverse; in the single mode of two patterns.
        track
            The array as known before the pair.
        """

    def take(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Take a pair of data in which the array was seen.

        Parameters
        ----------
        place
            Its number in the packet's data, from 0.
        pair
            Frames of a pattern and its inverse; in the single mode of two patterns.
        tracked
            The array in them, as `follow` found it.
        """

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Take what is left of a pair of data.

        Parameters
        ----------
        place
            Its number in the packet's data, from 0.
        lone
            The frame that is there.
        """

    def taken(self) -> UndecodedPacket:
        """All that was taken, to be decoded."""

    def learn(self, lesson: Any) -> None:
        """Learn what decoding this packet has taught, before `next` is asked for; else the next one's `catch_up` is.

        Parameters
        ----------
        lesson
            `Lesson.told` of what `Decoded.study` of this packet has given; None for nothing.
        """

    def next(self, beyond_doubt: bool) -> "PacketReader":
        """Give the reader of the next packet.

        Parameters
        ----------
        beyond_doubt
            Whether the array is there beyond doubt: this is then asked for before it is known what the packet teaches.
        """

    def catch_up(self, lesson: Any) -> None:
        """Learn what the packet before has taught, which was decoded while this one was seen.

        Parameters
        ----------
        lesson
            `Lesson.told` of what `Decoded.study` of the packet before has given; None for nothing.
        """


@dataclass(slots=True)
class PacketRecord:
    """What has been read of the current packet."""

    # (pairs,) pairs of data in which the array was seen
    seen: NDArray[np.bool_]
    # Numbers of its frames
    frames: list[int] = field(default_factory=list)
    # Correlation of each pair's sum with the array, -1 to 1
    scores: list[float] = field(default_factory=list)
    # The array's pose in each pair
    poses: list[Pose] = field(default_factory=list)
    # Standard deviation of the position in each pair, in px of its view
    stds_px: list[float] = field(default_factory=list)
    # Score of each pair of its header
    header: list[float] = field(default_factory=list)
    # Whether the light's clock measured its header
    clocked: bool = False

    @classmethod
    def nothing(cls, pairs: int) -> "PacketRecord":
        """Nothing yet."""
        return cls(np.zeros(pairs, dtype=bool))

    def note(self, frames: tuple[int, int], tracked: TrackedPair) -> None:
        """Gather what every pair gives."""
        self.frames += frames
        self.scores.append(tracked.fit.score)
        self.poses.append(tracked.state.pose)
        variance = tracked.state.covariance
        self.stds_px.append(math.sqrt(0.5 * (variance[0, 0] + variance[1, 1])))

    @property
    def header_score(self) -> float:
        """Amplitude of the header as a fraction of the array's light; 0 where no pair of it was read."""
        return float(np.mean(self.header or [0.0]))

    @property
    def header_seen(self) -> bool:
        """Whether the header was seen."""
        # about half a pattern out of step none of its pairs alternates
        return self.header_score >= HEADER_SEEN or (self.clocked and not self.header)

    def packet(self, identity: int, start_time_s: float, view: View, calibration: CalibrationSettings) -> Packet:
        """The packet gathered, without its codewords; a pair of it must have been seen."""
        pose = view.pose_out(self.poses[len(self.poses) // 2])
        return Packet(
            identity=identity,
            status="crc_fail",
            start_time_s=start_time_s,
            first_frame=self.frames[0],
            last_frame=self.frames[-1],
            pose=pose,
            # pinhole: pitch_px = f p / (Z pixel)
            distance_m=calibration.focal_m * calibration.pitch_m / (pose.frontal_pitch * calibration.pixel_m),
            header_score=self.header_score,
            track_score=float(np.mean(self.scores)),
            pairs_seen=float(self.seen.mean()),
            layers={},
            orientation=view.orientation,
            pose_std_px=2**view.level * self.stds_px[len(self.stds_px) // 2],
        )


LOG = logging.getLogger(__name__)

ASTRAY = 0.5
"""Pitches by which the rim of an array that is followed may lie off its header: beyond it LEDs are taken for others."""

DUE_PATTERNS = 0.5
"""Patterns by which a header may lie off the start of a packet and still be its own: a pattern off, it is another."""


class ArrayReceiver:
    """Follows an array from its detection on and reads its packets."""

    def __init__(
        self,
        detection: Detection,
        pairing: Pairing,
        tracker: Tracker,
        reader: PacketReader,
        decoders: Decoders,
        *,
        signal: SignalSettings,
        calibration: CalibrationSettings,
        coast_s: float,
        observe: Observer,
        view: View = CAMERA,
    ):
        self.found, self._view, self._as_camera = detection, view, view == CAMERA
        self._pairing, self._tracker, self._reader, self._decoders = pairing, tracker, reader, decoders
        self._signal, self._calibration, self._coast_s, self._observe = signal, calibration, coast_s, observe
        self._track = tracker.start(detection)
        self._gathered = self._empty()
        self._number, self._last_s = 0, -math.inf
        self._header = header_levels(detection.identity, signal.side) / 2.0 - 1.0
        self._slips = SlipWatch(detection.identity, signal)
        self._start_lost = 0
        self._poses: dict[int, PoseAt] = {}
        self._read: bool | None = None
        self._beside: PendingPacket | None = None
        self._taught = SharedLesson()
        self._proven = self._misled = self._failed = self._outgrown = self._over = False

    @property
    def identity(self) -> int:
        """Number of the array."""
        return self.found.identity

    @property
    def orientation(self) -> Orientation:
        """How the camera sees it, as its header was taken."""
        return self._view.orientation

    @property
    def proven(self) -> bool:
        """Whether a codeword was right."""
        return self._proven

    @property
    def pose(self) -> Pose:
        """Its pose now, on the sensor."""
        return self._view.pose_out(self._track.state.pose)

    @property
    def time_s(self) -> float:
        """Time of that pose in seconds."""
        return self._track.state.time_s

    @property
    def sure(self) -> bool:
        """Whether it is followed rightly: by the last packet, or before that is known by its header or a codeword."""
        read = self.found.is_clear or self._proven if self._read is None else self._read
        return read and not self._misled

    @property
    def done(self) -> bool:
        """Whether the array is out of sight or another size than its view is for, or what was followed is no array."""
        out_of_sight = self._pairing.now_s - self._track.last_seen_s > self._coast_s
        return self._failed or self._outgrown or self._over or self._pairing.lost or out_of_sight

    def leaves(self, time_s: float) -> bool:
        """Whether the array has another size than its view is for, and its packet is over: its next header is awaited.

        Its last pair may still be waited for, while the search finds that header.
        """
        if self._view.suits(self._track.state.pose):
            return False
        period_s = self._signal.pattern_period_s
        end_s = self._pairing.origin_s + (self._number // self._pairs + 1) * self._signal.packet_s
        return time_s + self._slips.lost * period_s > end_s - period_s / 2

    def yields(self, detection: Detection) -> bool:
        """Whether a header that was found where this array is followed is a better start than its own."""
        start_s = detection.start_time_s + self._slips.lost * self._signal.pattern_period_s
        packets = (start_s - self._pairing.origin_s) / self._signal.packet_s
        off_s = abs(packets - round(packets)) * self._signal.packet_s
        due = detection.identity == self.identity and off_s < DUE_PATTERNS * self._signal.pattern_period_s
        # its first header was weighed already; a later one in clear sight may show that the track went astray
        later = due and round(packets) > 0
        if later:
            return self.leaves(detection.time_s) or self._astray(detection)
        return not due and detection.score > self.found.score

    def _astray(self, detection: Detection) -> bool:
        """Whether a header that is whole and leaves no doubt shows the array elsewhere than it is followed."""
        there = self._view.pose_out(self._track.state.pose_at(detection.time_s))
        off = rim_distance(there, detection.fit.pose, self._signal.side)
        return detection.is_clear and bool((detection.led_gains == 1).all()) and off > ASTRAY * there.pitch

    def push(self, frame: Frame) -> Iterator[PendingPacket]:
        """Take the next frame; yield the packet it completes."""
        # no pair is due before the first header
        before_s = min(max(self._last_s, self._pairing.origin_s), self._track.last_seen_s)
        self._last_s = frame.time_s
        if self._over:
            return
        if frame.time_s - before_s > self._coast_s + self._signal.packet_s:
            # the packet in progress is over; times may jump by any length, so the pairs of the gap are skipped
            self._over = True
            yield from self.flush(over=True)
            return
        paired = self._reader.format.mode != "single"
        seen = frame if self._as_camera else self._view.frame(frame, self.pose, self._signal.side)
        for one in self._slips.push(seen, self._pairing.origin_s, self._pose_at, paired):
            yield from self._take_all(self._pairing.push(one))

    def flush(self, over: bool = False) -> Iterator[PendingPacket]:
        """Yield the packet in progress."""
        for one in self._slips.flush():
            yield from self._take_all(self._pairing.push(one))
        yield from self._take_all(self._pairing.flush())
        if self._gathered.poses if over else self._gathered.seen.mean() >= ENOUGH_SEEN:
            yield self._finish()

    def _pose_at(self, time_s: float) -> Pose:
        return self._track.state.pose_at(time_s)

    @property
    def _pairs(self) -> int:
        return self._signal.packet_patterns // 2

    def _take_all(self, numbers: Iterator[int]) -> Iterator[PendingPacket]:
        """Read pairs; an array whose pixels give no solution is given up, and found again by its next header."""
        try:
            for number in () if self._failed else numbers:
                yield from self._take(number)
        except np.linalg.LinAlgError as error:
            self._failed = True
            LOG.warning("array %d is given up at %.4f s: %s", self.identity, self._pairing.now_s, error)

    def _take(self, number: int) -> Iterator[PendingPacket]:
        """Read a pair; yield the packet it completes."""
        self._number, in_packet = number, number % self._pairs
        place = in_packet - self._signal.header_pairs
        first_gain = self._pairing.first_gain
        if in_packet == 0:
            self._start_lost = self._slips.lost
        if number == 0 and first_gain is not None:
            self._track = replace(self._track, gain=first_gain, data_gain=first_gain)
        if place == 0:
            self._end_header()
        single = place >= 0 and self._reader.format.mode == "single"
        pair = self._pairing.get_pair(number, self._track.state.pose_at, single)
        if isinstance(pair, UnpairedFrame):
            self._read_lone(place, pair)
        elif pair is not None:
            if place < 0:
                self._read_header(in_packet, pair)
            else:
                self._read_data(place, pair)
            self._poses[number] = self._track.state.pose_at
        # the light's clock asks for those around a header
        oldest = number + 1 - self._signal.header_pairs - PATTERNS_AROUND
        # pairs come in the order of their numbers
        while self._poses and (first := next(iter(self._poses))) < oldest:
            del self._poses[first]
        if in_packet == self._pairs - 1 and self._gathered.poses:
            yield self._finish()
        elif in_packet == self._pairs - 1 and self._gathered.frames:
            # single frames of its pairs, but none that shows where the array is
            self._gathered, self._reader = self._empty(), self._reader.next(beyond_doubt=False)

    def _end_header(self) -> None:
        """Correct the clock by the header just over; out of step it is read as a whole."""
        pose_at, led_gains = self._track.state.pose_at, self._track.shining
        header = self._pairing.measure_header(self._number, self._poses, pose_at, led_gains)
        if header is None:
            return
        self._gathered.clocked = True
        # a sum hardly tells the array's light from that of its panel
        self._track = replace(self._track, gain=header.gain)
        self._reader.end_header(header)

    def _read_header(self, number: int, pair: FramePair) -> None:
        tracked = self._tracker.follow(self._track, pair, self._header)
        self._note(pair, tracked)
        read = self._reader.read_header(number, pair, tracked)
        check_pose(read.track.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._track = read.track
        self._gathered.header.append(read.score)

    def _read_data(self, place: int, pair: FramePair) -> None:
        # all LEDs show in a pair's sum; only the reader knows what shows in data without inverses
        tracked = self._reader.follow(pair, self._track)
        self._note(pair, tracked)
        self._track = tracked.track
        if tracked.seen:
            self._reader.take(place, pair, tracked)
            self._gathered.seen[place] = True

    def _read_lone(self, place: int, lone: UnpairedFrame) -> None:
        """Keep the frame that is left of a pair where the array was in sight not long before."""
        self._gathered.frames.append(lone.frame.index)
        if lone.frame.time_s - self._track.last_seen_s < 2 * MAX_DISTANCE_PAIRS * self._signal.pattern_period_s:
            self._reader.add_unpaired(place, lone)
            self._gathered.seen[place] = True

    def _note(self, pair: FramePair, tracked: TrackedPair) -> None:
        """Gather what every pair of a packet gives; one whose pose is none of an array gives the array up."""
        check_pose(tracked.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._gathered.note((pair.pattern.index, pair.inverted.index), tracked)
        self._observe(TrackEvent(self.identity, pair.pattern.index, tracked, self._view))

    def _finish(self) -> PendingPacket:
        """Have decoded what was gathered, and begin the next packet."""
        self._take_over()
        gathered, self._gathered = self._gathered, self._empty()
        # by the camera's clock
        patterns = 2 * (self._number - self._number % self._pairs) - self._start_lost
        start_s = self._pairing.origin_s + patterns * self._signal.pattern_period_s
        seen = gathered.packet(self.identity, start_s, self._view, self._calibration)
        taken, lacks_pair = self._reader.taken(), self._lacks_pair
        # its next header finds it again, in a view that suits
        self._outgrown = not self._view.suits(self._track.state.pose)
        beyond_doubt = not lacks_pair and gathered.header_seen and self._expected(seen, taken)
        coming = self._coming(seen, taken, lacks_pair)
        if not beyond_doubt:
            self._conclude(coming)
        there = beyond_doubt or (coming.packet().status == "ok" and not lacks_pair and self._in_sight)
        if there and not self._misled:
            # nothing more of it is asked before the next packet's end
            self._beside = coming
        else:
            self._reader.learn(self._lesson(coming))
        self._reader = self._reader.next(there)
        return coming

    @property
    def _lacks_pair(self) -> bool:
        """Whether the next header shows where the packet's last pair should be."""
        return self._slips.shows_header(self._number) and self._number % self._pairs == self._pairs - 1

    @property
    def _in_sight(self) -> bool:
        """Whether no LED seems hidden or dark."""
        return bool((self._track.shining == 1).all())

    def _expected(self, seen: Packet, taken: UndecodedPacket) -> bool:
        """Whether an array is followed on, whatever comes of decoding its packet: that it is there, is beyond doubt."""
        if seen.pairs_seen < ENOUGH_SEEN or not self._in_sight or self._misled:
            return False
        if self._read is not None:
            return self._proven and self._read
        if self.found.is_complete and not self.found.is_ambiguous:
            return True
        self._proven |= glanced(self._decoders, taken)
        return self._proven

    def _coming(self, seen: Packet, taken: UndecodedPacket, lacks_pair: bool) -> PendingPacket:
        work = self._decoders.submit(Work(taken, self.identity, self._signal, lacks_pair, self._taught))
        lesson = self._decoders.submit(Study(self._taught))
        return PendingPacket(seen, taken, work, lesson, self._observe, self._pairing.exposure_range)

    def _take_over(self) -> None:
        """Take over what the packet before has taught, if it was decoded while this one was seen."""
        if self._beside is not None:
            self._conclude(self._beside)
            self._reader.catch_up(self._lesson(self._beside))
            self._beside = None

    def _conclude(self, coming: PendingPacket) -> None:
        """Know from a packet how the array is followed."""
        packet = coming.packet()
        # neither header nor a right codeword: no array, or out of step; it is found again by its next header
        # where LEDs seem to be missing, a packet read in part may have come from a wrong pose
        self._read = packet.status == "ok" or (packet.status == "partial" and self._in_sight)
        self._proven |= packet.status in ("ok", "partial")
        self._failed = packet.status in ("no_header", "no_array")

    def _lesson(self, coming: PendingPacket) -> Lesson | None:
        """What a packet teaches; it may be that the array is not quite as it is followed."""
        lesson = coming.lesson
        if lesson is not None:
            self._misled = lesson.misled
        return lesson

    def _empty(self) -> PacketRecord:
        return PacketRecord.nothing(self._signal.data_pairs)
