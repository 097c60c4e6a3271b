"""Reading of a packet at the limit of the channel: its pairs are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.frames import Frame
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.look import Glance, measure_noise, take_glance, take_look
from heliograph.receive.soft.naming import NameReader
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids


class SoftReading:
    """Equalises, cancels and decodes."""

    def __init__(self, identity: int, form: PacketFormat, settings: ReceiveSettings, observe: Observer):
        self._identity, self._form, self._settings, self._observe = identity, form, settings, observe
        self._glances: list[Glance | None] = [None] * form.settings.data_pairs
        self._gain = 0.0
        self._name = NameReader(identity, form.settings.side)
        mean, data = light_centroids(form.settings.slot_order)
        # a sum shows where the mean light was, a difference where the data's was, which is later
        self._later_s = (data - mean) * form.settings.pattern_period_s

    @property
    def named(self) -> Format:
        """What the header names."""
        return self._name.named(self._gain)

    def take_header(self, pair: int, pattern: Frame, inverted: Frame, tracker: Tracker) -> None:
        """Read what the header names."""
        state = tracker.state  # as the pairs before have refined it
        poses = (state.pose_at(pattern.time_s), state.pose_at(inverted.time_s))
        self._name.take(pair, pattern, inverted, poses)
        self._gain = tracker.data_gain

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        first, second = (tracked.state.pose_at(frame.time_s + self._later_s) for frame in (pattern, inverted))
        self._glances[place] = take_glance(pattern, inverted, (first, second), self._form.settings.side)
        self._gain = tracker.data_gain
        self._observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": (first, second)})

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all pairs."""
        side = self._form.settings.side
        seen = [glance for glance in self._glances if glance is not None]
        noise = measure_noise(seen, side)
        looks = [None if glance is None else take_look(glance, noise, side) for glance in self._glances]
        light = Light(self._gain, noise.lit)
        form = PacketFormat(self._form.settings, self.named)
        return decode_looks(looks, light, form, self._identity, self._settings)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}
