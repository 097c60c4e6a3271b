"""A street as a camera behind a windscreen sees it, by day or by night, drawn in perspective, of any size.

Sizes, places and gray levels are chosen by eye. A change would change every film with this background.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Gray

EYE_M = 1.3
"""Height of the camera above the road."""

FOCAL = 2.85
"""Focal length in widths of the picture: that of the reference camera."""

NEAR_M, FAR_M = 12.0, 320.0
"""Distances between which the street is drawn."""

KERB_M, WALL_M = 4.6, 8.0
"""Distances from the middle of the road to the kerb and to the houses."""

FINER = 3
"""The street is drawn so many times finer than it is shown, for smooth edges."""

Points = list[tuple[float, float, float]]
"""Corners in m: to the right, up from the road, ahead."""


class _Canvas:
    """A picture in whose perspective polygons are filled with a gray level."""

    def __init__(self, size: tuple[int, int]):
        self.height, self.width = (FINER * one for one in size)
        self.pixels = np.zeros((self.height, self.width), np.uint8)
        self._focal = FOCAL * self.width

    @property
    def horizon(self) -> int:
        return self.height // 2

    def fill(self, points: Points, level: float) -> None:
        import cv2

        cv2.fillConvexPoly(self.pixels, self.placed(points), float(np.clip(level, 0, 255)), cv2.LINE_AA)

    def disc(self, at: tuple[float, float, float], radius_m: float, level: float) -> None:
        import cv2

        (x, y), radius = self.placed([at])[0], max(1, round(radius_m * self._focal / at[2]))
        cv2.circle(self.pixels, (int(x), int(y)), radius, float(level), -1, cv2.LINE_AA)

    def placed(self, points: Points) -> NDArray[np.int32]:
        """Pixels of points, kept within what the filling takes."""
        corners = np.array(points, float)
        scale = self._focal / corners[:, 2]
        places = np.stack([self.width / 2 + corners[:, 0] * scale, self.horizon - (corners[:, 1] - EYE_M) * scale], 1)
        return np.clip(places, -30_000, 30_000).round().astype(np.int32)


def draw_street(size: tuple[int, int], rng: np.random.Generator, night: bool = False) -> Gray:
    """Draw a straight street: sky, houses, trees, lamps, parked cars, markings. Returns (height, width) uint8."""
    import cv2

    canvas, light = _Canvas(size), 0.16 if night else 1.0
    _draw_sky(canvas, night)
    _draw_ground(canvas, light)
    sides = [(side, list(_along(rng, 14.0, 30.0))) for side in (-1, 1)]
    for side, lots in sides:
        for far, near in reversed(lots):
            _draw_house(canvas, side, near, far, rng, light, night)
    for at in reversed(list(np.arange(26.0, FAR_M, 22.0))):
        for side in (-1, 1):
            if rng.random() < 0.55:
                _draw_tree(canvas, side, at + 6 * rng.random(), rng, light)
            if rng.random() < 0.5:
                _draw_car(canvas, side, at + 8 * rng.random(), rng, light, night)
            _draw_lamp(canvas, side, at, light, night)
    drawn = cv2.GaussianBlur(canvas.pixels, (0, 0), 0.5 * FINER)
    if night:
        glow = cv2.GaussianBlur(np.where(drawn > 150, drawn, 0).astype(np.uint8), (0, 0), 7.0 * FINER)
        drawn = cv2.add(drawn, cv2.convertScaleAbs(glow, alpha=0.8))
    return np.asarray(cv2.resize(drawn, (size[1], size[0]), interpolation=cv2.INTER_AREA), np.uint8)


def _along(rng: np.random.Generator, least_m: float, most_m: float) -> Iterator[tuple[float, float]]:
    """Far and near end of lots along the street, from near to far."""
    near = NEAR_M
    while near < FAR_M:
        far = near + float(rng.uniform(least_m, most_m))
        yield min(far, FAR_M), near
        near = far


def _draw_sky(canvas: _Canvas, night: bool) -> None:
    top, bottom = (5, 22) if night else (150, 225)
    rows = np.linspace(top, bottom, canvas.horizon)
    canvas.pixels[: canvas.horizon] = rows[:, None].astype(np.uint8)


def _draw_ground(canvas: _Canvas, light: float) -> None:
    canvas.fill([(-60, 0, NEAR_M), (60, 0, NEAR_M), (60, 0, FAR_M), (-60, 0, FAR_M)], 120 * light)
    canvas.pixels[canvas.horizon :] = round(120 * light)
    canvas.fill([(-KERB_M, 0, 5), (KERB_M, 0, 5), (KERB_M, 0, FAR_M), (-KERB_M, 0, FAR_M)], 72 * light)
    for side in (-1, 1):
        edge, inner = side * (KERB_M - 0.35), side * (KERB_M - 0.5)
        canvas.fill([(inner, 0, 5), (edge, 0, 5), (edge, 0, FAR_M), (inner, 0, FAR_M)], 190 * light)
    for at in np.arange(14.0, FAR_M, 9.0):
        canvas.fill([(-0.07, 0, at), (0.07, 0, at), (0.07, 0, at + 4), (-0.07, 0, at + 4)], 205 * light)
    for x in np.arange(-4.0, 3.6, 1.0):
        canvas.fill([(x, 0, 38), (x + 0.5, 0, 38), (x + 0.5, 0, 42), (x, 0, 42)], 210 * light)


def _draw_house(
    canvas: _Canvas, side: int, near: float, far: float, rng: np.random.Generator, light: float, night: bool
) -> None:
    """A front along the street, and the gable that looks towards the camera, with rows of windows."""
    x, floors = side * (WALL_M + float(rng.uniform(0, 0.8))), int(rng.integers(2, 6))
    top, shade = 3.1 * floors + 1.0, float(rng.uniform(70, 175))
    haze = 0.35 * near / FAR_M
    wall = (shade * (1 - haze) + 190 * haze) * light
    canvas.fill([(x, 0, near), (x, top, near), (x, top, far), (x, 0, far)], wall)
    canvas.fill([(x, 0, near), (x + side * 40, 0, near), (x + side * 40, top, near), (x, top, near)], 0.8 * wall)
    canvas.fill([(x, top, near), (x, top + 0.35, near), (x, top + 0.35, far), (x, top, far)], 0.55 * wall)
    for floor in range(floors):
        low = 3.1 * floor + 1.0
        for at in np.arange(near + 1.2, far - 1.6, 2.6):
            lit = night and rng.random() < 0.3
            level = float(rng.uniform(130, 230)) if lit else (0.5 if rng.random() < 0.8 else 1.35) * wall
            canvas.fill([(x, low, at), (x, low + 1.5, at), (x, low + 1.5, at + 1.2), (x, low, at + 1.2)], level)


def _draw_tree(canvas: _Canvas, side: int, at: float, rng: np.random.Generator, light: float) -> None:
    x = side * (KERB_M + 1.2)
    canvas.fill([(x - 0.12, 0, at), (x + 0.12, 0, at), (x + 0.08, 2.6, at), (x - 0.08, 2.6, at)], 45 * light)
    for _ in range(14):
        place = x + float(rng.normal(0, 0.7)), 3.6 + float(rng.normal(0, 0.7)), at
        canvas.disc(place, float(rng.uniform(0.4, 0.8)), float(rng.uniform(45, 85)) * light)


def _draw_car(canvas: _Canvas, side: int, at: float, rng: np.random.Generator, light: float, night: bool) -> None:
    """A parked car from behind."""
    middle, shade = side * (KERB_M - 1.15), float(rng.choice([40, 90, 140, 205])) * light
    left, right = middle - 0.85, middle + 0.85
    canvas.fill([(left, 0.05, at), (right, 0.05, at), (right, 0.2, at), (left, 0.2, at)], 15 * light)
    canvas.fill([(left, 0.2, at), (right, 0.2, at), (right, 0.9, at), (left, 0.9, at)], shade)
    canvas.fill([(left + 0.1, 0.9, at), (right - 0.1, 0.9, at), (right - 0.3, 1.45, at), (left + 0.3, 1.45, at)], shade)
    canvas.fill([(left + 0.22, 0.95, at), (right - 0.22, 0.95, at), (right - 0.35, 1.38, at), (left + 0.35, 1.38, at)],
                (40 if shade > 60 * light else 95) * light)  # fmt: skip
    for x in (left + 0.18, right - 0.18):
        canvas.disc((x, 0.75, at), 0.09, 210 if night and rng.random() < 0.4 else 110 * light)


def _draw_lamp(canvas: _Canvas, side: int, at: float, light: float, night: bool) -> None:
    x = side * (KERB_M + 0.5)
    canvas.fill([(x - 0.06, 0, at), (x + 0.06, 0, at), (x + 0.05, 6.4, at), (x - 0.05, 6.4, at)], 55 * light)
    end = x - side * 1.4
    canvas.fill([(x, 6.35, at), (end, 6.45, at), (end, 6.55, at), (x, 6.45, at)], 55 * light)
    canvas.fill([(end - 0.3, 6.35, at), (end + 0.3, 6.35, at), (end + 0.3, 6.5, at), (end - 0.3, 6.5, at)],
                255 if night else 70)  # fmt: skip
