"""Fig. 8 and 9: a pattern, its inverse, and their sum."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import film
from heliograph.experiments import plots
from heliograph.experiments.chapter import Chapter, Context, Finding, Table
from heliograph.experiments.figures.received import at_rest, leds, read
from heliograph.signal import haar
from heliograph.signal.packet import with_inverses

DISTANCES = (10.0, 25.0, 50.0, 80.0)
UNIFORM = 0.2
"""The sum counts as all LEDs on where its spread is at most this share of the single patterns' spread."""

TEXT = (
    "Pairs of random data filmed at rest. Spread: standard deviation of the luminance at the LEDs' places over the "
    "array, as a share of its mean, panel and ambient light taken off; for the pattern, and for the sum of pattern and "
    "inverse. The edge LEDs, which have fewer neighbours to share light with, count in it: the spread of an array with "
    "all LEDs on stands beside."
)


def run(context: Context) -> Chapter:
    """Film pairs near and far."""
    pairs = 4 if context.quick else 40
    spreads = {z: np.array([_spreads(z, context.seed + k) for k in range(pairs)]).mean(0) for z in DISTANCES}
    ratio = {z: (s[1] - s[2]) / s[0] for z, s in spreads.items()}
    shots = [_filmed(z, context.seed) for z in (25.0, 50.0)]
    images = [image for first, second, _ in shots for image in (first, second, (first + second) / 2)]
    names = [f"{z:g} m, {what}" for z in (25, 50) for what in ("pattern", "inverse", "sum / 2")]
    worst = max(ratio, key=lambda z: ratio[z])
    return Chapter(
        key="fig8",
        title="Fig. 8 and 9: inverted pattern and sum",
        text=TEXT,
        findings=[
            Finding(
                "Fig. 8, 9: pattern plus inverted pattern shows the array with all LEDs on.",
                f"Over {pairs} pairs at each distance the sum's spread beyond that of an all-on array is at most "
                f"{ratio[worst]:.0%} of a single pattern's (at {worst:g} m); "
                + ", ".join(f"{z:g} m: {s[0]:.0%} falls to {s[1]:.0%} (all on {s[2]:.0%})" for z, s in spreads.items())
                + ".",
                "holds" if ratio[worst] <= UNIFORM else "differs",
                "" if ratio[worst] <= UNIFORM else "Where single LEDs are resolved, full ones saturate the sensor.",
            )
        ],
        pictures=[(plots.image_row(images, names, rows=2), "A data pattern, its inverse, and half their sum.")],
        tables=[
            Table(
                "Spread of the LEDs' luminance",
                ["distance", "pattern", "sum with inverse", "all on"],
                [[f"{z:g} m", *(f"{v:.1%}" for v in s)] for z, s in spreads.items()],
            )
        ],
        data={f"{z:g} m": s.tolist() for z, s in spreads.items()},
    )


def _filmed(
    distance: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float, float]]:
    """Images of a pattern and its inverse, and the spreads of pattern, sum and all-on array."""
    rng = np.random.default_rng([seed, round(distance)])
    settings = at_rest(distance, rng).channel
    data = with_inverses(haar.encode(rng.choice([-1, 1], (1, 16, 16))))
    patterns = [*data, np.full((16, 16), 4, np.uint8), np.zeros((16, 16), np.uint8)]
    channel = replace(settings, duration_s=4e-3)
    shots = list(film(channel, [patterns], rng, pattern_period_s=1e-3, roi_margin_px=6))
    points = leds(shots[0][1].arrays[0])
    first, second, on, dark = (read(frame, points) for frame, _ in shots)
    first, second, on = first - dark, second - dark, on - dark
    images = [frame.pixels.astype(float) for frame, _ in shots[:2]]
    return images[0], images[1], (_spread(first), _spread(first + second), _spread(on))


def _spreads(distance: float, seed: int) -> tuple[float, float, float]:
    return _filmed(distance, seed)[2]


def _spread(light: NDArray[np.float64]) -> float:
    return float(light.std() / light.mean())
