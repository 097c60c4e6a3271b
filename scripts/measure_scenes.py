"""Counts of the soft receiver in hard scenes: tilted, hidden, failed LEDs, night, sun, saturated, off, six arrays.

    python scripts/measure_scenes.py [SCENE ...] [--at M,M] [--packets N] [--first SEED] [--receiver NAME]

prints for each scene and distance the codewords wrong (of packets missed altogether) of those sent by layer with the
95 % interval, and codewords passed as right that were not sent: there must be none.
"""

import argparse
from collections.abc import Mapping, Sequence

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.measure.statistics import Count
from heliograph.sweeps.executors import limit_threads

ARRAY = "channel.arrays.0."
NIGHT = ("channel.emitter.panel_level=0", "channel.background.level=0")

STILL: Mapping[str, Sequence[str]] = {
    "upright": (),
    **{f"yaw {a}": (f"{ARRAY}yaw_deg={a}",) for a in (10, 20, 30, 40)},
    "tilted": (f"{ARRAY}yaw_deg=25", f"{ARRAY}pitch_deg=15", f"{ARRAY}roll_deg=5"),
    "hidden quarter": (f"{ARRAY}hidden=[0,0,0.5,0.5]",),
    "hidden side": (f"{ARRAY}hidden=[0,0,0.25,1]",),
    "hidden side, sunlit": (f"{ARRAY}hidden=[0,0,0.25,1]", f"{ARRAY}hidden_level=0.5"),
    "behind a post": (f"{ARRAY}hidden=[0.375,0,0.625,1]",),
    "dead 5 %": (f"{ARRAY}dead=0.05",),
    "stuck 5 %": (f"{ARRAY}stuck=0.05",),
    "dead and stuck 5 %": (f"{ARRAY}dead=0.025", f"{ARRAY}stuck=0.025"),
    "night, 4 times dimmer": ("channel.emitter.all_on=0.2", *NIGHT),
    "night, 10 times dimmer": ("channel.emitter.all_on=0.08", *NIGHT),
    "sun, contrast 1.7": (
        "channel.emitter.all_on=0.33",
        "channel.emitter.panel_level=0.47",
        "channel.background.level=0.4",
    ),
    "saturated 2.5 times": ("channel.emitter.all_on=2",),
}
"""One array at rest, a packet a block; what each changes."""

OFF = ("channel.duration_s=1", f"{ARRAY}off_s=[[0.23, 0.53]]")

SIX = (
    "transmit.identities=[0, 7, 12, 3, 20, 9]",
    "channel.arrays=["
    # one crosses before the second, one comes nearer, one drives away, one sways off, one stands
    "{x_m=-1.2, y_m=-0.7, z_offset_m=-15, vx_m_s=2.4},"
    "{x_m=0.3, y_m=-1.0},"
    "{x_m=2.6, y_m=-0.5, vz_m_s=-15, start_s=0.011},"
    "{x_m=-3.0, y_m=-1.2, vz_m_s=12, start_s=0.037},"
    "{x_m=4.2, y_m=-1.6, z_offset_m=10, vx_m_s=-1.5, vy_m_s=0.5, start_s=0.052},"
    "{x_m=-4.5, y_m=0.5, z_offset_m=5, yaw_deg=15, start_s=0.078}]",
)

FILMS: Mapping[str, Sequence[str]] = {
    "off for 300 ms": OFF,
    "six arrays": ("channel.duration_s=1.5", *SIX),
    "six arrays, driving": (
        "channel.duration_s=1.5",
        "channel.speed_m_s=8.333",
        "channel.stop_m=20",
        "channel.shake=road",
        *SIX,
    ),
}
"""Films: of them the whole length is one block."""


def settings_of(scene: str, distance_m: float, receiver: str = "soft") -> LinkSettings:
    """The link of a scene."""
    centre = (f"{ARRAY}x_m=0", f"{ARRAY}y_m=0")
    changes = (*centre, *(STILL[scene] if scene in STILL else FILMS[scene]))
    return load_settings("static", None, [f"channel.distance_m={distance_m}", f"receive.receiver={receiver}", *changes])


def measure(scene: str, distance_m: float, seeds: range, receiver: str = "soft") -> BlockCounts:
    """Counts of some blocks."""
    total = BlockCounts()
    for seed in seeds:
        total += run_block(settings_of(scene, distance_m, receiver), seed)
    return total


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="*", help=f"of {', '.join([*STILL, *FILMS])}; all by default")
    parser.add_argument("--at", default="50,80", help="distances in m")
    parser.add_argument("--packets", type=int, default=20, help="blocks: packets of arrays at rest, or films")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--receiver", default="soft")
    given = parser.parse_args()
    unknown = set(given.scene) - {*STILL, *FILMS}
    if unknown:
        parser.error(f"there is no scene {', '.join(sorted(unknown))}")
    limit_threads()
    for scene in given.scene or [*STILL, *FILMS]:
        for distance in map(float, given.at.split(",")):
            counts = measure(scene, distance, range(given.first, given.first + given.packets), given.receiver)
            print(f"{scene}, {distance:g} m: {told(counts)}", flush=True)


def told(counts: BlockCounts) -> str:
    """Counts in a line."""
    layers = []
    for name, layer in counts.layers.items():
        low, high = Count(layer.codewords, layer.codeword_errors).interval()
        lost = f" ({layer.missed} missed)" if layer.missed else ""
        layers.append(f"{name} {layer.codeword_errors}/{layer.codewords}{lost} [{low:.1e}, {high:.1e}]")
    false = f"false codewords {counts.false_codewords}, packets of nothing {counts.false_packets}"
    return "; ".join([*layers, false])


if __name__ == "__main__":
    main()
