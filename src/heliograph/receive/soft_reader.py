"""The soft receiver's reader: collects the cut-outs of a packet for joint decoding."""

from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.receive.decode.observations import PacketBuffer
from heliograph.receive.decode.soft_packet import Light, PacketObservations, SoftDecoding, with_brightness
from heliograph.receive.decode.worker import ArrayState
from heliograph.receive.detect.header_bank import header_score, header_weights
from heliograph.receive.detect.header_format import FormatReader
from heliograph.receive.equalise.led_gains import LearntGains, LedGains
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import ExtractEvent, Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, UnpairedFrame
from heliograph.receive.track.track import Track, TrackedPair, dark_zone, mask_occluded
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.formats import AGREED, Format, known_format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

MAX_HEADER_FITS = 3
"""Maximum fits of a header pair: each change of an LED's gain asks for another fit, and the gain may alternate."""


class SoftReader:
    """Reads a packet at the limit of the channel; see `array.PacketReader`."""

    def __init__(
        self,
        identity: int,
        form: PacketFormat,
        tracker: Tracker,
        decoding: SoftDecoding,
        observe: Observer,
        led_gains: LedGains | None = None,
        confirmed: bool = False,
    ):
        self._identity, self._agreed, self._tracker, self._decoding = identity, form, tracker, decoding
        self._observe, self._led_gains, self._confirmed = observe, led_gains, confirmed
        self._settings, self._side = form.settings, form.settings.side
        _, data = light_centroids(self._settings.slot_order)
        # the data's light was in the middle of the exposure, or about it
        self._late_s = (data - 0.5) * self._settings.pattern_period_s
        self._format_reader = FormatReader(identity, self._side, self._settings.data_pairs)
        self._format = AGREED
        # (n, n) gains of the LEDs in the header's last pair, 0 if hidden
        self._shining = np.ones((self._side, self._side))
        self._headers = list[tuple[FramePair, tuple[Pose, Pose]]]()
        # the header out of step, its frames combined to one pair
        self._even: Cutout | None = None
        self._decisions: DecisionDirectedTracker | None = None
        self._light, self._data = Light(), PacketBuffer()

    @property
    def format(self) -> Format:
        """Format of the packet, as far as the header has shown."""
        return self._format

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> tuple[Track, float]:
        """Read the format, refine the pose and update the LED gains; see `PacketReader`."""
        track = tracked.track
        if tracked.seen:
            # cells may be hidden since the detection
            self._led_gains = self._led_gains or LedGains.in_sight(track.led_gains)
            track = replace(track, led_gains=self._led_gains.values)
            state = track.state  # as the pairs before have refined it
            poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
            self._format_reader.add_pair(number, pair, poses, track.shining)
            self._light = replace(self._light, gain=track.data_gain)
            self._shining = track.shining
            self._headers.append((pair, poses))
            self._read_format()
        # later pairs are dimmed if they signal a format
        signalled = self.format.number if number else 0
        weights = header_weights(self._identity, signalled, self._side, pair.combination)
        score = header_score(pair, tracked.state.pose, weights * track.shining, track.gain)
        if tracked.seen:
            track, self._led_gains = self._learn(pair, weights, tracked.before, track, self._gains())
        return track, score

    def end_header(self, header: MeasuredHeader) -> None:
        """Read noise and format from a header out of step; see `PacketReader`."""
        if header.pair is None or header.frames is None:
            return
        pose = header.frames.pose
        self._even = take_cutout(header.pair, (pose, pose), self._side)
        if self._headers:
            self._format_reader.add_frames(header.frames, self._shining)
            self._read_format()

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Track the array by the sum, or by decisions in the single mode; see `PacketReader`."""
        if self.format.mode != "single":
            return self._tracker.follow(track, pair)
        if self._decisions is None:
            self._decisions = self._begin_decisions(pair.late_s, track)
        return self._decisions.follow(track, pair)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Add the cut-outs of a pair; see `PacketReader`."""
        track = tracked.track
        sum_gain = self._light.sum_gain
        if tracked.cutouts:
            cutouts, self._data = tracked.cutouts, self._data.with_patterns(place, tracked.cutouts)
        else:
            cutouts, in_step = (self._cutout(pair, track, self._gains()),), pair.combination is None
            self._data = self._data.with_pair(place, cutouts[0], track, in_step)
            sum_gain = track.gain if in_step else sum_gain
        self._light = Light(track.data_gain, pair.pattern.full_scale, sum_gain)
        poses = tuple(pose for cutout in cutouts for pose in cutout.poses)
        self._observe(ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses))

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Add the remaining frame of a pair; see `PacketReader`."""
        self._data = self._data.with_lone(place, lone)

    def observations(self) -> PacketObservations:
        """Return the cut-outs of all pairs, with the light and LED gains of the array; see `PacketReader`."""
        return PacketObservations(
            self._identity,
            PacketFormat(self._settings, self._format),
            self._decoding,
            self._format_reader.decide_format(self._light.gain),
            self._data.trimmed,
            self._light,
            None if self._led_gains is None else self._led_gains.without_evidence,
            self._late_s,
            self._even,
            None if self._decisions is None else self._decisions.noise.lit,
        )

    def next(self, state: ArrayState | None, confirmed: bool) -> "SoftReader":
        """Make the reader of the next packet with the LED gains; see `PacketReader`."""
        led_gains = self._led_gains
        if state is not None:
            led_gains, confirmed = state.led_gains, confirmed or state.confirmed
            # the evidence of headers stays valid for the same visible LEDs
            if self._led_gains and led_gains and np.array_equal(led_gains.sight, self._led_gains.sight):
                led_gains = replace(led_gains, header_statistics=self._led_gains.header_statistics)
        else:
            confirmed = confirmed or self._confirmed
        led_gains = led_gains and led_gains.faded()
        shared = self._agreed, self._tracker, self._decoding, self._observe
        return SoftReader(self._identity, *shared, led_gains, confirmed)

    def update(self, state: ArrayState) -> None:
        """Use the LED brightness; the packet's header shows the visible LEDs; see `PacketReader`."""
        self._led_gains, self._confirmed = with_brightness(self._led_gains, state.led_gains), state.confirmed

    def _learn(
        self, pair: FramePair, weights: Floats, before: Track, track: Track, led_gains: LedGains
    ) -> tuple[Track, LedGains]:
        """Refine the pose by a header pair and update the LED gains; again while they change the pose."""
        for _ in range(MAX_HEADER_FITS):
            track = self._tracker.refine(track, pair, weights)
            if pair.combination is not None or np.any(np.abs(weights) != 1):
                # combined frames do not show gains; dimmed cells are another pattern than the headers before
                break
            cutout = self._cutout(pair, track, led_gains).steady
            if cutout.apart:
                # light smears within an exposure: LEDs would seem dim and bias the pose, and more LEDs seem dim
                break
            learnt = self._learn_gains(cutout, weights, track, led_gains)
            # LEDs that packets showed and that vanish together are hidden, not dead: data will show when they come back
            gone = (learnt.led_gains.sight == 0) & (led_gains.sight > 0) & self._confirmed
            hidden = dark_zone(gone, track.state.pose)
            led_gains = learnt.led_gains.with_visibility(np.where(hidden, led_gains.sight, learnt.led_gains.sight))
            change = np.where(hidden, 0.0, track.change)
            track = replace(track, data_gain=learnt.gain, led_gains=led_gains.values, change=change)
            if not learnt.changed:
                break
            unrefined = replace(track, state=before.state, change=np.where(hidden, 0.0, before.change))
            track = self._tracker.follow(unrefined, pair, weights).track
        return track, led_gains

    @one_thread()
    def _learn_gains(self, cutout: Cutout, header: Floats, track: Track, led_gains: LedGains) -> LearntGains:
        return led_gains.learn(cutout, header, track.data_gain, track.uncovered)

    @one_thread()
    def _begin_decisions(self, late_s: float, track: Track) -> DecisionDirectedTracker:
        times, headers = (late_s, self._late_s), list(self._headers)
        return DecisionDirectedTracker(self._tracker, times, headers, track.data_gain, track.shining)

    def _cutout(self, pair: FramePair, track: Track, led_gains: LedGains) -> Cutout:
        """Cut-out of a pair at the poses of the data's light, the background's motion not compensated."""
        late_s, combination = (self._late_s, self._late_s), pair.combination
        if combination is not None:
            period_s = self._settings.pattern_period_s
            first, second = ((time - combination.sum_time) * period_s for time in combination.data_times)
            late_s = first, second
        poses = _poses_at(track, pair, late_s)
        cutout = take_cutout(pair, poses, self._side, (track.gain, led_gains.values))
        return cutout if track.all_visible else mask_occluded(cutout, track.visible)

    def _read_format(self) -> None:
        """Read the format that the header has shown so far, by the light of data."""
        self._format = known_format(self._format_reader.decide_format(self._light.gain), self._settings.data_pairs)

    def _gains(self) -> LedGains:
        return self._led_gains or LedGains.sound(self._side)


def _poses_at(track: Track, pair: FramePair, late_s: tuple[float, float]) -> tuple[Pose, Pose]:
    """Poses at times after the starts of the two frames of a pair."""
    state = track.state
    return state.pose_at(pair.pattern.time_s + late_s[0]), state.pose_at(pair.inverted.time_s + late_s[1])
