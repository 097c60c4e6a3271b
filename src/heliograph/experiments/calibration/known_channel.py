"""The loss of the soft receiver by estimating the channel: the same receiver with the true pose, blur, gain and noise.

Only in this experiment does a receiver get the truth; everything else about it is the receiver's own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth
from heliograph.experiments.links import true_pose
from heliograph.experiments.result import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, simulate, transmitters
from heliograph.measure.bench import dithered, lasting, random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive.packets import Packet
from heliograph.receive.reading import Reading
from heliograph.receive.soft.glance import take_glance
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.noise import Noise
from heliograph.receive.soft.reading import SoftReading
from heliograph.receive.soft.receiver import SoftReceiver
from heliograph.receive.track import TrackedPair, Tracker
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""

DISTANCE_M, LAYER = 112.0, "low"
QUICK_BRIGHTNESS, FULL_BRIGHTNESS = (0.9,), (0.85, 0.9, 0.95)
QUICK_PACKETS, FULL_PACKETS = 6, 300

TEXT = (
    f"The {LAYER} layer at {DISTANCE_M:g} m, at rest, one packet a film with the array at its own place on the pixel "
    "grid: codewords wrong by brightness of the array, received blind and with the channel known, on the same films. "
    "A loss in brightness of 10 % is 0.9 dB where the sensor's dark noise dominates and 0.5 dB where photon noise does."
)


class KnownReading(SoftReading):
    """The soft reading with the true channel in place of the estimated one.

    Parameters
    ----------
    link
        The link as simulated.
    truths
        Truth of each frame taken so far.
    rest
        Parameters of `SoftReading`.
    """

    def __init__(self, link: LinkSettings, truths: Truths, *rest: Any):
        super().__init__(*rest)
        self._link, self._truths = link, truths

    def take(self, place: int, pattern: Frame, inverted: Frame, tracked: TrackedPair, tracker: Tracker) -> None:
        """Keep a pair with its true poses.

        Parameters
        ----------
        place
            Number of the pair in its packet.
        pattern, inverted
            Its frames.
        tracked, tracker
            The pair as it was followed, and the tracker that followed it.
        """
        super().take(place, pattern, inverted, tracked, tracker)
        first, second = (true_pose(self._truths[frame.index], self._link) for frame in (pattern, inverted))
        self._glances[place] = take_glance(pattern, inverted, (first, second), self._side)
        self._gain = true_gain(self._truths[pattern.index], self._link)

    def _measure(self) -> None:
        self._noise = true_noise(self._gain, self._link)


class KnownReceiver(SoftReceiver):
    """The soft receiver with the true channel.

    Parameters
    ----------
    link
        The link as simulated.
    truths
        Truth of each frame, which must be there before the frame is pushed.
    """

    def __init__(self, link: LinkSettings, truths: Truths):
        soft = replace(link.receive.soft, sharpen=False)
        super().__init__(link.signal, replace(link.receive, soft=soft))
        self._link, self._truths = link, truths

    def _reading(self, identity: int) -> Reading:
        return KnownReading(self._link, self._truths, identity, self._setup, Memory())


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a wide array with all LEDs on, by the Lambertian lobe of LEDs off the axis.

    Parameters
    ----------
    truth
        Of the array in a frame.
    link
        The link as simulated, with one array.
    """
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of a difference of two frames by EMVA 1288: 2 (K^2 sigma_d^2 + 1 / 12) and K times the light of both.

    Parameters
    ----------
    gain
        See `true_gain`.
    link
        The link as simulated.
    """
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    # 2 (K^2 sigma_d^2 + 1 / 12)
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, background = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * background * sensor.full_scale)


@dataclass(frozen=True, slots=True)
class KnownChannelTask:
    """Packets at one brightness.

    Attributes
    ----------
    link
        The link.
    layer
        The layer that is counted.
    seeds
        One a packet.
    known
        Whether the receiver gets the true channel.
    """

    link: LinkSettings
    layer: str
    seeds: range
    known: bool

    @property
    def brightness(self) -> float:
        """Brightness of the array, 1 for that of the reference link."""
        return self.link.channel.arrays[0].brightness


def tasks(distance_m: float, layer: str, brightness: Sequence[float], packets: int) -> list[KnownChannelTask]:
    """Packets blind and with the channel known, for each brightness.

    Parameters
    ----------
    distance_m
        Distance in m.
    layer
        The layer that is counted.
    brightness
        Of the array, 1 for that of the reference link.
    packets
        Packets of each.
    """
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
    """Codewords wrong of one packet at rest, by layer; a packet missed counts as wrong.

    Parameters
    ----------
    link
        The link, with one array.
    seed
        Of messages, place and noise.
    known
        Whether the receiver gets the true channel.
    """
    signal = link.signal
    link = dithered(lasting(link, signal.packet_s), seed)
    messages = random_messages(link, seed)
    sent = transmitters(link, messages)[0].blocks(0)
    truths: Truths = {}
    receiver = KnownReceiver(link, truths) if known else SoftReceiver(signal, link.receive)
    packets = [packet for frame in _frames(link, messages, seed, truths) for packet in receiver.push(frame)]
    packets += receiver.finish()
    return {name: _wrong(name, packets, sent[name]) for name in PacketFormat(signal).layers}


def _frames(link: LinkSettings, messages: Sequence[Messages], seed: int, truths: Truths) -> Iterator[Frame]:
    for frame, truth in simulate(link, messages, seed, None, window_margin_px(link)):
        truths[frame.index] = truth.arrays[0]
        yield frame


def _wrong(name: str, packets: Sequence[Packet], blocks: Sequence[Block]) -> Count:
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
