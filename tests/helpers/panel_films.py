"""Films with an LED panel, rendered independently of the package, for `locate`, `follow` and `sample`.

Each pixel averages a few panel samples through the inverse homography. Blur, colour crosstalk, light falloff, noise
and rounding follow.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Floats = NDArray[np.float64]

UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Panel corners, clockwise from the upper left."""


def keystone(
    centre: tuple[float, float], side: float, aspect: float = 1.0, turn: float = 0.0, tilt: float = 0.0
) -> Floats:
    """Return corners (4, 2) for a panel rotated by `turn` rad and tilted away at the right."""
    out = []
    for a, b in UNIT - 0.5:
        far = 1 + tilt * (a + 0.3 * b)
        x, y = side * aspect**0.5 * a / far, side / aspect**0.5 * b / far
        out.append([
            centre[0] + np.cos(turn) * x - np.sin(turn) * y, centre[1] + np.sin(turn) * x + np.cos(turn) * y
        ])  # fmt: skip
    return np.array(out)


def to_unit(corners: Floats) -> Floats:
    """Return the homography (3, 3) from the image to the unit square, from the null space of the linear system."""
    rows = []
    for (x, y), (a, b) in zip(corners, UNIT, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -a * x, -a * y, -a])
        rows.append([0, 0, 0, x, y, 1, -b * x, -b * y, -b])
    return np.asarray(np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3))


@dataclass
class PanelFilm:
    """Film of a panel with random LED states per colour.

    `corners` are the corners in frame k; `leak` is the crosstalk matrix from colours to camera channels; `halo` is
    the light fraction that the lens spreads over four times the blur.
    """

    corners: Callable[[int], Floats]
    rows: int = 64
    columns: int = 64
    width: int = 560
    height: int = 560
    blur: float = 2.0
    noise: float = 2.0
    colours: int = 3
    emitter: float = 0.55
    bright: float = 150.0
    spread: float = 0.05
    fall_off: float = 0.1
    scenery: float = 25.0
    halo: float = 0.0
    seed: int = 0
    places: int = 3
    leak: Floats = field(default_factory=lambda: np.array([[0.9, 0.08, 0.02], [0.07, 0.86, 0.07], [0.02, 0.1, 0.88]]))

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 1])
        shape = (self.height, self.width)
        # background with smooth patches, equal in all colours
        patches = gaussian_filter(rng.normal(size=shape), 12.0)
        self.behind = self.scenery * (1 + 0.5 * patches / patches.std()).clip(0)
        self.gains = (1 + self.spread * rng.normal(size=(self.rows, self.columns, self.colours))).clip(0.5)

    def bits(self, number: int) -> NDArray[np.bool_]:
        """Return LED states in frame k, shape (rows, columns, colours)."""
        return np.random.default_rng([self.seed, 2, number]).random((self.rows, self.columns, self.colours)) < 0.5

    def frame(self, number: int, lit: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
        """Return frame k, shape (height, width, colours)."""
        light = self.gains * (self.bits(number) if lit is None else lit)
        inverse = to_unit(self.corners(number))
        total = np.zeros((self.height, self.width, self.colours))
        steps = (np.arange(self.places) - (self.places - 1) / 2) / self.places
        for dy in steps:
            for dx in steps:
                total += self._looked_up(inverse, light, dx, dy)
        image = total / self.places**2
        if self.colours == 3:
            image = image @ self.leak.T
        blurred = [gaussian_filter(image[..., c], self.blur, truncate=5.0) for c in range(self.colours)]
        if self.halo:
            wide = [gaussian_filter(one, 4 * self.blur) for one in blurred]
            blurred = [(1 - self.halo) * one + self.halo * far for one, far in zip(blurred, wide, strict=True)]
        image = np.stack(blurred, axis=-1)
        y, x = np.mgrid[-1 : 1 : self.height * 1j, -1 : 1 : self.width * 1j]
        image *= (1 - 0.5 * self.fall_off * (x**2 + y**2))[..., None]
        rng = np.random.default_rng([self.seed, 3, number])
        # half of the noise variance at full brightness is signal-independent
        sigma = self.noise * np.sqrt(0.5 + 0.5 * image / self.bright)
        return np.clip(np.rint(image + sigma * rng.normal(size=image.shape)), 0, 255).astype(np.uint8)

    def _looked_up(self, inverse: Floats, light: Floats, dx: float, dy: float) -> Floats:
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        x, y = x + dx, y + dy
        a, b, w = (row[0] * x + row[1] * y + row[2] for row in inverse)
        a, b = a / w * self.columns, b / w * self.rows
        v, u = np.floor(a).astype(int), np.floor(b).astype(int)
        on_board = (v >= -1) & (v <= self.columns) & (u >= -1) & (u <= self.rows)
        inside = (v >= 0) & (v < self.columns) & (u >= 0) & (u < self.rows)
        emitting = inside & (np.hypot(a - v - 0.5, b - u - 0.5) < self.emitter / 2)
        out = np.where(on_board, 4.0, self.behind)[..., None] * np.ones(self.colours)
        # keep the mean light independent of the emitter diameter
        share = self.bright / (np.pi * self.emitter**2 / 4) * 0.5
        out[emitting] += share * light[u[emitting], v[emitting]]
        return out

    def film(self, count: int) -> Iterator[NDArray[np.uint8]]:
        return (self.frame(k) for k in range(count))


def moving(
    base: Floats, shift: tuple[float, float] = (0.6, 0.3), sway: float = 2.0, grow: float = 5e-4
) -> Callable[[int], Floats]:
    """Return corners that drift in px per frame, sway in px and grow by a fraction per frame."""

    def at(number: int) -> Floats:
        centre = base.mean(0)
        moved = centre + (base - centre) * (1 + grow * number)
        swayed = sway * np.array([np.sin(0.7 * number), np.cos(0.45 * number) - 1])
        return np.asarray(moved + number * np.array(shift) + swayed)

    return at
