"""The plain receiver's reader: luminances at the LEDs' image positions, FHWT, one decoding."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.decode.observations import renumbered
from heliograph.receive.decode.per_led import luminances, normalised, unblurred
from heliograph.receive.decode.worker import ArrayState, Decoded
from heliograph.receive.detect.header_bank import header_score, header_weights
from heliograph.receive.detect.header_format import FormatReader
from heliograph.receive.events import ExtractEvent, Observer
from heliograph.receive.settings import Equaliser
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, UnpairedFrame
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker
from heliograph.receive.track.unpaired_frames import interpolate_state, nearest_pairs
from heliograph.signal.formats import AGREED, Format, check_mode
from heliograph.signal.packet import PacketFormat


class PlainReader:
    """Reads a packet like the paper; see `array.PacketReader`."""

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
        self._format_reader = FormatReader(identity, side, pairs)
        self._gain = 0.0
        self._lone: dict[int, UnpairedFrame] = {}
        self._states: dict[int, PoseState] = {}
        self._sums: dict[int, Floats] = {}
        self._sum_gain = 0.0

    @property
    def format(self) -> Format:
        """Agreed format."""
        return AGREED

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> tuple[Track, float]:
        """Refine the pose by a header pair; see `PacketReader`."""
        track, side = tracked.track, self._form.settings.side
        if tracked.seen:
            poses = track.state.pose_at(pair.pattern.time_s), track.state.pose_at(pair.inverted.time_s)
            self._format_reader.add_pair(number, pair, poses, track.shining)
            self._gain = track.data_gain
        weights = header_weights(self._identity, AGREED.number, side)
        score = header_score(pair, track.state.pose, weights * track.shining, track.gain)
        return (self._tracker.refine(track, pair, weights) if tracked.seen else track), score

    def end_header(self, header: MeasuredHeader) -> None:
        """Ignore a header as a whole; see `PacketReader`."""

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Track the array by the sum; see `PacketReader`."""
        return self._tracker.follow(track, pair)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:
        """Read the luminances of a pair; see `PacketReader`."""
        frames, state = (pair.pattern, pair.inverted), tracked.state
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        side, gain = self._form.settings.side, tracked.track.gain
        up, down = (luminances(frame, pose, side) for frame, pose in zip(frames, poses, strict=True))
        inverse = self._equaliser == "inverse"
        x = unblurred(frames, poses, gain, side) if inverse else normalised(up - down, gain)
        self._luminances[place], self._seen[place] = x, True
        self._states[place], self._sums[place], self._sum_gain = state, up + down, gain
        self._observe(ExtractEvent(self._identity, frames, poses, x))

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Add the remaining frame of a pair; see `PacketReader`."""
        self._lone[place] = lone

    def observations(self) -> "LuminanceObservations":
        """Return the luminances and the unpaired frames; see `PacketReader`."""
        return LuminanceObservations(
            self._identity,
            self._form,
            self._options,
            self._format_reader.decide_format(self._gain),
            self._luminances,
            self._seen,
            self._lone,
            self._states,
            self._sums,
            self._sum_gain,
        )

    def next(self, state: ArrayState | None, confirmed: bool) -> "PlainReader":  # noqa: ARG002 - the protocol's
        """Make the reader of the next packet; see `PacketReader`."""
        return PlainReader(self._identity, self._form, self._tracker, self._equaliser, self._options, self._observe)

    def update(self, state: ArrayState) -> None:
        """Ignore the array's state; see `PacketReader`."""


@dataclass(frozen=True, slots=True)
class LuminanceObservations:
    """Observations of a packet by the plain receiver; see `worker.Observations`."""

    # Number of the array, 0 to 29
    identity: int
    # The agreed format of packets
    form: PacketFormat
    # Parameters of the channel decoder
    options: Decoding
    # Number of the format that the header signals
    mode: int
    # (pairs, n, n) difference of pattern and inverse at each LED
    luminances: Floats
    # (pairs,) True for visible pairs
    seen: NDArray[np.bool_]
    # Unpaired frames by number of the pair
    lone: Mapping[int, UnpairedFrame]
    # Pose of the array by number of the pair
    states: Mapping[int, PoseState]
    # (n, n) sum of pattern and inverse at each LED in gray levels, by number of the pair
    sums: Mapping[int, Floats]
    # Gray levels of a sum with all LEDs on
    sum_gain: float

    @property
    def cutouts(self) -> tuple[()]:
        """No cut-outs: the packet is decoded from luminances."""
        return ()

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `Observations`."""
        return False

    def renumbered(self, place: int) -> "LuminanceObservations":
        """Return the packet with the pairs from a lost one on moved to the next number; see `Observations`."""
        pairs, luminances, seen = len(self.seen), self.luminances.copy(), self.seen.copy()
        luminances[place + 1 :], seen[place + 1 :] = self.luminances[place:-1], self.seen[place:-1]
        luminances[place], seen[place] = 0.0, False
        return replace(
            self,
            luminances=luminances,
            seen=seen,
            lone=renumbered(self.lone, place, pairs),
            states=renumbered(self.states, place, pairs),
            sums=renumbered(self.sums, place, pairs),
        )

    def decode(self, state: ArrayState, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Decode the luminances; see `Observations`."""
        luminances, seen = self.luminances.copy(), self.seen.copy()
        for place, lone in self.lone.items():
            if (estimate := self._estimate_pair(place, lone)) is not None:
                luminances[place], seen[place] = estimate, True
        check_mode(self.mode, self.form.settings.data_pairs)
        words = decode_packet(luminances, seen, self.form, self.identity, self.options)
        return Decoded(words, luminances=luminances)

    def _estimate_pair(self, place: int, lone: UnpairedFrame) -> Floats | None:
        """Luminances (n, n) of a pair by the remaining frame and the sums of pairs around; None if impossible."""
        chosen = nearest_pairs(place, self.sums)
        if not chosen:
            return None
        pose = interpolate_state(lone.frame.time_s, self.states, place).pose
        total = np.mean([self.sums[k] for k in chosen], axis=0)
        # 2 r - (r + r') = r - r'
        difference = 2 * luminances(lone.frame, pose, len(total)) - total
        return normalised(-difference if lone.inverted else difference, self.sum_gain)
