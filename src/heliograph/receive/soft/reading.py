"""Reading of a packet at the limit of the channel: its frames are kept until its end and decoded together."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.kalman import PoseState
from heliograph.receive.packets import Codeword
from heliograph.receive.pose import Pose
from heliograph.receive.reading import Setup
from heliograph.receive.soft.behind import Header
from heliograph.receive.soft.cancel import Light, decode_looks
from heliograph.receive.soft.glance import Glance, take_glance
from heliograph.receive.soft.look import Look, Weighted, weigh
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.mix import mix_of
from heliograph.receive.soft.naming import HeaderFrames, NameReader
from heliograph.receive.soft.noise import LEAST_NOISE, Noise, measure_noise, noise_beside
from heliograph.receive.soft.shares import LedShares
from heliograph.receive.soft.sharpen import Seen, pose_errors, worth_moving
from heliograph.receive.soft.single import Singles
from heliograph.receive.soft.threads import one_thread
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

Floats = NDArray[np.float64]


class SoftReading:
    """Equalises, cancels and decodes; `memory` holds earlier looks at the array's codewords."""

    def __init__(self, identity: int, setup: Setup, memory: Memory, shares: LedShares | None = None):
        self._identity, self._setup, self._memory = identity, setup, memory
        self._agreed, self._side = setup.form.settings, setup.form.settings.side
        self._shares, self._begun = shares or LedShares(self._side), shares is not None
        self._lit = self._shares.values
        self._glances: list[Glance | None] = []
        self._weighted: list[Weighted | None] = []
        self._looks: list[Look | None] = []
        self._errors = np.zeros((0, 4))
        self._header: Glance | None = None
        self._noise = Noise(LEAST_NOISE, LEAST_NOISE)
        self._gain = 0.0
        self._name = NameReader(identity, self._side)
        self._form: PacketFormat | None = None
        self._headers: list[Header] = []
        self._singles: Singles | None = None
        _, data = light_centroids(self._agreed.slot_order)
        # where the light of the data was: in the middle of the exposure, or about it
        self._later_s = (data - 0.5) * self._agreed.pattern_period_s

    @property
    def named(self) -> Format:
        """What the header names."""
        return self._form.format if self._form else self._name.named(self._gain)

    def take_header(self, pair: int, pattern: Frame, inverted: Frame, tracker: Tracker) -> None:
        """Read what the header names."""
        if not self._begun:
            # cells may be known to be hidden since the detection
            self._shares.values, self._begun = tracker.shares, True
        tracker.shares = self._shares.values
        state = tracker.state  # as the pairs before have refined it
        poses = (state.pose_at(pattern.time_s), state.pose_at(inverted.time_s))
        self._name.take(pair, pattern, inverted, poses, self._shares.values)
        self._headers.append((pattern, inverted, poses))
        self._gain = tracker.data_gain

    @one_thread()
    def learn(self, pattern: Frame, inverted: Frame, header: Floats, tracker: Tracker) -> bool:
        """Find which LEDs give their light; combined frames do not tell."""
        if mix_of(pattern) is not None or np.any(np.abs(header) != 1):
            # dimmed where it names a format: another pattern than the looks that are summed up
            return False
        glance = self._glance(pattern, inverted, tracker.state, tracker.gain)
        tracker.data_gain, changed = self._shares.learn(glance, header, tracker.data_gain)
        tracker.shares = self._shares.values
        return changed

    def follow(self, pattern: Frame, inverted: Frame, tracker: Tracker, late_s: float) -> TrackedPair:
        """By the sum, or where there are no inverses by decisions."""
        if not self._known().single:
            return tracker.follow(pattern, inverted, late_s)
        if self._singles is None:
            self._singles = self._begin_singles(late_s, tracker.data_gain)
        return self._singles.follow(pattern, inverted, tracker)

    @one_thread()
    def _begin_singles(self, late_s: float, gain: float) -> Singles:
        return Singles((late_s, self._later_s), self._headers, gain, self._shares.values)

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair."""
        self._gain = tracker.data_gain
        if self._singles is None:
            glances: tuple[Glance, ...] = (self._glance(pattern, inverted, tracked.state, tracker.gain),)
        else:
            glances = self._singles.glances
        self._glances[len(glances) * place : len(glances) * (place + 1)] = glances
        poses = tuple(pose for glance in glances for pose in glance.poses)
        self._setup.observe("extract", {"identity": self._identity, "frames": (pattern, inverted), "poses": poses})

    def take_even(self, pattern: Frame, inverted: Frame, pose: Pose) -> None:
        """Take all frames of a header combined to one pair: its sum is even and tells the noise."""
        self._header = take_glance(pattern, inverted, (pose, pose), self._side, mix_of(pattern))

    def take_names(self, frames: HeaderFrames) -> None:
        """Take the frames of a header out of step in which the array was seen; they tell the format one by one."""
        if self._headers:
            self._name.take_frames(frames, self._shares.values)

    @one_thread()
    def decode(self) -> dict[str, tuple[Codeword, ...]]:
        """Decode all that was kept."""
        kept = self._memory.copy()
        words = self._attempt(self._shares.values, kept)
        if _open(words) and not (self._shares.values == 1).all():
            # a header before a bright background may have made LEDs seem dead that are not
            acquitted = self._memory.copy()
            sound = self._attempt(np.ones_like(self._lit), acquitted)
            if _open(sound) < _open(words):
                self._shares.acquit()
                kept = acquitted
            words = {name: tuple(map(_better, words[name], sound[name])) for name in words}
        self._memory.become(kept)
        return words

    def _attempt(self, shares: Floats, memory: Memory) -> dict[str, tuple[Codeword, ...]]:
        """Decode all that was kept, each LED giving a share (n, n) of its light."""
        form, kept, self._lit = self._known(), [*self._glances], shares
        self._measure()
        self._weighted = [None if glance is None else self._weigh(glance) for glance in self._glances]
        self._looks = [None if weighted is None else weighted.look() for weighted in self._weighted]
        self._errors = np.zeros((len(self._glances), 4))
        light, again = Light(self._gain, self._noise.lit), self._look_again
        settings, observe = self._setup.settings, self._setup.observe
        words = decode_looks(self._looks, light, form, self._identity, settings, memory, again, observe)
        self._glances = kept
        return words

    def _look_again(self, mean: Floats, variance: Floats, light: Light) -> tuple[list[Look | None], bool]:
        """Looks anew where what is decoded shows that the array is not where it was taken to be."""
        if self._singles is not None:
            # its poses are those of decided data already
            return self._looks, False
        seen = Seen(self._glances, self._weighted, self._looks, self._errors)
        brightness, cells = (light.gain, light.noise), (mean, variance)
        steps = pose_errors(seen, brightness, cells, self._known(), self._lit) - self._errors
        another = False
        for k, (glance, error) in enumerate(zip(self._glances, steps, strict=True)):
            if glance is not None and worth_moving(error):
                another = True
                self._errors[k] += error
                glance = self._glances[k] = glance.moved(error)
                weighted = self._weighted[k] = self._weigh(glance)
                self._looks[k] = weighted.look()
        return self._looks, another

    def _weigh(self, glance: Glance) -> Weighted:
        return weigh(glance, self._noise, self._side, self._lit)

    def _measure(self) -> None:
        seen = [glance for glance in self._glances if glance is not None]
        shares = self._lit
        if self._singles is not None:
            self._noise = Noise(self._singles.noise.lit, noise_beside(seen, self._side))
            return
        noise = self._noise = measure_noise(seen, self._gain, self._side, shares)
        if self._header is not None and any(glance.mix for glance in seen):
            # of pairs out of step the sum is uneven, not so that of a header
            even = measure_noise([self._header], self._gain, self._side, shares)
            self._noise = Noise(min(even.lit, noise.lit), noise.dark)

    def following(self) -> "SoftReading":
        """The reading of the next packet; it knows the LEDs."""
        self._shares.forget()
        return SoftReading(self._identity, self._setup, self._memory, self._shares if self._begun else None)

    def _glance(self, pattern: Frame, inverted: Frame, state: PoseState, gain: float) -> Glance:
        mix, later_s = mix_of(pattern), (self._later_s, self._later_s)
        if mix is not None:
            period_s = self._agreed.pattern_period_s
            later_s = (mix.data[0] - mix.light) * period_s, (mix.data[1] - mix.light) * period_s
        poses = state.pose_at(pattern.time_s + later_s[0]), state.pose_at(inverted.time_s + later_s[1])
        return take_glance(pattern, inverted, poses, self._side, mix).steadied(gain, self._shares.values)

    def shown(self) -> Mapping[str, Any]:
        """The pairs as they were kept."""
        return {"glances": self._glances}

    def _known(self) -> PacketFormat:
        """The packet's format, once its header is over."""
        if self._form is None:
            self._form = PacketFormat(self._agreed, self.named)
            self._glances = [None] * self._form.layers["high"].pairs
        return self._form


def _open(words: dict[str, tuple[Codeword, ...]]) -> int:
    """Codewords that are not decoded."""
    return sum(word.status == "crc_fail" for by in words.values() for word in by)


def _better(one: Codeword, other: Codeword) -> Codeword:
    """The one that was decoded."""
    return other if one.status == "crc_fail" else one
