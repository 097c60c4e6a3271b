"""Reading of a packet at the limit of the channel: its pairs are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.kalman import PoseState
from heliograph.receive.packets import Codeword, Observer
from heliograph.receive.pose import Pose
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.look import LEAST_NOISE, Glance, Look, Noise, measure_noise, take_glance, take_look
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.mix import mix_of
from heliograph.receive.soft.naming import NameReader
from heliograph.receive.soft.shares import LedShares
from heliograph.receive.soft.sharpen import sharpen
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

Floats = NDArray[np.float64]


class SoftReading:
    """Equalises, cancels and decodes; `memory` holds earlier looks at the array's codewords."""

    def __init__(
        self,
        memory: Memory,
        identity: int,
        form: PacketFormat,
        settings: ReceiveSettings,
        observe: Observer,
        shares: LedShares | None = None,
    ):
        self._memory = memory
        self._identity, self._form, self._settings, self._observe = identity, form, settings, observe
        self._shares = shares or LedShares(form.settings.side)
        self._glances: list[Glance | None] = [None] * form.settings.data_pairs
        self._looks: list[Look | None] = []
        self._header: Glance | None = None
        self._noise = Noise(LEAST_NOISE, LEAST_NOISE)
        self._gain = 0.0
        self._name = NameReader(identity, form.settings.side)
        _, data = light_centroids(form.settings.slot_order)
        # where the light of the data was: in the middle of the exposure, or about it
        self._later_s = (data - 0.5) * form.settings.pattern_period_s

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

    def learn(self, pattern: Frame, inverted: Frame, header: Floats, tracker: Tracker) -> bool:
        """Find which LEDs give their light; combined frames do not tell."""
        if mix_of(pattern) is not None:
            return False
        glance = self._glance(pattern, inverted, tracker.state)
        tracker.data_gain, changed = self._shares.learn(glance, header, tracker.data_gain)
        tracker.shares = self._shares.values
        return changed

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        glance = self._glances[place] = self._glance(pattern, inverted, tracked.state)
        self._gain = tracker.data_gain
        self._observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": glance.poses})

    def take_even(self, pattern: Frame, inverted: Frame, pose: Pose) -> None:
        """Take all frames of a header combined to one pair: its sum is even and tells the noise."""
        self._header = take_glance(pattern, inverted, (pose, pose), self._form.settings.side, mix_of(pattern))

    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all pairs."""
        self._measure()
        light, looks = Light(self._gain, self._noise.lit), self._look()
        form, observe = PacketFormat(self._form.settings, self.named), self._observe
        return decode_looks(looks, light, form, self._identity, self._settings, self._memory, self._look_again, observe)

    def _look_again(self, mean: Floats, variance: Floats, light: Light) -> list[Look | None]:
        """Looks with the poses sharpened by what is decoded."""
        self._glances = sharpen(
            self._glances, self._looks, (light.gain, self._noise), mean, variance, self._form, self._shares.values
        )
        self._measure()
        light.noise = self._noise.lit
        return self._look()

    def _measure(self) -> None:
        seen = [glance for glance in self._glances if glance is not None]
        side, shares = self._form.settings.side, self._shares.values
        noise = self._noise = measure_noise(seen, self._gain, side, shares)
        if self._header is not None and any(glance.mix for glance in seen):
            # of pairs out of step the sum is uneven, not so that of a header
            even = measure_noise([self._header], self._gain, side, shares)
            self._noise = Noise(min(even.lit, noise.lit), noise.dark)

    def _look(self) -> list[Look | None]:
        side, shares = self._form.settings.side, self._shares.values
        self._looks = [
            None if glance is None else take_look(glance, self._noise, side, shares) for glance in self._glances
        ]
        return self._looks

    def following(self) -> "SoftReading":
        """The reading of the next packet; it knows the LEDs."""
        self._shares.forget()
        return SoftReading(self._memory, self._identity, self._form, self._settings, self._observe, self._shares)

    def _glance(self, pattern: Frame, inverted: Frame, state: PoseState) -> Glance:
        mix, later_s = mix_of(pattern), (self._later_s, self._later_s)
        if mix is not None:
            period_s = self._form.settings.pattern_period_s
            later_s = (mix.data[0] - mix.light) * period_s, (mix.data[1] - mix.light) * period_s
        poses = state.pose_at(pattern.time_s + later_s[0]), state.pose_at(inverted.time_s + later_s[1])
        return take_glance(pattern, inverted, poses, self._form.settings.side, mix)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}
