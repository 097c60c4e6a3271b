"""Readings of a packet: where codewords stay open it is read once more, with other LEDs or other poses assumed.

What the soft receiver took of a packet, and its decoding: all frames equalised and decoded together.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from heliograph.base.threads import one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SharedBuffer, SoftBuffer
from heliograph.receive.decode.observations import PacketBuffer
from heliograph.receive.decode.per_led import read_led_by_led
from heliograph.receive.decode.per_quad import read_square_by_square
from heliograph.receive.decode.turbo_equaliser import DecodedPacket, GainAndNoise, decode_iteratively
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket, align_by_power
from heliograph.receive.events import DecodeEvent, Observer, ignore
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, measure_noise, noise_beside
from heliograph.receive.packet import Codeword, Packet, Words, with_raw
from heliograph.receive.settings import Feedback
from heliograph.signal.formats import Format, UnreadableModeError, check_mode
from heliograph.signal.packet import PacketFormat

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

    def with_cutouts(self, later: "ReadPacket") -> "ReadPacket":
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
            reading = reading.with_cutouts(ReadPacket.of(assumed, decode(assumed)))
    return reading


def verify_first_packet(
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
    cutouts, largest_px = align_by_power(assumed.cutouts, assumed.led_gains.values)
    return replace(assumed, cutouts=cutouts) if largest_px > PULLED_PX else None


def _decoded_one(one: Codeword, other: Codeword) -> Codeword:
    """The first of two that is decoded; the other where none is."""
    return other if one.status == "crc_fail" else one


OUT_OF_STEP_STRIDE = 4
"""Pairs out of step of which one is asked for the noise: the equaliser estimates it once more, from all of them."""


class Lesson(NamedTuple):
    """What a decoded packet teaches."""

    # Gains of the LEDs; None where nothing was known of them before
    led_gains: LedGains | None
    # Whether the equaliser has decoded a codeword of the array since it was found
    proven: bool
    # Whether the array is not quite as it is followed: the equaliser does not read what the LEDs' positions tell
    misled: bool = False

    @property
    def told(self) -> "Lesson":
        """The gains without what has shown them: that is asked for where packets are decoded alone."""
        return self._replace(led_gains=None if self.led_gains is None else self.led_gains.without_evidence)


@dataclass(frozen=True, slots=True)
class SoftReading:
    """How the soft receiver decodes an array's packets."""

    # What was seen of its codewords before; None adds nothing
    buffer: SharedBuffer | None
    # Algorithm of the channel decoder, and its most iterations
    options: Decoding
    # What the equaliser gets back from the decoder
    feedback: Feedback
    # Whether a packet is read LED by LED and square by square first
    led_by_led: bool


@dataclass(frozen=True, slots=True)
class Light:
    """Light of the array with all LEDs on in gray levels, as the last pair showed it."""

    # That of a difference of a pair
    gain: float = 0.0
    # Largest that the sensor can show
    full_scale: float = math.inf
    # Of the sum of a pair of data in step
    sum_gain: float = 0.0


@dataclass(frozen=True, slots=True)
class PacketObservations:
    """All that was taken of a packet; see `UndecodedPacket`."""

    # Number of the array, 0 to 29
    identity: int
    # Format of the packet
    form: PacketFormat
    # How it is decoded
    reading: SoftReading
    # Number of the format that its header signals
    mode: int
    # What was kept of its pairs
    data: PacketBuffer
    # Light of the array
    light: Light
    # Gains of its LEDs; None where nothing is known of them
    led_gains: LedGains | None
    # Seconds by which the data's light comes after the middle of an exposure
    late_s: float
    # The header out of step, its frames combined to one pair; None in step
    even: Cutout | None
    # Variance of a pixel inside the array by decided data, in squared gray levels; None where there are inverses
    decided_noise: float | None
    # Whether the equaliser has decoded a codeword of it since it was found: its pose and gains are then right
    proven: bool = False

    @property
    def format(self) -> Format:
        """The packet's format, as far as its header has shown it."""
        return self.form.format

    def taught(self, lesson: Lesson | None) -> "PacketObservations":
        """The same with the LEDs' brightness by earlier packets, and whether it is proven; see `UndecodedPacket`."""
        if lesson is None:
            return self
        # what is in sight, its own header shows
        return replace(self, led_gains=with_brightness(self.led_gains, lesson.led_gains), proven=lesson.proven)

    @one_thread()
    def glance(self) -> bool:
        """Whether the LEDs' positions alone tell a codeword; see `UndecodedPacket`."""
        try:
            check_mode(self.mode, self.form.settings.data_pairs)
        except UnreadableModeError:
            return False
        shown = self._led_by_led(Assumption(self._gains(), self._cutouts()), glance=True)
        return shown is not None and any(word.status == "ok" for by in shown.values() for word in by)

    def renumbered(self, place: int) -> "PacketObservations":
        """The same with the pairs from one on moved to the next number; see `UndecodedPacket`."""
        data = self.data.renumbered(place, self.form.settings.data_pairs)
        return replace(self, data=data, reading=replace(self.reading, buffer=None))

    @one_thread()
    def decode(self, observe: Observer, /) -> Decoded:
        """Codewords by layer, of all pairs kept; see `UndecodedPacket`."""
        check_mode(self.mode, self.form.settings.data_pairs)
        as_kept = Assumption(self._gains(), self._cutouts())
        shown = self._led_by_led(as_kept)
        if shown is not None and not open_words(shown):
            # whether they were read where the array is, nobody need wait for
            return Decoded(shown, study=lambda: self._learnt_beside(as_kept, shown))
        first = as_kept.steady
        reading, misled = self._equalised(first, shown, observe)
        cutouts = None if reading.assumed.cutouts is first.cutouts else tuple(reading.assumed.cutouts)
        words = reading.words if shown is None else with_raw(reading.words, shown)
        return Decoded(words, lambda: self._lesson(reading, misled), cutouts)

    def _equalised(self, first: Assumption, shown: Words | None, observe: Observer) -> tuple[ReadPacket, bool]:
        """The packet as the equaliser reads it, and whether its poses misled it."""
        buffer = self.reading.buffer
        earlier = None if buffer is None else buffer.content

        def read(assumed: Assumption) -> DecodedPacket[ObservedPacket]:
            return self._decode(
                assumed, earlier, shown if assumed.cutouts is first.cutouts else self._led_by_led(assumed), observe
            )

        def read_with(known: Words | None) -> ReadPacket:
            return read_packet(first, lambda assumed: self._decode(assumed, earlier, known, observe))

        reading, misled = (
            verify_first_packet(first, shown, read_with) if self._new else (read_packet(first, read), False)
        )
        if misled:
            reading = reading.with_cutouts(read_packet(first, read))
        if buffer is not None and reading.decoded.buffer is not None:
            buffer.keep(reading.decoded.buffer)
        return reading, misled

    def shown(self, packet: Packet, decoded: Decoded) -> DecodeEvent:
        """The packet with the cut-outs of its pairs; see `UndecodedPacket`."""
        cutouts = tuple(self._cutouts()) if decoded.cutouts is None else decoded.cutouts
        return DecodeEvent(self.identity, packet, cutouts=cutouts)

    def _led_by_led(self, assumed: Assumption, glance: bool = False) -> Words | None:
        """What the LEDs' positions alone tell, or at a glance; None where they are not asked, or tell nothing."""
        reading = self.reading
        if not reading.led_by_led or reading.feedback == "none":
            return None
        # behind a post the scale of these LLRs is wrong; max-log heeds their proportions alone
        options = replace(reading.options, algorithm="max-log")
        cutouts, place = self._with_lone(assumed), (self.form, self.identity, options)
        soft = reading.feedback in ("soft", "propagation")
        if _out_of_step(cutouts):
            return read_square_by_square(cutouts, self.light.gain, *place, soft=soft, glance=glance)
        shown = read_led_by_led(cutouts, *place)
        if shown is None or glance or open_words(shown) in (0, sum(map(len, shown.values()))):
            return shown
        # what is decoded tells what it leaves of its light in the others
        return read_square_by_square(cutouts, self.light.gain, *place, shown, soft=soft) or shown

    def _decode(
        self, assumed: Assumption, earlier: SoftBuffer | None, known: Words | None, observe: Observer
    ) -> DecodedPacket[ObservedPacket]:
        """Decode what is not known yet of all that was kept; `earlier` is what was seen of its codewords before."""
        reading, light, noise = self.reading, self.light, self._noise(assumed)
        observed = ObservedPacket.of(self._with_lone(assumed), noise, self.form, assumed.led_gains)
        channel = GainAndNoise(min(light.gain, light.full_scale), noise.lit, light.full_scale)
        return decode_iteratively(
            observed, channel, self.form, self.identity, reading.options, earlier, reading.feedback, observe, known
        )

    def _with_lone(self, assumed: Assumption) -> list[Cutout | None]:
        """All cut-outs, those of frames included whose other half is lost."""
        cutouts, gain, values = [*assumed.cutouts], self.light.sum_gain, assumed.led_gains.values
        for place, lone in self.data.lone_cutouts(self.late_s, gain, values).items():
            cutouts[place] = lone
        return cutouts

    def _noise(self, assumed: Assumption) -> Noise:
        """Noise of the cut-outs."""
        seen = [cutout for cutout in assumed.cutouts if cutout is not None]
        if self.decided_noise is not None:
            return Noise(self.decided_noise, noise_beside(seen, self._side))
        # what hides a part of the array is uneven too
        whole = [cutout for cutout in seen if cutout.in_sight is None]
        gain, values, even = self.light.gain, assumed.led_gains.values, self.even
        asked = whole if len(whole) > 1 else seen
        if even is None or not _out_of_step(seen):
            return measure_noise(asked, gain, self._side, values)
        # of pairs out of step the sum is uneven, but not that of a header
        noise = measure_noise(asked[::OUT_OF_STEP_STRIDE], gain, self._side, values)
        return Noise(min(measure_noise([even], gain, self._side, values).lit, noise.lit), noise.dark)

    @property
    def _new(self) -> bool:
        """Whether the equaliser must show yet that the array is where it is followed."""
        return self.led_gains is not None and not self.proven

    @one_thread()
    def _learnt_beside(self, as_kept: Assumption, shown: Words) -> Lesson:
        """What a packet teaches whose codewords the LEDs' positions have told."""
        if self._new:
            return self._lesson(*self._equalised(as_kept.steady, shown, ignore))
        return Lesson(self._brightness_learnt(as_kept, shown), self.proven)

    @one_thread()
    def _lesson(self, reading: ReadPacket, misled: bool) -> Lesson:
        """What a packet teaches that was equalised."""
        there = self._new and not misled and reading.open < sum(map(len, reading.words.values()))
        return Lesson(self._learnt(reading), self.proven or there, misled)

    def _learnt(self, reading: ReadPacket) -> LedGains | None:
        """Gains of the LEDs after a packet was equalised."""
        led_gains = reading.assumed.led_gains
        if self.led_gains is None or (not reading.open and led_gains.brightness.settled):
            return self.led_gains
        return _learnt_from(reading.decoded, led_gains)

    def _brightness_learnt(self, assumed: Assumption, shown: Words) -> LedGains | None:
        """Gains with the brightness of LEDs that a packet showed by themselves, unless that is known."""
        if self.led_gains is None or self.led_gains.brightness.learnt or _out_of_step(assumed.cutouts):
            return self.led_gains
        # only these pairs are learnt from
        stride = assumed.led_gains.brightness.stride
        kept = [
            None if k % stride or cutout is None or cutout.apart else cutout for k, cutout in enumerate(assumed.cutouts)
        ]
        if all(cutout is None for cutout in kept):
            return self.led_gains
        decoded = self._decode(replace(assumed, cutouts=kept).steady, None, shown, ignore)
        return _learnt_from(decoded, assumed.led_gains, stride=1)

    def _gains(self) -> LedGains:
        return self.led_gains or LedGains.sound(self._side)

    def _cutouts(self) -> list[Cutout | None]:
        """One per pair, in the single mode one per pattern; None where the array was not seen."""
        return self.data.in_order(self.form.layers["high"].pairs)

    @property
    def _side(self) -> int:
        return self.form.settings.side


def _out_of_step(cutouts: Sequence[Cutout | None]) -> bool:
    """Whether any pair was combined of frames out of step."""
    return any(cutout is not None and cutout.combination is not None for cutout in cutouts)


def with_brightness(led_gains: LedGains | None, learnt: LedGains | None) -> LedGains | None:
    """Gains of the LEDs, their brightness as it was learnt a packet before."""
    if learnt is None:
        return led_gains
    faded = learnt.faded()
    return faded if led_gains is None else replace(led_gains, brightness=faded.brightness)


def _learnt_from(decoded: DecodedPacket[ObservedPacket], led_gains: LedGains, stride: int | None = None) -> LedGains:
    """Gains of the LEDs with what a decoded packet shows of their brightness."""
    channel = decoded.channel
    learnt = decoded.observed.estimate_brightness(decoded.mean, decoded.variance, channel.gain, channel.noise, stride)
    return replace(led_gains, brightness=learnt)
