"""Receiver: detects arrays in a stream of frames, and hands each frame to all tracked arrays.

A header may fit two identities and orientations. The more plausible hypothesis gets the frames first; if the first
packet decodes no codeword, the other one gets the same frames.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from heliograph.base.frames import Frame
from heliograph.base.threads import in_one_thread
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.decode.worker import PendingPacket
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import HeaderSearch
from heliograph.receive.events import DetectEvent, DropEvent, LostEvent, MissedStartEvent, Observer
from heliograph.receive.geometry.pose import UPRIGHT, Orientation
from heliograph.receive.packet import Packet
from heliograph.receive.sync.frame_clock import FrameClock, check_next, owned


class HeaderHypotheses:
    """Tracks of an array, a track for each hypothesis of identity and orientation, until a codeword decodes."""

    def __init__(self, receivers: Sequence[ArrayReceiver], settled: bool):
        self._receivers, self._settled = list(receivers), settled
        self._first, self._only_first = self._receivers[0], len(self._receivers) > 1
        # frames that the others have not had
        self._held = list[Frame]()

    @property
    def leading(self) -> ArrayReceiver:
        """Most plausible receiver; once a codeword is decoded, the only one."""
        return self._receivers[0]

    @property
    def is_credible(self) -> bool:
        """True if packets without a codeword count: turned arrays are rare, clutter is not."""
        return self._settled or self.leading.has_codeword or self.leading.orientation == UPRIGHT

    @property
    def done(self) -> bool:
        """True if no receiver tracks the array any more."""
        return not self._receivers or self.leading.done

    def push(self, frame: Frame) -> Iterator[PendingPacket]:
        """Take the next frame; yield the packet it completes."""
        packets_of, wait = list[tuple[ArrayReceiver, list[PendingPacket]]](), False
        for receiver in self._receivers:
            packets = [*self._catch_up(receiver), *receiver.push(frame)]
            packets_of.append((receiver, packets))
            # 244 frames of 1024 x 512; beyond, the others read along
            has_room = len(self._held) * frame.pixels.nbytes < 128e6
            wait = self._only_first and receiver is self._first and not packets and has_room
            # after a codeword the other hypotheses are wrong and need no decoding
            if wait or receiver.has_codeword:
                break
        if wait:
            self._held.append(frame)
        else:
            self._only_first, self._held = False, []
        yield from self._select(packets_of)

    def flush(self) -> Iterator[PendingPacket]:
        """Yield the packet in progress; see `ArrayReceiver`."""
        packets_of = list[tuple[ArrayReceiver, list[PendingPacket]]]()
        for receiver in self._receivers:
            packets_of.append((receiver, [*self._catch_up(receiver), *receiver.flush()]))
            if self._only_first and receiver.has_codeword:
                break
        self._only_first, self._held = False, []
        yield from self._select(packets_of)

    def settle(self, orientation: Orientation) -> bool:
        """Drop the hypotheses of other orientations than the camera's; return False if none is left."""
        left = [receiver for receiver in self._receivers if receiver.orientation == orientation]
        if left:
            self._receivers, self._settled = left, True
            if left == [self._first]:
                self._only_first, self._held = False, []
        return bool(left)

    def _catch_up(self, receiver: ArrayReceiver) -> Iterator[PendingPacket]:
        """Hand a receiver the frames that it has not had; yield the packets they complete."""
        for frame in () if receiver is self._first else self._held:
            yield from receiver.push(frame)

    def _select(self, packets_of: list[tuple[ArrayReceiver, list[PendingPacket]]]) -> Iterator[PendingPacket]:
        """Yield the packets of the receiver that decoded a codeword, or of the upright receiver."""
        decoded = next((receiver for receiver, _ in packets_of if receiver.has_codeword), None)
        if decoded is not None:
            self._receivers = [decoded]
        else:
            # the leading receiver reports the loss of the array
            self._receivers[1:] = [receiver for receiver in self._receivers[1:] if not receiver.done]
        for receiver, packets in packets_of:
            if receiver is self.leading and self.is_credible:
                yield from packets


class StreamReceiver:
    """Detects and tracks arrays in a stream of frames and yields packets; see `packet.Receiver`.

    The clock gives frames their times, the search detects arrays that are not tracked yet, and `track` makes the
    receiver of a detected array.
    """

    def __init__(
        self, clock: FrameClock, search: HeaderSearch, track: Callable[[Detection], ArrayReceiver], observe: Observer
    ):
        self._clock, self.search, self._track, self._observe = clock, search, track, observe
        self._arrays: list[HeaderHypotheses] = []
        self._orientation: Orientation | None = None
        self._read, self._missed = set[int](), dict[int, float]()
        self._last: Frame | None = None
        self._pending: deque[PendingPacket | LostEvent] = deque()
        self._newest: PendingPacket | None = None
        self._load = SearchLoad()

    @in_one_thread
    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        check_next(frame, self._last)
        # the caller may fill the array again
        self._last = frame = owned(frame)
        for timed in self._clock.push(frame):
            self._queue(self._take(timed))
        yield from self._finished_packets()

    @in_one_thread
    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress that were visible for half of the data."""
        for timed in self._clock.flush():
            self._queue(self._take(timed))
        for array in self._arrays:
            self._queue(array.flush())
        self._arrays = []
        yield from self._finished_packets(wait=True)
        if self._newest is not None:
            # this process may end now; Python prints an error if the decoding process still sends something then
            self._newest.settle()

    def _queue(self, packets: Iterator[PendingPacket]) -> None:
        """Queue packets, each in order with the losses of arrays."""
        for packet in packets:
            self._pending.append(packet)
            self._newest = packet

    def _finished_packets(self, wait: bool = False) -> Iterator[Packet]:
        """Packets decoded by now, or all, in the order of the packets' ends; the loss of an array follows."""
        while self._pending:
            first = self._pending[0]
            if isinstance(first, LostEvent):
                self._pending.popleft()
                self._observe(first)
            elif wait or first.done:
                self._pending.popleft()
                packet = first.packet()
                self._emit_missed_start(packet)
                yield packet
            else:
                return

    def _take(self, frame: Frame) -> Iterator[PendingPacket]:
        """Track and search for arrays in a frame whose time is known."""
        if not self.search.recent:
            self.search.start(self._clock.period_s)
        for array in list(self._arrays):
            yield from self._push(array, frame)
        for array in [a for a in self._arrays if a.done]:
            yield from array.flush()
            self._forget(array)
        leading = [array.leading for array in self._arrays]
        kept = [one for one in leading if one.is_confirmed and not one.has_outgrown_view(frame.time_s)]
        for detection in self.search.search(frame, [receiver.pose for receiver in kept]):
            yield from self._handle_detection(detection)
        before, self._load = self._load, self.search.load
        if self._load.left_out != before.left_out:
            self._observe(DropEvent(frame.time_s, self._load - before))

    def _handle_detection(self, detection: Detection) -> Iterator[PendingPacket]:
        """Start to track a detected array, unless a better track is at the same position."""
        rivals = [array for array in self._arrays if array.leading.overlaps(detection)]
        if any(self._rival_wins(rival, detection) for rival in rivals):
            return
        for rival in rivals:
            if rival.leading.has_outgrown_view(detection.time_s):
                yield from rival.flush()
            self._forget(rival)
        yield from self._start_array(detection)

    def _rival_wins(self, rival: HeaderHypotheses, detection: Detection) -> bool:
        """Return True if a tracked array stays where a header is detected."""
        upright = detection.orientation in (UPRIGHT, self._orientation)
        if upright != rival.is_credible:
            return rival.is_credible
        return not rival.leading.should_restart_on(detection)

    def _start_array(self, detection: Detection) -> Iterator[PendingPacket]:
        """Start to track an array, from the frames of the header on."""
        recent = tuple(self.search.recent)
        self._emit_losses()
        self._observe(DetectEvent(detection, recent))
        for hypothesis in detection.hypotheses:
            self._missed.pop(hypothesis.identity, None)
            if detection.misses_start and hypothesis.identity not in self._read:
                self._missed[hypothesis.identity] = detection.start_time_s
        settled = self._orientation is not None
        array = HeaderHypotheses([self._track(hypothesis) for hypothesis in detection.hypotheses], settled)
        self._arrays.append(array)
        for frame in recent:
            yield from self._push(array, frame)

    def _emit_missed_start(self, packet: Packet) -> None:
        """Report a lost packet before the first decoded packet of an array."""
        if packet.status in ("ok", "partial"):
            self._read.add(packet.identity)
            if packet.identity in self._missed:
                self._observe(MissedStartEvent(packet.identity, self._missed.pop(packet.identity)))

    def _push(self, array: HeaderHypotheses, frame: Frame) -> Iterator[PendingPacket]:
        """Hand a frame to an array; the first decoded codeword settles the camera's orientation."""
        packets = list(array.push(frame))
        if self._orientation is None and array.leading.has_codeword:
            self._settle(array.leading.orientation)
        yield from packets

    def _settle(self, orientation: Orientation) -> None:
        """Drop all hypotheses of other orientations than the camera's."""
        self._orientation = orientation
        self.search.set_orientation(orientation)
        for array in [a for a in self._arrays if not a.settle(orientation)]:
            self._forget(array)

    def _forget(self, array: HeaderHypotheses) -> None:
        self._pending.append(LostEvent(array.leading.identity, array.leading.time_s))
        self._arrays.remove(array)

    def _emit_losses(self) -> None:
        """Report losses that wait for packets: the same array may be detected again before these are decoded."""
        for loss in [event for event in self._pending if isinstance(event, LostEvent)]:
            self._pending.remove(loss)
            self._observe(loss)
