"""The soft receiver's packet observations and the joint decoding.

Samples at the LEDs are decoded first, then the equaliser reads all frames together. If codewords fail, the packet is
read again with other LEDs or other poses assumed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from heliograph.base.threads import one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.observations import PacketBuffer
from heliograph.receive.decode.per_led import decode_per_led
from heliograph.receive.decode.per_quad import decode_per_quad
from heliograph.receive.decode.turbo_equaliser import DecodedPacket, GainAndNoise, decode_iteratively
from heliograph.receive.decode.worker import ArrayState, Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket, align_by_power
from heliograph.receive.events import Observer, ignore
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, measure_noise, noise_beside
from heliograph.receive.packet import Codeword, Words, with_raw
from heliograph.receive.settings import Feedback
from heliograph.signal.formats import UnreadableModeError, check_mode
from heliograph.signal.packet import PacketFormat

MAX_POSE_ERROR_PX = 0.5
"""Error of a pose, by the power of differences, above which the pose is wrong: right poses err by 0.3 px at most."""


@dataclass(frozen=True, slots=True)
class Assumption:
    """LED gains and poses that an attempt at a packet assumes."""

    # Gains of the LEDs
    led_gains: LedGains
    # Cut-outs of the pairs at the assumed poses, in the single mode of the patterns; None for missing pairs
    cutouts: Sequence[Cutout | None]

    @property
    def steady(self) -> "Assumption":
        """Assumption less the background's light that moves with the array."""
        return replace(self, cutouts=[None if cutout is None else cutout.steady for cutout in self.cutouts])


@dataclass(frozen=True, slots=True)
class DecodeAttempt:
    """Attempt at a packet under an assumption."""

    # Assumed LED gains and poses
    assumed: Assumption
    # Result of the equaliser
    decoded: DecodedPacket[ObservedPacket]
    # Codewords by layer, also from other attempts
    words: Words

    @classmethod
    def of(cls, assumed: Assumption, decoded: DecodedPacket[ObservedPacket]) -> "DecodeAttempt":
        """Attempt with the codewords that it decoded."""
        return cls(assumed, decoded, decoded.words)

    @property
    def open(self) -> int:
        """Number of undecoded codewords."""
        return open_words(self.words)

    def lacks(self, others: Words) -> bool:
        """Return True if another attempt decoded a codeword that failed here."""
        pairs = (pair for name, by in self.words.items() for pair in zip(by, others[name], strict=True))
        return any(own.status == "crc_fail" and other.status != "crc_fail" for own, other in pairs)

    def best_of(self, later: "DecodeAttempt") -> "DecodeAttempt":
        """Return the attempt with more codewords, this one if equal; with the codewords of both."""
        best = later if later.open < self.open else self
        words = {name: tuple(map(_prefer_decoded, by, later.words[name])) for name, by in self.words.items()}
        return replace(best, words=with_raw(words, self.words))


def open_words(words: Words) -> int:
    """Number of undecoded codewords."""
    return sum(word.status == "crc_fail" for by in words.values() for word in by)


def read_packet(first: Assumption, decode: Callable[[Assumption], DecodedPacket[ObservedPacket]]) -> DecodeAttempt:
    """Decode a packet; if codewords fail, decode it again with all LEDs assumed sound, then with other poses."""
    attempt = DecodeAttempt.of(first, decode(first))
    for revise in (all_leds_sound, poses_by_power):
        assumed = revise(attempt) if attempt.open else None
        if assumed is not None:
            attempt = attempt.best_of(DecodeAttempt.of(assumed, decode(assumed)))
    return attempt


def verify_first_packet(
    first: Assumption, sampled: Words | None, read: Callable[[Words | None], DecodeAttempt]
) -> tuple[DecodeAttempt, bool]:
    """Decode the first packet of an array; also return True if the equaliser shows that the pose is wrong."""
    if sampled is not None and open_words(known := _without_finest(sampled)) < sum(map(len, sampled.values())):
        # if the equaliser adds a codeword at these poses they are right, and half the time is saved
        attempt = read(known)
        moved = attempt.assumed.cutouts is not first.cutouts
        is_right = not moved and attempt.decoded.observed.moved_px < MAX_POSE_ERROR_PX
        if is_right and attempt.open < open_words(known) and not attempt.lacks(sampled):
            return attempt, False
    attempt = read(None)
    return attempt, sampled is not None and attempt.lacks(sampled)


def _without_finest(words: Words) -> Words:
    """Codewords less the last and finest layer, which needs the best pose."""
    finest = [*words][-1]
    return {**words, finest: tuple(replace(word, status="crc_fail", block=None) for word in words[finest])}


def all_leds_sound(attempt: DecodeAttempt) -> Assumption | None:
    """Assume that no LED is dead or hidden: a header before a bright background may make LEDs seem so."""
    led_gains = attempt.assumed.led_gains
    return replace(attempt.assumed, led_gains=LedGains.sound(len(led_gains.sight))) if led_gains.doubtful else None


def poses_by_power(attempt: DecodeAttempt) -> Assumption | None:
    """Assume the array at the power of the differences: a bright neighbour may have shifted the poses of the sums."""
    assumed = attempt.assumed
    if attempt.decoded.observed.form.single:
        return None
    cutouts, largest_px = align_by_power(assumed.cutouts, assumed.led_gains.values)
    return replace(assumed, cutouts=cutouts) if largest_px > MAX_POSE_ERROR_PX else None


def _prefer_decoded(first: Codeword, second: Codeword) -> Codeword:
    """Return the first codeword if it is decoded, else the second."""
    return second if first.status == "crc_fail" else first


@dataclass(frozen=True, slots=True)
class SoftDecoding:
    """Settings of decoding for the packets of the soft receiver."""

    # Parameters of the channel decoder
    options: Decoding
    # Feedback from the decoder to the equaliser
    feedback: Feedback
    # True to decode samples at the LEDs before the equaliser runs
    led_by_led: bool
    # True to combine a codeword with repetitions received earlier
    combining: bool


@dataclass(frozen=True, slots=True)
class Light:
    """Light of the array with all LEDs on in gray levels, by the last pair."""

    # Light of a difference of a pair
    gain: float = 0.0
    # Largest light that the sensor can show
    full_scale: float = math.inf
    # Light of the sum of a pair of data in step
    sum_gain: float = 0.0


@dataclass(frozen=True, slots=True)
class PacketObservations:
    """Observations of a packet by the soft receiver; see `worker.Observations`."""

    # Number of the array, 0 to 29
    identity: int
    # Format of the packet
    form: PacketFormat
    # Settings of decoding
    decoding: SoftDecoding
    # Number of the format that the header signals
    mode: int
    # Cut-outs and unpaired frames
    data: PacketBuffer
    # Light of the array
    light: Light
    # Gains of the LEDs; None if unknown
    led_gains: LedGains | None
    # Seconds by which the data's light comes after the middle of an exposure
    late_s: float
    # Header out of step, the frames combined to a pair; None in step
    even: Cutout | None
    # Variance of a pixel inside the array by decided data, in squared gray levels; None with inverses
    decided_noise: float | None
    # True if the equaliser has decoded a codeword of the array: pose and gains are right
    confirmed: bool = False

    @property
    def cutouts(self) -> list[Cutout | None]:
        """Cut-outs of the pairs, in the single mode of the patterns; None for missing pairs."""
        return self.data.in_order(self.form.layers["high"].pairs)

    @one_thread()
    def has_codeword(self) -> bool:
        """Return True if samples at the LEDs decode to a codeword; see `Observations`."""
        try:
            check_mode(self.mode, self.form.settings.data_pairs)
        except UnreadableModeError:
            return False
        sampled = self._decode_samples(Assumption(self._gains(), self.cutouts), quick=True)
        return sampled is not None and any(word.status == "ok" for by in sampled.values() for word in by)

    def renumbered(self, place: int) -> "PacketObservations":
        """Return the packet with a lost pair; see `Observations`."""
        return replace(self, data=self.data.renumbered(place, self.form.settings.data_pairs))

    @one_thread()
    def decode(self, state: ArrayState, observe: Observer, /) -> Decoded:
        """Decode by samples at the LEDs, then by the equaliser; see `Observations`."""
        check_mode(self.mode, self.form.settings.data_pairs)
        # the packet's header shows the visible LEDs
        led_gains = with_brightness(self.led_gains, state.led_gains)
        packet = replace(self, led_gains=led_gains, confirmed=state.confirmed)
        return packet._decode_all(state.buffer if self.decoding.combining else None, observe)

    def _decode_all(self, buffer: SoftBuffer | None, observe: Observer) -> Decoded:
        as_kept = Assumption(self._gains(), self.cutouts)
        sampled = self._decode_samples(as_kept)
        if sampled is not None and not open_words(sampled):
            # the pose is confirmed after the packet is returned
            return Decoded(sampled, learn=lambda: self._learn_from_samples(as_kept, sampled, buffer))
        first = as_kept.steady
        attempt, misled, buffer = self._equalise(first, sampled, buffer, observe)
        cutouts = None if attempt.assumed.cutouts is first.cutouts else tuple(attempt.assumed.cutouts)
        words = attempt.words if sampled is None else with_raw(attempt.words, sampled)
        return Decoded(words, lambda: self._learn(attempt, misled), buffer, cutouts)

    def _equalise(
        self, first: Assumption, sampled: Words | None, buffer: SoftBuffer | None, observe: Observer
    ) -> tuple[DecodeAttempt, bool, SoftBuffer | None]:
        """Equalise and decode; also return True if the poses were wrong, and the new buffer."""

        def read(assumed: Assumption) -> DecodedPacket[ObservedPacket]:
            known = sampled if assumed.cutouts is first.cutouts else self._decode_samples(assumed)
            return self._decode(assumed, buffer, known, observe)

        def read_with(known: Words | None) -> DecodeAttempt:
            return read_packet(first, lambda assumed: self._decode(assumed, buffer, known, observe))

        if self._is_unconfirmed:
            attempt, misled = verify_first_packet(first, sampled, read_with)
        else:
            attempt, misled = read_packet(first, read), False
        if misled:
            attempt = attempt.best_of(read_packet(first, read))
        return attempt, misled, attempt.decoded.buffer

    def _decode_samples(self, assumed: Assumption, quick: bool = False) -> Words | None:
        """Codewords by samples at the LEDs, after the first round if quick; None without samples."""
        decoding = self.decoding
        if not decoding.led_by_led or decoding.feedback == "none":
            return None
        # behind a post the scale of the LLRs is wrong; max-log needs the proportions only
        options = replace(decoding.options, algorithm="max-log")
        cutouts, place = self._with_lone(assumed), (self.form, self.identity, options)
        soft = decoding.feedback in ("soft", "propagation")
        if _out_of_step(cutouts):
            return decode_per_quad(cutouts, self.light.gain, *place, soft=soft, quick=quick)
        sampled = decode_per_led(cutouts, *place)
        if sampled is None or quick or open_words(sampled) in (0, sum(map(len, sampled.values()))):
            return sampled
        # decoded codewords show the residue of decoded light in the others
        return decode_per_quad(cutouts, self.light.gain, *place, sampled, soft=soft) or sampled

    def _decode(
        self, assumed: Assumption, buffer: SoftBuffer | None, known: Words | None, observe: Observer
    ) -> DecodedPacket[ObservedPacket]:
        """Equalise and decode the unknown codewords, with the buffer."""
        decoding, light, noise = self.decoding, self.light, self._noise(assumed)
        observed = ObservedPacket.of(self._with_lone(assumed), noise, self.form, assumed.led_gains)
        channel = GainAndNoise(min(light.gain, light.full_scale), noise.lit, light.full_scale)
        return decode_iteratively(
            observed, channel, self.form, self.identity, decoding.options, buffer, decoding.feedback, observe, known
        )

    def _with_lone(self, assumed: Assumption) -> list[Cutout | None]:
        """All cut-outs, completed by estimates from unpaired frames."""
        cutouts, gain, values = [*assumed.cutouts], self.light.sum_gain, assumed.led_gains.values
        for place, lone in self.data.lone_cutouts(self.late_s, gain, values).items():
            cutouts[place] = lone
        return cutouts

    def _noise(self, assumed: Assumption) -> Noise:
        """Noise of the cut-outs."""
        seen = [cutout for cutout in assumed.cutouts if cutout is not None]
        if self.decided_noise is not None:
            return Noise(self.decided_noise, noise_beside(seen, self._side))
        # an occluder is uneven too
        whole = [cutout for cutout in seen if cutout.in_sight is None]
        gain, values, even = self.light.gain, assumed.led_gains.values, self.even
        even_cutouts = whole if len(whole) > 1 else seen
        if even is None or not _out_of_step(seen):
            return measure_noise(even_cutouts, gain, self._side, values)
        # the sum of pairs out of step is uneven, that of a header even; a quarter of the pairs is enough
        noise = measure_noise(even_cutouts[::4], gain, self._side, values)
        return Noise(min(measure_noise([even], gain, self._side, values).lit, noise.lit), noise.dark)

    @property
    def _is_unconfirmed(self) -> bool:
        """True if the equaliser must still confirm the track."""
        return self.led_gains is not None and not self.confirmed

    @one_thread()
    def _learn_from_samples(self, assumed: Assumption, sampled: Words, buffer: SoftBuffer | None) -> ArrayState:
        """State of the array after a packet that samples at the LEDs decoded completely."""
        if self._is_unconfirmed:
            attempt, misled, buffer = self._equalise(assumed.steady, sampled, buffer, ignore)
            return replace(self._learn(attempt, misled), buffer=buffer)
        return ArrayState(self._brightness_by_samples(assumed, sampled), self.confirmed)

    @one_thread()
    def _learn(self, attempt: DecodeAttempt, misled: bool) -> ArrayState:
        """State of the array after a packet that was equalised."""
        confirms = self._is_unconfirmed and not misled and attempt.open < sum(map(len, attempt.words.values()))
        assumed, led_gains = attempt.assumed.led_gains, self.led_gains
        if led_gains is not None and (attempt.open or not assumed.brightness.settled):
            led_gains = _learnt_from(attempt.decoded, assumed)
        return ArrayState(led_gains, self.confirmed or confirms, misled)

    def _brightness_by_samples(self, assumed: Assumption, sampled: Words) -> LedGains | None:
        """Gains with the brightness of the LEDs by a packet decoded from samples, unless it is known."""
        if self.led_gains is None or self.led_gains.brightness.learnt or _out_of_step(assumed.cutouts):
            return self.led_gains
        # pairs that show the brightness
        stride = assumed.led_gains.brightness.stride
        kept = [
            None if k % stride or cutout is None or cutout.apart else cutout for k, cutout in enumerate(assumed.cutouts)
        ]
        if all(cutout is None for cutout in kept):
            return self.led_gains
        decoded = self._decode(replace(assumed, cutouts=kept).steady, None, sampled, ignore)
        return _learnt_from(decoded, assumed.led_gains, stride=1)

    def _gains(self) -> LedGains:
        return self.led_gains or LedGains.sound(self._side)

    @property
    def _side(self) -> int:
        return self.form.settings.side


def _out_of_step(cutouts: Sequence[Cutout | None]) -> bool:
    """Return True if any pair was combined of frames out of step."""
    return any(cutout is not None and cutout.combination is not None for cutout in cutouts)


def with_brightness(led_gains: LedGains | None, learnt: LedGains | None) -> LedGains | None:
    """LED gains with the brightness learnt from the packet before."""
    if learnt is None:
        return led_gains
    faded = learnt.faded()
    return faded if led_gains is None else replace(led_gains, brightness=faded.brightness)


def _learnt_from(decoded: DecodedPacket[ObservedPacket], led_gains: LedGains, stride: int | None = None) -> LedGains:
    """LED gains with the brightness learnt from a decoded packet."""
    channel = decoded.channel
    learnt = decoded.observed.estimate_brightness(decoded.mean, decoded.variance, channel.gain, channel.noise, stride)
    return replace(led_gains, brightness=learnt)
