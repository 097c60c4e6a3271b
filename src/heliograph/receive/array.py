"""One array: frames are paired, the array is tracked through the pairs, and packets are recorded and decoded."""

import logging
import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.receive.decode.header_reader import HeaderReader, data_late_s
from heliograph.receive.decode.worker import ArrayKey, PacketDecoder, PacketObservations, PendingPacket, wait_for
from heliograph.receive.detect.candidate import are_disjoint
from heliograph.receive.detect.detection import Detection
from heliograph.receive.equalise.led_gains import update_brightness
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import Observer, TrackEvent
from heliograph.receive.geometry.pose import Pose, rim_distance
from heliograph.receive.geometry.view import CAMERA, View
from heliograph.receive.packet import MIN_HEADER_SCORE, MIN_PAIRS_SEEN, Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.pairing import DuePair, FramePair, MeasuredHeader, Pairing
from heliograph.receive.track.spatial import fit_with_all_errors, spatial_poses
from heliograph.receive.track.track import TrackedPair, check_pose
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

LOG = logging.getLogger(__name__)


class ArrayReceiver:
    """Tracks an array from the detection on and observes the packets."""

    def __init__(
        self,
        detection: Detection,
        pairing: Pairing,
        tracker: Tracker,
        headers: HeaderReader,
        make_packet: Callable[[], PacketObservations],
        submit: Callable[..., Future[Any]],
        decoder: PacketDecoder,
        key: ArrayKey,
        *,
        signal: SignalSettings,
        settings: ReceiveSettings,
        observe: Observer,
        view: View = CAMERA,
    ):
        self.detection, self._view = detection, view
        # number of the array, 0 to 29, and orientation in which the header was read
        self.identity, self.orientation = detection.identity, view.orientation
        self._pairing, self._tracker, self._headers, self._make_packet = pairing, tracker, headers, make_packet
        self._submit, self._decoder, self._key = submit, decoder, key
        self._signal, self._calibration, self._observe = signal, settings.calibration, observe
        self._coast_s = settings.track.coast_patterns * signal.pattern_period_s
        # pairs of a packet, with the header
        self._pairs = signal.packet_patterns // 2
        self._track = tracker.start(detection)
        self._number, self._last_s = 0, -math.inf
        self._header = header_levels(detection.identity, signal.side) / 2.0 - 1.0
        self._start_lost = 0
        # True if a codeword was decoded: identity and orientation are right
        self.has_codeword = False
        # True if the last packet was decoded; None before the first
        self._decoded: bool | None = None
        self._failed = self._outgrown = self._over = False
        # the last packet, while the state after it is pending
        self._pending: PendingPacket | None = None
        self._start_packet()

    def _start_packet(self) -> None:
        """Begin the next packet."""
        self._packet = self._make_packet()
        # numbers of the frames, pairs in which the array was tracked, and the score of each header pair
        self._frames, self._tracked, self._scores = list[int](), list[TrackedPair](), list[float]()
        # True for pairs of data in which the array was visible, and if the light's clock measured the header
        self._seen, self._clocked = np.zeros(self._signal.data_pairs, dtype=bool), False
        self._decisions: DecisionDirectedTracker | None = None

    @property
    def pose(self) -> Pose:
        """Present pose on the sensor."""
        return self._view.pose_out(self._track.state.pose)

    @property
    def time_s(self) -> float:
        """Time of the present pose in seconds."""
        return self._track.state.time_s

    @property
    def is_confirmed(self) -> bool:
        """True if the last packet, or before the first packet a clear header or a codeword, confirms the track."""
        return self.has_codeword or self.detection.is_clear if self._decoded is None else self._decoded

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
        return time_s + self._pairing.slips.lost * period_s > end_s - period_s / 2

    def overlaps(self, detection: Detection) -> bool:
        """Return True if a detected array is at the same position."""
        return not are_disjoint(self.pose, detection.fit.pose, self._signal.side)

    def should_restart_on(self, detection: Detection) -> bool:
        """Return True if a header detected where this array is tracked is a better start."""
        start_s = detection.start_time_s + self._pairing.slips.lost * self._signal.pattern_period_s
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
        # beyond half a pitch LEDs are mistaken for neighbours
        return bool(detection.is_clear and detection.led_gains.all() and error_px > 0.5 * pose.pitch)

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
        viewed = frame if self._view == CAMERA else self._view.frame(frame, self.pose, self._signal.side)
        self._pairing.push(viewed, self._track.state.pose_at, self._is_single)
        yield from self._read_pairs()

    def flush(self, over: bool = False) -> Iterator[PendingPacket]:
        """Yield the packet in progress."""
        self._pairing.flush()
        yield from self._read_pairs()
        if self._tracked if over else self._seen.mean() >= MIN_PAIRS_SEEN:
            yield self._finish()

    def _read_pairs(self) -> Iterator[PendingPacket]:
        """Read pairs; end the track if the equations have no solution: the next header starts another."""
        try:
            while not self._failed and (due := self._next_pair()) is not None:
                yield from self._take(*due)
        except np.linalg.LinAlgError as error:
            self._failed = True
            LOG.warning("array %d is given up at %.4f s: %s", self.identity, self._pairing.now_s, error)

    def _next_pair(self) -> DuePair | None:
        return self._pairing.next_pair(self._track.state.pose_at, self._track.shining, self._is_single)

    @property
    def _is_single(self) -> bool:
        """True in the mode of data without inverses."""
        return self._headers.format.mode == "single"

    def _take(self, number: int, pair: FramePair | MeasuredHeader | None) -> Iterator[PendingPacket]:
        """Read a pair; yield the packet it completes."""
        if isinstance(pair, MeasuredHeader):
            self._clocked = True
            # in a sum the light of the panel adds to the array's
            self._track = replace(self._track, gain=pair.gain)
            self._headers.read_frames(pair, self._track.data_gain)
            return
        self._number, in_packet = number, number % self._pairs
        place = in_packet - self._signal.header_pairs
        first_gain = self._pairing.first_gain
        if in_packet == 0:
            self._start_lost = self._pairing.slips.lost
        if number == 0 and first_gain is not None:
            self._track = replace(self._track, gain=first_gain, data_gain=first_gain)
        if pair is not None:
            if place < 0:
                self._read_header(in_packet, pair)
            else:
                self._read_data(place, pair)
        if in_packet == self._pairs - 1 and self._tracked:
            yield self._finish()

    def _read_header(self, number: int, pair: FramePair) -> None:
        tracked = self._tracker.follow(self._track, pair, self._header)
        self._record_pair(pair, tracked)
        track, score = self._headers.read_pair(number, pair, tracked, self._tracker)
        check_pose(track.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._track = track
        self._scores.append(score)

    def _read_data(self, place: int, pair: FramePair) -> None:
        # a pair's sum shows all LEDs; data without inverses need decisions
        tracker: Tracker | DecisionDirectedTracker = self._tracker
        if self._is_single:
            track, late_s = self._track, (pair.late_s, data_late_s(self._signal))
            self._decisions = tracker = self._decisions or DecisionDirectedTracker(
                self._tracker, late_s, self._headers.pairs, track.data_gain, track.shining
            )
        tracked = tracker.follow(self._track, pair)
        self._record_pair(pair, tracked)
        self._track = tracked.track
        if tracked.seen:
            self._observe(self._packet.add_pair(place, pair, tracked))
            self._seen[place] = True

    def _record_pair(self, pair: FramePair, tracked: TrackedPair) -> None:
        """Record and report a pair; raise `LinAlgError` if the pose is impossible."""
        check_pose(tracked.state.pose, self._signal.side, pair.pattern.pixels.shape)
        self._frames += pair.pattern.index, pair.inverted.index
        self._tracked.append(tracked)
        self._observe(TrackEvent(self.identity, pair.pattern.index, tracked, self._view))

    def _finish(self) -> PendingPacket:
        """Have the packet decoded, and begin the next one."""
        self._apply_pending_state()
        packet, observations = self._undecoded_packet(), self._packet
        observations.end(self._headers, self._track, self._decisions)
        # the next header starts a track in a suitable view
        self._outgrown = not self._view.suits(self._track.state.pose)
        # about half a pattern out of step no pair of a header alternates
        has_header = packet.header_score >= MIN_HEADER_SCORE or (self._clocked and not self._scores)
        # the next header may come in the place of the last pair
        lacks_pair = self._pairing.slips.shows_header(self._number) and self._number % self._pairs == self._pairs - 1
        is_certain = has_header and not lacks_pair and self._is_certain(packet, observations)
        decoded = self._submit(self._decoder.decode, observations, self._key, lacks_pair)
        learnt = self._submit(self._decoder.learn, self._key)
        pending = PendingPacket(packet, observations, decoded, learnt, self._observe, self._pairing.exposure_range)
        if not is_certain:
            self._judge(pending.packet())
            is_certain = pending.packet().status == "ok" and not lacks_pair and self._all_visible
        # then the state is used at the end of the next packet
        self._pending = pending if is_certain else None
        self._headers.confirmed |= is_certain
        self._headers.next(None if is_certain else pending.led_gains)
        self._start_packet()
        return pending

    def _undecoded_packet(self) -> Packet:
        """Return the packet before decoding; at least one pair must be recorded."""
        # by the camera's clock
        patterns = 2 * (self._number - self._number % self._pairs) - self._start_lost
        track = self._tracked[len(self._tracked) // 2].track
        state = track.state
        pose, variance = self._view.pose_out(state.pose), state.covariance
        image = self._view.map_fit(fit_with_all_errors(track, self._signal.packet_s), inverse=True)
        return Packet(
            identity=self.identity,
            status="crc_fail",
            start_time_s=self._pairing.origin_s + patterns * self._signal.pattern_period_s,
            first_frame=self._frames[0],
            last_frame=self._frames[-1],
            pose=pose,
            distance_m=self._calibration.distance_m(pose),
            header_score=float(np.mean(self._scores or [0.0])),
            track_score=float(np.mean([tracked.fit.score for tracked in self._tracked])),
            pairs_seen=float(self._seen.mean()),
            layers={},
            orientation=self.orientation,
            pose_std_px=2**self._view.level * math.sqrt(0.5 * (variance[0, 0] + variance[1, 1])),
            compute_poses=partial(spatial_poses, state.time_s, image, self._calibration),
        )

    @property
    def _all_visible(self) -> bool:
        """True if no LED seems hidden or dark."""
        return bool(self._track.shining.all())

    def _is_certain(self, packet: Packet, observations: PacketObservations) -> bool:
        """Return True if tracking may continue without waiting for the packet to decode."""
        if packet.pairs_seen < MIN_PAIRS_SEEN or not self._all_visible:
            return False
        if self._decoded is None and not self.detection.is_certain:
            self.has_codeword |= wait_for(self._submit(observations.has_codeword))
            return self.has_codeword
        return self._decoded is not False

    def _apply_pending_state(self) -> None:
        """Use the state after the packet before, if that was decoded during this one."""
        if self._pending is not None:
            self._judge(self._pending.packet())
            self._headers.led_gains = update_brightness(self._headers.led_gains, self._pending.led_gains)
            self._pending = None

    def _judge(self, packet: Packet) -> None:
        """Update the confidence by a decoded packet."""
        # if LEDs seem to be missing, a packet decoded in part may stem from a wrong pose
        self._decoded = packet.status == "ok" or (packet.status == "partial" and self._all_visible)
        self.has_codeword |= packet.has_codeword
        # no array, or out of step: the next header starts another track
        self._failed = packet.status in ("no_header", "no_array")
