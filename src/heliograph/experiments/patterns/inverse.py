"""Fig. 8 and 9: a pattern, its inverse, and their sum."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import film
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link
from heliograph.experiments.patterns.received import led_points, luminance_at
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.signal import haar
from heliograph.signal.packet import with_inverses

HEAD = ("pattern", "sum with inverse", "all on")
DISTANCES = (10.0, 25.0, 50.0, 80.0)
DIM = 0.05
"""Brightness at which no LED saturates the sensor even at 10 m."""

UNIFORM = 0.2
"""The sum counts as all LEDs on where its spread is at most this fraction of the single patterns' spread."""

TEXT = (
    "Pairs of random data filmed at rest. Spread: standard deviation of the luminance at the LEDs' places over the "
    "array, by its mean, panel and ambient light taken off; for the pattern, and for the sum of pattern and "
    "inverse. The edge LEDs, which have fewer neighbours to share light with, count in it: the spread of an array with "
    "all LEDs on stands beside, and the same with dim LEDs, which never saturate the sensor."
)


@dataclass(frozen=True, slots=True)
class Spreads:
    """Spread of the LEDs' luminance by distance in m: of pattern, sum and all-on array, (3,) each."""

    # Pairs filmed at each distance
    pairs: int
    # bright, dim: with LEDs as bright as in the reference link, and with `DIM` of that
    bright: Mapping[float, NDArray[np.float64]]
    dim: Mapping[float, NDArray[np.float64]]


def run(context: Context) -> ExperimentResult:
    """Film pairs near and far."""
    spreads = measure(4 if context.quick else 40, context.seed)
    shots = [_filmed(z, context.seed) for z in (25.0, 50.0)]
    images = [image for first, second, _ in shots for image in (first, second, (first + second) / 2)]
    names = [f"{z:g} m, {what}" for z in (25, 50) for what in ("pattern", "inverse", "sum / 2")]
    return ExperimentResult(
        key="fig8",
        title="Fig. 8 and 9: inverted pattern and sum",
        text=TEXT,
        findings=[judge(spreads)],
        pictures=[(plots.image_row(images, names, rows=2), "A data pattern, its inverse, and half their sum.")],
        tables=[
            Table(
                "Spread of the LEDs' luminance",
                ["distance", *HEAD, *(f"{name}, dim" for name in HEAD)],
                [[f"{z:g} m", *(f"{v:.1%}" for v in (*spreads.bright[z], *spreads.dim[z]))] for z in DISTANCES],
            )
        ],
        data={f"{z:g} m": {"bright": spreads.bright[z].tolist(), "dim": spreads.dim[z].tolist()} for z in DISTANCES},
    )


def measure(pairs: int, seed: int) -> Spreads:
    """Mean spreads at each distance."""
    bright, dim = (
        {z: np.array([_spreads(z, seed + k, light) for k in range(pairs)]).mean(0) for z in DISTANCES}
        for light in (1.0, DIM)
    )
    return Spreads(pairs, bright, dim)


def judge(spreads: Spreads) -> Finding:
    """Whether the sum is about as uniform as an array with all LEDs on."""
    rest, rest_dim = (
        {z: float((s[1] - s[2]) / s[0]) for z, s in part.items()} for part in (spreads.bright, spreads.dim)
    )
    bad = [z for z in DISTANCES if rest[z] > UNIFORM]
    return Finding(
        "Fig. 8, 9: pattern plus inverted pattern shows the array with all LEDs on.",
        f"Of a single pattern's spread the sum of {spreads.pairs} pairs each has left, beyond an all-on array's: "
        + ", ".join(f"{rest[z]:.0%} at {z:g} m" for z in DISTANCES)
        + ".",
        "differs" if bad else "holds",
        _why(bad, rest_dim),
    )


def _why(bad: Sequence[float], rest_dim: Mapping[float, float]) -> str:
    """Whether saturation is the cause: without it, is the sum uniform?"""
    if not bad:
        return ""
    left = ", ".join(f"{rest_dim[z]:.0%} at {z:g} m" for z in bad)
    cause = all(rest_dim[z] <= UNIFORM for z in bad)
    text = f"With LEDs of {DIM:.0%} of the brightness there is left: {left}."
    return ("Where single LEDs are resolved, fully lit ones saturate the sensor. " if cause else "") + text


def _filmed(
    distance: float, seed: int, brightness: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float, float]]:
    """Images of a pattern and its inverse, and the spreads of pattern, sum and all-on array."""
    rng = np.random.default_rng([seed, round(distance)])
    settings = centred_link(distance, rng, brightness).channel
    data = with_inverses(haar.encode(rng.choice([-1, 1], (1, 16, 16))))
    patterns = [*data, np.full((16, 16), 4, np.uint8), np.zeros((16, 16), np.uint8)]
    channel = replace(settings, duration_s=4e-3)
    shots = list(film(channel, [patterns], rng, pattern_period_s=1e-3, roi_margin_px=6))
    points = led_points(shots[0][1].arrays[0])
    first, second, on, dark = (luminance_at(frame, points) for frame, _ in shots)
    first, second, on = first - dark, second - dark, on - dark
    images = [frame.pixels.astype(float) for frame, _ in shots[:2]]
    return images[0], images[1], (_spread(first), _spread(first + second), _spread(on))


def _spreads(distance: float, seed: int, brightness: float) -> tuple[float, float, float]:
    return _filmed(distance, seed, brightness)[2]


def _spread(light: NDArray[np.float64]) -> float:
    return float(light.std() / light.mean())
