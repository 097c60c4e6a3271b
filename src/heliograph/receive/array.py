"""One array: frames are paired, the array is tracked through the pairs, and packets are recorded and decoded."""

import logging
import math
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.decode.worker import (
    ArrayKey,
    ArrayState,
    Observations,
    PacketDecoder,
    PendingPacket,
    wait_for,
)
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import Observer, TrackEvent
from heliograph.receive.geometry.pose import Orientation, Pose, rim_distance
from heliograph.receive.geometry.view import CAMERA, View
from heliograph.receive.packet import MIN_HEADER_SCORE, MIN_PAIRS_SEEN, Packet
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.sync.pairing import DuePair, FramePair, MeasuredHeader, Pairing, UnpairedFrame
from heliograph.receive.sync.slips import SlipWatch
from heliograph.receive.track.track import Track, TrackedPair, check_pose
from heliograph.receive.track.tracker import Tracker
from heliograph.receive.track.unpaired_frames import MAX_DISTANCE_PAIRS
from heliograph.signal.formats import Format
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

LOG = logging.getLogger(__name__)


class PacketReader(Protocol):
    """Reads a packet of an array."""

    @property
    def format(self) -> Format:
        """Format of the packet, as far as the header has shown."""

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> tuple[Track, float]:
        """Read a header pair.

        Parameters
        ----------
        number
            Number of the pair in the header, from 0.
        pair
            Frames of the header and its inverse.
        tracked
            The array in the frames, as their sum shows it.

        Returns
        -------
        track, score
            Track with the pose refined by the header; amplitude of the header as a fraction of the array's light.
        """

    def end_header(self, header: MeasuredHeader) -> None:
        """Read a complete header that a camera out of step recorded.

        Parameters
        ----------
        header
            The measured gain, and the frames, both combined to one pair and one by one.
        """

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Track the array through a pair of data.

        Parameters
        ----------
        pair
            Frames of a pattern and its inverse; in the single mode of two patterns.
        track
            The array before the pair.
        """

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Add a pair of data in which the array is visible.

        Parameters
        ----------
        place
            Number of the pair in the packet's data, from 0.
        pair
            Frames of a pattern and its inverse; in the single mode of two patterns.
        tracked
            The array in the frames, as `follow` returned it.
        """

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Add the remaining frame of a pair of data.

        Parameters
        ----------
        place
            Number of the pair in the packet's data, from 0.
        lone
            The remaining frame.
        """

    def observations(self) -> Observations:
        """Return the observations of the packet, ready to decode."""

    def next(self, state: ArrayState | None, confirmed: bool) -> "PacketReader":
        """Make the reader of the next packet.

        Parameters
        ----------
        state
            State of the array after this packet; None if unchanged, or if a call of `update` follows.
        confirmed
            True if the pose of the track is certain.
        """

    def update(self, state: ArrayState) -> None:
        """Use the state of the array after the packet before, which was decoded during this one.

        Parameters
        ----------
        state
            State without the evidence.
        """


class Confidence(IntEnum):
    """Evidence for the track of an array; the search detects other arrays in place of a candidate."""

    # a weak header, or the last packet was not decoded or showed that the pose is wrong
    CANDIDATE = 0
    # a clear header, before the first packet is decoded
    HEADER = 1
    # the last packet was decoded: tracking need not wait for the decoder
    CODEWORD = 2


@dataclass(slots=True)
class PacketRecord:
    """Metadata of the packet in progress."""

    # (pairs,) True for pairs of data in which the array was visible
    seen: NDArray[np.bool_]
    # Numbers of the frames
    frames: list[int] = field(default_factory=list)
    # Correlation of each pair's sum with the array, -1 to 1
    scores: list[float] = field(default_factory=list)
    # The array's pose in each pair
    poses: list[Pose] = field(default_factory=list)
    # Standard deviation of the position in each pair, in px of its view
    stds_px: list[float] = field(default_factory=list)
    # Score of each pair of the header
    header: list[float] = field(default_factory=list)
    # True if the light's clock measured the header
    clocked: bool = False

    def add_pair(self, frames: tuple[int, int], tracked: TrackedPair) -> None:
        """Record a pair."""
        self.frames += frames
        self.scores.append(tracked.fit.score)
        self.poses.append(tracked.state.pose)
        variance = tracked.state.covariance
        self.stds_px.append(math.sqrt(0.5 * (variance[0, 0] + variance[1, 1])))

    @property
    def header_score(self) -> float:
        """Amplitude of the header as a fraction of the array's light; 0 if no pair was read."""
        return float(np.mean(self.header or [0.0]))

    @property
    def has_header(self) -> bool:
        """True if the header was received."""
        # about half a pattern out of step no pair of a header alternates
        return self.header_score >= MIN_HEADER_SCORE or (self.clocked and not self.header)

    def to_packet(self, identity: int, start_time_s: float, view: View, calibration: CalibrationSettings) -> Packet:
        """Return the packet before decoding; at least one pair must be recorded."""
        pose = view.pose_out(self.poses[len(self.poses) // 2])
        return Packet(
            identity=identity,
            status="crc_fail",
            start_time_s=start_time_s,
            first_frame=self.frames[0],
            last_frame=self.frames[-1],
            pose=pose,
            distance_m=calibration.distance_m(pose),
            header_score=self.header_score,
            track_score=float(np.mean(self.scores)),
            pairs_seen=float(self.seen.mean()),
            layers={},
            orientation=view.orientation,
            pose_std_px=2**view.level * self.stds_px[len(self.stds_px) // 2],
        )


MAX_TRACK_ERROR_PITCHES = 0.5
"""Maximum distance between the rims of track and header in pitches: beyond, LEDs are mistaken for neighbours."""


class ArrayReceiver:
    """Tracks an array from the detection on and reads the packets."""

    def __init__(
        self,
        detection: Detection,
        pairing: Pairing,
        tracker: Tracker,
        reader: PacketReader,
        executor: Executor,
        decoder: PacketDecoder,
        key: ArrayKey,
        *,
        signal: SignalSettings,
        calibration: CalibrationSettings,
        coast_s: float,
        observe: Observer,
        view: View = CAMERA,
    ):
        self.detection, self._view, self._as_camera = detection, view, view == CAMERA
        self._pairing, self._tracker, self._reader = pairing, tracker, reader
        self._executor, self._decoder, self._key = executor, decoder, key
        self._signal, self._calibration, self._coast_s, self._observe = signal, calibration, coast_s, observe
        self._track = tracker.start(detection)
        self._record = self._new_record()
        self._number, self._last_s = 0, -math.inf
        self._header = header_levels(detection.identity, signal.side) / 2.0 - 1.0
        self._slips = SlipWatch(detection.identity, signal)
        self._start_lost = 0
        # True if the last packet was decoded; None before the first
        self._decoded: bool | None = None
        self._has_codeword = self._misled = self._failed = self._outgrown = self._over = False
        # the last packet, while the state after it is pending
        self._pending: PendingPacket | None = None

    @property
    def identity(self) -> int:
        """Number of the array, 0 to 29."""
        return self.detection.identity

    @property
    def orientation(self) -> Orientation:
        """Orientation in which the header was read."""
        return self._view.orientation

    @property
    def has_codeword(self) -> bool:
        """True if a codeword was decoded: identity and orientation are right."""
        return self._has_codeword

    @property
    def pose(self) -> Pose:
        """Present pose on the sensor."""
        return self._view.pose_out(self._track.state.pose)

    @property
    def time_s(self) -> float:
        """Time of the present pose in seconds."""
        return self._track.state.time_s

    @property
    def confidence(self) -> Confidence:
        """Evidence for the track: the last packet, or the header before the first packet."""
        decoded = self._decoded or (self._decoded is None and self._has_codeword)
        if decoded and not self._misled:
            return Confidence.CODEWORD
        has_header = self._decoded is None and self.detection.is_clear and not self._misled
        return Confidence.HEADER if has_header else Confidence.CANDIDATE

    @property
    def done(self) -> bool:
        """True if the array is out of sight or has outgrown the view, or clutter was tracked."""
        out_of_sight = self._pairing.now_s - self._track.last_seen_s > self._coast_s
        return self._failed or self._outgrown or self._over or self._pairing.lost or out_of_sight

    def has_outgrown_view(self, time_s: float) -> bool:
        """Return True if the array no longer fits the view and the packet has ended: the next header is due.

        The packet's last pair may still be missing while the search detects the header.
        """
        if self._view.suits(self._track.state.pose):
            return False
        period_s = self._signal.pattern_period_s
        end_s = self._pairing.origin_s + (self._number // self._pairs + 1) * self._signal.packet_s
        return time_s + self._slips.lost * period_s > end_s - period_s / 2

    def should_restart_on(self, detection: Detection) -> bool:
        """Return True if a header detected where this array is tracked is a better start."""
        start_s = detection.start_time_s + self._slips.lost * self._signal.pattern_period_s
        packets = (start_s - self._pairing.origin_s) / self._signal.packet_s
        off_s = abs(packets - round(packets)) * self._signal.packet_s
        # a header a pattern off the start of a packet is another array's
        due = detection.identity == self.identity and off_s < 0.5 * self._signal.pattern_period_s
        # the first header started this array; a later header in clear sight may show that the track went astray
        if due and round(packets) > 0:
            return self.has_outgrown_view(detection.time_s) or self._is_off_track(detection)
        return not due and detection.score > self.detection.score

    def _is_off_track(self, detection: Detection) -> bool:
        """Return True if a clear header with all LEDs in sight shows the array off the track."""
        pose = self._view.pose_out(self._track.state.pose_at(detection.time_s))
        error_px = rim_distance(pose, detection.fit.pose, self._signal.side)
        all_visible = bool((detection.led_gains == 1).all())
        return detection.is_clear and all_visible and error_px > MAX_TRACK_ERROR_PITCHES * pose.pitch

    def push(self, frame: Frame) -> Iterator[PendingPacket]:
        """Take the next frame; yield the packet it completes."""
        # no pair is due before the first header
        before_s = min(max(self._last_s, self._pairing.origin_s), self._track.last_seen_s)
        self._last_s = frame.time_s
        if self._over:
            return
        if frame.time_s - before_s > self._coast_s + self._signal.packet_s:
            # the packet has ended; times may jump by any length, so the pairs of the gap are skipped
            self._over = True
            yield from self.flush(over=True)
            return
        paired = self._reader.format.mode != "single"
        viewed = frame if self._as_camera else self._view.frame(frame, self.pose, self._signal.side)
        for kept in self._slips.push(viewed, self._pairing.origin_s, self._track.state.pose_at, paired):
            self._pairing.push(kept)
            yield from self._read_pairs()

    def flush(self, over: bool = False) -> Iterator[PendingPacket]:
        """Yield the packet in progress."""
        for frame in self._slips.flush():
            self._pairing.push(frame)
            yield from self._read_pairs()
        self._pairing.flush()
        yield from self._read_pairs()
        if self._record.poses if over else self._record.seen.mean() >= MIN_PAIRS_SEEN:
            yield self._finish()

    @property
    def _pairs(self) -> int:
        return self._signal.packet_patterns // 2

    def _read_pairs(self) -> Iterator[PendingPacket]:
        """Read pairs; end the track if the equations have no solution: the next header starts another."""
        try:
            while not self._failed and (due := self._next_pair()) is not None:
                yield from self._take(*due)
        except np.linalg.LinAlgError as error:
            self._failed = True
            LOG.warning("array %d is given up at %.4f s: %s", self.identity, self._pairing.now_s, error)

    def _next_pair(self) -> DuePair | None:
        single = self._reader.format.mode == "single"
        return self._pairing.next_pair(self._track.state.pose_at, self._track.shining, single)

    def _take(self, number: int, pair: FramePair | UnpairedFrame | MeasuredHeader | None) -> Iterator[PendingPacket]:
        """Read a pair; yield the packet it completes."""
        if isinstance(pair, MeasuredHeader):
            self._record.clocked = True
            # in a sum the light of the panel adds to the array's
            self._track = replace(self._track, gain=pair.gain)
            self._reader.end_header(pair)
            return
        self._number, in_packet = number, number % self._pairs
        place = in_packet - self._signal.header_pairs
        first_gain = self._pairing.first_gain
        if in_packet == 0:
            self._start_lost = self._slips.lost
        if number == 0 and first_gain is not None:
            self._track = replace(self._track, gain=first_gain, data_gain=first_gain)
        if isinstance(pair, UnpairedFrame):
            self._add_unpaired(place, pair)
        elif pair is not None:
            if place < 0:
                self._read_header(in_packet, pair)
            else:
                self._read_data(place, pair)
        if in_packet == self._pairs - 1 and self._record.poses:
            yield self._finish()
        elif in_packet == self._pairs - 1 and self._record.frames:
            # unpaired frames only, which show no pose
            self._record, self._reader = self._new_record(), self._reader.next(None, confirmed=False)

    def _read_header(self, number: int, pair: FramePair) -> None:
        tracked = self._tracker.follow(self._track, pair, self._header)
        self._record_pair(pair, tracked)
        track, score = self._reader.read_header(number, pair, tracked)
        check_pose(track.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._track = track
        self._record.header.append(score)

    def _read_data(self, place: int, pair: FramePair) -> None:
        # a pair's sum shows all LEDs; data without inverses need the reader's decisions
        tracked = self._reader.follow(pair, self._track)
        self._record_pair(pair, tracked)
        self._track = tracked.track
        if tracked.seen:
            self._reader.add_pair(place, pair, tracked)
            self._record.seen[place] = True

    def _add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Add the remaining frame of a pair if the array was in sight shortly before."""
        self._record.frames.append(lone.frame.index)
        if lone.frame.time_s - self._track.last_seen_s < 2 * MAX_DISTANCE_PAIRS * self._signal.pattern_period_s:
            self._reader.add_unpaired(place, lone)
            self._record.seen[place] = True

    def _record_pair(self, pair: FramePair, tracked: TrackedPair) -> None:
        """Record and report a pair; raise `LinAlgError` if the pose is impossible."""
        check_pose(tracked.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._record.add_pair((pair.pattern.index, pair.inverted.index), tracked)
        self._observe(TrackEvent(self.identity, pair.pattern.index, tracked, self._view))

    def _finish(self) -> PendingPacket:
        """Have the packet decoded, and begin the next one."""
        self._apply_pending_state()
        record, self._record = self._record, self._new_record()
        # by the camera's clock
        patterns = 2 * (self._number - self._number % self._pairs) - self._start_lost
        start_s = self._pairing.origin_s + patterns * self._signal.pattern_period_s
        packet = record.to_packet(self.identity, start_s, self._view, self._calibration)
        observations, lacks_pair = self._reader.observations(), self._lacks_pair
        # the next header starts a track in a suitable view
        self._outgrown = not self._view.suits(self._track.state.pose)
        is_certain = not lacks_pair and record.has_header and self._is_certain(packet, observations)
        decoded = self._executor.submit(self._decoder.decode, observations, self._key, lacks_pair)
        learnt = self._executor.submit(self._decoder.learn, self._key)
        pending = PendingPacket(packet, observations, decoded, learnt, self._observe, self._pairing.exposure_range)
        if not is_certain:
            self._judge(pending.packet())
            is_certain = pending.packet().status == "ok" and not lacks_pair and self._all_visible
        # otherwise the state is used at the end of the next packet
        is_needed = self._misled or not is_certain
        self._pending = None if is_needed else pending
        self._reader = self._reader.next(self._state_after(pending) if is_needed else None, is_certain)
        return pending

    @property
    def _lacks_pair(self) -> bool:
        """True if the next header came in the place of the packet's last pair."""
        return self._slips.shows_header(self._number) and self._number % self._pairs == self._pairs - 1

    @property
    def _all_visible(self) -> bool:
        """True if no LED seems hidden or dark."""
        return bool((self._track.shining == 1).all())

    def _is_certain(self, packet: Packet, observations: Observations) -> bool:
        """Return True if tracking may continue without waiting for the packet to decode."""
        if packet.pairs_seen < MIN_PAIRS_SEEN or not self._all_visible or self._misled:
            return False
        if self._decoded is None and not (self.detection.is_complete and not self.detection.is_ambiguous):
            check = self._executor.submit(self._decoder.has_codeword, observations)
            self._has_codeword |= wait_for(check)
            return self._has_codeword
        return self._decoded is not False

    def _apply_pending_state(self) -> None:
        """Use the state after the packet before, if that was decoded during this one."""
        if self._pending is not None:
            self._judge(self._pending.packet())
            state, self._pending = self._state_after(self._pending), None
            if state is not None:
                self._reader.update(state)

    def _judge(self, packet: Packet) -> None:
        """Update the confidence by a decoded packet."""
        # if LEDs seem to be missing, a packet decoded in part may stem from a wrong pose
        self._decoded = packet.status == "ok" or (packet.status == "partial" and self._all_visible)
        self._has_codeword |= packet.has_codeword
        # no array, or out of step: the next header starts another track
        self._failed = packet.status in ("no_header", "no_array")

    def _state_after(self, pending: PendingPacket) -> ArrayState | None:
        """State of the array after a packet; it may show that the tracked pose is wrong."""
        state = pending.state
        if state is not None:
            self._misled = state.misled
        return state

    def _new_record(self) -> PacketRecord:
        return PacketRecord(np.zeros(self._signal.data_pairs, dtype=bool))
