"""Pattern, inverse and their sum.

Pairs of random data filmed at rest. Spread is the standard deviation of the luminance at the LED positions, relative to
the mean over the array, after subtraction of panel and ambient light. The table states the spread of the pattern and of
the sum of pattern and inverse. Edge LEDs have fewer neighbours, so the spread of an array with all LEDs on is the
reference. Dim LEDs, with 5 % of the luminance, never saturate the sensor.
"""

from collections.abc import Mapping

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link, film_at_rest
from heliograph.experiments.patterns.received import led_points, luminance_at
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.signal import haar
from heliograph.signal.packet import with_inverses

Spreads = Mapping[float, Floats]  # luminance spread of pattern, sum and all-on array, (3,), by distance in m


def run(context: Context) -> ExperimentResult:
    """Film pairs at several distances."""
    count, seed, distances_m = 4 if context.quick else 40, context.seed, (10.0, 25.0, 50.0, 80.0)
    bright, dim = (
        {z: np.mean([_filmed(z, seed + k, light)[2] for k in range(count)], 0) for z in distances_m}
        for light in (1.0, 0.05)
    )
    pairs = [_filmed(z, seed)[:2] for z in (25.0, 50.0)]
    images = [image for first, second in pairs for image in (first, second, (first + second) / 2)]
    names = [f"{z:g} m, {part}" for z in (25, 50) for part in ("pattern", "inverse", "sum / 2")]
    head = ("pattern", "sum with inverse", "all on")
    rows = [[f"{z:g} m", *(f"{v:.1%}" for v in (*bright[z], *dim[z]))] for z in distances_m]
    return ExperimentResult(
        findings=[judge(count, bright, dim)],
        pictures=[(plots.image_row(images, names, rows=2), "A data pattern, the inverse, and half the sum.")],
        tables=[Table("Spread of the LEDs' luminance", ["distance", *head, *(f"{name}, dim" for name in head)], rows)],
        data={f"{z:g} m": {"bright": bright[z].tolist(), "dim": dim[z].tolist()} for z in distances_m},
    )


def judge(pairs: int, bright: Spreads, dim: Spreads) -> Finding:
    """Check that the sum is about as uniform as an array with all LEDs on."""
    rest, rest_dim = ({z: float((s[1] - s[2]) / s[0]) for z, s in part.items()} for part in (bright, dim))
    # relative spread of the sum that counts as uniform
    limit, why = 0.2, ""
    bad = [z for z in rest if rest[z] > limit]
    if bad:
        saturated = all(rest_dim[z] <= limit for z in bad)
        why = "Where single LEDs are resolved, fully lit ones saturate the sensor. " if saturated else ""
        why += f"With LEDs of 5% of the brightness: {', '.join(f'{rest_dim[z]:.0%} at {z:g} m' for z in bad)}."
    return Finding(
        "Fig. 8, 9: pattern plus inverted pattern shows the array with all LEDs on.",
        f"Spread of the sum of {pairs} pairs each, beyond an all-on array, relative to a single pattern: "
        f"{', '.join(f'{part:.0%} at {z:g} m' for z, part in rest.items())}.",
        verdict_of(not bad),
        why,
    )


def _filmed(distance_m: float, seed: int, brightness: float = 1.0) -> tuple[Floats, Floats, tuple[float, ...]]:
    """Images of pattern and inverse, and the spreads of pattern, sum and all-on array."""
    rng = np.random.default_rng([seed, round(distance_m)])
    channel = centred_link(distance_m, rng, brightness).channel
    data = with_inverses(haar.encode(rng.choice([-1, 1], (1, 16, 16))))
    shots = film_at_rest(channel, [*data, np.full((16, 16), 4, np.uint8), np.zeros((16, 16), np.uint8)], rng)
    points = led_points(shots[0][1])
    first, second, on, dark = (luminance_at(frame, points) for frame, _ in shots)
    first, second, on = first - dark, second - dark, on - dark
    spreads = tuple(float(light.std() / light.mean()) for light in (first, first + second, on))
    return shots[0][0].pixels.astype(float), shots[1][0].pixels.astype(float), spreads
