"""Packets of the plain receiver: luminances at the LEDs' image positions, FHWT, one decoding."""

from copy import copy

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.per_led import luminances, normalised, pair_luminances
from heliograph.receive.decode.worker import Decoded, renumber
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import ExtractEvent, Observer
from heliograph.receive.settings import Equaliser
from heliograph.receive.sync.pairing import FramePair, UnpairedFrame
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.unpaired_frames import interpolate_state, nearest_pairs
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import PacketFormat


class PlainPacket:
    """Observations of a packet by the plain receiver; see `worker.PacketObservations`."""

    cutouts = ()

    def __init__(self, identity: int, form: PacketFormat, equaliser: Equaliser, options: Decoding):
        self.form, self.mode = form, AGREED.number
        self._identity, self._equaliser, self._options = identity, equaliser, options
        pairs, side = form.settings.data_pairs, form.settings.side
        # difference of pattern and inverse at each LED, and True for visible pairs
        self._luminances, self._seen = np.zeros((pairs, side, side)), np.zeros(pairs, dtype=bool)
        # by number of the pair: pose, sum of pattern and inverse at each LED in gray levels, unpaired frames
        self._states = dict[int, PoseState]()
        self._sums = dict[int, Floats]()
        self._unpaired = dict[int, UnpairedFrame]()
        # gray levels of a sum with all LEDs on
        self._gain = 0.0

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:
        """Read the luminances of a pair; see `PacketObservations`."""
        frames, state = (pair.pattern, pair.inverted), tracked.state
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        self._gain = tracked.track.gain
        x, total = pair_luminances(frames, poses, self._gain, self.form.settings.side, self._equaliser)
        self._luminances[place], self._seen[place] = x, True
        self._states[place], self._sums[place] = state, total
        return ExtractEvent(self._identity, frames, poses, x)

    def add_unpaired(self, place: int, unpaired: UnpairedFrame) -> None:
        """Add the remaining frame of a pair; see `PacketObservations`."""
        self._unpaired[place] = unpaired

    def end(self, headers: HeaderReader, track: Track, decisions: DecisionDirectedTracker | None) -> None:  # noqa: ARG002 - the protocol's
        """Take the mode from the header; see `PacketObservations`."""
        self.mode = headers.mode(track.data_gain)

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `PacketObservations`."""
        return False

    def renumbered(self, place: int) -> "PlainPacket":
        """Return the packet with a lost pair; see `PacketObservations`."""
        moved, pairs = copy(self), len(self._seen)
        moved._luminances = np.insert(self._luminances, place, 0.0, axis=0)[:-1]
        moved._seen = np.insert(self._seen, place, False)[:-1]
        moved._states, moved._sums = renumber(self._states, place, pairs), renumber(self._sums, place, pairs)
        moved._unpaired = renumber(self._unpaired, place, pairs)
        return moved

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Decode the luminances; see `PacketObservations`."""
        for place, unpaired in self._unpaired.items():
            self._estimate_pair(place, unpaired)
        words = decode_packet(self._luminances, self._seen, self.form, self._identity, self._options)
        return Decoded(words, luminances=self._luminances)

    def _estimate_pair(self, place: int, unpaired: UnpairedFrame) -> None:
        """Estimate the luminances of a pair by the remaining frame and the sums of pairs around."""
        chosen = nearest_pairs(place, self._sums)
        if not chosen:
            return
        pose = interpolate_state(unpaired.frame.time_s, self._states, place).pose
        total = np.mean([self._sums[k] for k in chosen], axis=0)
        # 2 r - (r + r') = r - r'
        difference = 2 * luminances(unpaired.frame, pose, len(total)) - total
        self._luminances[place] = normalised(-difference if unpaired.inverted else difference, self._gain)
        self._seen[place] = True
