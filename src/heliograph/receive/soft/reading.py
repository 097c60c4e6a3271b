"""Reading of a packet at the limit of the channel: its frames are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.frames import Frame
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.behind import Header
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.look import Glance, Noise, measure_noise, noise_beside, take_glance, take_look
from heliograph.receive.soft.naming import NameReader
from heliograph.receive.soft.single import Singles
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids


class SoftReading:
    """Equalises, cancels and decodes."""

    def __init__(self, identity: int, form: PacketFormat, settings: ReceiveSettings, observe: Observer):
        self._identity, self._settings, self._observe = identity, settings, observe
        self._signal = form.settings
        self._glances: list[Glance | None] = []
        self._gain = 0.0
        self._name = NameReader(identity, form.settings.side)
        self._form: PacketFormat | None = None
        self._headers: list[Header] = []
        self._singles: Singles | None = None
        mean, data = light_centroids(form.settings.slot_order)
        # a sum shows where the mean light was, a difference where the data's was, which is later
        self._later_s = (data - mean) * form.settings.pattern_period_s

    @property
    def named(self) -> Format:
        """What the header names."""
        return self._form.named if self._form else self._name.named(self._gain)

    def take_header(self, pair: int, pattern: Frame, inverted: Frame, tracker: Tracker) -> None:
        """Read what the header names."""
        state = tracker.state  # as the pairs before have refined it
        poses = (state.pose_at(pattern.time_s), state.pose_at(inverted.time_s))
        self._name.take(pair, pattern, inverted, poses)
        self._headers.append((pattern, inverted, poses))
        self._gain = tracker.data_gain

    def follow(self, pattern: Frame, inverted: Frame, tracker: Tracker) -> TrackedPair:
        """By the sum, or where there are no inverses by decisions, frame by frame."""
        if not self._known().single:
            return tracker.follow(pattern, inverted)
        if self._singles is None:
            side = self._signal.side
            self._singles = Singles(side, self._later_s, self._headers, tracker.data_gain)
        return self._singles.follow(pattern, inverted, tracker)

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        self._gain = tracker.data_gain
        if self._singles is not None:
            self._glances[2 * place : 2 * place + 2] = self._singles.glances
            first, second = (glance.middle for glance in self._singles.glances)
        else:
            first, second = (tracked.state.pose_at(frame.time_s + self._later_s) for frame in (pattern, inverted))
            self._glances[place] = take_glance(pattern, inverted, (first, second), self._signal.side)
        self._observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": (first, second)})

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all that was kept."""
        form, side = self._known(), self._signal.side
        seen = [glance for glance in self._glances if glance is not None]
        if self._singles is not None and seen:
            noise = Noise(self._singles.noise.lit, noise_beside(seen, side))
        else:
            noise = measure_noise(seen, side)
        looks = [None if glance is None else take_look(glance, noise, side) for glance in self._glances]
        light = Light(self._gain, noise.lit)
        return decode_looks(looks, light, form, self._identity, self._settings)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}

    def _known(self) -> PacketFormat:
        """The packet's format, once its header is over."""
        if self._form is None:
            self._form = PacketFormat(self._signal, self.named)
            self._glances = [None] * self._form.layers["high"].pairs
        return self._form
