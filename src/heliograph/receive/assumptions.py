"""Readings of a packet: where codewords stay open it is read once more, with other LEDs or other poses assumed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from heliograph.receive.decode.observed import DecodedPacket
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packets import Codeword, Words, with_raw
from heliograph.receive.track.pose_refinement import ObservedPacket
from heliograph.receive.track.realign import realigned

PULLED_PX = 0.5
"""Error of a pose in px, by the power of differences, from which on a packet is read once more without it.

Of poses that are right that power errs by 0.1 px rms at 63 m, and by 0.3 px at most at 95 m. A pose that decoded data
correct by as much proves nothing of an array.
"""


@dataclass(frozen=True, slots=True)
class Assumption:
    """What a reading of a packet takes for granted."""

    # Gains of the LEDs
    led_gains: LedGains
    # One per pair at the poses where the array is thought to be, in the single mode one per pattern; None where it was
    # not seen
    cutouts: Sequence[Cutout | None]

    @property
    def steady(self) -> "Assumption":
        """The same with cut-outs without the background's light that moves with the array."""
        return replace(self, cutouts=[None if one is None else one.steady for one in self.cutouts])


@dataclass(frozen=True, slots=True)
class ReadPacket:
    """A packet as it was read."""

    # What was taken for granted
    assumed: Assumption
    # What came of it
    decoded: DecodedPacket[ObservedPacket]
    # Codewords by layer, with those that only other readings gave
    words: Words

    @classmethod
    def of(cls, assumed: Assumption, decoded: DecodedPacket[ObservedPacket]) -> "ReadPacket":
        """A reading with the codewords that it gave."""
        return cls(assumed, decoded, decoded.words)

    @property
    def open(self) -> int:
        """Codewords that are not decoded."""
        return open_words(self.words)

    def lacks(self, others: Words) -> bool:
        """Whether another reading decoded a codeword that this one did not."""
        pairs = (pair for name, by in self.words.items() for pair in zip(by, others[name], strict=True))
        return any(one.status == "crc_fail" and other.status != "crc_fail" for one, other in pairs)

    def or_rather(self, later: "ReadPacket") -> "ReadPacket":
        """The later reading if it leaves fewer codewords open, else this one; with the codewords of both."""
        best = later if later.open < self.open else self
        words = {name: tuple(map(_decoded_one, by, later.words[name])) for name, by in self.words.items()}
        return replace(best, words=with_raw(words, self.words))


def open_words(words: Words) -> int:
    """How many codewords are not decoded."""
    return sum(word.status == "crc_fail" for by in words.values() for word in by)


def read_packet(first: Assumption, decode: Callable[[Assumption], DecodedPacket[ObservedPacket]]) -> ReadPacket:
    """Read a packet, and where codewords stay open, once more under each other assumption that there is reason for."""
    reading = ReadPacket.of(first, decode(first))
    for otherwise in (all_leds_sound, poses_by_power):
        assumed = otherwise(reading) if reading.open else None
        if assumed is not None:
            reading = reading.or_rather(ReadPacket.of(assumed, decode(assumed)))
    return reading


def read_new(
    first: Assumption, shown: Words | None, read: Callable[[Words | None], ReadPacket]
) -> tuple[ReadPacket, bool]:
    """Read a packet of an array just found, of which the equaliser must show by itself that the pose is right."""
    if shown is not None and open_words(known := _without_finest(shown)) < sum(map(len, shown.values())):
        # a codeword that the equaliser adds to them where the poses are is proof enough, in half the time
        reading = read(known)
        there = reading.assumed.cutouts is first.cutouts and reading.decoded.observed.moved_px < PULLED_PX
        if there and reading.open < open_words(known) and not reading.lacks(shown):
            return reading, False
    reading = read(None)
    return reading, shown is not None and reading.lacks(shown)


def _without_finest(words: Words) -> Words:
    """Codewords, those of the finest layer open: the last one, which asks most of the pose."""
    finest = [*words][-1]
    return {**words, finest: tuple(replace(word, status="crc_fail", block=None) for word in words[finest])}


def all_leds_sound(reading: ReadPacket) -> Assumption | None:
    """Assume that no LED is dead or hidden: a header before a bright background may make sound ones seem so."""
    led_gains = reading.assumed.led_gains
    return replace(reading.assumed, led_gains=LedGains.sound(len(led_gains.sight))) if led_gains.doubtful else None


def poses_by_power(reading: ReadPacket) -> Assumption | None:
    """Assume the array where the differences have their power: what shines beside it may have pulled sums' poses."""
    assumed = reading.assumed
    if reading.decoded.observed.form.single:
        return None
    cutouts, largest_px = realigned(assumed.cutouts, assumed.led_gains.values)
    return replace(assumed, cutouts=cutouts) if largest_px > PULLED_PX else None


def _decoded_one(one: Codeword, other: Codeword) -> Codeword:
    """The first of two that is decoded; the other where none is."""
    return other if one.status == "crc_fail" else one
