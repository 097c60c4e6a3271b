"""What packets of a carousel that come again add: codewords wrong by the look at which they were to be read.

    python scripts/measure_looks.py --distance 160 --layer middle --looks 5 --films 20 [key=value ...]

Each film shows one packet over and over, from a car at 30 km/h on the road of the `paper` preset, the given distance at
the middle of the film. Prints the codewords wrong in the first, second, ... packet of the films, those missed included.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, simulate
from heliograph.measure.bench import window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat
from heliograph.sweeps.executors import limit_threads


def film_settings(distance_m: float, looks: int, changes: Sequence[str]) -> LinkSettings:
    """The link of a film of so many packets."""
    base = load_settings("paper", None, changes)
    film_s = looks * base.signal.packet_s + 0.005
    start = distance_m + base.channel.speed_m_s * film_s / 2
    own = (f"channel.distance_m={start}", "channel.stop_m=5", f"channel.duration_s={film_s}", "receive.receiver=soft")
    return load_settings("paper", None, [*own, *changes])


def one_packet(settings: LinkSettings, seed: int) -> Messages:
    """Random messages that fill one packet."""
    rng = np.random.default_rng([seed, 1])
    layers = PacketFormat(settings.signal).layers
    return {name: [rng.bytes(layer.codewords * layer.payload_bytes)] for name, layer in layers.items()}


def wrong_by_look(settings: LinkSettings, layer: str, looks: int, seed: int) -> list[int]:
    """Codewords of a layer that were not read in each packet of a film."""
    receiver, packets = make_receiver(settings.signal, settings.receive), list[Packet]()
    for frame, _ in simulate(settings, [one_packet(settings, seed)], seed, None, window_margin_px(settings)):
        packets += receiver.push(frame)
    packets += receiver.finish()
    wrong = [PacketFormat(settings.signal).layers[layer].codewords] * looks
    for packet in packets:
        number = round(packet.start_time_s / settings.signal.packet_s)
        if number < looks:
            wrong[number] = sum(word.status != "ok" for word in packet.layers[layer])
    return wrong


def main() -> None:
    """Count what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("changes", nargs="*", metavar="key=value")
    parser.add_argument("--distance", type=float, default=160.0)
    parser.add_argument("--layer", default="middle", choices=["high", "middle", "low"])
    parser.add_argument("--looks", type=int, default=5)
    parser.add_argument("--films", type=int, default=20)
    given = parser.parse_args()
    limit_threads()
    settings = film_settings(given.distance, given.looks, given.changes)
    sent = given.films * PacketFormat(settings.signal).layers[given.layer].codewords
    wrong = np.sum([wrong_by_look(settings, given.layer, given.looks, seed) for seed in range(given.films)], axis=0)
    for look, errors in enumerate(wrong, 1):
        low, high = Count(sent, int(errors)).interval()
        print(f"{given.distance:g} m, {given.layer}, look {look}: {errors} of {sent} wrong ({low:.2g} to {high:.2g})")


if __name__ == "__main__":
    main()
