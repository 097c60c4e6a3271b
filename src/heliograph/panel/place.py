"""Place of a panel in an image, a homography of four corners, and pictures as gray levels."""

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, check_unmasked

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


Levels = NDArray[np.float32]
"""Gray levels, (rows, columns), or (channels, rows, columns)."""

AnyFrame = Frame | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | Floats
"""A frame: `heliograph.Frame`, or an array (rows, columns) or (rows, columns, 3)."""

COLOURS = 3
"""Channels of a frame in colour."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A frame as it is computed with.

    Attributes
    ----------
    levels
        (channels, rows, columns) gray levels; one channel, or three.
    origin
        (x, y) on the sensor of the first pixel.
    """

    levels: Levels
    origin: tuple[int, int] = (0, 0)

    @property
    def gray(self) -> Levels:
        """(rows, columns) mean of the channels."""
        return self.levels[0] if len(self.levels) == 1 else np.asarray(self.levels.mean(axis=0))

    @property
    def corner(self) -> Floats:
        """Place (2,) of the first pixel on the sensor."""
        return np.array(self.origin, np.float64)


def picture_of(frame: object) -> Picture:
    """Take a frame."""
    if isinstance(frame, Frame):
        return Picture(_finite(frame.pixels[None]), frame.origin)
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
    return Picture(_finite(frame[None] if frame.ndim == 2 else np.moveaxis(frame, 2, 0)))


def _finite(levels: NDArray[np.number]) -> Levels:
    with np.errstate(over="ignore"):
        out = np.ascontiguousarray(levels, np.float32)
    if levels.dtype.kind == "f" and not np.isfinite(out).all():
        raise HeliographError("a frame has levels that are not finite; set them to 0 or leave the frame out")
    return out
