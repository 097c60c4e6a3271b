"""Packets of the soft receiver: samples at the LEDs are decoded first, then the equaliser reads all frames together.

If codewords fail, the packet is read again with other LEDs or other poses assumed.
"""

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from heliograph.base.threads import one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.header_reader import HeaderReader, data_late_s, take_data
from heliograph.receive.decode.per_led import decode_per_led
from heliograph.receive.decode.per_quad import decode_per_quad
from heliograph.receive.decode.turbo_equaliser import TurboEqualiser, decode_iteratively
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains, update_brightness
from heliograph.receive.equalise.pose_refinement import ObservedPacket, align_by_power
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import ExtractEvent, Observer, ignore
from heliograph.receive.observe.cutout import Cutout, Cutouts, Noise, measure_noise, noise_beside
from heliograph.receive.packet import Words, ok_flags, with_raw
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import Track, TrackedPair, mask_occluded_retroactively
from heliograph.signal.formats import AGREED, UnreadableModeError, check_mode
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings


class SoftPacket:
    """Observations of a packet by the soft receiver; see `worker.PacketObservations`."""

    def __init__(self, identity: int, signal: SignalSettings, options: Decoding):
        self.form, self.mode = PacketFormat(signal), AGREED.number
        self._identity, self._signal, self._options = identity, signal, options
        self._late_s = data_late_s(signal)
        # by number of the pair, in the single mode of the pattern
        self._cutouts = dict[int, Cutout]()
        # gray levels of the array with all LEDs on in a difference, in the sum of a pair in step, and of the sensor
        self._gain, self._sum_gain, self._full_scale = 0.0, 0.0, math.inf
        # gains of the LEDs, and a header out of step, its frames combined to a pair; None if unknown
        self._led_gains: LedGains | None = None
        self._header: Cutout | None = None
        # variance of a pixel inside the array by decided data, in squared gray levels; None with inverses
        self._decided_noise: float | None = None

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:
        """Add the cut-outs of a pair; see `PacketObservations`."""
        track, cutouts = tracked.track, tracked.cutouts
        if cutouts:
            # two patterns of the single mode, which has no inverses
            self._cutouts.update(enumerate(cutouts, len(cutouts) * place))
        else:
            cutouts = (cutout := take_data(pair, track, self._signal, self._late_s),)
            self._cutouts[place] = cutout
            if not track.all_visible:
                self._cutouts |= mask_occluded_retroactively(self._cutouts, place, track.visible)
            if pair.combination is None:
                self._sum_gain = track.gain
        self._full_scale = pair.pattern.full_scale
        poses = tuple(pose for cutout in cutouts for pose in cutout.poses)
        return ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses)

    def end(self, headers: HeaderReader, track: Track, decisions: DecisionDirectedTracker | None) -> None:
        """Take format, light and LED gains of the array; see `PacketObservations`."""
        self.form, self.mode = PacketFormat(self._signal, headers.format), headers.mode(track.data_gain)
        self._gain, self._header = track.data_gain, headers.combined
        self._led_gains = headers.led_gains and headers.led_gains.without_evidence
        self._decided_noise = None if decisions is None else decisions.noise.lit

    @property
    def cutouts(self) -> list[Cutout | None]:
        """Cut-outs of the pairs, in the single mode of the patterns; None for missing pairs."""
        return [self._cutouts.get(k) for k in range(self.form.layers["high"].pairs)]

    @one_thread()
    def has_codeword(self) -> bool:
        """Return True if samples at the LEDs decode to a codeword; see `PacketObservations`."""
        try:
            check_mode(self.mode, self._signal.data_pairs)
        except UnreadableModeError:
            return False
        sampled = self._decode_samples(self.cutouts, quick=True)
        return sampled is not None and any(ok_flags(sampled))

    def renumbered(self, place: int) -> "SoftPacket":
        """Return the packet with a lost pair; see `PacketObservations`."""
        moved, pairs = copy(self), self._signal.data_pairs
        moved._cutouts = {k + (k >= place): cutout for k, cutout in self._cutouts.items() if k + (k >= place) < pairs}
        return moved

    @one_thread()
    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:
        """Decode by samples at the LEDs, then by the equaliser; see `PacketObservations`."""
        # the packet's header shows the visible LEDs
        self._led_gains = update_brightness(self._led_gains, led_gains)
        led_gains = self._led_gains or LedGains.sound(self._signal.side)
        cutouts, earlier = self.cutouts, buffer if self._options.combining else None
        sampled = self._decode_samples(cutouts)
        if sampled is not None and not count_open(sampled):
            return Decoded(sampled, learn=lambda: self._learn_from_samples(cutouts, sampled))
        first = self._compensated(cutouts, led_gains)
        has_codeword = sampled is not None and count_open(sampled) < sum(map(len, sampled.values()))

        def equalise(assumed: Cutouts, gains: LedGains, known: Words | None) -> TurboEqualiser:
            known = known if assumed is first else self._decode_samples(assumed)
            return self._equalise(assumed, gains, known, earlier, observe)

        attempt = read_packet(first, led_gains, self.form, sampled if has_codeword else None, equalise)
        words = attempt.words if sampled is None else with_raw(attempt.words, sampled)
        moved = None if attempt.observed.cutouts is first else tuple(attempt.observed.cutouts)
        return Decoded(words, lambda: self._learn(attempt), attempt.buffer, moved)

    def _compensated(self, cutouts: Cutouts, led_gains: LedGains) -> Cutouts:
        """Cut-outs less the background's light that moves with the array: slow, and not needed for samples."""
        return [cutout and cutout.motion_compensated(self._sum_gain, led_gains.values) for cutout in cutouts]

    def _decode_samples(self, cutouts: Cutouts, quick: bool = False) -> Words | None:
        """Codewords by samples at the LEDs, after the first round if quick; None without samples."""
        if not self._options.led_by_led or self._options.feedback == "none":
            return None
        # behind a post the scale of the LLRs is wrong; max-log needs the proportions only
        options = replace(self._options, algorithm="max-log")
        if _is_out_of_step(cutouts):
            return decode_per_quad(cutouts, self._gain, self.form, self._identity, options, quick=quick)
        sampled = decode_per_led(cutouts, self.form, self._identity, options)
        if sampled is None or quick or count_open(sampled) in (0, sum(map(len, sampled.values()))):
            return sampled
        # decoded codewords show the residue of decoded light in the others
        return decode_per_quad(cutouts, self._gain, self.form, self._identity, options, sampled) or sampled

    def _equalise(
        self, cutouts: Cutouts, led_gains: LedGains, known: Words | None, buffer: SoftBuffer | None, observe: Observer
    ) -> TurboEqualiser:
        """Equalise and decode the unknown codewords, with the buffer."""
        observed = ObservedPacket(cutouts, self._noise(cutouts, led_gains), self.form, led_gains, self._full_scale)
        return decode_iteratively(observed, self._gain, self._identity, self._options, buffer, observe, known)

    def _noise(self, cutouts: Cutouts, led_gains: LedGains) -> Noise:
        """Noise of the cut-outs."""
        side, values = self._signal.side, led_gains.values
        pairs = [cutout for cutout in cutouts if cutout is not None]
        if self._decided_noise is not None:
            return Noise(self._decided_noise, noise_beside(pairs, side))
        # an occluder is uneven too
        whole = [cutout for cutout in pairs if cutout.in_sight is None]
        even = whole if len(whole) > 1 else pairs
        if self._header is None or not _is_out_of_step(pairs):
            return measure_noise(even, self._gain, side, values)
        # the sum of pairs out of step is uneven, that of a header even; a quarter of the pairs is enough
        noise = measure_noise(even[::4], self._gain, side, values)
        return Noise(min(measure_noise([self._header], self._gain, side, values).lit, noise.lit), noise.dark)

    @one_thread()
    def _learn(self, decoded: TurboEqualiser) -> LedGains | None:
        """Gains of the LEDs after a packet that was equalised, unless the brightness is known."""
        if self._led_gains is None or (decoded.observed.led_gains.known and not count_open(decoded.words)):
            return self._led_gains
        return decoded.observed.learn_gains(decoded.mean, decoded.variance, decoded.gain, decoded.noise)

    @one_thread()
    def _learn_from_samples(self, cutouts: Cutouts, sampled: Words) -> LedGains | None:
        """Gains of the LEDs after a packet decoded from samples, unless the brightness is known."""
        led_gains = self._led_gains
        if led_gains is None or led_gains.learnt or _is_out_of_step(cutouts):
            return led_gains
        # pairs that show the brightness
        stride = led_gains.stride
        chosen = [None if cutout and (k % stride or cutout.apart) else cutout for k, cutout in enumerate(cutouts)]
        if not any(chosen):
            return led_gains
        decoded = self._equalise(self._compensated(chosen, led_gains), led_gains, sampled, None, ignore)
        return decoded.observed.learn_gains(decoded.mean, decoded.variance, decoded.gain, decoded.noise, stride=1)


def read_packet(
    cutouts: Cutouts,
    led_gains: LedGains,
    form: PacketFormat,
    known: Words | None,
    equalise: Callable[[Cutouts, LedGains, Words | None], TurboEqualiser],
) -> TurboEqualiser:
    """Equalise a packet; if codewords fail, again with all LEDs assumed sound, then with other poses."""
    best = equalise(cutouts, led_gains, known)
    # while the brightness of unequal LEDs is unknown, codewords known by samples make the equaliser too sure
    if count_open(best.words) and known is not None and not led_gains.packets:
        best = best_of(best, equalise(cutouts, led_gains, None))
    # a header before a bright background may make LEDs seem hidden or failed
    if count_open(best.words) and led_gains.doubtful:
        best = best_of(best, equalise(cutouts, LedGains.sound(form.settings.side), known))
    # a bright neighbour may have shifted the poses of the sums; right poses err by 0.3 px at most
    if count_open(best.words) and not form.single:
        moved, largest_px = align_by_power(cutouts, best.observed.led_gains.values)
        if largest_px > 0.5:
            best = best_of(best, equalise(moved, best.observed.led_gains, known))
    return best


def best_of(first: TurboEqualiser, later: TurboEqualiser) -> TurboEqualiser:
    """Return the attempt with more codewords, the first if equal; with the codewords of both."""
    words = {
        name: tuple(b if a.status == "crc_fail" else a for a, b in zip(by, later.words[name], strict=True))
        for name, by in first.words.items()
    }
    best = later if count_open(later.words) < count_open(first.words) else first
    best.words = with_raw(words, first.words)
    return best


def count_open(words: Words) -> int:
    """Number of undecoded codewords."""
    return sum(word.status == "crc_fail" for by in words.values() for word in by)


def _is_out_of_step(cutouts: Cutouts) -> bool:
    """Return True if any pair was combined of frames out of step."""
    return any(cutout is not None and cutout.combination is not None for cutout in cutouts)
