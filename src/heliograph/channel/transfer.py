"""The way of a frame from the camera to the receiver: some are lost, some come twice, their times are inexact."""

from dataclasses import replace

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel.settings import CameraSettings

LARGEST_JITTER = 0.45
"""Largest error of a time as a share of the frame period: times still rise."""


class Transfer:
    """Delivers frames, each with an accident of its own, which depends on seed and frame alone.

    Parameters
    ----------
    camera
        How often frames are dropped and repeated, and the jitter of their times.
    seed
        Of the accidents.
    """

    def __init__(self, camera: CameraSettings, seed: int):
        self._camera, self._seed = camera, seed
        self._last: Frame | None = None

    def __call__(self, frame: Frame) -> Frame | None:
        """Take the next frame; return it as delivered, or None where it is dropped."""
        camera = self._camera
        if not (camera.dropped or camera.repeated or camera.jitter_s):
            return frame
        rng = np.random.default_rng([self._seed, frame.index])
        chance, late = rng.random(), rng.normal(0.0, camera.jitter_s)
        if chance < camera.dropped:
            return None
        largest = LARGEST_JITTER / camera.fps
        time_s = frame.time_s + float(np.clip(late, -largest, largest))
        shown = self._last if self._last is not None and chance < camera.dropped + camera.repeated else frame
        # a window's place on the sensor goes with its pixels
        self._last = replace(shown, index=frame.index, time_s=time_s)
        return self._last
