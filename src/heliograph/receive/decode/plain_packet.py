"""Packets of the plain receiver: luminances at the LEDs' image positions, FHWT, one decoding."""

from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import ExtractEvent, Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import PacketFormat

ReadPair = Callable[[tuple[AnyFrame, AnyFrame], tuple[Pose, Pose], float], Floats]
"""Reads luminances (n, n) of two frames, by the poses in both and the gain."""


class PlainPacket:
    """Observations of a packet by the plain receiver; see `worker.PacketObservations`."""

    cutouts = ()

    def __init__(self, identity: int, form: PacketFormat, read: ReadPair, options: Decoding):
        self.form, self.mode = form, AGREED.number
        self._identity, self._read, self._options = identity, read, options
        pairs, side = form.settings.data_pairs, form.settings.side
        # difference of pattern and inverse at each LED, and True for visible pairs
        self._luminances, self._seen = np.zeros((pairs, side, side)), np.zeros(pairs, dtype=bool)

    def __getstate__(self) -> dict[str, Any]:
        # another process only decodes
        return {**self.__dict__, "_read": None}

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:
        """Read the luminances of a pair; see `PacketObservations`."""
        frames, state = (pair.pattern, pair.inverted), tracked.state
        poses = state.pose_at(pair.pattern.time_s), state.pose_at(pair.inverted.time_s)
        x = self._read(frames, poses, tracked.track.gain)
        self._luminances[place], self._seen[place] = x, True
        return ExtractEvent(self._identity, frames, poses, x)

    def end(self, headers: HeaderReader, track: Track, decisions: DecisionDirectedTracker | None) -> None:  # noqa: ARG002 - the protocol's
        """Take the mode from the header; see `PacketObservations`."""
        self.mode = headers.mode(track.data_gain)

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `PacketObservations`."""
        return False

    def renumbered(self, place: int) -> "PlainPacket":
        """Return the packet with a lost pair; see `PacketObservations`."""
        moved = copy(self)
        moved._luminances = np.insert(self._luminances, place, 0.0, axis=0)[:-1]
        moved._seen = np.insert(self._seen, place, False)[:-1]
        return moved

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Decode the luminances; see `PacketObservations`."""
        words = decode_packet(self._luminances, self._seen, self.form, self._identity, self._options)
        return Decoded(words, luminances=self._luminances)
