"""Loss of the soft receiver by channel estimation.

The low layer at 112 m, at rest, in single packets with random pixel phases of the array: wrong codewords by brightness
of the array, received with the estimated (blind) and the true channel, in the same films. A reduction of the brightness
by 10 % is 0.9 dB if the dark noise of the sensor dominates and 0.5 dB if photon noise does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.threads import one_thread
from heliograph.channel.truth import ArrayTruth
from heliograph.experiments.links import receive_packets, true_pose
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import dithered, lasting, random_messages
from heliograph.measure.statistics import Count
from heliograph.receive.api import make_receiver
from heliograph.receive.build import soft_receiver
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.turbo_equaliser import decode_iteratively
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import ExtractEvent, Observer, ignore
from heliograph.receive.observe.cutout import Noise, take_cutout
from heliograph.receive.packet import Receiver
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import TrackedPair

Truths = dict[int, ArrayTruth]  # truth of the array by frame number


class KnownPacket(SoftPacket):
    """Observations of the soft receiver with the true channel."""

    def __init__(self, link: LinkSettings, truths: Truths):
        self._link, self._truths, self._true_gain = link, truths, 0.0
        self._decoding = Decoding("log-map", link.receive.decode.iterations)
        super().__init__(link.transmit.identities[0], link.signal, self._decoding)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:  # noqa: ARG002 - the protocol
        """Add a pair with the true poses; see `PacketObservations`."""
        first, second = (self._truths[frame.index] for frame in (pair.pattern, pair.inverted))
        poses = true_pose(first, self._link), true_pose(second, self._link)
        self._cutouts[place] = take_cutout(pair, poses, self._link.signal.side)
        self._true_gain = true_gain(first, self._link)
        return ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses)

    def has_codeword(self) -> bool:
        """Return False, as no check is faster than decoding; see `PacketObservations`."""
        return False

    @one_thread()
    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol
        """Decode the codewords by layer."""
        gain, sound = self._true_gain, LedGains.sound(self._link.signal.side)
        observed = _FixedPoses(self.cutouts, true_noise(gain, self._link), self.form, sound)
        return Decoded(decode_iteratively(observed, gain, self._identity, self._decoding).words)


class _FixedPoses(ObservedPacket):
    """Pairs with true poses and LED gains."""

    def refine_poses(self, *_: object) -> bool:
        return False

    def apply_brightness(self, *_: object) -> bool:
        return False


def known_receiver(link: LinkSettings, truths: Truths) -> Receiver:
    """Soft receiver with the true channel."""
    return soft_receiver(link.signal, link.receive, ignore, lambda _identity: KnownPacket(link, truths))


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a large array with all LEDs on, by the Lambertian lobe off the axis."""
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of the difference of two frames by EMVA 1288."""
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    # 2 (K^2 sigma_d^2 + 1 / 12), plus K times the light of both frames
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, background = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * background * sensor.full_scale)


@dataclass(frozen=True, slots=True)
class KnownChannelTask:
    """Packets at a brightness."""

    # Link with a single array at rest
    link: LinkSettings
    # Counted layer
    layer: str
    # Seed of each packet
    seeds: range
    # True if the receiver gets the true channel
    known: bool

    @property
    def brightness(self) -> float:
        """Brightness of the array relative to the reference link."""
        return self.link.channel.arrays[0].brightness


def tasks(distance_m: float, layer: str, brightness: Sequence[float], packets: int) -> list[KnownChannelTask]:
    """Tasks with the estimated and the true channel, for each brightness."""
    out = []
    for level in brightness:
        changes = (f"channel.distance_m={distance_m}", f"channel.arrays.0.brightness={level}")
        link = load_settings("static", None, ("receive.receiver=soft", *changes))
        out += [KnownChannelTask(link, layer, range(packets), known) for known in (False, True)]
    return out


def measure(task: KnownChannelTask) -> Count:
    """Count wrong codewords of all packets."""
    total = Count()
    for seed in task.seeds:
        total.include(_count_packet(task, seed))
    return total


def _count_packet(task: KnownChannelTask, seed: int) -> Count:
    """Count wrong codewords of a packet at rest, including missed codewords."""
    link = dithered(lasting(task.link, task.link.signal.packet_s), seed)
    messages = random_messages(link, seed)
    sent = transmitters(link, messages)[0].blocks(0)[task.layer]
    truths: Truths = {}
    receiver = known_receiver(link, truths) if task.known else make_receiver(link.signal, link.receive)
    packets = list(receive_packets(link, messages, seed, receiver, truths))
    read = [word.block for packet in packets for word in packet.layers[task.layer] if word.block is not None]
    return Count(len(sent), sum(block not in read for block in sent))
