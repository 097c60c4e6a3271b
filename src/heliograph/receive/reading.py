"""Reading of a packet's data: what is done with each of its pairs, and at its end."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.decode import decode_packet
from heliograph.receive.extract import pair_luminances
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.formats import AGREED, Format
from heliograph.signal.packet import PacketFormat

Floats = NDArray[np.float64]


class Reading(Protocol):
    """Reads one packet."""

    @property
    def named(self) -> Format:
        """The format the packet has."""

    def take_header(self, pair: int, pattern: Frame, inverted: Frame, tracker: Tracker) -> None:
        """Take header pair `pair` of the packet, in which the array was seen."""

    def learn(self, pattern: Frame, inverted: Frame, header: Floats, tracker: Tracker) -> bool:
        """Take a header pair of levels (n, n) of +-1, in which the array was seen.

        Returns whether it is to be followed and taken once more, as the tracker now knows better what it looks like.
        """

    def follow(self, pattern: Frame, inverted: Frame, tracker: Tracker, late_s: float) -> TrackedPair:
        """Find the array in a pair of the packet's data and move the tracker on.

        The light of all LEDs together comes `late_s` after the middle of the exposures.
        """

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Take data pair `place` of the packet, in which the array was seen."""

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Codewords by layer."""

    def following(self) -> "Reading":
        """The reading of the next packet."""

    def shown(self) -> Mapping[str, Any]:
        """What an observer of the stage "decode" gets beside the packet."""


@dataclass(frozen=True, slots=True)
class Setup:
    """What the parts of a receiver share.

    Attributes
    ----------
    form
        The agreed format of packets.
    settings
        The receiver's.
    observe
        Gets what each stage produces.
    """

    form: PacketFormat
    settings: ReceiveSettings
    observe: Observer


class PlainReading:
    """The paper's own: the luminance at each LED's image position, FHWT, turbo decoder."""

    def __init__(self, identity: int, setup: Setup):
        self._identity, self._setup = identity, setup
        pairs, side = setup.form.settings.data_pairs, setup.form.settings.side
        self._luminances = np.zeros((pairs, side, side))
        self._seen = np.zeros(pairs, dtype=bool)

    @property
    def named(self) -> Format:
        """The agreed one: it looks for no other."""
        return AGREED

    def take_header(self, pair: int, pattern: Frame, inverted: Frame, tracker: Tracker) -> None:
        """Nothing is read of it."""

    def learn(
        self,
        pattern: Frame,  # noqa: ARG002 - as all readings
        inverted: Frame,  # noqa: ARG002 - as all readings
        header: Floats,  # noqa: ARG002 - as all readings
        tracker: Tracker,  # noqa: ARG002 - as all readings
    ) -> bool:
        """Learn nothing."""
        return False

    def follow(self, pattern: Frame, inverted: Frame, tracker: Tracker, late_s: float) -> TrackedPair:
        """By the sum."""
        return tracker.follow(pattern, inverted, late_s)

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Read the luminances of a pair."""
        poses = (tracked.state.pose_at(pattern.time_s), tracked.state.pose_at(inverted.time_s))
        side, equaliser = self._setup.form.settings.side, self._setup.settings.equaliser
        x = pair_luminances(pattern, inverted, poses, tracker.gain, side, equaliser)
        self._luminances[place], self._seen[place] = x, True
        self._setup.observe(
            "extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": poses, "luminances": x}
        )

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode what was read."""
        form, settings = self._setup.form, self._setup.settings.decode
        return decode_packet(self._luminances, self._seen, form, self._identity, settings)

    def following(self) -> "PlainReading":
        """The reading of the next packet."""
        return PlainReading(self._identity, self._setup)

    def shown(self) -> Mapping[str, Any]:
        """The luminances, (pairs, n, n)."""
        return {"luminances": self._luminances}
