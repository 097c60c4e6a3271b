"""What the soft receiver loses by finding the channel itself: the same receiver told pose, blur, gain and noise.

Only here, in an experiment, does a receiver see the truth; everything else about it is the receiver's own.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import simulate, transmitters
from heliograph.measure.bench import dithered, random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.receive.packets import Packet
from heliograph.receive.reading import Reading
from heliograph.receive.soft.glance import take_glance
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.noise import Noise
from heliograph.receive.soft.reading import SoftReading
from heliograph.receive.soft.receiver import SoftReceiver
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.packet import PacketFormat

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""


class KnownReading(SoftReading):
    """The soft reading with the true channel in place of the estimated one."""

    def __init__(self, link: LinkSettings, truths: Truths, *rest: Any):
        super().__init__(*rest)
        self._link, self._truths = link, truths

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair with its true poses."""
        super().take(place, pattern, inverted, tracked, tracker)
        first, second = (true_pose(self._truths[frame.index], self._link) for frame in (pattern, inverted))
        self._glances[place] = take_glance(pattern, inverted, (first, second), self._side)
        self._gain = true_gain(self._truths[pattern.index], self._link)

    def _measure(self) -> None:
        self._noise = true_noise(self._gain, self._link)


class KnownReceiver(SoftReceiver):
    """The soft receiver told the truth."""

    def __init__(self, link: LinkSettings, truths: Truths):
        soft = replace(link.receive.soft, sharpen=False)
        super().__init__(link.signal, replace(link.receive, soft=soft))
        self._link, self._truths = link, truths

    def _reading(self, identity: int) -> Reading:
        return KnownReading(self._link, self._truths, identity, self._setup, Memory())


def true_pose(truth: ArrayTruth, link: LinkSettings) -> Pose:
    """Pose and blur of an array: optics and disc, of variance (radius / 2)^2 along an axis."""
    emitter = link.channel.emitter
    disc = 0.25 * emitter.diameter_m / emitter.pitch_m * truth.pitch_px
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad, float(np.hypot(link.channel.camera.blur_px, disc)))


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a wide array with all LEDs on, the Lambertian lobe of LEDs off the axis counted."""
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of a difference of two frames by EMVA 1288: 2 (K^2 sigma_d^2 + 1 / 12) and K times the light of both."""
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, behind = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * behind * sensor.full_scale)


def count(link: LinkSettings, seed: int, known: bool) -> dict[str, Count]:
    """Codewords wrong of one packet at rest, by layer; a packet missed counts as wrong."""
    signal = link.signal
    link = dithered(replace(link, channel=replace(link.channel, duration_s=signal.packet_s)), seed)
    messages = random_messages(link, seed)
    sent = transmitters(link, messages)[0].blocks(0)
    truths: Truths = {}
    receiver = KnownReceiver(link, truths) if known else SoftReceiver(signal, link.receive)
    packets = [packet for frame in _frames(link, messages, seed, truths) for packet in receiver.push(frame)]
    packets += receiver.finish()
    return {name: _wrong(name, packets, sent[name]) for name in PacketFormat(signal).layers}


def _frames(link: LinkSettings, messages: Any, seed: int, truths: Truths) -> Iterator[Frame]:
    for frame, truth in simulate(link, messages, seed, None, window_margin_px(link)):
        truths[frame.index] = truth.arrays[0]
        yield frame


def _wrong(name: str, packets: list[Packet], blocks: list[Any]) -> Count:
    right = [word.block for packet in packets for word in packet.layers[name] if word.block is not None]
    return Count(len(blocks), sum(block not in right for block in blocks))
