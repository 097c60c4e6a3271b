"""Received image at 10 m and 70 m.

The reference link with the car at rest. The left image of each distance shows a data pattern of random bits, the right
image all LEDs on. Contrast compares the luminance at the LED centres with the luminance midway between neighbours in a
row: difference over sum, averaged over an array with all LEDs on. Neighbours are resolved above the Rayleigh contrast
of 15 %.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.channel.truth import ArrayTruth
from heliograph.experiments import plots
from heliograph.experiments.links import centred_link, film_at_rest
from heliograph.experiments.report import Context, ExperimentResult, Finding, verdict_of
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.pose import Pose
from heliograph.signal import haar

RESOLVED = (1 - 0.735) / (1 + 0.735)
"""Rayleigh contrast of two lights just resolved: the middle has 73.5 % of the peak luminance."""


def run(context: Context) -> ExperimentResult:
    """Film the array at near and far distances."""
    seeds, on = range(2 if context.quick else 20), np.full((16, 16), 4, np.uint8)
    distances_m = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
    contrasts = {z: [contrast(*static_frame(z, on, seed)) for seed in seeds] for z in distances_m}
    data = haar.encode(np.random.default_rng(context.seed).choice([-1, 1], (16, 16)))
    shown = [(z, name, levels) for z in (10.0, 70.0) for name, levels in (("data", data), ("all on", on))]
    images = [static_frame(z, levels, 0)[0].pixels for z, _, levels in shown]
    near, far = np.array(contrasts[10.0]), np.array(contrasts[70.0])
    finding = Finding(
        "Fig. 3: single LEDs are resolved at 10 m and run together at 70 m.",
        f"Contrast between LEDs and gaps {near.mean():.0%} at 10 m ({(near > RESOLVED).sum()} of {near.size} "
        f"frames above {RESOLVED:.0%}), {far.mean():.1%} at 70 m ({(far > RESOLVED).sum()} of {far.size}).",
        verdict_of(bool((near > RESOLVED).all() and (far < RESOLVED).all())),
    )
    names = [f"{z:g} m, {name}" for z, name, _ in shown]
    return ExperimentResult(
        findings=[finding],
        pictures=[
            (plots.image_row(images, names), "Camera image of the array, pixel for pixel."),
            (_contrast_plot(contrasts), "Contrast of single LEDs by distance."),
        ],
        data={"contrast": {f"{z:g} m": values for z, values in contrasts.items()}},
    )


def static_frame(distance_m: float, levels: NDArray[np.uint8], seed: int) -> tuple[Frame, ArrayTruth]:
    """Frame and truth of a steady pattern near the sensor centre."""
    channel = centred_link(distance_m, np.random.default_rng([seed, round(distance_m)])).channel
    return film_at_rest(channel, [levels], np.random.default_rng(seed))[0]


def luminance_at(frame: Frame, points: Floats) -> Floats:
    """Luminance in gray levels at (..., 2) points on the sensor, by cubic interpolation."""
    flat = np.ascontiguousarray((points - np.array(frame.origin)).reshape(-1, 2))
    out = np.empty(len(flat))
    kernels.sample_cubic(frame.pixels.astype(np.float64), flat, out)
    return out.reshape(points.shape[:-1])


def led_points(truth: ArrayTruth) -> Floats:
    """True image points of the LEDs, (16, 16, 2) x and y in px."""
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad).leds(16)


def contrast(frame: Frame, truth: ArrayTruth) -> float:
    """(LEDs - gaps) / (LEDs + gaps), -1 to 1, for an array with all LEDs on."""
    points = led_points(truth)
    midway = 0.5 * (points[:, 1:] + points[:, :-1])
    # cubic interpolation may undershoot
    on, gap = (np.maximum(luminance_at(frame, place), 0).mean() for place in (points, midway))
    return float((on - gap) / (on + gap))


def _contrast_plot(contrasts: Mapping[float, Sequence[float]]) -> Figure:
    figure = Figure(figsize=(7, 3.4))
    axes = figure.add_subplot(xlabel="distance (m)", ylabel="contrast of single LEDs", ylim=(-0.05, 1))
    axes.plot(list(contrasts), [np.mean(v) for v in contrasts.values()], "o-")
    axes.axhline(RESOLVED, color=plots.GRAY, ls="--", lw=1, label="Rayleigh limit")
    axes.legend()
    return figure
