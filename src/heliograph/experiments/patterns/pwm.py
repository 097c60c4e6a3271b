"""Fig. 4: pulse width modulation, and what an exposure makes of it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.channel import film
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings

DISTANCE_M = 60.0
"""Far enough that no LED saturates the sensor."""

LEVELS = np.arange(5, dtype=np.uint8)

EXPOSURES_S = (1e-3, 0.5e-3)

TEXT = (
    f"Arrays of one level each, {DISTANCE_M:g} m away, filmed with an exposure of the whole pattern period T_b = 1 ms "
    "and of half of it. The light of the array in the frame, the dark array's taken off, stands for the integral of "
    "equation (6); it is stated by that of level 4."
)


Luminances = Mapping[float, NDArray[np.float64]]
"""Light by level of each film, (films, 5) with 1 for level 4, by exposure in s."""


def run(context: Context) -> ExperimentResult:
    """Draw the waveforms and film each level."""
    light = measure(range(context.seed, context.seed + (4 if context.quick else 40)))
    return ExperimentResult(
        key="fig4",
        title="Fig. 4: pulse width modulation",
        text=TEXT,
        findings=judge(light),
        pictures=[
            (_waveforms(), "Light of an LED by level over a pattern and its inverse; the shutter is open above.")
        ],
        tables=[_table(light)],
        data={f"{1e3 * tau:g} ms": rows.tolist() for tau, rows in light.items()},
    )


def measure(seeds: Sequence[int]) -> Luminances:
    """Film each level with each exposure."""
    return {tau: np.array([filmed(tau, seed) for seed in seeds]) for tau in EXPOSURES_S}


def judge(light: Luminances) -> list[Finding]:
    """Whether the light grows with the level, with an exposure of T_b and with half of it."""
    whole, half = (light[tau] for tau in EXPOSURES_S)
    off = np.abs(whole.mean(0) - LEVELS / 4).max()
    lost = _lost_steps(half.mean(0))
    # largest deviation from a straight line, by the highest level, that counts as none
    return [
        Finding(
            "Fig. 4: an LED lit for a fraction of T_b has that fraction of the luminance.",
            f"Levels 0 to 4 give {_numbers(whole.mean(0))} of the light ({len(whole)} films of each); largest "
            f"deviation from a straight line {off:.2%}, from film to film {whole.std(0).max():.2%}.",
            "holds" if off < 0.02 else "differs",
        ),
        Finding(
            "Section II-B allows an exposure shorter than T_b.",
            f"With half of T_b, and slots lit from the first on, levels 0 to 4 give {_numbers(half.mean(0))}: "
            f"{lost} of 4 steps between levels are lost.",
            "differs" if lost else "holds",
            "An exposure must last the whole T_b for PWM, or the levels lit after its end look alike." if lost else "",
        ),
    ]


def _table(light: Luminances) -> Table:
    rows = [[f"{1e3 * tau:g} ms", *(f"{v:.3f}" for v in rows.mean(0))] for tau, rows in light.items()]
    return Table("Light by level, by that of level 4", ["exposure", *map(str, LEVELS)], rows)


def filmed(exposure_s: float, seed: int) -> NDArray[np.float64]:
    """Light of the array in a frame at each level, less that of the dark array, by that of level 4."""
    rng = np.random.default_rng(seed)
    settings = centred_link(DISTANCE_M, rng).channel
    settings = replace(settings, duration_s=5e-3, camera=replace(settings.camera, exposure_s=exposure_s))
    patterns = [np.full((16, 16), level, np.uint8) for level in LEVELS]
    frames = [f for f, _ in film(settings, [patterns], rng, pattern_period_s=1e-3, roi_margin_px=4)]
    light = np.array([frame.pixels.sum(dtype=float) for frame in frames])
    return np.asarray((light - light[0]) / (light[4] - light[0]))


def _lost_steps(light: NDArray[np.float64]) -> int:
    """Steps from level to level that are less than half of what they should be."""
    return int((np.diff(light) < 0.5 / 4).sum())


def _numbers(values: NDArray[np.float64]) -> str:
    return ", ".join(f"{v:.3f}" for v in values)


def _waveforms() -> Figure:
    order = SignalSettings().slot_order
    figure = Figure(figsize=(9, 4))
    axes = figure.add_subplot()
    for level in LEVELS:
        pair = np.array([[[level]], [[4 - level]]], dtype=np.uint8)
        wave = np.append(pwm.waveform(pair, order), 0)
        axes.step(np.arange(9) / 4, 0.8 * wave - 1.2 * level, where="post", color=plots.BLUE, lw=1.4)
        axes.fill_between(
            np.arange(9) / 4, -1.2 * level, 0.8 * wave - 1.2 * level, step="post", color=plots.BLUE, alpha=0.15, lw=0
        )
        axes.text(-0.05, 0.3 - 1.2 * level, f"x = {level}/4", ha="right", fontsize=9)
    for start in (0, 1):
        axes.plot([start + 0.01, start + 0.99], [1.15, 1.15], color=plots.ORANGE, lw=3)
        axes.text(start + 0.5, 1.3, ("pattern", "inverse")[start], ha="center", fontsize=9)
    axes.set(xlim=(-0.3, 2.02), ylim=(-5.1, 1.7), xlabel="time (ms)", yticks=[], xticks=[0, 0.25, 0.5, 0.75, 1, 1.5, 2])
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.tight_layout()
    return figure
