"""Reading of a packet at the limit of the channel: its pairs are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.frames import Frame
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.pose import Pose
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.look import Glance, Noise, measure_noise, take_glance, take_look
from heliograph.receive.soft.mix import mix_of
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids


class SoftReading:
    """Equalises, cancels and decodes."""

    def __init__(self, identity: int, form: PacketFormat, settings: ReceiveSettings, observe: Observer):
        self._identity, self._form, self._settings, self._observe = identity, form, settings, observe
        self._glances: list[Glance | None] = [None] * form.settings.data_pairs
        self._header: Glance | None = None
        self._gain = 0.0
        mean, data = light_centroids(form.settings.slot_order)
        # a sum shows where the mean light was, a difference where the data's was, which is later
        self._later_s = (data - mean) * form.settings.pattern_period_s

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        mix, later_s = mix_of(pattern), (self._later_s, self._later_s)
        if mix is not None:
            period = self._form.settings.pattern_period_s
            later_s = (mix.data[0] - mix.light) * period, (mix.data[1] - mix.light) * period
        first = tracked.state.pose_at(pattern.time_s + later_s[0])
        second = tracked.state.pose_at(inverted.time_s + later_s[1])
        self._glances[place] = take_glance(pattern, inverted, (first, second), self._form.settings.side, mix)
        self._gain = tracker.data_gain
        self._observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": (first, second)})

    def take_header(self, pattern: Frame, inverted: Frame, pose: Pose) -> None:
        """Take all frames of a header as one pair: its sum is even and tells the noise."""
        self._header = take_glance(pattern, inverted, (pose, pose), self._form.settings.side, mix_of(pattern))

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all pairs."""
        side = self._form.settings.side
        seen = [glance for glance in self._glances if glance is not None]
        noise = self._noise(seen, side)
        looks = [None if glance is None else take_look(glance, noise, side) for glance in self._glances]
        light = Light(self._gain, noise.lit)
        return decode_looks(looks, light, self._form, self._identity, self._settings)

    def _noise(self, seen: list[Glance], side: int) -> Noise:
        """Noise of the pairs; of such as are out of step the sum is uneven, not so that of a header."""
        noise = measure_noise(seen, side)
        if self._header is None or not any(glance.mix for glance in seen):
            return noise
        return Noise(min(measure_noise([self._header], side).lit, noise.lit), noise.dark)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}
