"""Coverage of the stated 95 % regions of positions and poses in space, over random scenes.

    python -m benchmarks.pose_coverage [--films 100] [--seed 46] [--receiver plain] [--receiver soft]

Draws distances from 25 to 150 m, yaw from -40 to 40 degrees, and in turn each kind of scene. A packet is covered if one
of the two stated poses has the truth in its region. Counts have Clopper-Pearson intervals.
"""

import argparse
import os

from heliograph.base.workers import THREAD_LIMITS

os.environ.update(THREAD_LIMITS)  # before importing NumPy

import numpy as np

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.measure.statistics import Count

DRIVES = {"drive": "paper", "drive-night": "night"}
KINDS = ("static", "tilted", "night", "spread", "dead", "glare", "lamps", "clock", *DRIVES)


def draw(kind: str, receiver: str, rng: np.random.Generator) -> LinkSettings:
    """Draw a scene of a kind."""
    distance = float(rng.uniform(25, 150))
    x, y, yaw, tilt, phase = (float(value) for value in rng.uniform([-3, -1, -40, -1, 0], [3, 0.5, 40, 1, 1e-3]))
    array = {"x_m": x * distance / 60, "y_m": y * distance / 60, "yaw_deg": yaw}
    array |= {"pitch_deg": tilt * (25 if kind == "tilted" else 5), "roll_deg": float(rng.uniform(-3, 3))}
    array |= {"brightness": 0.25 if kind == "night" else 1.0, "spread": 0.2 if kind == "spread" else 0.0}
    array["dead"] = 0.15 if kind == "dead" else 0.0
    if kind == "clock":
        # "plain" needs a camera in step
        array |= {"clock_ppm": 50.0, "start_s": phase if receiver == "soft" else 0.0}
    channel = {"distance_m": distance, "arrays": [array], "weather": {"glare": 0.3 if kind == "glare" else 0.0}}
    if kind == "lamps":
        channel["background"] = {"kind": "street"}
    if kind in DRIVES:
        channel |= {"speed_m_s": float(rng.uniform(5, 28)), "stop_m": 5.0}
    changes = {"channel": channel, "receive": {"receiver": receiver}}
    return load_settings(DRIVES.get(kind, "static"), changes)


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=100)
    parser.add_argument("--seed", type=int, default=46)
    parser.add_argument("--receiver", action="append", choices=["plain", "soft"])
    options = parser.parse_args()
    for receiver in options.receiver or ["plain", "soft"]:
        totals = dict.fromkeys([*KINDS, "all"], BlockCounts())
        for number in range(options.films):
            kind, rng = KINDS[number % len(KINDS)], np.random.default_rng([options.seed, number])
            counts = run_block(draw(kind, receiver, rng), options.seed * 10_000 + number, max_packets=2)
            totals[kind] += counts
            totals["all"] += counts
        for kind, total in totals.items():
            covered = (Count(total.posed, n) for n in (total.covered_positions, total.covered_poses))
            print(f"{receiver:6} {kind:12} position {{}}  pose {{}}".format(*map(_text, covered)), flush=True)


def _text(count: Count) -> str:
    low, high = count.interval()
    return f"{count.errors:4}/{count.trials:<4} ({100 * low:5.1f} to {100 * high:5.1f} %)"


if __name__ == "__main__":
    main()
