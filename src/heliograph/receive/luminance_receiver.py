"""Base class of receivers with another method for the luminances of LEDs."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.build import plain_receiver
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame, cut_out, window_around
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


class LuminanceReceiver(ABC):
    """Base class of a receiver that reads the luminances of the LEDs in a pair of frames.

    A subclass defines `luminances`. The package detects and tracks the arrays, pairs the frames and decodes the
    luminances, as for the receiver "plain": the camera takes one frame per pattern.

    Parameters
    ----------
    signal
        Settings of the light's signal.
    settings
        Settings of the receiver.
    observe
        Function that gets every event, see `heliograph.receive.events`.
    """

    margin_px = 4.0
    """Pixels around the array in the windows for `luminances`."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self.signal, self.settings = signal, settings
        self._receiver = plain_receiver(signal, settings, observe, self._read)

    @abstractmethod
    def luminances(self, pattern: NDArray[np.float64], inverse: NDArray[np.float64], leds: Floats) -> ArrayLike:
        """Read a pair of data.

        Parameters
        ----------
        pattern, inverse
            (rows, columns) gray levels around the array in the frames of a pattern and its inverse.
        leds
            (2, n, n, 2) position (x, y) of each LED in the windows of both frames, in px from the centre of the first
            pixel; row u from top to bottom, column v from left to right.

        Returns
        -------
        (n, n) luminance of each LED in the pattern less that in the inverse, in any unit that all pairs share.
        """

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        return self._receiver.push(frame)

    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress; see `Receiver`."""
        return self._receiver.finish()

    def _read(self, frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float) -> Floats:  # noqa: ARG002 - a `ReadPair`
        """Cut the windows out and read them."""
        side = self.signal.side
        window = window_around(Pose.midway(*poses), side, self.margin_px)
        pattern, inverse = (cut_out(frame, window) for frame in frames)
        leds = np.stack([pose.leds(side) for pose in poses]) - np.array(window[:2])
        values: Any = np.asarray(self.luminances(pattern, inverse, leds), np.float64)
        if values.shape != (side, side) or not np.isfinite(values).all():
            raise HeliographError(
                f"{type(self).__name__}.luminances must return {side} x {side} finite numbers, not an array of shape "
                f"{values.shape}{'' if np.isfinite(values).all() else ' with values that are not finite'}"
            )
        return values
