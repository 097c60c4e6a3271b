"""Where a panel is in the image: a homography, by its four corners."""

from dataclasses import dataclass
from math import nan

import numpy as np

from heliograph.base.arrays import Floats

UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of the unit square in the order of a place's."""

SLOPE_STEP_PX = 0.01
"""Step in px of numeric derivatives by a corner: rounding then errs by 1e-12 px, the map's curvature by less."""


@dataclass(frozen=True, slots=True)
class PanelLimits:
    """Limits of quadrilaterals that may be panels."""

    # Smallest pitch of LEDs in px: closer ones cannot be told apart
    pitch_px: float = 1.5
    # Smallest sine of a corner's angle
    sine: float = 0.1
    # Largest ratio of the distances of the farthest and nearest corner from the camera
    depth: float = 4.0


LIMITS = PanelLimits()


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a panel is in the image, with full perspective.

    Attributes
    ----------
    corners
        (4, 2) image points (x, y) in px of the corners of the LED area: upper left, upper right, lower right, lower
        left as the panel counts its rows and columns. They lie half a pitch outside the centres of the outer LEDs. An
        integer is a pixel's centre.
    blur
        Standard deviation of one LED's image in px, emitter and lens together; NaN where it is not known.
    score
        Probability that the place is right, 0 to 1; NaN if the LEDs' grid was not searched.
    """

    corners: Floats
    blur: float = nan
    score: float = nan

    @property
    def homography(self) -> Floats:
        """Map (3, 3) from the LED area as a unit square, (0, 0) its upper left corner, to image points in px."""
        return homographies(self.corners)

    def leds(self, rows: int, columns: int) -> Floats:
        """Image points of all LEDs.

        Parameters
        ----------
        rows, columns
            LEDs along a column and along a row.

        Returns
        -------
        (rows, columns, 2) px as (x, y).
        """
        return mapped(self.homography, grid(rows, columns)).reshape(rows, columns, 2)


def homographies(corners: Floats) -> Floats:
    """Maps of the unit square to quadrilaterals (Heckbert 1989)."""
    p0, p1, p2, p3 = (corners[..., k, :] for k in range(4))
    d1, d2, rest = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    area = _cross(d1, d2)
    g, h = _cross(rest, d2) / area, _cross(d1, rest) / area
    out = np.ones((*corners.shape[:-2], 3, 3))
    out[..., :2, 0] = p1 - p0 + g[..., None] * p1
    out[..., :2, 1] = p3 - p0 + h[..., None] * p3
    out[..., :2, 2] = p0
    out[..., 2, 0], out[..., 2, 1] = g, h
    return out


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def mapped(homography: Floats, points: Floats) -> Floats:
    """Points under a homography. Returns (..., n, 2)."""
    whole = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.swapaxes(homography, -1, -2)
    return np.asarray(whole[..., :2] / whole[..., 2:])


def grid(rows: int, columns: int) -> Floats:
    """Centres of LEDs on the unit square, row by row. Returns (rows * columns, 2) as (x, y)."""
    x, y = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def slopes(corners: Floats, points: Floats) -> Floats:
    """How image points move with the corners. Returns (8, n, 2) derivatives by x and y of each corner in turn."""
    steps = SLOPE_STEP_PX * np.eye(8).reshape(8, 4, 2)
    ahead, behind = (mapped(homographies(corners + sign * steps), points) for sign in (1, -1))
    return np.asarray((ahead - behind) / (2 * SLOPE_STEP_PX))


def grown(corners: Floats, margin: float) -> Floats:
    """Corners of the quadrilateral whose sides lie farther out. Returns (4, 2)."""
    sides = np.roll(corners, -1, axis=0) - corners
    outwards = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.linalg.norm(sides, axis=1)[:, None]
    if area(corners) < 0:
        outwards = -outwards
    out = np.empty((4, 2))
    for k in range(4):
        # the corner lies on the sides before and after it: n . (p - c) = margin for both
        out[k] = corners[k] + np.linalg.solve(outwards[[k - 1, k]], [margin, margin])
    return out


def area(corners: Floats) -> float:
    """Area of a quadrilateral in squared px, positive where its corners follow each other clockwise in the image."""
    return float(0.5 * _cross(corners, np.roll(corners, -1, axis=0)).sum())


def is_convex(corners: Floats) -> bool:
    """Whether corners are those of a convex quadrilateral, clockwise in the image."""
    if not np.isfinite(corners).all():
        return False
    sides = np.roll(corners, -1, axis=0) - corners
    return bool((_cross(sides, np.roll(sides, -1, axis=0)) > 0).all())


def is_possible(corners: Floats, rows: int = 1, columns: int = 1) -> bool:
    """True if a camera may see a panel of LEDs with such corners, and tell its LEDs apart."""
    if not is_convex(corners):
        return False
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    sines = _cross(np.roll(sides, 1, axis=0), sides) / (np.roll(lengths, 1) * lengths)
    far = np.append(UNIT, np.ones((4, 1)), axis=1) @ homographies(corners)[2]
    counts = np.array([columns, rows, columns, rows])
    is_near = far.max() <= LIMITS.depth * far.min()
    return bool((lengths / counts).min() >= LIMITS.pitch_px and sines.min() >= LIMITS.sine and is_near)


def pitches(corners: Floats, rows: int, columns: int) -> tuple[float, float]:
    """Mean distances in px of neighbouring LEDs along a row and along a column."""
    top, right, low, left = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return float(top + low) / 2 / columns, float(left + right) / 2 / rows
