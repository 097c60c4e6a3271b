"""Windows of frames about an array."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from math import ceil, floor
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose

Window = tuple[int, int, int, int]
"""Corner (x, y) on the sensor, columns and rows."""

RIM_PX = 2.0
"""Pixels beyond the array on which LEDs of its rim shine: 4 standard deviations of the reference link's blur."""

HALF_LIT = 0.5
"""Light of a pixel within an array, at least, as a fraction of the brightest one's: a blurred edge has half of it."""


class ImagePatch(Protocol):
    """Pixels with their place on the sensor: a `Frame`, or frames combined."""

    @property
    def pixels(self) -> NDArray[Any]:
        """Gray levels, (rows, columns)."""

    @property
    def origin(self) -> tuple[int, int]:
        """Place (x, y) of the first pixel on the sensor."""


def window_around(pose: Pose, side: int, margin: float) -> Window:
    """Pixels around an array."""
    (a, b), (c, d) = pose.steps
    across, down = 0.5 * side * (abs(a) + abs(b)) + margin, 0.5 * side * (abs(c) + abs(d)) + margin
    x0, y0 = floor(pose.x - across), floor(pose.y - down)
    return x0, y0, ceil(pose.x + across) - x0 + 1, ceil(pose.y + down) - y0 + 1


def cut_out(frame: ImagePatch, window: Window) -> Floats:
    """Pixels of a window; what lies beyond the frame repeats its border."""
    x0, y0, width, height = window
    x, y = x0 - frame.origin[0], y0 - frame.origin[1]
    rows, cols = frame.pixels.shape
    if x >= 0 and y >= 0 and x + width <= cols and y + height <= rows:
        return frame.pixels[y : y + height, x : x + width].astype(np.float64)
    i = np.clip(np.arange(y, y + height), 0, rows - 1)
    j = np.clip(np.arange(x, x + width), 0, cols - 1)
    return frame.pixels[np.ix_(i, j)].astype(np.float64)


def covered(
    frames: Sequence[ImagePatch], corner: tuple[int, int], shape: tuple[int, int]
) -> tuple[Floats, Floats] | None:
    """Columns and rows of a window that all frames have."""
    (x, y), (rows, columns) = corner, shape
    if all(_holds(frame, x, y, x + columns, y + rows) for frame in frames):
        return None
    sides = []
    for axis in (0, 1):
        first = max(frame.origin[axis] for frame in frames)
        end = min(frame.origin[axis] + frame.pixels.shape[1 - axis] for frame in frames)
        place = corner[axis] + np.arange(shape[1 - axis])
        sides.append(((place >= first) & (place < end)).astype(np.float64))
    return sides[0], sides[1]


def _holds(frame: ImagePatch, left: int, top: int, right: int, low: int) -> bool:
    """Whether a frame has all pixels of a window."""
    (x, y), (rows, columns) = frame.origin, frame.pixels.shape
    return x <= left and y <= top and right <= x + columns and low <= y + rows


def common(frames: Sequence[Frame]) -> list[Frame]:
    """Cut frames to the part of the sensor that all of them show; a camera's window may follow the array."""
    if all(f.origin == frames[0].origin and f.pixels.shape == frames[0].pixels.shape for f in frames):
        return list(frames)
    left, top = (max(f.origin[k] for f in frames) for k in (0, 1))
    right, low = (min(f.origin[k] + f.pixels.shape[1 - k] for f in frames) for k in (0, 1))
    return [_cropped(f, left, top, max(right, left), max(low, top)) for f in frames]


def _cropped(frame: Frame, left: int, top: int, right: int, low: int) -> Frame:
    x, y = frame.origin
    return replace(frame, pixels=frame.pixels[top - y : low - y, left - x : right - x].copy(), origin=(left, top))


@lru_cache(maxsize=64)  # windows about arrays have few sizes
def plane(rows: int, cols: int) -> Floats:
    """Images whose combinations are an even background with a slope."""
    y = ((np.arange(rows) - (rows - 1) / 2) / rows)[:, None] + np.zeros(cols)
    x = ((np.arange(cols) - (cols - 1) / 2) / cols)[None, :] + np.zeros((rows, 1))
    out = np.stack([np.ones((rows, cols)), x, y])
    out.setflags(write=False)
    return out
