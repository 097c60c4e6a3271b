"""Pattern, inverse and their sum.

Pairs of random data filmed at rest. Spread is the standard deviation of the luminance at the LED positions, relative to
the mean over the array, after subtraction of panel and ambient light. The table states the spread of the pattern and of
the sum of pattern and inverse. Edge LEDs have fewer neighbours, so the spread of an array with all LEDs on is the
reference. Dim LEDs, with 5 % of the luminance, never saturate the sensor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import film
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link
from heliograph.experiments.patterns.received import led_points, luminance_at
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, description, verdict_of
from heliograph.signal import haar
from heliograph.signal.packet import with_inverses

DISTANCES_M = (10.0, 25.0, 50.0, 80.0)


@dataclass(frozen=True, slots=True)
class Spreads:
    """Luminance spread of pattern, sum and all-on array, (3,) each, by distance in m."""

    # Pairs at each distance
    pairs: int
    bright: Mapping[float, NDArray[np.float64]]
    dim: Mapping[float, NDArray[np.float64]]


def run(context: Context) -> ExperimentResult:
    """Film pairs at several distances."""
    spreads = measure(4 if context.quick else 40, context.seed)
    pairs = [_filmed(z, context.seed)[:2] for z in (25.0, 50.0)]
    images = [image for first, second in pairs for image in (first, second, (first + second) / 2)]
    names = [f"{z:g} m, {part}" for z in (25, 50) for part in ("pattern", "inverse", "sum / 2")]
    head = ("pattern", "sum with inverse", "all on")
    return ExperimentResult(
        key="fig8",
        title="Fig. 8 and 9: inverted pattern and sum",
        text=description(__doc__),
        findings=[judge(spreads)],
        pictures=[(plots.image_row(images, names, rows=2), "A data pattern, the inverse, and half the sum.")],
        tables=[
            Table(
                "Spread of the LEDs' luminance",
                ["distance", *head, *(f"{name}, dim" for name in head)],
                [[f"{z:g} m", *(f"{v:.1%}" for v in (*spreads.bright[z], *spreads.dim[z]))] for z in DISTANCES_M],
            )
        ],
        data={f"{z:g} m": {"bright": spreads.bright[z].tolist(), "dim": spreads.dim[z].tolist()} for z in DISTANCES_M},
    )


def measure(pairs: int, seed: int) -> Spreads:
    """Mean spreads at each distance."""
    bright, dim = (
        {z: np.array([_filmed(z, seed + k, light)[2] for k in range(pairs)]).mean(0) for z in DISTANCES_M}
        for light in (1.0, 0.05)
    )
    return Spreads(pairs, bright, dim)


def judge(spreads: Spreads) -> Finding:
    """Check that the sum is about as uniform as an array with all LEDs on."""
    rest, rest_dim = (
        {z: float((s[1] - s[2]) / s[0]) for z, s in part.items()} for part in (spreads.bright, spreads.dim)
    )
    # relative spread of the sum that counts as uniform
    limit = 0.2
    bad = [z for z in DISTANCES_M if rest[z] > limit]
    why = ""
    if bad:
        saturated = all(rest_dim[z] <= limit for z in bad)
        why = "Where single LEDs are resolved, fully lit ones saturate the sensor. " if saturated else ""
        why += f"With LEDs of 5% of the brightness: {', '.join(f'{rest_dim[z]:.0%} at {z:g} m' for z in bad)}."
    return Finding(
        "Fig. 8, 9: pattern plus inverted pattern shows the array with all LEDs on.",
        f"Spread of the sum of {spreads.pairs} pairs each, beyond an all-on array, relative to a single pattern: "
        + ", ".join(f"{rest[z]:.0%} at {z:g} m" for z in DISTANCES_M)
        + ".",
        verdict_of(not bad),
        why,
    )


def _filmed(
    distance: float, seed: int, brightness: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, ...]]:
    """Images of pattern and inverse, and the spreads of pattern, sum and all-on array."""
    rng = np.random.default_rng([seed, round(distance)])
    channel = replace(centred_link(distance, rng, brightness).channel, duration_s=4e-3)
    data = with_inverses(haar.encode(rng.choice([-1, 1], (1, 16, 16))))
    patterns = [*data, np.full((16, 16), 4, np.uint8), np.zeros((16, 16), np.uint8)]
    shots = list(film(channel, [patterns], rng, pattern_period_s=1e-3, roi_margin_px=6))
    points = led_points(shots[0][1].arrays[0])
    first, second, on, dark = (luminance_at(frame, points) for frame, _ in shots)
    first, second, on = first - dark, second - dark, on - dark
    spreads = tuple(float(light.std() / light.mean()) for light in (first, first + second, on))
    return shots[0][0].pixels.astype(float), shots[1][0].pixels.astype(float), spreads
