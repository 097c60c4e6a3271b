"""Error rates in hard scenes: tilted, hidden, failed LEDs, night, sun, saturated, switched off, six arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.signal.settings import LAYERS

ARRAY = "channel.arrays.0."
NIGHT = ("channel.emitter.panel_level=0", "channel.background.level=0")

STATIC: Mapping[str, Sequence[str]] = {
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
"""Settings of each scene with one array at rest; a block is one packet."""

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

MOVING: Mapping[str, Sequence[str]] = {
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
"""Settings of each scene that changes; a block is the whole film."""

SCENES = (*STATIC, *MOVING)
"""Names of all scenes."""

DISTANCES_M = (50.0, 80.0)
QUICK_BLOCKS, FULL_BLOCKS = 1, 6

TEXT = (
    "The soft receiver in hard scenes. In those at rest one array stands within a pixel of its place and is acquired "
    "anew for each packet; the others are whole films. Codewords wrong, missed ones included, of those sent; intervals "
    "are Clopper-Pearson, 95 %."
)


SceneCounts = Mapping[tuple[str, float], BlockCounts]
"""Counts by scene and distance in m."""


@dataclass(frozen=True, slots=True)
class SceneTask:
    """A block of a scene."""

    # Name of the scene, one of `SCENES`
    scene: str
    # Distance in m to the plane of the arrays at the start of the film, above 0
    distance_m: float
    # Seed of messages, road, noise and place
    seed: int
    # Name of the receiver, such as "soft"
    receiver: str


def scene_settings(scene: str, distance_m: float, receiver: str = "soft") -> LinkSettings:
    """The link of a scene."""
    centre = (f"{ARRAY}x_m=0", f"{ARRAY}y_m=0")
    changes = (*centre, *{**STATIC, **MOVING}[scene])
    return load_settings("static", None, [f"channel.distance_m={distance_m}", f"receive.receiver={receiver}", *changes])


def measure(
    scenes: Sequence[str], distances_m: Sequence[float], seeds: Sequence[int], receiver: str, context: Context
) -> SceneCounts:
    """Counts of a block a seed, in each scene and at each distance."""
    todo = [SceneTask(scene, z, seed, receiver) for scene in scenes for z in distances_m for seed in seeds]
    total: dict[tuple[str, float], BlockCounts] = {}
    for task, counts in zip(todo, context.each("hard scenes", count_block, todo), strict=True):
        place = task.scene, task.distance_m
        total[place] = total.get(place, BlockCounts()) + counts
    return total


def count_block(task: SceneTask) -> BlockCounts:
    """Counts of one block."""
    return run_block(scene_settings(task.scene, task.distance_m, task.receiver), task.seed)


def counts_text(counts: BlockCounts) -> str:
    """Counts in a line: codewords wrong, missed, sent, and what was accepted that was not sent."""
    layers = []
    for name, layer in counts.layers.items():
        low, high = layer.words.interval()
        lost = f" ({layer.missed} missed)" if layer.missed else ""
        layers.append(f"{name} {layer.codeword_errors}/{layer.codewords}{lost} [{low:.1e}, {high:.1e}]")
    false = f"false codewords {counts.false_codewords}, packets of nothing {counts.false_packets}"
    return "; ".join([*layers, false])


def run(context: Context) -> ExperimentResult:
    """Count all scenes at all distances."""
    seeds = range(context.seed, context.seed + (QUICK_BLOCKS if context.quick else FULL_BLOCKS))
    total = measure(SCENES, DISTANCES_M, seeds, "soft", context)
    return ExperimentResult(
        key="scenes",
        title="Hard scenes",
        text=TEXT,
        findings=[_never_false(list(total.values()))],
        tables=[_table(total)],
        data={f"{scene}, {z:g} m": counts.to_plain() for (scene, z), counts in total.items()},
    )


def _never_false(counts: Sequence[BlockCounts]) -> Finding:
    false, sent = sum(one.false_codewords for one in counts), sum(one.codewords for one in counts)
    return Finding(
        "Asked: no codeword is accepted that was not sent.",
        f"{false} false codewords beside {sent} sent.",
        "differs" if false else "holds",
    )


def _table(total: SceneCounts) -> Table:
    head = ["scene", *(f"{z:g} m: {', '.join(LAYERS)}" for z in DISTANCES_M)]
    rows = [[scene, *(_cell(total[scene, z]) for z in DISTANCES_M)] for scene in SCENES]
    return Table("Codewords wrong of sent", head, rows)


def _cell(counts: BlockCounts) -> str:
    return " ".join(f"{layer.codeword_errors}/{layer.codewords}" for layer in counts.layers.values())
