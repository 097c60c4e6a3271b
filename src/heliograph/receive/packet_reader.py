"""The soft receiver's reader: a packet's frames are kept until its end, equalised and decoded together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.acquire.format_reader import FormatReader
from heliograph.receive.acquire.header import header_score, header_weights
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.gain_and_noise import GainAndNoise
from heliograph.receive.decode.iterate import decode_iteratively
from heliograph.receive.decode.observed import DecodedPacket
from heliograph.receive.decode.soft_combining import SharedBuffer
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.threads import one_thread
from heliograph.receive.events import DecodeEvent, ExtractEvent, Observer
from heliograph.receive.image.pose import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise, measure_noise, noise_beside
from heliograph.receive.packets import Codeword, Packet
from heliograph.receive.reader_protocol import ReadHeader
from heliograph.receive.settings import Feedback
from heliograph.receive.timing.frame_pair import FramePair, LoneFrame, MeasuredHeader
from heliograph.receive.track.background import SeenHeader
from heliograph.receive.track.decision_directed import DecidedPair, DecisionDirectedTracker
from heliograph.receive.track.lone_frames import SeenPair, lone_cutout
from heliograph.receive.track.pose_refinement import ObservedPacket
from heliograph.receive.track.realign import realigned
from heliograph.receive.track.tracker import Track, TrackedPair, Tracker
from heliograph.signal.formats import Format, check_mode, known_format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

PULLED_PX = 0.5
"""Error of a pose in px, by the power of differences, from which on a packet is read once more without it.

Of poses that are right that power errs by 0.1 px rms at 63 m, and by 0.3 px at most at 95 m.
"""

RELEARN = 3
"""Most times a header pair is fitted, once more whenever it shows that an LED has failed or come back."""


@dataclass(frozen=True, slots=True)
class SoftParts:
    """What the readers of an array's packets share.

    Attributes
    ----------
    form
        The agreed format of packets.
    tracker
        Follows the array from pair to pair.
    buffer
        What was seen of its codewords before; None adds nothing.
    options
        Algorithm of the channel decoder, and its most iterations.
    feedback
        What the equaliser gets back from the decoder.
    observe
        Gets an `ExtractEvent` each pair and an `EqualiseEvent` each iteration.
    """

    form: PacketFormat
    tracker: Tracker
    buffer: SharedBuffer | None
    options: Decoding
    feedback: Feedback
    observe: Observer


class SoftReader:
    """Reads a packet at the limit of the channel; see `array.PacketReader`.

    Parameters
    ----------
    identity
        Number of the array, 0 to 29.
    parts
        What all its readers share.
    led_gains
        Gains of its LEDs by earlier packets; None takes those of the detection.
    """

    def __init__(self, identity: int, parts: SoftParts, led_gains: LedGains | None = None):
        self._identity, self._parts, self._led_gains = identity, parts, led_gains
        self._side = parts.form.settings.side
        self._cutouts: list[Cutout | None] = []
        self._seen: dict[int, SeenPair] = {}
        self._lone: dict[int, LoneFrame] = {}
        self._sum_gain = 0.0
        self._even: Cutout | None = None
        self._gain, self._full_scale = 0.0, math.inf
        self._shining = np.ones((self._side, self._side))
        self._format_reader = FormatReader(identity, self._side)
        self._form: PacketFormat | None = None
        self._headers: list[SeenHeader] = []
        self._decisions: DecisionDirectedTracker | None = None
        self._decided: DecidedPair | None = None
        _, data = light_centroids(parts.form.settings.slot_order)
        # the data's light was in the middle of the exposure, or about it
        self._late_s = (data - 0.5) * parts.form.settings.pattern_period_s

    @property
    def format(self) -> Format:
        """The packet's format, as far as its header has shown it."""
        return self._form.format if self._form else known_format(self._format_reader.number(self._gain))

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> ReadHeader:
        """Read the format, refine the pose and learn the LEDs' gains; see `PacketReader`."""
        track = tracked.track
        if tracked.seen:
            # cells may be known to be hidden since the detection
            self._led_gains = self._led_gains or LedGains.in_sight(track.led_gains)
            track = replace(track, led_gains=self._led_gains.values)
            self._take_format(number, pair, track)
        # the later pairs are dimmed where a format is signalled
        signalled = self.format.number if number else 0
        weights = header_weights(self._identity, signalled, self._side, pair.combination)
        score = header_score(pair, tracked.state.pose, weights * track.shining, track.gain)
        return ReadHeader(self._learn(pair, weights, tracked.before, track) if tracked.seen else track, score)

    def end_header(self, header: MeasuredHeader) -> None:
        """Take a header out of step: its even sum for the noise, its frames for the format; see `PacketReader`."""
        if header.pair is None or header.frames is None:
            return
        pose = header.frames.pose
        self._even = take_cutout(header.pair, (pose, pose), self._side)
        if self._headers and self._led_gains is not None:
            self._format_reader.take_frames(header.frames, self._shining)

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Find the array by the sum, or where there are no inverses by decisions; see `PacketReader`."""
        if not self._known().single:
            return self._parts.tracker.follow(track, pair)
        if self._decisions is None:
            self._decisions = self._begin_decisions(pair.late_s, track)
        self._decided = self._decisions.follow(track, pair)
        return self._decided.tracked

    def take(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Keep a pair; see `PacketReader`."""
        self._gain, self._full_scale = tracked.track.data_gain, pair.pattern.full_scale
        cutouts: Sequence[Cutout] = (
            [self._cutout(pair, tracked.track)] if self._decided is None else self._decided.cutouts
        )
        self._cutouts[len(cutouts) * place : len(cutouts) * (place + 1)] = cutouts
        if self._decided is None and pair.combination is None:
            self._seen[place] = SeenPair(tracked.state, cutouts[0])
            self._sum_gain = tracked.track.gain
        poses = tuple(pose for cutout in cutouts for pose in cutout.poses)
        self._parts.observe(ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses))

    def take_lone(self, place: int, lone: LoneFrame) -> None:
        """Keep the frame that is left of a pair; see `PacketReader`."""
        self._lone[place] = lone

    @one_thread()
    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Codewords by layer, of all pairs kept."""
        check_mode(self._format_reader.number(self._gain))
        form, led_gains = self._known(), self._gains()
        decoded = self._attempt(form, led_gains)
        words = decoded.words
        if _open(words) and led_gains.doubtful:
            # a header before a bright background may have made LEDs seem dead that are not
            sound = self._attempt(form, LedGains.sound(self._side))
            if _open(sound.words) < _open(words):
                led_gains, decoded = LedGains.sound(self._side), sound
            words = {name: tuple(map(_better, words[name], sound.words[name])) for name in words}
        if _open(words) and not form.single:
            # what shines beside the array may have pulled the poses that sums show
            cutouts, largest_px = realigned(self._cutouts, led_gains.values)
            if largest_px > PULLED_PX:
                self._cutouts = cutouts
                again = self._attempt(form, led_gains)
                if _open(again.words) < _open(words):
                    decoded = again
                words = {name: tuple(map(_better, words[name], again.words[name])) for name in words}
        if self._led_gains is not None and (_open(words) or not led_gains.brightness.settled):
            channel = decoded.channel
            learnt = decoded.observed.learnt(decoded.mean, decoded.variance, channel.gain, channel.noise)
            self._led_gains = replace(led_gains, brightness=learnt)
        if self._parts.buffer is not None and decoded.buffer is not None:
            self._parts.buffer.keep(decoded.buffer)
        return words

    def shown(self, packet: Packet) -> DecodeEvent:
        """The packet with the cut-outs of its pairs; see `PacketReader`."""
        return DecodeEvent(self._identity, packet, cutouts=tuple(self._cutouts))

    def next(self) -> "SoftReader":
        """The reader of the next packet; it knows the LEDs."""
        return SoftReader(self._identity, self._parts, None if self._led_gains is None else self._led_gains.faded())

    def _take_format(self, number: int, pair: FramePair, track: Track) -> None:
        """Take what a header pair shows of the format, and keep the pair."""
        state = track.state  # as the pairs before have refined it
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        self._shining = track.shining
        self._format_reader.take(number, pair, poses, self._shining)
        self._headers.append(SeenHeader(pair, poses))
        self._gain = track.data_gain

    def _learn(self, pair: FramePair, weights: Floats, before: Track, track: Track) -> Track:
        """Refine the pose by a header pair, and learn the LEDs' gains; again while these change the pose."""
        for _ in range(RELEARN):
            track = self._parts.tracker.refine(track, pair, weights)
            if pair.combination is not None or np.any(np.abs(weights) != 1):
                # combined frames do not show it; dimmed cells are another pattern than those that are summed up
                return track
            learnt, gain, changed = self._learn_gains(pair, weights, track)
            self._led_gains = learnt
            track = replace(track, data_gain=gain, led_gains=learnt.values)
            if not changed:
                return track
            before_it = replace(track, state=before.state, change=before.change)
            track = self._parts.tracker.follow(before_it, pair, weights).track
        return track

    @one_thread()
    def _learn_gains(self, pair: FramePair, header: Floats, track: Track) -> tuple[LedGains, float, bool]:
        learnt = self._gains().learn(self._cutout(pair, track), header, track.data_gain, track.in_sight)
        return learnt.led_gains, learnt.gain, learnt.changed

    @one_thread()
    def _begin_decisions(self, late_s: float, track: Track) -> DecisionDirectedTracker:
        return DecisionDirectedTracker(
            self._parts.tracker, (late_s, self._late_s), self._headers, track.data_gain, track.shining
        )

    def _attempt(self, form: PacketFormat, led_gains: LedGains) -> DecodedPacket[ObservedPacket]:
        """Decode all that was kept, LEDs having given gains."""
        parts, noise = self._parts, self._noise(led_gains.values)
        observed = ObservedPacket.of(self._with_lone(led_gains.values), noise, form, led_gains)
        channel = GainAndNoise(min(self._gain, self._full_scale), noise.lit, self._full_scale)
        earlier = None if parts.buffer is None else parts.buffer.content
        return decode_iteratively(
            observed, channel, form, self._identity, parts.options, earlier, parts.feedback, parts.observe
        )

    def _with_lone(self, led_gains: Floats) -> list[Cutout | None]:
        """All cut-outs, those of frames included whose other half is lost."""
        cutouts = [*self._cutouts]
        for place, lone in self._lone.items():
            cutouts[place] = lone_cutout(lone, place, self._seen, self._late_s, self._sum_gain, led_gains)
        return cutouts

    def _noise(self, led_gains: Floats) -> Noise:
        """Noise of the cut-outs."""
        seen = [cutout for cutout in self._cutouts if cutout is not None]
        if self._decisions is not None:
            return Noise(self._decisions.noise.lit, noise_beside(seen, self._side))
        # what hides a part of the array is uneven too
        whole = [cutout for cutout in seen if cutout.in_sight is None]
        noise = measure_noise(whole if len(whole) > 1 else seen, self._gain, self._side, led_gains)
        if self._even is None or not any(cutout.combination for cutout in seen):
            return noise
        # of pairs out of step the sum is uneven, but not that of a header
        even = measure_noise([self._even], self._gain, self._side, led_gains)
        return Noise(min(even.lit, noise.lit), noise.dark)

    def _cutout(self, pair: FramePair, track: Track) -> Cutout:
        """Cut-out of a pair where the data's light was, the background's motion compensated."""
        late_s, combination = (self._late_s, self._late_s), pair.combination
        if combination is not None:
            period_s = self._parts.form.settings.pattern_period_s
            first, second = ((time - combination.sum_time) * period_s for time in combination.data_times)
            late_s = first, second
        poses = _poses_at(track, pair, late_s)
        cutout = take_cutout(pair, poses, self._side)
        if not track.in_sight.all():
            cutout = replace(cutout, in_sight=track.in_sight)
        return cutout.motion_compensated(track.gain, self._gains().values)

    def _gains(self) -> LedGains:
        return self._led_gains or LedGains.sound(self._side)

    def _known(self) -> PacketFormat:
        """The packet's format, once its header is over."""
        if self._form is None:
            self._form = PacketFormat(self._parts.form.settings, self.format)
            self._cutouts = [None] * self._form.layers["high"].pairs
        return self._form


def _poses_at(track: Track, pair: FramePair, late_s: tuple[float, float]) -> tuple[Pose, Pose]:
    """Poses at times after the starts of a pair's two frames."""
    state = track.state
    return state.pose_at(pair.pattern.time_s + late_s[0]), state.pose_at(pair.inverted.time_s + late_s[1])


def _open(words: dict[str, tuple[Codeword, ...]]) -> int:
    """Codewords that are not decoded."""
    return sum(word.status == "crc_fail" for by in words.values() for word in by)


def _better(one: Codeword, other: Codeword) -> Codeword:
    """The one that was decoded."""
    return other if one.status == "crc_fail" else one
