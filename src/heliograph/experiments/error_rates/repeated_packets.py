"""Repeated packets.

Films show a packet repeatedly, on the road of the preset "paper" at 30 km/h. The table counts wrong codewords in the
first, second, ... packet of the films, including missed packets. The soft receiver combines repeated packets.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments.links import receive_link
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, description
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.statistics import Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat


def film_settings(distance_m: float, receptions: int, changes: Sequence[str] = ()) -> LinkSettings:
    """Link of a film of several packets, centred at a distance."""
    base = load_settings("paper", None, changes)
    film_s = receptions * base.signal.packet_s + 0.005
    start = distance_m + base.channel.speed_m_s * film_s / 2
    drive = (f"channel.distance_m={start}", "channel.stop_m=5", f"channel.duration_s={film_s}", "receive.receiver=soft")
    return load_settings("paper", None, [*drive, *changes])


def measure(settings: LinkSettings, layer: str, receptions: int, films: int, context: Context) -> list[Count]:
    """Count wrong codewords by reception."""
    job = partial(wrong_codewords, settings, layer, receptions)
    wrong = np.sum(context.each("repeated packets", job, range(films)), axis=0)
    sent = films * PacketFormat(settings.signal).layers[layer].codewords
    return [Count(sent, int(errors)) for errors in wrong]


def wrong_codewords(settings: LinkSettings, layer: str, receptions: int, seed: int) -> NDArray[np.int64]:
    """Wrong codewords of a layer in each packet of a film, (receptions,)."""
    formats = PacketFormat(settings.signal).layers
    rng = np.random.default_rng([seed, 1])
    # messages that fill a packet
    messages = {name: [rng.bytes(form.codewords * form.payload_bytes)] for name, form in formats.items()}
    receiver, packets = make_receiver(settings.signal, settings.receive), list[Packet]()
    for _, received in receive_link(settings, [messages], seed, receiver):
        packets += received
    packets += receiver.finish()
    wrong = np.full(receptions, formats[layer].codewords, np.int64)
    for packet in packets:
        number = round(packet.start_time_s / settings.signal.packet_s)
        if number < receptions:
            wrong[number] = sum(word.status != "ok" for word in packet.layers[layer])
    return wrong


def run(context: Context) -> ExperimentResult:
    """Count repeated packets at distances beyond the range of a single reception."""
    receptions, found = 4, {}
    for layer, z in (("low", 130.0), ("middle", 160.0), ("middle", 180.0), ("high", 220.0), ("high", 240.0)):
        films = 1 if context.quick else 12
        found[f"{layer}, {z:g} m"] = measure(film_settings(z, receptions), layer, receptions, films, context)
    head = ["layer, distance", *(f"reception {k}" for k in range(1, receptions + 1))]
    rows = [[place, *(f"{c.errors}/{c.trials}" for c in counts)] for place, counts in found.items()]
    ends = "; ".join(f"{place}: {counts[0].errors} and {counts[-1].errors}" for place, counts in found.items())
    return ExperimentResult(
        key="repeated-packets",
        title="Repeated packets",
        text=description(__doc__),
        findings=[
            Finding(
                "Question: the gain of a repeated packet.",
                f"Codewords wrong in the first and in the last of {receptions} receptions: {ends}.",
                "shown",
            )
        ],
        tables=[Table("Codewords wrong of sent", head, rows)],
        data={place: [[c.errors, c.trials] for c in counts] for place, counts in found.items()},
    )
