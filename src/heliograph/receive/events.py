"""Events of a receiver, which an observer gets as values."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.view import CAMERA, View
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Packet
from heliograph.receive.track.track import TrackedPair


@dataclass(frozen=True, slots=True)
class EqualiseEvent:
    """An iteration of the soft receiver has equalised the symbols; the codewords are not decoded yet.

    A packet that samples at the LEDs decode completely has no such event, even if it is equalised later for LED gains.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    iteration
        Number of the iteration, from 0.
    llr
        By layer (codewords, E) LLRs of the coded bits, ln P(b=0)/P(b=1), whitening undone.
    """

    identity: int
    iteration: int
    llr: Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class DetectEvent:
    """An array is detected and will be tracked.

    Attributes
    ----------
    detection
        Pose, time and identity of the header.
    frames
        The last frames, oldest first, with the header.
    """

    detection: Detection
    frames: tuple[Frame, ...]


@dataclass(frozen=True, slots=True)
class TrackEvent:
    """An array is tracked through a pair, by the receiver "screen" through a frame.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    frame
        Number of the first camera frame of the pair, or of the frame.
    tracked
        Pose, fit and visibility of the array, in the array's view.
    view
        View of the array: ``view.pose_out`` returns the pose on the sensor.
    """

    identity: int
    frame: int
    tracked: TrackedPair
    view: View = CAMERA


@dataclass(frozen=True, slots=True)
class ExtractEvent:
    """A pair of data is extracted.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    frames
        Pattern and inverse, in the array's view; in the single mode two patterns.
    poses
        Pose of the array in each frame.
    luminances
        (n, n) normalised luminances x' = level - 2; None if the receiver decodes cut-outs.
    number
        Number of the pair in the packet's data, from 0; None if unknown.
    """

    identity: int
    frames: tuple[AnyFrame, AnyFrame]
    poses: tuple[Pose, ...]
    luminances: NDArray[np.float64] | None = None
    number: int | None = None


@dataclass(frozen=True, slots=True)
class DecodeEvent:
    """A packet is decoded.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    packet
        The packet as returned by the receiver.
    luminances
        (pairs, n, n) luminances that "plain" and "screen" decoded, or (patterns, n, n); None from "soft".
    cutouts
        Cut-outs of the pairs that "soft" decoded, None for unseen pairs; empty from the other receivers.
    exposure_range
        Bounds of the camera's exposure in T_b by the headers so far; None from "plain".
    """

    identity: int
    packet: Packet
    luminances: NDArray[np.float64] | None = None
    cutouts: tuple[Cutout | None, ...] = ()
    exposure_range: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class LostEvent:
    """An array is lost.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    time_s
        Time in seconds of the last pose.
    """

    identity: int
    time_s: float


@dataclass(frozen=True, slots=True)
class MissedStartEvent:
    """A packet of an array began before the first detected header, and is lost.

    The event precedes the first packet with a decoded codeword.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    time_s
        Start in seconds of the first detected header.
    """

    identity: int
    time_s: float


@dataclass(frozen=True, slots=True)
class DropEvent:
    """The search skipped work to stay within its CPU share.

    Attributes
    ----------
    time_s
        Time in seconds of the searched frame.
    load
        Work done and skipped with this frame.
    """

    time_s: float
    load: SearchLoad


@dataclass(frozen=True, slots=True)
class UnseenEvent:
    """The receiver "screen" has detected no screen since the film began; reported once.

    Attributes
    ----------
    searched_s
        Searched time of the film in seconds.
    """

    searched_s: float


Event = (
    DetectEvent
    | TrackEvent
    | ExtractEvent
    | EqualiseEvent
    | DecodeEvent
    | LostEvent
    | MissedStartEvent
    | DropEvent
    | UnseenEvent
)
"""Every event."""

Observer = Callable[[Event], None]
"""Function that gets every event, for plots, a browser view or timings. It does not change the reception."""


def ignore(event: object, /) -> None:
    """Ignore an event."""
