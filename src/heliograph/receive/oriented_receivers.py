"""Receivers of one array: one for each way in which its header may be read, until a codeword is right.

Turned arrays are rare. So the most plausible receiver alone gets frames until its first packet is over. If no codeword
of that is right, the others get the same frames then.
"""

from collections.abc import Iterator, Sequence

from heliograph.base.frames import Frame
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.coming import ComingPacket
from heliograph.receive.image.orientation import UPRIGHT, Orientation

HELD_BYTES = 128e6
"""Bytes of frames that are kept for the others at most: 244 frames of 1024 x 512. Beyond it they read along."""


class OrientedReceivers:
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

    def push(self, frame: Frame) -> Iterator[ComingPacket]:
        """Take the next frame; yield the packet it completes."""
        read, wait = list[tuple[ArrayReceiver, list[ComingPacket]]](), False
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

    def flush(self, over: bool = False) -> Iterator[ComingPacket]:
        """Yield the packet in progress; see `ArrayReceiver`."""
        read = list[tuple[ArrayReceiver, list[ComingPacket]]]()
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

    def _believed(self, read: list[tuple[ArrayReceiver, list[ComingPacket]]]) -> Iterator[ComingPacket]:
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
