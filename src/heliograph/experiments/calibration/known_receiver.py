"""Loss of the soft receiver by channel estimation: the same films received blind and with the true channel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
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
from heliograph.receive.array import PacketReader
from heliograph.receive.build import soft_parts, soft_reader
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.turbo_equaliser import GainAndNoise, decode_iteratively
from heliograph.receive.decode.worker import ArrayState, Decoded
from heliograph.receive.detect.detection import Detection
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import Observer, ignore
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, UnpairedFrame
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.block import AnyBlock
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""


class KnownReader:
    """The soft receiver's reader with the true channel in place of the estimated one; see `array.PacketReader`."""

    def __init__(self, link: LinkSettings, truths: Truths, blind: PacketReader):
        self._link, self._truths, self._blind = link, truths, blind
        self._form = PacketFormat(link.signal)
        self._cutouts: list[Cutout | None] = [None] * link.signal.data_pairs
        self._gain = 0.0

    @property
    def format(self) -> Format:
        """The packet's format, as its header signals it."""
        return self._blind.format

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> tuple[Track, float]:
        """Read a header pair blind; see `PacketReader`."""
        return self._blind.read_header(number, pair, tracked)

    def end_header(self, header: MeasuredHeader) -> None:
        """Nothing: the camera is in step."""

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Follow the array blind; see `PacketReader`.

        Parameters
        ----------
        pair
            Camera frames of a pair of data.
        track
            The array as it was before this pair.
        """
        return self._blind.follow(pair, track)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:  # noqa: ARG002 - the truth is known
        """Keep a pair with its true poses."""
        first, second = (self._truths[frame.index] for frame in (pair.pattern, pair.inverted))
        poses = true_pose(first, self._link), true_pose(second, self._link)
        self._cutouts[place] = take_cutout(pair, poses, self._link.signal.side)
        self._gain = true_gain(first, self._link)

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Leave a pair out of which one frame is lost; see `PacketReader`."""

    def observations(self) -> "KnownPairs":
        """The cut-outs of all pairs, with the gain; see `PacketReader`."""
        return KnownPairs(self._link, self._form, tuple(self._cutouts), self._gain)

    def next(self, state: ArrayState | None, confirmed: bool) -> "KnownReader":
        """Make the reader of the next packet; see `PacketReader`."""
        return KnownReader(self._link, self._truths, self._blind.next(state, confirmed))

    def update(self, state: ArrayState) -> None:
        """Ignore the array's state: all is known; see `PacketReader`."""


@dataclass(frozen=True, slots=True)
class KnownPairs:
    """What was taken of a packet whose channel is known; see `worker.Observations`."""

    # The link as simulated, with one array at rest in step
    link: LinkSettings
    # Format of the packet
    form: PacketFormat
    # Cut-outs of its pairs at their true poses; None for pairs not seen
    cutouts: tuple[Cutout | None, ...]
    # Gray levels of the array with all LEDs on
    gain: float

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `Observations`."""
        return False

    def renumbered(self, place: int) -> "KnownPairs":  # noqa: ARG002 - no frame is lost
        """The same: no frame is lost of which the truth is known; see `Observations`."""
        return self

    @one_thread()
    def decode(self, state: ArrayState, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Codewords by layer.

        Parameters
        ----------
        state
            State of the array; ignored.
        observe
            Gets nothing: no event tells of this decoding.
        """
        noise, receive = true_noise(self.gain, self.link), self.link.receive
        observed = ObservedPacket.of(self.cutouts, noise, self.form, LedGains.sound(self.link.signal.side))
        channel, decoding = GainAndNoise(self.gain, noise.lit), Decoding("log-map", receive.decode.iterations)
        identity = self.link.transmit.identities[0]
        return Decoded(decode_iteratively(_FixedPoses(observed), channel, self.form, identity, decoding, None).words)


@dataclass(frozen=True, slots=True)
class _FixedPoses:
    """Pairs whose poses are right already."""

    observed: ObservedPacket

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        return self.observed.statistics

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "_FixedPoses":  # noqa: ARG002 - the protocol's
        return self

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "_FixedPoses":  # noqa: ARG002 - the protocol's
        return self


def known_receiver(link: LinkSettings, truths: Truths) -> Receiver:
    """The soft receiver with the true channel."""
    blind = soft_reader(link.signal, link.receive, ignore)

    def reader(detection: Detection, tracker: Tracker) -> PacketReader:
        return KnownReader(link, truths, blind(detection, tracker))

    return StreamReceiver(soft_parts(link.signal, link.receive, ignore, reader), ignore)


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
