"""The plain receiver's reader: luminances at the LEDs' image positions, FHWT, one decoding."""

from copy import copy

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.acquire.format_reader import FormatReader
from heliograph.receive.acquire.header import header_score, header_weights
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.events import DecodeEvent, ExtractEvent, Observer
from heliograph.receive.packets import Packet, Words
from heliograph.receive.plain.extract import luminances, normalised, pair_luminances
from heliograph.receive.reader_protocol import ReadHeader
from heliograph.receive.settings import Equaliser
from heliograph.receive.timing.frame_pair import FramePair, LoneFrame, MeasuredHeader
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.kept_pairs import renumbered
from heliograph.receive.track.lone_frames import around, state_between
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.formats import AGREED, Format, check_mode
from heliograph.signal.packet import PacketFormat


class PlainReader:
    """Reads a packet as the paper does; see `array.PacketReader`.

    Parameters
    ----------
    identity
        Number of the array, 0 to 29.
    form
        The agreed format of packets; the plain receiver reads no other.
    tracker
        Follows the array from pair to pair.
    equaliser
        How the LEDs are read, as in `pair_luminances`.
    options
        How codewords are decoded: algorithm and iterations.
    observe
        Gets an `ExtractEvent` each pair.
    """

    def __init__(
        self,
        identity: int,
        form: PacketFormat,
        tracker: Tracker,
        equaliser: Equaliser,
        options: Decoding,
        observe: Observer,
    ):
        self._identity, self._form, self._tracker = identity, form, tracker
        self._equaliser, self._options, self._observe = equaliser, options, observe
        pairs, side = form.settings.data_pairs, form.settings.side
        self._luminances = np.zeros((pairs, side, side))
        self._seen = np.zeros(pairs, dtype=bool)
        self._format_reader = FormatReader(identity, side)
        self._gain = 0.0
        self._lone: dict[int, LoneFrame] = {}
        self._states: dict[int, PoseState] = {}
        self._sums: dict[int, Floats] = {}
        self._sum_gain = 0.0

    @property
    def format(self) -> Format:
        """The agreed one."""
        return AGREED

    @property
    def misled(self) -> bool:
        """It reads LED by LED."""
        return False

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> ReadHeader:
        """Refine the pose by a header pair; see `PacketReader`."""
        track, side = tracked.track, self._form.settings.side
        if tracked.seen:
            poses = track.state.pose_at(pair.pattern.time_s), track.state.pose_at(pair.inverted.time_s)
            self._format_reader.take(number, pair, poses, track.shining)
            self._gain = track.data_gain
        weights = header_weights(self._identity, AGREED.number, side)
        score = header_score(pair, track.state.pose, weights * track.shining, track.gain)
        return ReadHeader(self._tracker.refine(track, pair, weights) if tracked.seen else track, score)

    def end_header(self, header: MeasuredHeader) -> None:
        """Nothing is read of a header as a whole; see `PacketReader`."""

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Find the array by the sum; see `PacketReader`."""
        return self._tracker.follow(track, pair)

    def take(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Read the luminances of a pair; see `PacketReader`."""
        frames, state = (pair.pattern, pair.inverted), tracked.state
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        side, gain = self._form.settings.side, tracked.track.gain
        up, down = (luminances(frame, pose, side) for frame, pose in zip(frames, poses, strict=True))
        x = normalised(up - down, gain)
        if self._equaliser != "none":
            x = pair_luminances(frames, poses, gain, side, self._equaliser)
        self._luminances[place], self._seen[place] = x, True
        self._states[place], self._sums[place], self._sum_gain = state, up + down, gain
        self._observe(ExtractEvent(self._identity, frames, poses, x))

    def take_lone(self, place: int, lone: LoneFrame) -> None:
        """Keep the frame that is left of a pair; see `PacketReader`."""
        self._lone[place] = lone

    def renumbered(self, place: int) -> "PlainReader":
        """The same reader with the pairs from one on moved to the next number; see `PacketReader`."""
        other, pairs = copy(self), len(self._seen)
        other._luminances, other._seen = self._luminances.copy(), self._seen.copy()
        other._luminances[place + 1 :], other._seen[place + 1 :] = self._luminances[place:-1], self._seen[place:-1]
        other._luminances[place], other._seen[place] = 0.0, False
        other._lone = renumbered(self._lone, place, pairs)
        other._states, other._sums = renumbered(self._states, place, pairs), renumbered(self._sums, place, pairs)
        return other

    def decode(self, observe: Observer, /) -> Words:  # noqa: ARG002 - the protocol's
        """Codewords by layer; see `PacketReader`."""
        for place, lone in self._lone.items():
            self._read_lone(place, lone)
        check_mode(self._format_reader.number(self._gain))
        return decode_packet(self._luminances, self._seen, self._form, self._identity, self._options)

    def _read_lone(self, place: int, lone: LoneFrame) -> None:
        """Read the luminances of a pair by one of its frames, the sum being that of the pairs around."""
        chosen = around(place, self._sums)
        if not chosen:
            return
        pose = state_between(lone.frame.time_s, self._states, place).pose
        total = np.mean([self._sums[k] for k in chosen], axis=0)
        # 2 r - (r + r') = r - r'
        shown = 2 * luminances(lone.frame, pose, len(total)) - total
        self._luminances[place] = normalised(-shown if lone.inverted else shown, self._sum_gain)
        self._seen[place] = True

    def shown(self, packet: Packet) -> DecodeEvent:
        """The packet with its luminances; see `PacketReader`."""
        return DecodeEvent(self._identity, packet, luminances=self._luminances)

    def next(self) -> "PlainReader":
        """The reader of the next packet."""
        return PlainReader(self._identity, self._form, self._tracker, self._equaliser, self._options, self._observe)

    def learn_from(self, before: "PlainReader") -> None:
        """Nothing is learnt of a packet; see `PacketReader`."""
