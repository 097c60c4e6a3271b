"""Trackers that make no use of the light's structure: motion of the background, and OpenCV's general ones."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Gray
from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.detect.detection import Detection

FEATURES = 120
KEY_PAIRS = 10
"""Background features, and pairs after which they are chosen again."""

REACH_PX = 3
"""Largest motion in px from pair to pair that is searched; in the drives here it is up to 2 px."""


class BackgroundMotion:
    """Motion of the background, section IV.B.2: the median motion of its features is added to the array's position.

    Pyramidal Lucas-Kanade from a key pair to each of the next, on the sums of pairs, scaled to 8 bits by the key
    pair's. The array and its panel are left out. The tracker has no measure of the array's size and of its own drift,
    and takes a near array to move like the background far behind it.
    """

    sized = False
    _old: NDArray[np.float32]
    _key: Gray
    _way: tuple[float, float]

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:
        """Choose features around the array; see `Follower`."""
        self._pose: Pose = found.fit.pose
        self._side = 16 * self._pose.pitch
        self._renew(_sum(pattern, inverted))

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Move with the background; see `Follower`."""
        both = _sum(pattern, inverted)
        self._age += 1
        if len(self._old):
            self._follow(self._stretched(both))
        if self._age >= KEY_PAIRS or not len(self._old):
            self._renew(both)
        return self._pose

    def _follow(self, image: Gray) -> None:
        guess = self._old + np.array(self._way, np.float32)
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        new, good, _ = cv2.calcOpticalFlowPyrLK(
            self._key, image, self._old, guess, winSize=(21, 21), maxLevel=1, flags=flags
        )
        kept = good.ravel() == 1
        if kept.any():
            x, y = np.median((new - self._old).reshape(-1, 2)[kept], axis=0)
            self._way = float(x), float(y)
            self._pose = self._at.moved(*self._way)

    def _renew(self, both: NDArray[np.float32]) -> None:
        """A new key pair and new features."""
        self._age, self._at, self._way = 0, self._pose, (0.0, 0.0)
        self._alpha = 255 / max(float(np.quantile(both[::8, ::8], 0.995)), 16.0)
        self._key = self._stretched(both)
        mask, half = np.full(self._key.shape, 255, np.uint8), self._side + 4
        rows, cols = (slice(max(0, int(c - half)), max(0, int(c + half))) for c in (self._pose.y, self._pose.x))
        mask[rows, cols] = 0
        found = cv2.goodFeaturesToTrack(self._key, FEATURES, 0.02, 12, mask=mask)
        self._old = np.zeros((0, 1, 2), np.float32) if found is None else np.asarray(found, np.float32)

    def _stretched(self, both: NDArray[np.float32]) -> Gray:
        return np.asarray(cv2.convertScaleAbs(both, alpha=self._alpha), np.uint8)


class MultipleInstance:
    """OpenCV's TrackerMIL on the sums: the only general tracker of OpenCV 5 that needs no trained model.

    It learns a box of twice the array's side and gives boxes of whole pixels and of one size.
    Its features come from a generator of OpenCV's that goes on through a process and has no seed.
    """

    sized = False

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:
        """Learn the array; see `Follower`."""
        opencv: Any = cv2  # its type hints leave this tracker out
        params = opencv.TrackerMIL_Params()
        params.samplerSearchWinSize = float(REACH_PX)
        cv2.setRNGSeed(0)
        self._tracker: Any = opencv.TrackerMIL_create(params)
        self._pose, side = found.fit.pose, round(32 * found.fit.pose.pitch)
        left, top = round(self._pose.x - side / 2), round(self._pose.y - side / 2)
        # the box's whole pixels lie a fraction of a pixel beside the array's centre
        self._rest = self._pose.x - left, self._pose.y - top
        view, corner = self._view(pattern, inverted)
        self._tracker.init(view, (left - corner[0], top - corner[1], side, side))
        self._corner = corner

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Ask OpenCV for the box; where it has none the last one stays; see `Follower`."""
        view, _ = self._view(pattern, inverted)
        found, (left, top, _, _) = self._tracker.update(view)
        if found:
            dx, dy = (start + rest for start, rest in zip(self._corner, self._rest, strict=True))
            self._pose = self._pose.moved(left + dx - self._pose.x, top + dy - self._pose.y)
        return self._pose

    def _view(self, pattern: Frame, inverted: Frame) -> tuple[Gray, tuple[int, int]]:
        """Half of the sum in colour, and its corner on the sensor."""
        gray = cv2.addWeighted(pattern.pixels, 0.5, inverted.pixels, 0.5, 0)
        return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8), pattern.origin


class TemplateMatch:
    """OpenCV's template matching on the sums: normalised correlation, its peak between pixels by parabolas.

    The template, twice the array's side, is led after what was found by a tenth a pair, so it grows with the array.
    """

    sized = False

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:
        """Cut the template out; see `Follower`."""
        self._pose, self._side = found.fit.pose, 2 * round(16 * found.fit.pose.pitch) + 1
        self._template = self._patch(_sum(pattern, inverted), self._side)

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Move to the best match; see `Follower`."""
        both = _sum(pattern, inverted)
        area = self._patch(both, self._side + 2 * REACH_PX)
        match = np.asarray(cv2.matchTemplate(area, self._template, cv2.TM_CCOEFF_NORMED), np.float32)
        _, _, _, (j, i) = cv2.minMaxLoc(match)
        self._pose = self._pose.moved(j - REACH_PX + _peak(match[i], j), i - REACH_PX + _peak(match[:, j], i))
        self._template = np.float32(0.9) * self._template + np.float32(0.1) * self._patch(both, self._side)
        return self._pose

    def _patch(self, both: NDArray[np.float32], side: int) -> NDArray[np.float32]:
        return np.asarray(cv2.getRectSubPix(both, (side, side), (self._pose.x, self._pose.y)), np.float32)


def _sum(pattern: Frame, inverted: Frame) -> NDArray[np.float32]:
    return np.asarray(cv2.add(pattern.pixels, inverted.pixels, dtype=cv2.CV_32F), np.float32)


def _peak(values: NDArray[np.float32], k: int) -> float:
    """Place of a parabola's peak beside sample k."""
    if not 0 < k < len(values) - 1:
        return 0.0
    left, middle, right = (float(values[k + d]) for d in (-1, 0, 1))
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0
