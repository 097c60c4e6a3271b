"""Reading of a packet at the limit of the channel: its pairs are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.kalman import PoseState
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.look import Glance, measure_noise, take_glance, take_look
from heliograph.receive.soft.shares import LedShares
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

Floats = NDArray[np.float64]


class SoftReading:
    """Equalises, cancels and decodes."""

    def __init__(
        self,
        identity: int,
        form: PacketFormat,
        settings: ReceiveSettings,
        observe: Observer,
        shares: LedShares | None = None,
    ):
        self._identity, self._form, self._settings, self._observe = identity, form, settings, observe
        self._shares = shares or LedShares(form.settings.side)
        self._glances: list[Glance | None] = [None] * form.settings.data_pairs
        self._gain = 0.0
        mean, data = light_centroids(form.settings.slot_order)
        # a sum shows where the mean light was, a difference where the data's was, which is later
        self._later_s = (data - mean) * form.settings.pattern_period_s

    def learn(self, pattern: Frame, inverted: Frame, header: Floats, tracker: Tracker) -> bool:
        """Find which LEDs give their light."""
        glance = self._glance(pattern, inverted, tracker.state)
        tracker.data_gain, changed = self._shares.learn(glance, header, tracker.data_gain)
        tracker.shares = self._shares.values
        return changed

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        glance = self._glances[place] = self._glance(pattern, inverted, tracked.state)
        self._gain = tracker.data_gain
        self._observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": glance.poses})

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all pairs."""
        side, shares = self._form.settings.side, self._shares.values
        seen = [glance for glance in self._glances if glance is not None]
        noise = measure_noise(seen, side, shares)
        looks = [None if glance is None else take_look(glance, noise, side, shares) for glance in self._glances]
        light = Light(self._gain, noise.lit)
        return decode_looks(looks, light, self._form, self._identity, self._settings)

    def following(self) -> "SoftReading":
        """The reading of the next packet; it knows the LEDs."""
        self._shares.forget()
        return SoftReading(self._identity, self._form, self._settings, self._observe, self._shares)

    def _glance(self, pattern: Frame, inverted: Frame, state: PoseState) -> Glance:
        first, second = (state.pose_at(frame.time_s + self._later_s) for frame in (pattern, inverted))
        return take_glance(pattern, inverted, (first, second), self._form.settings.side)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}
