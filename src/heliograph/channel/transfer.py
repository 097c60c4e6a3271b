"""Transfer of frames from the camera to the receiver: some are lost, some repeated, and their times are inexact."""

from dataclasses import replace

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel.settings import CameraSettings

LARGEST_JITTER = 0.45
"""Largest error of a time in frame periods: below 1/2, so that the times of successive frames rise, by 0.1 at least."""


class Transfer:
    """Deliver frames: a frame's accident depends on the seed and its number alone.

    Without gaps frames are numbered, and timed, as they are delivered.
    """

    def __init__(self, camera: CameraSettings, seed: int):
        self._camera, self._seed = camera, seed
        self._last: Frame | None = None
        self._lost = 0

    def __call__(self, frame: Frame) -> Frame | None:
        """Take the next frame and return it as delivered; None where it is dropped."""
        camera = self._camera
        if not (camera.dropped or camera.repeated or camera.jitter_s):
            return frame
        rng = np.random.default_rng([self._seed, frame.index])
        draw, late = rng.random(), rng.normal(0.0, camera.jitter_s)
        if draw < camera.dropped:
            self._lost += not camera.gaps
            return None
        largest = LARGEST_JITTER / camera.fps
        time_s = frame.time_s - self._lost / camera.fps + float(np.clip(late, -largest, largest))
        shown = self._last if self._last is not None and draw < camera.dropped + camera.repeated else frame
        # a repeated window keeps its place on the sensor
        self._last = replace(shown, index=frame.index - self._lost, time_s=time_s)
        return self._last
