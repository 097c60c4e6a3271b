"""Films with an array among flickering lamps, as in a city at night."""

from dataclasses import replace

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate


def lamp_film(lamps: int, seed: int, duration_s: float, size: tuple[int, int]) -> tuple[LinkSettings, list[Frame]]:
    """Film an array at 50 m at a random place and phase; `size` is columns and rows of the camera."""
    rng, (columns, rows) = np.random.default_rng((seed, 0)), size
    px_m = 0.035 / 12e-6 / 50.0
    reach_px = 8 * 0.02 * px_m + 16
    x_m, y_m = (float(rng.uniform(-1, 1)) * (n / 2 - reach_px) / px_m for n in size)
    place = {"x_m": x_m, "y_m": y_m, "start_s": -float(rng.integers(0, 100)) * 1e-3}
    camera = {"width": columns, "height": rows}
    channel = {"distance_m": 50.0, "duration_s": duration_s, "camera": camera, "arrays": [place]}
    link = load_settings("static", {"channel": channel, "transmit": {"identities": [int(rng.integers(30))]}})
    lamp_rng, frames = np.random.default_rng((seed, 1)), list[Frame]()
    centres = np.rint(lamp_rng.uniform(0, size, (lamps, 2))).astype(int).tolist()
    radii = lamp_rng.integers(1, 5, lamps).tolist()
    level, rate_hz = lamp_rng.uniform(40, 255, lamps), lamp_rng.uniform(100, 500, lamps)
    duty, phase = lamp_rng.uniform(0.1, 0.9, lamps), lamp_rng.random(lamps)

    def on_time(cycles: Floats) -> Floats:
        whole = np.floor(cycles)
        return np.asarray(whole * duty + np.minimum(cycles - whole, duty))

    for frame, truth in simulate(link, default_messages(link), seed):
        light, cycles = np.zeros(frame.pixels.shape), phase + rate_hz * frame.time_s
        # the mean over an exposure of 1 ms
        shown = level * (on_time(cycles + 1e-3 * rate_hz) - on_time(cycles)) / (1e-3 * rate_hz)
        for centre, radius, gray in zip(centres, radii, shown.tolist(), strict=True):
            cv2.circle(light, centre, radius, gray, -1)
        # the panel occludes lamps behind it
        array = truth.arrays[0]
        reach = 8.5 * array.pitch_px
        (left, right), (top, low) = ((round(c - reach), round(c + reach) + 1) for c in (array.x, array.y))
        light[top:low, left:right] = 0
        frames.append(replace(frame, pixels=np.clip(np.rint(frame.pixels + light), 0, 255).astype(np.uint8)))
    return link, frames
