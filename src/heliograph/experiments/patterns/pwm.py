"""Pulse width modulation and the exposure.

Arrays with a single level, 60 m away, filmed with an exposure of the pattern period T_b = 1 ms and of half of it. At 60
m no LED saturates the sensor. The summed luminance of the array in the frame, minus that of the dark array, measures
the integral of equation (6); results are relative to level 4.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link, film_at_rest
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings

LEVELS = np.arange(5, dtype=np.uint8)

Luminances = Mapping[float, Floats]  # luminance by level of each film, (films, 5) relative to level 4, by exposure in s


def run(context: Context) -> ExperimentResult:
    """Draw the waveforms, and film each level with each exposure."""
    seeds = range(context.seed, context.seed + (4 if context.quick else 40))
    luminances = {tau: np.array([filmed(tau, seed) for seed in seeds]) for tau in (1e-3, 0.5e-3)}
    rows = [[f"{1e3 * tau:g} ms", *(f"{v:.3f}" for v in rows.mean(0))] for tau, rows in luminances.items()]
    return ExperimentResult(
        findings=judge(luminances),
        pictures=[(_waveforms(), "Light of an LED by level over a pattern and the inverse; orange: open shutter.")],
        tables=[Table("Luminance by level, relative to level 4", ["exposure", *map(str, LEVELS)], rows)],
        data={f"{1e3 * tau:g} ms": rows.tolist() for tau, rows in luminances.items()},
    )


def judge(luminances: Luminances) -> list[Finding]:
    """Check that the luminance grows with the level for both exposures."""
    full, half = luminances.values()
    deviation = np.abs(full.mean(0) - LEVELS / 4).max()
    # a step is lost below half of the nominal size
    lost = int((np.diff(half.mean(0)) < 0.5 / 4).sum())
    full_text, half_text = (", ".join(f"{v:.3f}" for v in part.mean(0)) for part in (full, half))
    return [
        Finding(
            "Fig. 4: an LED lit for a fraction of T_b has that fraction of the luminance.",
            f"Levels 0 to 4 give {full_text} of the light ({len(full)} films of each); largest "
            f"deviation from a straight line {deviation:.2%}, from film to film {full.std(0).max():.2%}.",
            verdict_of(bool(deviation < 0.02)),
        ),
        Finding(
            "Section II-B allows an exposure shorter than T_b.",
            f"With half of T_b, and slots lit from the first on, levels 0 to 4 give {half_text}: "
            f"{lost} of 4 steps between levels are lost.",
            verdict_of(not lost),
            "PWM needs an exposure of T_b: levels that differ after the exposure look alike." if lost else "",
        ),
    ]


def filmed(exposure_s: float, seed: int) -> Floats:
    """Luminance of the array at each level, minus the dark array, relative to level 4."""
    rng = np.random.default_rng(seed)
    channel = centred_link(60.0, rng).channel
    channel = replace(channel, camera=replace(channel.camera, exposure_s=exposure_s))
    shots = film_at_rest(channel, [np.full((16, 16), level, np.uint8) for level in LEVELS], rng, margin_px=4)
    light = np.array([frame.pixels.sum(dtype=float) for frame, _ in shots])
    return np.asarray((light - light[0]) / (light[4] - light[0]))


def _waveforms() -> Figure:
    order, times = SignalSettings().slot_order, np.arange(9) / 4
    figure = Figure(figsize=(9, 4))
    axes = figure.add_subplot(xlim=(-0.3, 2.02), ylim=(-5.1, 1.7), xlabel="time (ms)")
    axes.set(yticks=[], xticks=[0, 0.25, 0.5, 0.75, 1, 1.5, 2])
    axes.spines["left"].set_visible(False)
    for level in LEVELS:
        pair = np.array([[[level]], [[4 - level]]], dtype=np.uint8)
        base = -1.2 * level
        wave = base + 0.8 * np.append(pwm.waveform(pair, order), 0)
        axes.step(times, wave, where="post", color=plots.BLUE)
        axes.fill_between(times, base, wave, step="post", color=plots.BLUE, alpha=0.15, lw=0)
        axes.text(-0.05, 0.3 + base, f"x = {level}/4", ha="right", fontsize=9)
    for start, name in enumerate(("pattern", "inverse")):
        axes.plot([start + 0.01, start + 0.99], [1.15, 1.15], color=plots.ORANGE, lw=3)
        axes.text(start + 0.5, 1.3, name, ha="center", fontsize=9)
    return figure
