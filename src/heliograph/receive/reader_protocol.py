"""What a reader of packets must offer to the receiver of an array."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from heliograph.base.arrays import Floats
from heliograph.receive.events import DecodeEvent, Observer
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packets import Packet, Words
from heliograph.receive.timing.frame_pair import FramePair, LoneFrame, MeasuredHeader
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.formats import Format


@dataclass(frozen=True, slots=True)
class ReadHeader:
    """A header pair as it was read.

    Attributes
    ----------
    track
        The array, its pose refined by the header.
    score
        Amplitude of the header as a fraction of the array's light.
    """

    track: Track
    score: float


class Lesson(Protocol):
    """What a packet teaches of its array: all of it stays where packets are decoded."""

    @property
    def misled(self) -> bool:
        """Whether the array is not quite as it is followed."""

    @property
    def told(self) -> "Lesson":
        """The part of it that readers need, which another process may have to hand over."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """What decoding made of what was taken of a packet.

    Attributes
    ----------
    words
        Codewords by layer, decoded or not.
    study
        Gives what they teach of the array, which nobody need wait for; None where that is nothing.
    cutouts
        Cut-outs of its pairs where others were decoded than those taken; None else.
    luminances
        (pairs, n, n) that were decoded; None of a reader that does not read LED by LED.
    """

    words: Words
    study: Callable[[], Lesson | None] | None = None
    cutouts: tuple[Cutout | None, ...] | None = None
    luminances: Floats | None = None


class TakenPacket(Protocol):
    """All that was taken of a packet: a value, which another process may decode."""

    @property
    def format(self) -> Format:
        """The packet's format, as far as its header has shown it."""

    def taught(self, lesson: Any) -> "TakenPacket":
        """Give the same packet with what is known of the array by the packets before.

        They are decoded by then, where the reader may have known only of those before the last.

        Parameters
        ----------
        lesson
            What `Decoded.study` of the last packet that taught anything has given; None before the first.
        """

    def glance(self) -> bool:
        """Whether a codeword is right by what can be read at once, in less time than an equaliser takes."""

    def renumbered(self, place: int) -> "TakenPacket":
        """Give the same packet as it is if a pair is lost that the numbers do not tell of.

        What it teaches is not kept for later packets.

        Parameters
        ----------
        place
            Number of the lost pair; what was taken from there on is that of the pairs after it.
        """

    def decode(self, observe: Observer, /) -> Decoded:
        """Decode it.

        Parameters
        ----------
        observe
            Gets the events of decoding.
        """

    def shown(self, packet: Packet, decoded: Decoded) -> DecodeEvent:
        """What an observer of the packet gets.

        Parameters
        ----------
        packet
            The packet as it will be handed out.
        decoded
            What decoding made of it.
        """


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

    def take_lone(self, place: int, lone: LoneFrame) -> None:
        """Take what is left of a pair of data.

        Parameters
        ----------
        place
            Its number in the packet's data, from 0.
        lone
            The frame that is there.
        """

    def taken(self) -> TakenPacket:
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
