"""Fig. 3: the received image at 10 m and 70 m."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, film
from heliograph.experiments import plots
from heliograph.experiments.result import Chapter, Context, Finding
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.receive import Pose
from heliograph.signal import haar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAR_M, FAR_M = 10.0, 70.0

SWEEP_M = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)

RESOLVED = (1 - 0.735) / (1 + 0.735)
"""Contrast of two lights that are just told apart by Rayleigh: the middle has 73.5 % of the peaks' light."""

TEXT = (
    "The reference link, the car at rest. Left, a data pattern of random bits; right, all LEDs on. Contrast: light at "
    "the LEDs' centres less that midway between neighbours in a row, by their sum, over the whole array with all LEDs "
    "on. Neighbours count as told apart above Rayleigh's contrast of 15 %."
)


def run(context: Context) -> Chapter:
    """Film the array from near to far."""
    rng = np.random.default_rng(context.seed)
    data = haar.encode(rng.choice([-1, 1], (16, 16)))
    seeds = range(2 if context.quick else 20)
    by_distance = {z: [contrast(*still(z, np.full((16, 16), 4, np.uint8), seed)) for seed in seeds] for z in SWEEP_M}
    near, far = (np.array(by_distance[z]) for z in (NEAR_M, FAR_M))
    told = bool((near > RESOLVED).all()), bool((far < RESOLVED).all())
    finding = Finding(
        "Fig. 3: single LEDs are told apart at 10 m and run together at 70 m.",
        f"Contrast between LEDs and gaps {near.mean():.0%} at {NEAR_M:g} m ({(near > RESOLVED).sum()} of {near.size} "
        f"frames above {RESOLVED:.0%}), {far.mean():.1%} at {FAR_M:g} m ({(far > RESOLVED).sum()} of {far.size}).",
        "holds" if all(told) else "differs",
    )
    images = [still(z, levels, 0)[0].pixels for z in (NEAR_M, FAR_M) for levels in (data, np.full_like(data, 4))]
    names = [f"{z:g} m, {what}" for z in (NEAR_M, FAR_M) for what in ("data", "all on")]
    return Chapter(
        key="fig3",
        title="Fig. 3: received image",
        text=TEXT,
        findings=[finding],
        pictures=[
            (plots.image_row(images, names), "The array as the camera sees it, pixel for pixel."),
            (_line(by_distance), "Contrast of single LEDs by distance; dashed: told apart by Rayleigh."),
        ],
        data={"contrast": {f"{z:g} m": values for z, values in by_distance.items()}},
    )


def still(distance_m: float, levels: NDArray[np.uint8], seed: int) -> tuple[Frame, ArrayTruth]:
    """A frame of a steady pattern, the array at rest near the optical axis; its place in a pixel is random."""
    settings = at_rest(distance_m, np.random.default_rng([seed, round(distance_m)]))
    channel = replace(settings.channel, duration_s=1e-3)
    shots = film(channel, [[levels]], np.random.default_rng(seed), pattern_period_s=1e-3, roi_margin_px=6)
    frame, truth = next(iter(shots))
    return frame, truth.arrays[0]


def at_rest(distance_m: float, rng: np.random.Generator, brightness: float = 1.0) -> LinkSettings:
    """The reference link, nothing moves; the array within a pixel of the sensor's middle."""
    x, y = (float(rng.uniform(-0.5, 0.5)) * distance_m / 2917 for _ in range(2))
    over: dict[str, Any] = {"distance_m": distance_m, "arrays": [{"x_m": x, "y_m": y, "brightness": brightness}]}
    return load_settings("static", {"channel": over})


def read(frame: Frame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Luminance at points (..., 2) of the sensor, by cubic interpolation."""
    from heliograph.receive import kernels

    flat = np.ascontiguousarray((points - np.array(frame.origin)).reshape(-1, 2))
    out = np.empty(len(flat))
    kernels.sample_cubic(frame.pixels.astype(np.float64), flat, out)
    return out.reshape(points.shape[:-1])


def leds(truth: ArrayTruth) -> NDArray[np.float64]:
    """True image points of the LEDs, (16, 16, 2)."""
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad).leds(16)


def contrast(frame: Frame, truth: ArrayTruth) -> float:
    """(light at LEDs - light midway) / sum, over an array with all LEDs on."""
    points = leds(truth)
    midway = 0.5 * (points[:, 1:] + points[:, :-1])
    on, gap = (np.maximum(read(frame, where), 0).mean() for where in (points, midway))  # cubics undershoot
    return float((on - gap) / (on + gap))


def _line(by_distance: dict[float, list[float]]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.4))
    axes = figure.add_subplot()
    axes.plot(list(by_distance), [np.mean(v) for v in by_distance.values()], "o-", color="#1b6ca8", ms=4)
    axes.axhline(RESOLVED, color="#8a929b", ls="--", lw=1)
    axes.set(xlabel="distance (m)", ylabel="contrast of single LEDs", ylim=(-0.05, 1))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)
    figure.tight_layout()
    return figure
