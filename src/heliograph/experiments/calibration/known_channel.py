"""The loss of the soft receiver by estimating the channel: the same films read blind, and by `known_receiver`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from heliograph.base.frames import Frame
from heliograph.experiments.calibration.known_receiver import Truths, known_receiver
from heliograph.experiments.result import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, simulate, transmitters
from heliograph.measure.bench import dithered, lasting, random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.block import AnyBlock
from heliograph.signal.packet import PacketFormat

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
