"""Headers of an array: the format of the packets, refined poses, and the gains of the LEDs."""

from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.decode.header_format import FormatReader, header_score, header_weights
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.single_mode import HeaderPair
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader
from heliograph.receive.track.track import Track, TrackedPair, dark_zone, mask_occluded
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.formats import AGREED, known_format
from heliograph.signal.pwm import light_centroids
from heliograph.signal.settings import SignalSettings


class HeaderReader:
    """Reads the headers of an array; the receiver "plain" reads the agreed format and takes LEDs as equal."""

    def __init__(self, identity: int, signal: SignalSettings, is_plain: bool):
        self._identity, self._signal, self._is_plain = identity, signal, is_plain
        self._late_s = data_late_s(signal)
        # gains of the LEDs; None before the first header, and with "plain"
        self.led_gains: LedGains | None = None
        # True if a decoded packet confirmed the track
        self.confirmed = False
        self.start()

    def start(self) -> None:
        """Begin the next packet."""
        self._format_reader = FormatReader(self._identity, self._signal.side, self._signal.data_pairs)
        self.format = AGREED
        # header pairs, and a header out of step, its frames combined to a pair
        self.pairs = list[HeaderPair]()
        self.combined: Cutout | None = None
        # (n, n) gains of the LEDs in the last pair, 0 if hidden
        self._shining = np.ones((self._signal.side, self._signal.side))

    def mode(self, gain: float) -> int:
        """Number of the format that the header signals, by the light of data."""
        return self._format_reader.decide_format(gain)

    def read_pair(self, number: int, pair: FramePair, tracked: TrackedPair, tracker: Tracker) -> tuple[Track, float]:
        """Read a header pair; return the refined track, and the header's amplitude as a fraction of the light."""
        track, side = tracked.track, self._signal.side
        if tracked.seen:
            if not self._is_plain:
                # cells may be hidden since the detection
                self.led_gains = self.led_gains or LedGains(track.led_gains, np.ones((side, side)))
                track = replace(track, led_gains=self.led_gains.values)
            state = track.state  # as the pairs before have refined it
            poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
            self._format_reader.add_pair(number, pair, poses, track.shining)
            self._shining = track.shining
            self.pairs.append((pair, poses))
            self._read_format(track.data_gain)
        # later pairs are dimmed if they signal a format
        weights = header_weights(self._identity, self.format.number if number else 0, side, pair.combination)
        score = header_score(pair, tracked.state.pose, weights * track.shining, track.gain)
        return (self._refine(pair, weights, tracked, track, tracker) if tracked.seen else track), score

    def read_frames(self, header: MeasuredHeader, gain: float) -> None:
        """Read the format from a complete header that a camera out of step recorded."""
        if header.pair is None:
            return
        self.combined = take_cutout(header.pair, (header.pose, header.pose), self._signal.side)
        if self.pairs:
            self._format_reader.add_frames(header, self._shining)
            self._read_format(gain)

    def next(self, learnt: LedGains | None) -> None:
        """Begin the next packet, with the LED gains learnt from this packet; None if unchanged or unknown yet."""
        if learnt is not None and self.led_gains is not None and np.array_equal(learnt.sight, self.led_gains.sight):
            # the evidence of headers stays valid for the same visible LEDs
            learnt = replace(learnt, headers=self.led_gains.headers)
        led_gains = learnt or self.led_gains
        self.led_gains = led_gains and led_gains.faded()
        self.start()

    def _read_format(self, gain: float) -> None:
        if not self._is_plain:
            self.format = known_format(self.mode(gain), self._signal.data_pairs)

    def _refine(self, pair: FramePair, weights: Floats, tracked: TrackedPair, track: Track, tracker: Tracker) -> Track:
        """Refine the pose by a header pair and update the LED gains; again while they change the pose."""
        # the gain of an LED may alternate
        for _ in range(3):
            track = tracker.refine(track, pair, weights)
            if self.led_gains is None or pair.combination is not None or np.any(np.abs(weights) != 1):
                # combined frames do not show gains; dimmed cells are another pattern than the headers before
                break
            cutout = take_data(pair, track, self._signal, self._late_s)
            cutout = cutout.motion_compensated(track.gain, self.led_gains.values)
            if cutout.apart:
                # light smears within an exposure: LEDs would seem dim and bias the pose, and more LEDs seem dim
                break
            before = self.led_gains.sight
            learnt, gain, changed = self.led_gains.learn_header(cutout, weights, track.data_gain, track.uncovered)
            # LEDs that packets showed and that vanish together are hidden, not dead: data will show when they come back
            gone = (learnt.sight == 0) & (before > 0) & self.confirmed
            hidden = dark_zone(gone, track.state.pose)
            self.led_gains = replace(learnt, sight=np.where(hidden, before, learnt.sight))
            change = np.where(hidden, 0.0, track.change)
            track = replace(track, data_gain=gain, led_gains=self.led_gains.values, change=change)
            if not changed:
                break
            unrefined = replace(track, state=tracked.before.state, change=np.where(hidden, 0.0, tracked.before.change))
            track = tracker.follow(unrefined, pair, weights).track
        return track


def take_data(pair: FramePair, track: Track, signal: SignalSettings, late_s: float) -> Cutout:
    """Cut out a pair at the poses of the data's light, which is late as in `data_late_s` unless frames are combined."""
    first_s, second_s = late_s, late_s
    if pair.combination is not None:
        times = pair.combination.data_times
        first_s, second_s = ((time - pair.combination.sum_time) * signal.pattern_period_s for time in times)
    state = track.state
    poses = state.pose_at(pair.pattern.time_s + first_s), state.pose_at(pair.inverted.time_s + second_s)
    cutout = take_cutout(pair, poses, signal.side)
    return cutout if track.all_visible else mask_occluded(cutout, track.visible)


def data_late_s(signal: SignalSettings) -> float:
    """Seconds by which the data's light comes after the middle of an exposure."""
    _, data = light_centroids(signal.slot_order)
    return (data - 0.5) * signal.pattern_period_s
