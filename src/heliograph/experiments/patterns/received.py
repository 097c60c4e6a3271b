"""Fig. 3: the received image at 10 m and 70 m."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, film
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link
from heliograph.experiments.report import Context, ExperimentResult, Finding
from heliograph.receive import Pose
from heliograph.signal import haar

NEAR_M, FAR_M = 10.0, 70.0

SWEEP_M = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)

RESOLVED = (1 - 0.735) / (1 + 0.735)
"""Contrast of two lights that are just resolved by Rayleigh: the middle has 73.5 % of the peaks' light."""

TEXT = (
    "The reference link, the car at rest. Left, a data pattern of random bits; right, all LEDs on. Contrast: light at "
    "the LEDs' centres less that midway between neighbours in a row, by their sum, over the whole array with all LEDs "
    "on. Neighbours count as resolved above Rayleigh's contrast of 15 %."
)

Contrasts = Mapping[float, Sequence[float]]
"""Contrast of each frame, by distance in m."""


def run(context: Context) -> ExperimentResult:
    """Film the array from near to far."""
    contrasts = measure(range(2 if context.quick else 20))
    return ExperimentResult(
        key="fig3",
        title="Fig. 3: received image",
        text=TEXT,
        findings=[judge(contrasts)],
        pictures=draw(contrasts, context.seed),
        data={"contrast": {f"{z:g} m": values for z, values in contrasts.items()}},
    )


def measure(seeds: Sequence[int]) -> Contrasts:
    """Contrast of single LEDs in each frame, by distance in m."""
    on = np.full((16, 16), 4, np.uint8)
    return {z: [contrast(*static_frame(z, on, seed)) for seed in seeds] for z in SWEEP_M}


def judge(contrasts: Contrasts) -> Finding:
    """Whether single LEDs are resolved near in all frames and far in none."""
    near, far = (np.array(contrasts[z]) for z in (NEAR_M, FAR_M))
    holds = bool((near > RESOLVED).all() and (far < RESOLVED).all())
    return Finding(
        "Fig. 3: single LEDs are resolved at 10 m and run together at 70 m.",
        f"Contrast between LEDs and gaps {near.mean():.0%} at {NEAR_M:g} m ({(near > RESOLVED).sum()} of {near.size} "
        f"frames above {RESOLVED:.0%}), {far.mean():.1%} at {FAR_M:g} m ({(far > RESOLVED).sum()} of {far.size}).",
        "holds" if holds else "differs",
    )


def draw(contrasts: Contrasts, seed: int) -> list[tuple[Figure, str]]:
    """The array near and far, and its contrast by distance; each with its caption."""
    data = haar.encode(np.random.default_rng(seed).choice([-1, 1], (16, 16)))
    images = [static_frame(z, levels, 0)[0].pixels for z in (NEAR_M, FAR_M) for levels in (data, np.full_like(data, 4))]
    names = [f"{z:g} m, {what}" for z in (NEAR_M, FAR_M) for what in ("data", "all on")]
    return [
        (plots.image_row(images, names), "The array as the camera sees it, pixel for pixel."),
        (_line(contrasts), "Contrast of single LEDs by distance; dashed: resolved by Rayleigh."),
    ]


def static_frame(distance_m: float, levels: NDArray[np.uint8], seed: int) -> tuple[Frame, ArrayTruth]:
    """A frame of a steady pattern and its truth, the array at rest within a pixel of the sensor's middle."""
    settings = centred_link(distance_m, np.random.default_rng([seed, round(distance_m)]))
    channel = replace(settings.channel, duration_s=1e-3)
    shots = film(channel, [[levels]], np.random.default_rng(seed), pattern_period_s=1e-3, roi_margin_px=6)
    frame, truth = next(iter(shots))
    return frame, truth.arrays[0]


def luminance_at(frame: Frame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Luminance in gray levels at points of the sensor, by cubic interpolation. Returns (...) luminances."""
    from heliograph.receive.decode import kernels

    flat = np.ascontiguousarray((points - np.array(frame.origin)).reshape(-1, 2))
    out = np.empty(len(flat))
    kernels.sample_cubic(frame.pixels.astype(np.float64), flat, out)
    return out.reshape(points.shape[:-1])


def led_points(truth: ArrayTruth) -> NDArray[np.float64]:
    """True image points of the LEDs, (16, 16, 2) x and y in px."""
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad).leds(16)


def contrast(frame: Frame, truth: ArrayTruth) -> float:
    """(light at LEDs - light midway) / sum, -1 to 1, over an array with all LEDs on."""
    points = led_points(truth)
    midway = 0.5 * (points[:, 1:] + points[:, :-1])
    on, gap = (np.maximum(luminance_at(frame, where), 0).mean() for where in (points, midway))  # cubics undershoot
    return float((on - gap) / (on + gap))


def _line(contrasts: Contrasts) -> Figure:
    figure = Figure(figsize=(7, 3.4))
    axes = figure.add_subplot()
    axes.plot(list(contrasts), [np.mean(v) for v in contrasts.values()], "o-", color=plots.BLUE, ms=4)
    axes.axhline(RESOLVED, color=plots.GRAY, ls="--", lw=1)
    axes.set(xlabel="distance (m)", ylabel="contrast of single LEDs", ylim=(-0.05, 1))
    plots.tidy(axes)
    figure.tight_layout()
    return figure
