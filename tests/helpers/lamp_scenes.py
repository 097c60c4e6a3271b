"""Films with an array among flickering lamps, as in a city at night."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate

Floats = NDArray[np.float64]

REACH_PX = 7
"""Half side of a lamp's window in px."""


@dataclass(frozen=True, kw_only=True)
class LampScene:
    """Lamps with random position, size, rate, duty cycle, phase and waveform, with or without an array.

    Attributes
    ----------
    lamps
        Number of lamps.
    seed
        Seed for lamps, array, shake and noise.
    distance_m
        Array distance; None for a dark array.
    start_s
        Time when the array appears.
    duration_s
        Film length.
    shaking
        True if the camera shakes, by some px at 5 to 40 Hz.
    size
        Camera columns and rows.
    sizes_px, rates_hz
        Ranges for lamp diameters and flicker rates.
    drifting
        Fraction of moving lamps, by up to 60 px/s along each axis.
    """

    lamps: int
    seed: int
    distance_m: float | None = 50.0
    start_s: float = 0.0
    duration_s: float = 1.0
    shaking: bool = False
    size: tuple[int, int] = (1024, 512)
    sizes_px: tuple[float, float] = (2.0, 8.0)
    rates_hz: tuple[float, float] = (100.0, 500.0)
    drifting: float = 0.2

    def link(self) -> LinkSettings:
        """Return link settings with a random array position and a start within a packet."""
        rng, (columns, rows) = np.random.default_rng((self.seed, 0)), self.size
        distance_m = self.distance_m or 50.0
        px_m = 0.035 / 12e-6 / distance_m
        reach_px = 8 * 0.02 * px_m + 16
        x_m, y_m = (float(rng.uniform(-1, 1)) * (n / 2 - reach_px) / px_m for n in (columns, rows))
        begin_s = self.start_s - float(rng.integers(0, 100)) * 1e-3
        # the array is dark until it appears
        off_s = [(0.0, self.start_s)] if self.start_s else []
        place = {"x_m": x_m, "y_m": y_m, "start_s": begin_s if self.distance_m else 1e3, "off_s": off_s}
        channel = {
            "distance_m": distance_m,
            "duration_s": self.duration_s,
            "camera": {"width": columns, "height": rows},
            "arrays": [place],
        }
        sent = {"identities": [int(rng.integers(30))]}
        return load_settings("static", {"channel": channel, "transmit": sent})

    def frames(self) -> Iterator[Frame]:
        link, rng = self.link(), np.random.default_rng((self.seed, 1))
        lamps, shift = _Lamps(self, rng), _shake(rng) if self.shaking else None
        for frame, truth in simulate(link, default_messages(link), self.seed):
            lit = lamps.light(frame.time_s)
            if self.distance_m and frame.time_s >= self.start_s:
                # the panel occludes lamps behind it
                array = truth.arrays[0]
                reach = 8.5 * array.pitch_px
                (left, right), (top, low) = ((round(c - reach), round(c + reach) + 1) for c in (array.x, array.y))
                lit[top:low, left:right] = 0
            light = frame.pixels + lit
            if shift is not None:
                map_ = np.column_stack([np.eye(2), shift(frame.time_s)])
                light = np.asarray(cv2.warpAffine(light, map_, self.size, borderMode=cv2.BORDER_REFLECT), np.float64)
            yield replace(frame, pixels=np.clip(np.rint(light), 0, 255).astype(np.uint8))


class _Lamps:
    """Lamp light integrated over 1 ms frames."""

    def __init__(self, scene: LampScene, rng: np.random.Generator):
        (columns, rows), n = scene.size, scene.lamps
        self._shape = rows, columns
        self._place = rng.uniform(0, [columns, rows], (n, 2))
        self._moves = (rng.random(n) < scene.drifting)[:, None] * rng.uniform(-60, 60, (n, 2))
        self._radius = rng.uniform(*scene.sizes_px, n) / 2
        self._level, self._rate = rng.uniform(40, 255, n), rng.uniform(*scene.rates_hz, n)
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


def _shake(rng: np.random.Generator) -> Callable[[float], Floats]:
    """Return the image displacement (x, y) in px as a function of time in s."""
    rates, phases = rng.uniform(5, 40, (4, 2)), rng.random((4, 2))
    # displacement falls with the square of the rate
    sizes = 2.0 * (10 / rates) ** 2 * rng.uniform(0.3, 1, (4, 2))

    def shift(time_s: float) -> Floats:
        return np.asarray((sizes * np.sin(2 * np.pi * (rates * time_s + phases))).sum(0))

    return shift
