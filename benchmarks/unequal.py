"""Codewords read of arrays whose LEDs differ or have failed, over the first second of a film and after it.

    python -m benchmarks.unequal [--films 5] [--at 95] [--driving] [--receiver soft] [CHANGE ...]

Each film has its own draw of LEDs, messages, noise, place within a pixel and, driving, road (30 km/h, class B); its
number is the seed. The first ten packets count as the first second. CHANGE is a setting of array 0, such as spread=0.2
or dead=0.15. Prints wrong codewords of sent by layer, with intervals of 95 % by Clopper and Pearson.
"""

import argparse
import os
from collections.abc import Sequence

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: one core

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import dithered, random_messages, window_margin_px
from heliograph.measure.statistics import clopper_pearson
from heliograph.receive import Packet, make_receiver
from heliograph.signal.settings import LAYERS

FIRST = 10
"""Packets of the first second."""

PACKETS = 22
"""Packets of a film."""

METRES_PER_S = 30 / 3.6


def link(distance_m: float, driving: bool, receiver: str, changes: Sequence[str], seed: int) -> LinkSettings:
    """The link of a film; a drive passes the distance in the middle of what comes after the first second."""
    duration = PACKETS * 0.1
    start = distance_m + METRES_PER_S * 0.05 * (FIRST + PACKETS) if driving else distance_m
    own = [
        f"channel.distance_m={start}", f"channel.duration_s={duration}", f"receive.receiver={receiver}",
        "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0", *(f"channel.arrays.0.{one}" for one in changes),
    ]  # fmt: skip
    if driving:
        own += [f"channel.speed_m_s={METRES_PER_S}", "channel.shake=road", "channel.road_class=B"]
    return dithered(load_settings("static", None, own), seed)


def packets_of(settings: LinkSettings, seed: int) -> list[Packet]:
    """Packets read of a film."""
    receiver, packets = make_receiver(settings.signal, settings.receive), list[Packet]()
    for frame, _ in simulate(settings, random_messages(settings, seed), seed, None, window_margin_px(settings)):
        packets += receiver.push(frame)
    return [*packets, *receiver.finish()]


def wrong(packets: Sequence[Packet], first: int, last: int) -> dict[str, tuple[int, int]]:
    """Wrong codewords of sent by layer, of the packets numbered from `first` to below `last`; those not read count."""
    read = {round(packet.start_time_s / 0.1): packet for packet in packets}
    counts = {}
    for name in LAYERS:
        each = 2 if name == "middle" else 1
        right = sum(
            word.status == "ok" for k in range(first, last) if k in read for word in read[k].layers[name]
        )  # fmt: skip
        counts[name] = each * (last - first) - right, each * (last - first)
    return counts


def main() -> None:
    limit_threads()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("changes", nargs="*", metavar="CHANGE", default=["spread=0.2"])
    parser.add_argument("--films", type=int, default=5)
    parser.add_argument("--at", type=float, default=95.0)
    parser.add_argument("--driving", action="store_true")
    parser.add_argument("--receiver", default="soft")
    asked = parser.parse_args()
    parts = {"first second": (0, FIRST), "after it": (FIRST, PACKETS)}
    total = {part: dict.fromkeys(LAYERS, (0, 0)) for part in parts}
    for seed in range(asked.films):
        packets = packets_of(link(asked.at, asked.driving, asked.receiver, asked.changes, seed), seed)
        for part, span in parts.items():
            for name, (errors, sent) in wrong(packets, *span).items():
                before = total[part][name]
                total[part][name] = before[0] + errors, before[1] + sent
    how = "driving" if asked.driving else "at rest"
    for part, counts in total.items():
        found = (
            f"{e}/{n} [{low:.2g}, {high:.2g}]" for e, n in counts.values() for low, high in [clopper_pearson(e, n)]
        )
        print(f"{' '.join(asked.changes)}, {asked.at:g} m, {how}, {part}: " + "  ".join(found))


if __name__ == "__main__":
    main()
