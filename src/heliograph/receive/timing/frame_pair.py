"""Frames of one array paired: which of them show a pattern and its inverse.

A camera in step takes a pattern and its inverse one by one. Any other camera needs the light's clock, and frames
combined. Either way an array's receiver gets pairs by number, counted from the header by which the array was found.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.image.pose import Pose
from heliograph.receive.timing.combination import Combination
from heliograph.signal.pwm import light_centroids
from heliograph.signal.settings import SignalSettings

PoseAt = Callable[[float], Pose]
"""The array's pose at a time in seconds, as the tracker predicts it."""


@dataclass(frozen=True, slots=True)
class CombinedFrame:
    """Frames combined to a pattern or to an inverse, about one array."""

    # Number of the first or the last camera frame in it
    index: int
    # Half a pattern before the mean time of its light, as if it were a camera frame
    time_s: float
    # (rows, columns) float32 gray levels
    pixels: NDArray[np.float32]
    # Place (x, y) of the first pixel on the sensor
    origin: tuple[int, int]
    # Largest gray level of the camera
    full_scale: int


AnyFrame = Frame | CombinedFrame


@dataclass(frozen=True, slots=True)
class FramePair:
    """What shows a pattern and its inverse; of data without inverses, two patterns."""

    # First of the two, which shows the pattern
    pattern: AnyFrame
    # Second of the two, which shows the inverse, or the next pattern of data without inverses
    inverted: AnyFrame
    # Seconds by which the mean light of their sum comes after the middle of the exposures
    late_s: float = 0.0
    # How both were combined; None for two camera frames in step
    combination: Combination | None = None

    @property
    def time_s(self) -> float:
        """Time in seconds halfway between the starts of both."""
        return 0.5 * (self.pattern.time_s + self.inverted.time_s)


@dataclass(frozen=True, slots=True)
class LoneFrame:
    """The frame that is left of a pair of data in step whose other frame is lost."""

    # The camera's frame, whose time is the start of its exposure
    frame: Frame
    # Whether it shows the inverse
    inverted: bool
    # Seconds by which the mean light of the array comes after the middle of the exposure
    late_s: float


@dataclass(frozen=True, slots=True)
class HeaderFrames:
    """Frames of a header by a camera out of step."""

    # (frames, rows, columns) gray levels about the array
    images: NDArray[np.float32]
    # (x, y) on the sensor of the first pixel
    corner: tuple[int, int]
    # Pose of the array in the middle of the header
    pose: Pose
    # (2, frames) amplitude of the header less its inverse, -1 to 1: of whole cells, and of dimmed ones
    alternation: NDArray[np.float64]
    # (2, frames) mean light of both, 0 to 1
    light: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeasuredHeader:
    """A whole header seen by a camera out of step."""

    # Gray levels of the array with all LEDs on
    gain: float
    # All its frames combined to one pair, whose sum is even; None where they do not show it
    pair: FramePair | None = None
    # The frames themselves, for the format; None as `pair`
    frames: HeaderFrames | None = None


class Pairing(Protocol):
    """Pairs an array's frames; pairs are counted from the header of the detection."""

    # Whether what was found cannot be a header
    lost: bool
    # Gray levels of the array with all LEDs on by the first header, where the detection saw it too weak; else None
    first_gain: float | None

    @property
    def now_s(self) -> float:
        """Time in seconds up to which pairs have been read."""

    @property
    def origin_s(self) -> float:
        """Start in seconds of pair 0 by the last pair read, patterns taken to be T_b long since."""

    @property
    def exposure_range(self) -> tuple[float, float] | None:
        """Exposures in T_b between which headers put it; None where none was measured, or it makes no difference."""

    def push(self, frame: Frame) -> Iterator[int]:
        """Take the next frame; yield the numbers of the pairs that can be read by now."""

    def flush(self) -> Iterator[int]:
        """Yield the numbers of the pairs that can still be read, as there will be no more frames."""

    def header(
        self, pair: int, poses: Mapping[int, PoseAt], pose_at: PoseAt, led_gains: NDArray[np.float64]
    ) -> MeasuredHeader | None:
        """Correct the clock by the header before a pair."""

    def pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | LoneFrame | None:
        """Frames of a pair."""


def is_data(number: int, signal: SignalSettings) -> bool:
    """Whether a pair holds data."""
    return number % (signal.packet_patterns // 2) >= signal.header_pairs


def sum_late_s(signal: SignalSettings) -> float:
    """Seconds by which the mean light of a data pair's sum comes after the middle of the exposures.

    PWM lights the first slots of a pattern more than the last.
    """
    mean, _ = light_centroids(signal.slot_order)
    return (mean - 0.5) * signal.pattern_period_s
