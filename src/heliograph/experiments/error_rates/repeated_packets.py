"""Repeated packets.

Films show a packet repeatedly, on the road of the preset "paper" at 30 km/h. The table counts wrong codewords in the
first, second, ... packet of the films, including missed packets. The soft receiver combines repeated packets.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments.links import receive_packets
from heliograph.experiments.report import Context
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.statistics import Count
from heliograph.receive.api import make_receiver
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
    receiver = make_receiver(settings.signal, settings.receive)
    wrong = np.full(receptions, formats[layer].codewords, np.int64)
    for packet in receive_packets(settings, [messages], seed, receiver, {}):
        number = round(packet.start_time_s / settings.signal.packet_s)
        if number < receptions:
            wrong[number] = sum(word.status != "ok" for word in packet.layers[layer])
    return wrong
