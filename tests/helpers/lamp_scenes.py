"""Films with an array among flickering lamps, as in a city at night."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate

Floats = NDArray[np.float64]

REACH_PX = 7
"""Half side of a lamp's window in px."""


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
    light, frames = _Lamps(lamps, size, np.random.default_rng((seed, 1))).light, list[Frame]()
    for frame, truth in simulate(link, default_messages(link), seed):
        lit, array = light(frame.time_s), truth.arrays[0]
        # the panel occludes lamps behind it
        reach = 8.5 * array.pitch_px
        (left, right), (top, low) = ((round(c - reach), round(c + reach) + 1) for c in (array.x, array.y))
        lit[top:low, left:right] = 0
        frames.append(replace(frame, pixels=np.clip(np.rint(frame.pixels + lit), 0, 255).astype(np.uint8)))
    return link, frames


class _Lamps:
    """Lamps with random position, size, rate, duty cycle, phase and waveform; a fifth of them moves."""

    def __init__(self, n: int, size: tuple[int, int], rng: np.random.Generator):
        columns, rows = size
        self._shape = rows, columns
        self._place = rng.uniform(0, [columns, rows], (n, 2))
        self._moves = (rng.random(n) < 0.2)[:, None] * rng.uniform(-60, 60, (n, 2))
        self._radius = rng.uniform(2, 8, n) / 2
        self._level, self._rate = rng.uniform(40, 255, n), rng.uniform(100, 500, n)
        self._duty, self._phase = rng.uniform(0.1, 0.9, n), rng.random(n)
        self._is_sine = rng.random(n) < 0.5
        self._depth = rng.uniform(0.3, 1, n)

    def light(self, time_s: float) -> Floats:
        """Return gray levels, shape (rows, columns)."""
        begin = self._phase + self._rate * time_s
        end = begin + 1e-3 * self._rate
        square = (self._square(end) - self._square(begin)) / (end - begin)
        sine = 0.5 + 0.5 * self._depth * (np.sin(2 * np.pi * end) - np.sin(2 * np.pi * begin)) / (
            2 * np.pi * (end - begin)
        )
        level = self._level * np.where(self._is_sine, sine, square)
        place = self._place + self._moves * time_s
        corner = np.rint(place).astype(int) - REACH_PX
        offsets = np.arange(2 * REACH_PX + 1)
        x, y = (corner[:, k, None] + offsets for k in (0, 1))
        away = np.hypot((x - place[:, :1])[:, None, :], (y - place[:, 1:])[:, :, None])
        discs = level[:, None, None] * np.clip(self._radius[:, None, None] + 0.5 - away, 0, 1)
        rows, columns = self._shape
        within = ((x >= 0) & (x < columns))[:, None, :] & ((y >= 0) & (y < rows))[:, :, None]
        number = (y[:, :, None] * columns + x[:, None, :])[within]
        return np.asarray(np.bincount(number, discs[within], rows * columns).reshape(rows, columns), np.float64)

    def _square(self, phase: Floats) -> Floats:
        """Integrate a square wave from phase 0, in periods."""
        whole = np.floor(phase)
        return np.asarray(whole * self._duty + np.minimum(phase - whole, self._duty))
