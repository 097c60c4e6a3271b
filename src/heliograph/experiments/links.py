"""Links at rest that several experiments film, and the true pose of an array in them."""

from typing import Any

import numpy as np

from heliograph.channel import ArrayTruth
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import lasting, placed_within_pixel
from heliograph.receive import Pose


def static_link(distance_m: float, rng: np.random.Generator, **changes: Any) -> LinkSettings:
    """The reference link at rest for one packet, the array anywhere within a pixel of its place."""
    settings = placed_within_pixel(load_settings("static", {"channel": {"distance_m": distance_m}, **changes}), rng)
    # one frame is not yet whole at the very end
    return lasting(settings, settings.signal.packet_s + 1e-6)


def centred_link(distance_m: float, rng: np.random.Generator, brightness: float = 1.0) -> LinkSettings:
    """The reference link at rest, the array within a pixel of the sensor's middle."""
    # focal length of the reference camera in px, rounded: 35 mm by 12 um
    x, y = (float(rng.uniform(-0.5, 0.5)) * distance_m / 2917 for _ in range(2))
    over: dict[str, Any] = {"distance_m": distance_m, "arrays": [{"x_m": x, "y_m": y, "brightness": brightness}]}
    return load_settings("static", {"channel": over})


def true_pose(truth: ArrayTruth, settings: LinkSettings) -> Pose:
    """The true pose of an array that faces the camera, with the true blur."""
    camera, emitter = settings.channel.camera, settings.channel.emitter
    radius = 0.5 * emitter.diameter_m * camera.focal_px / truth.distance_m
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad, float(np.hypot(camera.blur_px, radius / 2)))
