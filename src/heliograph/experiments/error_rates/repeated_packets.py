"""Packets of a carousel that are received again: codewords wrong by the number of the reception.

Each film shows one packet over and over, from a car on the road of the preset "paper".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, simulate
from heliograph.measure.bench import window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat

RECEPTIONS = 4
QUICK_FILMS, FULL_FILMS = 1, 12

TEXT = (
    "One packet shown over and over, on the road of the preset at 30 km/h: codewords wrong in the first, second, ... "
    "packet of the films, those missed included. The soft receiver combines what it received of a packet before."
)


@dataclass(frozen=True, slots=True)
class RepeatedPacket:
    """A film of one packet, shown over and over."""

    # The link, with the length of the film
    settings: LinkSettings
    # The layer that is counted
    layer: str
    # Packets of the film
    receptions: int
    # Of data, road and noise
    seed: int


def film_settings(distance_m: float, receptions: int, changes: Sequence[str] = ()) -> LinkSettings:
    """The link of a film of so many packets."""
    base = load_settings("paper", None, changes)
    film_s = receptions * base.signal.packet_s + 0.005
    start = distance_m + base.channel.speed_m_s * film_s / 2
    own = (f"channel.distance_m={start}", "channel.stop_m=5", f"channel.duration_s={film_s}", "receive.receiver=soft")
    return load_settings("paper", None, [*own, *changes])


def measure(settings: LinkSettings, layer: str, receptions: int, films: int, context: Context) -> list[Count]:
    """Codewords wrong, a count a reception."""
    todo = [RepeatedPacket(settings, layer, receptions, seed) for seed in range(films)]
    wrong = np.sum(context.each("repeated packets", wrong_codewords, todo), axis=0)
    sent = films * PacketFormat(settings.signal).layers[layer].codewords
    return [Count(sent, int(errors)) for errors in wrong]


def wrong_codewords(film: RepeatedPacket) -> NDArray[np.int64]:
    """Codewords of a layer that were not read in each packet of a film, (receptions,)."""
    settings = film.settings
    receiver, packets = make_receiver(settings.signal, settings.receive), list[Packet]()
    messages = _one_packet(settings, film.seed)
    for frame, _ in simulate(settings, [messages], film.seed, None, window_margin_px(settings)):
        packets += receiver.push(frame)
    packets += receiver.finish()
    wrong = np.full(film.receptions, PacketFormat(settings.signal).layers[film.layer].codewords, np.int64)
    for packet in packets:
        number = round(packet.start_time_s / settings.signal.packet_s)
        if number < film.receptions:
            wrong[number] = sum(word.status != "ok" for word in packet.layers[film.layer])
    return wrong


def _one_packet(settings: LinkSettings, seed: int) -> Messages:
    """Random messages that fill one packet."""
    rng = np.random.default_rng([seed, 1])
    layers = PacketFormat(settings.signal).layers
    return {name: [rng.bytes(layer.codewords * layer.payload_bytes)] for name, layer in layers.items()}


def run(context: Context) -> ExperimentResult:
    """Count repeated packets where a single reception is not enough."""
    films, found = QUICK_FILMS if context.quick else FULL_FILMS, {}
    # layers and the distances in m at which a single reception is not enough
    for layer, z in (("low", 130.0), ("middle", 160.0), ("middle", 180.0), ("high", 220.0), ("high", 240.0)):
        found[f"{layer}, {z:g} m"] = measure(film_settings(z, RECEPTIONS), layer, RECEPTIONS, films, context)
    head = ["layer, distance", *(f"reception {k}" for k in range(1, RECEPTIONS + 1))]
    rows = [[place, *(f"{c.errors}/{c.trials}" for c in counts)] for place, counts in found.items()]
    return ExperimentResult(
        key="repeated-packets",
        title="Packets received again",
        text=TEXT,
        findings=[_finding(found)],
        tables=[Table("Codewords wrong of sent", head, rows)],
        data={place: [[c.errors, c.trials] for c in counts] for place, counts in found.items()},
    )


def _finding(found: dict[str, list[Count]]) -> Finding:
    parts = [f"{place}: {counts[0].errors} and {counts[-1].errors}" for place, counts in found.items()]
    return Finding(
        "Asked: the gain of receiving a packet again.",
        f"Codewords wrong in the first and in the last of {RECEPTIONS} receptions: {'; '.join(parts)}.",
        "shown",
    )
