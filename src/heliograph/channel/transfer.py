"""Frame transfer from camera to receiver with lost and repeated frames and time stamp errors."""

from dataclasses import replace

import numpy as np

from heliograph.base.frames import Frame
from heliograph.channel.settings import CameraSettings

MAX_JITTER = 0.45
"""Largest time error in frame periods; below 1/2, so that frame times rise."""


class Transfer:
    """Frame transfer; faults depend on the seed and the frame number only.

    With ``gaps`` off, delivered frames have consecutive numbers and times.
    """

    def __init__(self, camera: CameraSettings, seed: int):
        self._camera, self._seed = camera, seed
        self._last: Frame | None = None
        self._lost = 0

    def __call__(self, frame: Frame) -> Frame | None:
        """Return the delivered frame; None for a dropped frame."""
        camera = self._camera
        if not (camera.dropped or camera.repeated or camera.jitter_s):
            return frame
        rng = np.random.default_rng([self._seed, frame.index])
        draw, late = rng.random(), rng.normal(0.0, camera.jitter_s)
        if draw < camera.dropped:
            self._lost += not camera.gaps
            return None
        limit = MAX_JITTER / camera.fps
        time_s = frame.time_s - self._lost / camera.fps + float(np.clip(late, -limit, limit))
        source = self._last if self._last is not None and draw < camera.dropped + camera.repeated else frame
        self._last = replace(source, index=frame.index - self._lost, time_s=time_s)
        return self._last
