"""Receivers of one array: one for each way in which its header may be read, until a codeword is right.

Turned arrays are rare. So the most plausible receiver alone gets frames until its first packet is over. If no codeword
of that is right, the others get the same frames then.

A receiver: finds arrays in a stream of frames and hands each frame to all that are followed.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from heliograph.base.frames import Frame, check_next
from heliograph.base.threads import in_one_thread
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.decode.worker import PendingPacket
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.candidate import are_disjoint
from heliograph.receive.detect.detection import Detection, HeaderSearch, shone_before
from heliograph.receive.events import DetectEvent, DropEvent, LostEvent, MissedStartEvent, Observer
from heliograph.receive.geometry.pose import UPRIGHT, Orientation
from heliograph.receive.packet import Packet
from heliograph.receive.sync.frame_clock import FrameClock
from heliograph.signal.settings import SignalSettings

HELD_BYTES = 128e6
"""Bytes of frames that are kept for the others at most: 244 frames of 1024 x 512. Beyond it they read along."""


class HeaderHypotheses:
    """An array that is followed, its identity and orientation taken to be any of several until a codeword is right."""

    def __init__(self, receivers: Sequence[ArrayReceiver], settled: bool):
        self._receivers, self._settled = list(receivers), settled
        # whether the first gets frames alone, and those that the others have not had
        self._first, self._alone, self._held = self._receivers[0], len(self._receivers) > 1, list[Frame]()

    @property
    def leading(self) -> ArrayReceiver:
        """The most plausible receiver; once a codeword was right, the only one."""
        return self._receivers[0]

    @property
    def credible(self) -> bool:
        """Whether it may be taken for an array without a right codeword: turned arrays are rare, clutter is not."""
        return self._settled or self.leading.proven or self.leading.orientation == UPRIGHT

    @property
    def sure(self) -> bool:
        """Whether no other array is to be looked for where it is."""
        return self.leading.sure

    @property
    def done(self) -> bool:
        """Whether it is followed no longer."""
        return not self._receivers or self.leading.done

    def push(self, frame: Frame) -> Iterator[PendingPacket]:
        """Take the next frame; yield the packet it completes."""
        read, wait = list[tuple[ArrayReceiver, list[PendingPacket]]](), False
        for one in self._receivers:
            packets = [packet for each in (*self._missed(one), frame) for packet in one.push(each)]
            read.append((one, packets))
            room = len(self._held) * frame.pixels.nbytes < HELD_BYTES
            wait = self._alone and one is self._first and not packets and room
            # where a codeword is right, the others are mistaken: their packets need not be decoded
            if wait or one.proven:
                break
        if wait:
            self._held.append(frame)
        else:
            self._alone, self._held = False, []
        yield from self._believed(read)

    def flush(self, over: bool = False) -> Iterator[PendingPacket]:
        """Yield the packet in progress; see `ArrayReceiver`."""
        read = list[tuple[ArrayReceiver, list[PendingPacket]]]()
        for one in self._receivers:
            late = [packet for each in self._missed(one) for packet in one.push(each)]
            read.append((one, [*late, *one.flush(over)]))
            if self._alone and one.proven:
                break
        self._alone, self._held = False, []
        yield from self._believed(read)

    def settle(self, orientation: Orientation) -> bool:
        """Leave out what the camera's orientation rules out."""
        left = [one for one in self._receivers if one.orientation == orientation]
        if left:
            self._receivers, self._settled = left, True
            if left == [self._first]:
                self._alone, self._held = False, []
        return bool(left)

    def _missed(self, one: ArrayReceiver) -> list[Frame]:
        """Frames that a receiver has not had."""
        return [] if one is self._first else self._held

    def _believed(self, read: list[tuple[ArrayReceiver, list[PendingPacket]]]) -> Iterator[PendingPacket]:
        """Packets of the receiver of which a codeword was right, else of the upright one."""
        proven = next((one for one, _ in read if one.proven), None)
        if proven is not None:
            self._receivers = [proven]
        else:
            # what gave up is no longer of interest, but the leading one says when all is over
            self._receivers[1:] = [one for one in self._receivers[1:] if not one.done]
        for one, packets in read:
            if one is self.leading and self.credible:
                yield from packets


@dataclass(frozen=True, slots=True)
class Parts:
    """What a receiver is made of."""

    # Gives frames their times
    clock: FrameClock
    # Looks for headers of arrays that are not followed yet
    search: HeaderSearch
    # Makes the receiver of an array that was found
    follow: Callable[[Detection], ArrayReceiver]
    # The light's signal: LEDs in a row, length of a pattern and of a packet
    signal: SignalSettings


class StreamReceiver:
    """Finds arrays in a stream of frames, follows each, and yields its packets; see `packets.Receiver`."""

    def __init__(self, parts: Parts, observe: Observer):
        self._parts, self._observe = parts, observe
        self._arrays: list[HeaderHypotheses] = []
        self._orientation: Orientation | None = None
        self._began_s: float | None = None
        self._read, self._missed = set[int](), dict[int, float]()
        self._last: Frame | None = None
        self._coming: deque[PendingPacket | LostEvent] = deque()
        self._newest: PendingPacket | None = None

    @property
    def load(self) -> SearchLoad:
        """What the search did and left out so far."""
        return self._parts.search.load

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        return in_one_thread(self._checked(frame))

    def _checked(self, frame: Frame) -> Iterator[Packet]:
        """Take a camera's frame, if it may follow the last one."""
        check_next(frame, self._last)
        # the caller may fill its array again, and frames are kept
        self._last = frame = frame.copied()
        for timed in self._parts.clock.push(frame):
            self._await(self._take(timed))
        yield from self._known()

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packets in progress of which enough was seen."""
        return in_one_thread(self._finish())

    def _finish(self) -> Iterator[Packet]:
        for timed in self._parts.clock.flush():
            self._await(self._take(timed))
        for array in self._arrays:
            self._await(array.flush())
        self._arrays = []
        yield from self._known(wait=True)
        if self._newest is not None:
            # this process may end now; what the one that decodes sends it then, Python prints an error of
            self._newest.settle()

    def _await(self, packets: Iterator[PendingPacket]) -> None:
        """Keep packets that were seen, each in its place among the losses of arrays."""
        for packet in packets:
            self._coming.append(packet)
            self._newest = packet

    def _known(self, wait: bool = False) -> Iterator[Packet]:
        """Packets decoded by now, or all, in the order in which they were seen; an array's loss comes after them."""
        while self._coming:
            first = self._coming[0]
            if isinstance(first, LostEvent):
                self._coming.popleft()
                self._observe(first)
            elif wait or first.done:
                self._coming.popleft()
                packet = first.packet()
                self._tell_missed_start(packet)
                yield packet
            else:
                return

    def _take(self, frame: Frame) -> Iterator[PendingPacket]:
        """Take a frame whose time is known."""
        if self._began_s is None:
            self._parts.search.start(self._parts.clock.period_s)
            self._began_s = frame.time_s
        for array in list(self._arrays):
            yield from self._push(array, frame)
        for array in [a for a in self._arrays if a.done]:
            yield from array.flush()
            self._forget(array)
        kept = [one for one in self._arrays if one.sure and not one.leading.leaves(frame.time_s)]
        before = self.load
        for detection in self._parts.search.push(frame, [array.leading.pose for array in kept]):
            yield from self._weigh(detection)
        if self.load.left_out != before.left_out:
            self._observe(DropEvent(frame.time_s, self.load - before))

    def _weigh(self, detection: Detection) -> Iterator[PendingPacket]:
        """Follow what was found unless it lies where a better array is followed."""
        rivals = [
            a for a in self._arrays if not are_disjoint(a.leading.pose, detection.fit.pose, self._parts.signal.side)
        ]
        if any(self._stands(rival, detection) for rival in rivals):
            return
        for rival in rivals:
            if rival.leading.leaves(detection.time_s):
                yield from rival.flush()
            self._forget(rival)
        yield from self._take_up(detection)

    def _stands(self, rival: HeaderHypotheses, detection: Detection) -> bool:
        """Whether an array is followed on where a header was found; what was taken for one may stand in its way."""
        upright = detection.orientation in (UPRIGHT, self._orientation)
        if upright != rival.credible:
            return rival.credible
        return not rival.leading.yields(detection)

    def _take_up(self, detection: Detection) -> Iterator[PendingPacket]:
        """Begin to follow an array, its header's frames first."""
        recent = tuple(self._parts.search.recent)
        self._tell_losses()
        self._observe(DetectEvent(detection, recent))
        missed = self._misses_start(detection, recent)
        for one in detection.hypotheses:
            self._missed.pop(one.identity, None)
            if missed and one.identity not in self._read:
                self._missed[one.identity] = detection.start_time_s
        settled = self._orientation is not None
        array = HeaderHypotheses([self._parts.follow(one) for one in detection.hypotheses], settled)
        self._arrays.append(array)
        for frame in recent:
            yield from self._push(array, frame)

    def _tell_missed_start(self, packet: Packet) -> None:
        """Report before the first packet read of an array that one before it is lost."""
        if packet.status in ("ok", "partial"):
            self._read.add(packet.identity)
            if packet.identity in self._missed:
                self._observe(MissedStartEvent(packet.identity, self._missed.pop(packet.identity)))

    def _misses_start(self, detection: Detection, recent: Sequence[Frame]) -> bool:
        """Return True if the array was sending before its header, in the first two packets of the film."""
        assert self._began_s is not None
        signal, began_s = self._parts.signal, self._began_s
        # the search fills up its window with copies of the first frame, at times before it
        filmed = [frame for frame in recent if frame.time_s > began_s - signal.pattern_period_s / 2]
        return detection.start_time_s - began_s < 2.5 * signal.packet_s and shone_before(detection, filmed, signal)

    def _push(self, array: HeaderHypotheses, frame: Frame) -> Iterator[PendingPacket]:
        """Hand a frame to an array; the first right codeword tells how the camera sees all of them."""
        packets = list(array.push(frame))
        if self._orientation is None and array.leading.proven:
            self._settle(array.leading.orientation)
        yield from packets

    def _settle(self, orientation: Orientation) -> None:
        """Know the camera's orientation from now on."""
        self._orientation = orientation
        self._parts.search.set_orientation(orientation)
        for array in [a for a in self._arrays if not a.settle(orientation)]:
            self._forget(array)

    def _forget(self, array: HeaderHypotheses) -> None:
        self._coming.append(LostEvent(array.leading.identity, array.leading.time_s))
        self._arrays.remove(array)

    def _tell_losses(self) -> None:
        """Tell losses that wait for packets: the same array may be found again before these are decoded."""
        for loss in [one for one in self._coming if isinstance(one, LostEvent)]:
            self._coming.remove(loss)
            self._observe(loss)
