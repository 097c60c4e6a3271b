"""How surely and how soon an array is found after it is switched on, counted.

    python scripts/measure_acquisition.py [--trials N] [--first SEED] [--within PATTERNS] [key=value ...]

Each trial is a drive of the `paper` preset from its start, 80 m, with its own road, noise, place within a pixel and
identity. The camera runs before; the array is switched on at a random moment of its packet, at most PATTERNS before a
header (100: anywhere in the packet). It is acquired once the receiver follows it with the right identity and the right
start of the packet; missed if it does not by the end of the second header. Windows about the array are filmed.
"""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive.detect import Detection
from heliograph.receive.receivers import make_receiver
from heliograph.signal.header import IDENTITIES
from heliograph.sweeps.executors import limit_threads

ON_S = 0.006
"""Frames before the light comes on, in s."""


def trial_settings(seed: int, within: int, changes: Sequence[str]) -> tuple[LinkSettings, float]:
    """The link of a trial, and the time at which its first header begins."""
    rng = np.random.default_rng([seed, 5])
    base = load_settings("paper", None, changes)
    period, patterns = base.signal.pattern_period_s, base.signal.packet_patterns
    lead = int(rng.integers(0, min(within, patterns - 1) + 1))
    first = ON_S + lead * period
    pixel_m = base.channel.distance_m / base.channel.camera.focal_px
    x, y = np.array([1.5, -1.0]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
    own = (
        f"transmit.identities=[{rng.integers(IDENTITIES)}]",
        f"channel.arrays.0.x_m={x}",
        f"channel.arrays.0.y_m={y}",
        f"channel.arrays.0.start_s={first - patterns * period}",
        f"channel.arrays.0.off_s=[[-1.0, {ON_S}]]",
        f"channel.duration_s={first + (patterns + 12) * period}",
    )
    return load_settings("paper", None, ["receive.receiver=soft", *changes, *own]), first


def acquired(settings: LinkSettings, first_s: float, seed: int) -> tuple[int, int]:
    """Headers until the array was found, 0 if it was not; and the number of wrong detections on the way."""
    detected: list[Detection] = []
    found: list[Detection] = []

    def watch(stage: str, data: Mapping[str, Any], /) -> None:
        if stage == "detect":
            detected.append(data["detection"])
        elif stage == "track":
            # the last one found is the one followed, as soon as its header is seen to be one
            found.extend(one for one in detected[-1:] if one.identity == data["identity"] and one not in found)

    receiver = make_receiver(settings.signal, settings.receive, watch)
    identity, period = settings.transmit.identities[0], settings.signal.pattern_period_s
    packet_s = settings.signal.packet_s
    for frame, _ in simulate(settings, random_messages(settings, seed), seed, None, window_margin_px(settings)):
        for _ in receiver.push(frame):
            pass
        for one in found:
            headers, rest = divmod((one.start_time_s - first_s) / packet_s + 0.5, 1.0)
            if one.identity == identity and abs(rest - 0.5) * packet_s < 0.5 * period:
                return int(headers) + 1, len(detected) - 1
    return 0, len(detected)


def main() -> None:
    """Count what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("changes", nargs="*", metavar="key=value")
    parser.add_argument("--trials", type=int, default=3000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--within", type=int, default=100)
    given = parser.parse_args()
    limit_threads()
    by_header, wrong = [0, 0, 0], 0
    for seed in range(given.first, given.first + given.trials):
        settings, first = trial_settings(seed, given.within, given.changes)
        headers, false = acquired(settings, first, seed)
        by_header[headers] += 1
        wrong += false
        if headers != 1:
            print(f"trial {seed}: {'missed' if not headers else 'by its second header'}", flush=True)
    low, high = Count(given.trials, by_header[0]).interval()
    print(
        f"{given.trials} trials: by the first header {by_header[1]}, by the second {by_header[2]}, missed "
        f"{by_header[0]} [{low:.1e}, {high:.1e}]; wrong detections {wrong}"
    )


if __name__ == "__main__":
    main()
