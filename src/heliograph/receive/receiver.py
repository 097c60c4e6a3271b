"""A receiver: finds arrays in a stream of frames and hands each frame to all that are followed."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from heliograph.base.frames import Frame, check_next
from heliograph.base.threads import in_one_thread
from heliograph.receive.acquire.budget import SearchLoad
from heliograph.receive.acquire.candidate import apart
from heliograph.receive.acquire.detection import Detection, HeaderSearch
from heliograph.receive.acquire.earlier_light import shone_before
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.coming import ComingPacket
from heliograph.receive.events import DetectEvent, DropEvent, LostEvent, MissedStartEvent, Observer
from heliograph.receive.image.orientation import UPRIGHT, Orientation
from heliograph.receive.oriented_receivers import OrientedReceivers
from heliograph.receive.packets import Packet
from heliograph.receive.timing.camera_clock import FrameClock
from heliograph.signal.settings import SignalSettings


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
        self._arrays: list[OrientedReceivers] = []
        self._orientation: Orientation | None = None
        self._began_s: float | None = None
        self._read, self._missed = set[int](), dict[int, float]()
        self._last: Frame | None = None
        self._coming: deque[ComingPacket | LostEvent] = deque()
        self._newest: ComingPacket | None = None

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

    def _await(self, packets: Iterator[ComingPacket]) -> None:
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

    def _take(self, frame: Frame) -> Iterator[ComingPacket]:
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

    def _weigh(self, detection: Detection) -> Iterator[ComingPacket]:
        """Follow what was found unless it lies where a better array is followed."""
        rivals = [a for a in self._arrays if not apart(a.leading.pose, detection.fit.pose, self._parts.signal.side)]
        if any(self._stands(rival, detection) for rival in rivals):
            return
        for rival in rivals:
            if rival.leading.leaves(detection.time_s):
                yield from rival.flush()
            self._forget(rival)
        yield from self._take_up(detection)

    def _stands(self, rival: OrientedReceivers, detection: Detection) -> bool:
        """Whether an array is followed on where a header was found; what was taken for one may stand in its way."""
        upright = detection.orientation in (UPRIGHT, self._orientation)
        if upright != rival.credible:
            return rival.credible
        return not rival.leading.yields(detection)

    def _take_up(self, detection: Detection) -> Iterator[ComingPacket]:
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
        array = OrientedReceivers([self._parts.follow(one) for one in detection.hypotheses], settled)
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

    def _push(self, array: OrientedReceivers, frame: Frame) -> Iterator[ComingPacket]:
        """Hand a frame to an array; the first right codeword tells how the camera sees all of them."""
        packets = list(array.push(frame))
        if self._orientation is None and array.leading.proven:
            self._settle(array.leading.orientation)
        yield from packets

    def _settle(self, orientation: Orientation) -> None:
        """Know the camera's orientation from now on."""
        self._orientation = orientation
        self._parts.search.settle(orientation)
        for array in [a for a in self._arrays if not a.settle(orientation)]:
            self._forget(array)

    def _forget(self, array: OrientedReceivers) -> None:
        self._coming.append(LostEvent(array.leading.identity, array.leading.time_s))
        self._arrays.remove(array)

    def _tell_losses(self) -> None:
        """Tell losses that wait for packets: the same array may be found again before these are decoded."""
        for loss in [one for one in self._coming if isinstance(one, LostEvent)]:
            self._coming.remove(loss)
            self._observe(loss)
