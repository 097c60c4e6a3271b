"""Position of a panel as a homography of four corners, and frames as gray levels."""

from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError, shown
from heliograph.base.frames import Frame, check_unmasked

UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of the unit square in the order of `Place.corners`."""


MIN_PITCH_PX = 1.5  # minimum distance from LED to LED in px


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Position of a panel in an image, with full perspective.

    Attributes
    ----------
    corners
        (4, 2) image points (x, y) in px of the corners of the LED area: upper left, upper right, lower right, lower
        left in the panel's order of rows and columns. The corners lie half a pitch outside the centres of the outer
        LEDs. Integers are pixel centres.
    blur
        Standard deviation of an LED's image in px, emitter and lens together; NaN if unknown.
    score
        Probability of a correct position, 0 to 1; NaN if the grid of LEDs was not searched.
    """

    corners: Floats
    blur: float = nan
    score: float = nan

    @property
    def homography(self) -> Floats:
        """Map (3, 3) from the LED area as a unit square, (0, 0) the upper left corner, to image points in px."""
        return homographies(self.corners)

    def leds(self, rows: int, columns: int) -> Floats:
        """Return the image points of all LEDs.

        Parameters
        ----------
        rows, columns
            LEDs along a column and along a row.

        Returns
        -------
        (rows, columns, 2) px as (x, y).
        """
        return transform(self.homography, grid(rows, columns)).reshape(rows, columns, 2)


def homographies(corners: Floats) -> Floats:
    """Return the maps (..., 3, 3) of the unit square to quadrilaterals (Heckbert 1989)."""
    p0, p1, p2, p3 = (corners[..., k, :] for k in range(4))
    d1, d2, rest = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    determinant = _cross(d1, d2)
    g, h = _cross(rest, d2) / determinant, _cross(d1, rest) / determinant
    out = np.ones((*corners.shape[:-2], 3, 3))
    out[..., :2, 0] = p1 - p0 + g[..., None] * p1
    out[..., :2, 1] = p3 - p0 + h[..., None] * p3
    out[..., :2, 2] = p0
    out[..., 2, 0], out[..., 2, 1] = g, h
    return out


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def transform(homography: Floats, points: Floats) -> Floats:
    """Map points (n, 2) by homographies; return (..., n, 2)."""
    projective = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.swapaxes(homography, -1, -2)
    return np.asarray(projective[..., :2] / projective[..., 2:])


def grid(rows: int, columns: int) -> Floats:
    """Return the centres (rows * columns, 2) of LEDs on the unit square as (x, y), row by row."""
    x, y = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def corner_jacobian(corners: Floats, points: Floats) -> Floats:
    """Return the derivatives (8, n, 2) of image points by x and y of each corner."""
    step_px = 0.01  # central differences: rounding errors are 1e-12 px
    steps = step_px * np.eye(8).reshape(8, 4, 2)
    ahead, behind = (transform(homographies(corners + sign * steps), points) for sign in (1, -1))
    return np.asarray((ahead - behind) / (2 * step_px))


def grow(corners: Floats, margin: float) -> Floats:
    """Move the sides of a quadrilateral outwards by a margin in px."""
    sides = np.roll(corners, -1, axis=0) - corners
    outwards = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.linalg.norm(sides, axis=1)[:, None]
    outwards *= np.sign(area(corners)) or 1.0
    # a corner lies on the sides before and after: n . (p - c) = margin for both normals
    return np.array([
        corner + np.linalg.solve(outwards[[k - 1, k]], [margin, margin]) for k, corner in enumerate(corners)
    ])  # fmt: skip


def area(corners: Floats) -> float:
    """Return the area of a quadrilateral in squared px, positive for clockwise corners in the image."""
    return float(0.5 * _cross(corners, np.roll(corners, -1, axis=0)).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Numbers of LEDs along a column and along a row of a panel."""

    rows: int
    columns: int

    @property
    def grid(self) -> Floats:
        """(rows * columns, 2) centres of the LEDs on the unit square as (x, y), row by row."""
        return grid(self.rows, self.columns)

    def pitches(self, corners: Floats) -> tuple[float, float]:
        """Return the mean distances in px of neighbouring LEDs along a row and along a column."""
        top, right, low, left = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        return float(top + low) / 2 / self.columns, float(left + right) / 2 / self.rows

    def pitch(self, corners: Floats) -> float:
        """Return the shorter of the mean pitches in px."""
        return min(self.pitches(corners))

    def is_possible(self, corners: Floats) -> bool:
        """Return True if a camera can see the panel with such corners and resolve the LEDs."""
        if not np.isfinite(corners).all():
            return False
        sides = np.roll(corners, -1, axis=0) - corners
        if not (_cross(sides, np.roll(sides, -1, axis=0)) > 0).all():  # not convex and clockwise
            return False
        lengths = np.linalg.norm(sides, axis=1)
        sines = _cross(np.roll(sides, 1, axis=0), sides) / (np.roll(lengths, 1) * lengths)
        depths = np.append(UNIT, np.ones((4, 1)), axis=1) @ homographies(corners)[2]
        pitch = (lengths / np.array([self.columns, self.rows, self.columns, self.rows])).min()
        is_regular = sines.min() >= 0.1 and depths.max() <= 4.0 * depths.min()
        return bool(pitch >= MIN_PITCH_PX and is_regular)


Levels = NDArray[np.float32]
"""Gray levels, (rows, columns), or (channels, rows, columns)."""

AnyFrame = Frame | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | Floats
"""A frame: `heliograph.Frame`, or an array (rows, columns) or (rows, columns, 3)."""

COLOURS = 3  # channels of a colour frame


class Picture(NamedTuple):
    """Frame with one or three channels."""

    # (channels, rows, columns) gray levels
    levels: Levels
    # (2,) position (x, y) of the first pixel on the sensor
    corner: Floats

    @property
    def gray(self) -> Levels:
        """(rows, columns) mean of the channels."""
        return self.levels[0] if len(self.levels) == 1 else np.asarray(self.levels.mean(axis=0))


def picture_of(frame: object) -> Picture:
    """Convert a frame, after checks."""
    if isinstance(frame, Frame):
        return Picture(_to_levels(frame.pixels[None]), np.array(frame.origin, np.float64))
    if not isinstance(frame, np.ndarray):
        raise HeliographError(
            f"a frame is a heliograph.Frame or an array (rows, columns) or (rows, columns, 3), not "
            f"{type(frame).__name__}"
        )
    if frame.dtype.kind not in "uif" or not (frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == COLOURS)):
        raise HeliographError(
            f"a frame's pixels are numbers of shape (rows, columns) or (rows, columns, 3), not {frame.dtype} of "
            f"{frame.shape}; give several frames as a list"
        )
    check_unmasked(frame)
    if not frame.size:
        raise HeliographError(f"a frame has no pixels: its shape is {frame.shape}; leave it out")
    return Picture(_to_levels(frame[None] if frame.ndim == 2 else np.moveaxis(frame, 2, 0)), np.zeros(2))


def _to_levels(levels: NDArray[np.number]) -> Levels:
    with np.errstate(over="ignore"):
        out = np.ascontiguousarray(levels, np.float32)
    if levels.dtype.kind == "f" and not np.isfinite(out).all():
        raise HeliographError("a frame has levels that are not finite; set them to 0 or leave the frame out")
    return out


def matrix_of(value: Any, shape: tuple[int, ...], rule: str) -> Floats:
    """Convert a value to a finite array of a shape, or raise an error with the rule."""
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise HeliographError(f"{rule}, not {shown(value)}")
    return matrix
