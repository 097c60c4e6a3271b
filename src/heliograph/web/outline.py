"""Outline of the screen in the picture of a camera, before the receiver detects an array."""

from collections import deque

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.cells import Pixels32, light_of
from heliograph.receive.screen.locate import find_quadrilaterals, mean_change, reduce_frame

MIN_WINDOW_S, WINDOW_S, STEP_S = 0.3, 1.0, 0.2  # frames of a search, and interval of searches in s
FRAME_S = 0.045  # minimum interval of the frames in s
MAX_SHIFT = 0.05  # maximum shift of a corner between two searches, over the side of the picture
MIN_FILL = 0.35  # minimum change of 90 % of the pixels, over the mean change: screens have 0.48, edges 0.19
LIGHT = ((np.arange(256) / 255) ** 2.2).astype(np.float32)  # light of gray levels


class OutlineFinder:
    """Finder of the quadrilateral that changes most, confirmed by two successive searches."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, Pixels32]] = deque()
        self._next_s = 0.0
        self._last: Floats | None = None

    def add(self, frame: Frame) -> list[float] | None:
        """Add a frame of 8 bits; return x and y of four corners over width and height, or an empty list if none.

        None between two searches.
        """
        frames, now_s = self._frames, frame.time_s
        if frames and now_s - frames[-1][0] < FRAME_S:
            return None
        small, factor = reduce_frame(light_of(frame.pixels, LIGHT))
        frames.append((now_s, small))
        while now_s - frames[0][0] > WINDOW_S:
            frames.popleft()
        if now_s < self._next_s or now_s - frames[0][0] < MIN_WINDOW_S:
            return None
        self._next_s = now_s + STEP_S
        changes = mean_change([small for _, small in frames])
        found = [corners for corners in find_quadrilaterals(changes, factor) if _is_filled(changes, corners, factor)]
        corners = (found[0] + 0.5) / frame.pixels.shape[::-1] if found else None
        last, self._last = self._last, corners
        if corners is None or last is None or np.abs(corners - last).max() > MAX_SHIFT:
            return []
        return [round(float(value), 4) for value in corners.ravel()]


def _is_filled(changes: Pixels32, corners: Floats, factor: int) -> bool:
    """Return True if most of a quadrilateral changes, unlike the edges of a moving picture."""
    mask = np.zeros(changes.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners / factor).astype(np.int32), 1)
    inside = changes[mask > 0]
    return bool(np.percentile(inside, 10) > MIN_FILL * inside.mean())
