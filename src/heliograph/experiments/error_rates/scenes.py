"""Difficult scenes: tilted and occluded arrays, failed LEDs, night, sun, saturation, a pause, six arrays.

The soft receiver in difficult scenes. In scenes at rest a single array stands within half a pixel of the nominal
position, and each packet needs a new acquisition; the other scenes are complete films. The table states wrong codewords
of sent codewords, including missed packets.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.signal.settings import LAYERS


def _array(**changes: object) -> tuple[str, ...]:
    """Changes of the first array."""
    return tuple(f"channel.arrays.0.{key}={value}" for key, value in changes.items())


def _light(all_on: float, panel_level: float, level: float) -> tuple[str, ...]:
    """Luminance of LEDs, panel and background."""
    emitter = (f"channel.emitter.all_on={all_on}", f"channel.emitter.panel_level={panel_level}")
    return (*emitter, f"channel.background.level={level}")


_SIX_ARRAYS = (
    "channel.duration_s=1.5",
    "transmit.identities=[0, 7, 12, 3, 20, 9]",
    "channel.arrays=["
    # crossing before the second, approaching, driving away, swaying off, standing
    "{x_m=-1.2, y_m=-0.7, z_offset_m=-15, vx_m_s=2.4},"
    "{x_m=0.3, y_m=-1.0},"
    "{x_m=2.6, y_m=-0.5, vz_m_s=-15, start_s=0.011},"
    "{x_m=-3.0, y_m=-1.2, vz_m_s=12, start_s=0.037},"
    "{x_m=4.2, y_m=-1.6, z_offset_m=10, vx_m_s=-1.5, vy_m_s=0.5, start_s=0.052},"
    "{x_m=-4.5, y_m=0.5, z_offset_m=5, yaw_deg=15, start_s=0.078}]",
)

SCENES: Mapping[str, Sequence[str]] = {
    "upright": (),
    **{f"yaw {angle}": _array(yaw_deg=angle) for angle in (10, 20, 30, 40)},
    "tilted": _array(yaw_deg=25, pitch_deg=15, roll_deg=5),
    "hidden quarter": _array(hidden=[0, 0, 0.5, 0.5]),
    "hidden side": _array(hidden=[0, 0, 0.25, 1]),
    "sunlit hidden side": _array(hidden=[0, 0, 0.25, 1], hidden_level=0.5),
    "behind a post": _array(hidden=[0.375, 0, 0.625, 1]),
    "dead 5 %": _array(dead=0.05),
    "stuck 5 %": _array(stuck=0.05),
    "dead and stuck 5 %": _array(dead=0.025, stuck=0.025),
    "night 4 times dimmer": _light(0.2, 0, 0),
    "night 10 times dimmer": _light(0.08, 0, 0),
    "sun contrast 1.7": _light(0.33, 0.47, 0.4),
    "saturated 2.5 times": ("channel.emitter.all_on=2",),
    "off for 300 ms": ("channel.duration_s=1", *_array(off_s=[[0.23, 0.53]])),
    "six arrays": _SIX_ARRAYS,
    "six arrays driving": ("channel.speed_m_s=8.333", "channel.stop_m=20", "channel.shake=road", *_SIX_ARRAYS),
}
"""Settings of each scene. A block is a packet of an array at rest, or a film of a scene with a duration."""

SceneCounts = Mapping[tuple[str, float], BlockCounts]  # counts by scene and distance in m


def scene_settings(scene: str, distance_m: float, receiver: str = "soft") -> LinkSettings:
    """Link of a scene."""
    changes = (f"channel.distance_m={distance_m}", f"receive.receiver={receiver}", *_array(x_m=0, y_m=0))
    return load_settings("static", None, [*changes, *SCENES[scene]])


def measure(
    scenes: Sequence[str], distances_m: Sequence[float], seeds: Sequence[int], receiver: str, context: Context
) -> SceneCounts:
    """Count a block per seed, in each scene and at each distance."""
    todo = list(product(scenes, distances_m, seeds))
    total: dict[tuple[str, float], BlockCounts] = {}
    counts = context.each("hard scenes", partial(_count_block, receiver), todo)
    for (scene, z, _), block in zip(todo, counts, strict=True):
        total[scene, z] = total.get((scene, z), BlockCounts()) + block
    return total


def _count_block(receiver: str, work: tuple[str, float, int]) -> BlockCounts:
    """Count a block of a scene, a distance and a seed."""
    scene, distance_m, seed = work
    return run_block(scene_settings(scene, distance_m, receiver), seed)


def counts_text(counts: BlockCounts) -> str:
    """Wrong, missed, sent and falsely accepted codewords in a line."""
    layers = []
    for name, layer in counts.layers.items():
        low, high = layer.words.interval()
        lost = f" ({layer.missed} missed)" if layer.missed else ""
        layers.append(f"{name} {layer.codeword_errors}/{layer.codewords}{lost} [{low:.1e}, {high:.1e}]")
    false = f"false codewords {counts.false_codewords}, packets of nothing {counts.false_packets}"
    return "; ".join([*layers, false])


def run(context: Context) -> ExperimentResult:
    """Count all scenes at 50 m and 80 m."""
    distances_m = (50.0, 80.0)
    seeds = range(context.seed, context.seed + (1 if context.quick else 6))
    total = measure(list(SCENES), distances_m, seeds, "soft", context)
    false, sent = (sum(getattr(c, name) for c in total.values()) for name in ("false_codewords", "codewords"))
    claim = "Question: the receiver accepts no codeword that was not sent."
    head = ["scene", *(f"{z:g} m: {', '.join(LAYERS)}" for z in distances_m)]
    rows = [[scene, *(_errors_text(total[scene, z]) for z in distances_m)] for scene in SCENES]
    return ExperimentResult(
        findings=[Finding(claim, f"{false} false codewords, {sent} sent.", verdict_of(not false))],
        tables=[Table("Codewords wrong of sent", head, rows)],
        data={f"{scene}, {z:g} m": counts.to_plain() for (scene, z), counts in total.items()},
    )


def _errors_text(counts: BlockCounts) -> str:
    """Wrong and sent codewords of each layer."""
    return " ".join(f"{layer.codeword_errors}/{layer.codewords}" for layer in counts.layers.values())
