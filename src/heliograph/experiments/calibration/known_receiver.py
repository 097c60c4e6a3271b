"""Loss of the soft receiver by channel estimation: the same films received blind and with the true channel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.frames import Frame
from heliograph.base.threads import one_thread
from heliograph.channel import ArrayTruth
from heliograph.experiments.links import true_pose
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, simulate, transmitters
from heliograph.measure.bench import dithered, lasting, random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import Packet, Receiver, make_receiver
from heliograph.receive.build import soft_receiver
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.turbo_equaliser import decode_iteratively
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import ExtractEvent, Observer, ignore
from heliograph.receive.observe.cutout import take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import TrackedPair
from heliograph.signal.block import AnyBlock
from heliograph.signal.packet import PacketFormat

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""


class KnownPacket(SoftPacket):
    """The soft receiver's observations with the true channel in place of the estimated one."""

    def __init__(self, link: LinkSettings, truths: Truths):
        self._link, self._truths, self._true_gain = link, truths, 0.0
        self._decoding = Decoding("log-map", link.receive.decode.iterations)
        super().__init__(link.transmit.identities[0], link.signal, self._decoding)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:  # noqa: ARG002 - the truth is known
        """Add a pair with its true poses; see `PacketObservations`."""
        first, second = (self._truths[frame.index] for frame in (pair.pattern, pair.inverted))
        poses = true_pose(first, self._link), true_pose(second, self._link)
        self._cutouts[place] = take_cutout(pair, poses, self._link.signal.side)
        self._true_gain = true_gain(first, self._link)
        return ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses)

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `PacketObservations`."""
        return False

    @one_thread()
    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Codewords by layer."""
        gain, sound = self._true_gain, LedGains.sound(self._link.signal.side)
        observed = _FixedPoses(self.cutouts, true_noise(gain, self._link), self.form, sound)
        return Decoded(decode_iteratively(observed, gain, self._identity, self._decoding).words)


class _FixedPoses(ObservedPacket):
    """Pairs whose poses and LED gains are right already."""

    def refine_poses(self, *_: object) -> bool:
        return False

    def apply_brightness(self, *_: object) -> bool:
        return False


def known_receiver(link: LinkSettings, truths: Truths) -> Receiver:
    """The soft receiver with the true channel."""
    return soft_receiver(link.signal, link.receive, ignore, lambda _identity: KnownPacket(link, truths))


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a wide array with all LEDs on, by the Lambertian lobe of LEDs off the axis."""
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of a difference of two frames by EMVA 1288: 2 (K^2 sigma_d^2 + 1 / 12) and K times the light of both."""
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    # 2 (K^2 sigma_d^2 + 1 / 12)
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, background = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * background * sensor.full_scale)


DISTANCE_M, LAYER = 112.0, "low"
QUICK_BRIGHTNESS, FULL_BRIGHTNESS = (0.9,), (0.85, 0.9, 0.95)
QUICK_PACKETS, FULL_PACKETS = 6, 300

TEXT = (
    f"The {LAYER} layer at {DISTANCE_M:g} m, at rest, one packet a film with the array at its own place on the pixel "
    "grid: codewords wrong by brightness of the array, received blind and with the channel known, on the same films. "
    "A loss in brightness of 10 % is 0.9 dB where the sensor's dark noise dominates and 0.5 dB where photon noise does."
)


@dataclass(frozen=True, slots=True)
class KnownChannelTask:
    """Packets at one brightness."""

    # The link as simulated, with one array at rest
    link: LinkSettings
    # The layer that is counted
    layer: str
    # Seeds of messages, place and noise, one for each packet
    seeds: range
    # Whether the receiver gets the true channel
    known: bool

    @property
    def brightness(self) -> float:
        """Brightness of the array, 1 for that of the reference link."""
        return self.link.channel.arrays[0].brightness


def tasks(distance_m: float, layer: str, brightness: Sequence[float], packets: int) -> list[KnownChannelTask]:
    """Packets blind and with the channel known, for each brightness."""
    out = []
    for one in brightness:
        changes = (f"channel.distance_m={distance_m}", f"channel.arrays.0.brightness={one}")
        link = load_settings("static", None, ("receive.receiver=soft", *changes))
        out += [KnownChannelTask(link, layer, range(packets), known) for known in (False, True)]
    return out


def measure(task: KnownChannelTask) -> Count:
    """Codewords wrong of all packets."""
    total = Count()
    for seed in task.seeds:
        total.include(count_packet(task.link, seed, task.known)[task.layer])
    return total


def count_packet(link: LinkSettings, seed: int, known: bool) -> dict[str, Count]:
    """Codewords wrong of one packet at rest, by layer; a packet missed counts as wrong."""
    signal = link.signal
    link = dithered(lasting(link, signal.packet_s), seed)
    messages = random_messages(link, seed)
    sent = transmitters(link, messages)[0].blocks(0)
    truths: Truths = {}
    receiver = known_receiver(link, truths) if known else make_receiver(signal, link.receive)
    packets = [packet for frame in _frames(link, messages, seed, truths) for packet in receiver.push(frame)]
    packets += receiver.finish()
    return {name: _wrong(name, packets, sent[name]) for name in PacketFormat(signal).layers}


def _frames(link: LinkSettings, messages: Sequence[Messages], seed: int, truths: Truths) -> Iterator[Frame]:
    for frame, truth in simulate(link, messages, seed, None, window_margin_px(link)):
        truths[frame.index] = truth.arrays[0]
        yield frame


def _wrong(name: str, packets: Sequence[Packet], blocks: Sequence[AnyBlock]) -> Count:
    right = [word.block for packet in packets for word in packet.layers[name] if word.block is not None]
    return Count(len(blocks), sum(block not in right for block in blocks))


def run(context: Context) -> ExperimentResult:
    """Count codewords blind and with the channel known."""
    brightness = QUICK_BRIGHTNESS if context.quick else FULL_BRIGHTNESS
    todo = tasks(DISTANCE_M, LAYER, brightness, QUICK_PACKETS if context.quick else FULL_PACKETS)
    counts = context.each("known channel", measure, todo)
    blind, known = ([c for t, c in zip(todo, counts, strict=True) if t.known is side] for side in (False, True))
    rows = [
        [f"{one:g}", *(f"{c.errors} of {c.trials} ({_range(c)})" for c in pair)]
        for one, *pair in zip(brightness, blind, known, strict=True)
    ]
    return ExperimentResult(
        key="known-channel",
        title="Beside the known channel",
        text=TEXT,
        findings=[_loss(blind, known)],
        tables=[Table("Codewords wrong", ["brightness", "blind", "channel known"], rows)],
        data={
            name: {f"{one:g}": [c.errors, c.trials] for one, c in zip(brightness, side, strict=True)}
            for name, side in (("blind", blind), ("known", known))
        },
    )


def _loss(blind: Sequence[Count], known: Sequence[Count]) -> Finding:
    errors, trials = (sum(getattr(one, name) for one in blind) for name in ("errors", "trials"))
    best = sum(one.errors for one in known)
    return Finding(
        "Asked: the loss by estimating pose, blur, gain and noise.",
        f"All brightnesses together: {errors} of {trials} codewords wrong blind, {best} with the channel known.",
        "shown",
    )


def _range(count: Count) -> str:
    low, high = count.interval()
    return f"{low:.2g} to {high:.2g}"
