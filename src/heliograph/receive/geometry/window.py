"""Windows of frames about an array."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Corner, Pose, Shape

# Corner (x, y) on the sensor, columns and rows
Window = tuple[int, int, int, int]

# Left, top, right and low on the sensor; the last two lie outside
Part = tuple[int, int, int, int]

RIM_PX = 2.0  # light of an array beyond the outer LEDs, in px: 4 standard deviations of the reference link's blur
HALF_LIT = 0.5  # relative light at a blurred edge; pixels within an array have more


@dataclass(frozen=True, slots=True)
class CombinedFrame:
    """Frames combined to a pattern or to an inverse around an array."""

    # Number of the first or the last camera frame
    index: int
    # Time in seconds, half a pattern before the mean time of the light, as for a camera frame
    time_s: float
    # (rows, columns) float32 gray levels
    pixels: NDArray[np.float32]
    # Position (x, y) of the first pixel on the sensor
    origin: tuple[int, int]
    # Largest gray level of the camera
    full_scale: int


AnyFrame = Frame | CombinedFrame


def window_around(pose: Pose, side: int, margin: float) -> Window:
    """Window that holds an array and a margin in px."""
    (a, b), (c, d) = pose.steps
    across, down = 0.5 * side * (abs(a) + abs(b)) + margin, 0.5 * side * (abs(c) + abs(d)) + margin
    x0, y0 = floor(pose.x - across), floor(pose.y - down)
    return x0, y0, ceil(pose.x + across) - x0 + 1, ceil(pose.y + down) - y0 + 1


def cut_out(frame: AnyFrame, window: Window) -> Floats:
    """Copy the pixels of a window; beyond the frame the border repeats."""
    x0, y0, width, height = window
    x, y = x0 - frame.origin[0], y0 - frame.origin[1]
    rows, cols = frame.pixels.shape
    if x >= 0 and y >= 0 and x + width <= cols and y + height <= rows:
        return frame.pixels[y : y + height, x : x + width].astype(np.float64)
    i = np.clip(np.arange(y, y + height), 0, rows - 1)
    j = np.clip(np.arange(x, x + width), 0, cols - 1)
    return frame.pixels[np.ix_(i, j)].astype(np.float64)


def shared_part(frames: Sequence[AnyFrame]) -> Part:
    """Part of the sensor that all frames show; without one, right or low is not beyond left or top."""
    left, top = (max(f.origin[k] for f in frames) for k in (0, 1))
    right, low = (min(f.origin[k] + f.pixels.shape[1 - k] for f in frames) for k in (0, 1))
    return left, top, right, low


def covered(frames: Sequence[AnyFrame], corner: Corner, shape: Shape) -> tuple[Floats, Floats] | None:
    """Mark columns and rows of a window inside all frames with 1; None if all are inside."""
    left, top, right, low = shared_part(frames)
    if left <= corner[0] and top <= corner[1] and corner[0] + shape[1] <= right and corner[1] + shape[0] <= low:
        return None
    x, y = corner[0] + np.arange(shape[1]), corner[1] + np.arange(shape[0])
    columns, rows = (x >= left) & (x < right), (y >= top) & (y < low)
    return columns.astype(np.float64), rows.astype(np.float64)


def crop(frame: Frame, window: Window) -> Frame:
    """Crop a frame to the part in a window, which may be empty."""
    (x, y), (rows, columns) = frame.origin, frame.pixels.shape
    left, right = (min(max(edge - x, 0), columns) for edge in (window[0], window[0] + window[2]))
    top, low = (min(max(edge - y, 0), rows) for edge in (window[1], window[1] + window[3]))
    return replace(frame, pixels=frame.pixels[top:low, left:right], origin=(x + left, y + top))


def common(frames: Sequence[Frame]) -> list[Frame]:
    """Crop frames to the common part of the sensor; a camera's window may follow the array."""
    if all(f.origin == frames[0].origin and f.pixels.shape == frames[0].pixels.shape for f in frames):
        return list(frames)
    left, top, right, low = shared_part(frames)
    # frames without a common part have an empty part at the same place
    parts = [crop(frame, (left, top, right - left, low - top)) for frame in frames]
    cropped = [replace(part, origin=(left, top)).copied() for part in parts]
    for frame in cropped:
        frame.pixels.setflags(write=False)
    return cropped


@lru_cache(maxsize=64)  # windows about arrays have few sizes
def plane(rows: int, cols: int) -> Floats:
    """Images of a constant and of slopes along x and y, (3, rows, columns)."""
    y = ((np.arange(rows) - (rows - 1) / 2) / rows)[:, None] + np.zeros(cols)
    x = ((np.arange(cols) - (cols - 1) / 2) / cols)[None, :] + np.zeros((rows, 1))
    out = np.stack([np.ones((rows, cols)), x, y])
    out.setflags(write=False)
    return out
