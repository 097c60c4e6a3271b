"""What an observer of a receiver gets: one event per stage, as a value."""

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
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Packet
from heliograph.receive.sync.pairing import AnyFrame
from heliograph.receive.track.track import TrackedPair


@dataclass(frozen=True, slots=True)
class EqualiseEvent:
    """An iteration of the soft receiver: its symbols are equalised, its codewords not yet decoded.

    A packet that LEDs alone decode completely gives none, though it may be equalised later to learn the LED gains.

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


def ignore(event: object, /) -> None:
    """Observe nothing."""


__all__ = [
    "DecodeEvent",
    "DetectEvent",
    "DropEvent",
    "EqualiseEvent",
    "Event",
    "ExtractEvent",
    "LostEvent",
    "MissedStartEvent",
    "Observer",
    "TrackEvent",
    "UnseenEvent",
    "ignore",
]


@dataclass(frozen=True, slots=True)
class DetectEvent:
    """An array is found and will be followed.

    Attributes
    ----------
    detection
        Where and when its header was.
    frames
        The last frames, oldest first, which hold the header.
    """

    detection: Detection
    frames: tuple[Frame, ...]


@dataclass(frozen=True, slots=True)
class TrackEvent:
    """An array is followed through a pair, by the receiver "screen" through a frame.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    frame
        Number of the pair's first camera frame, or of the frame.
    tracked
        Pose, fit, and whether the array was in sight, in the array's view.
    view
        That view: ``view.pose_out`` gives the pose on the sensor.
    """

    identity: int
    frame: int
    tracked: TrackedPair
    view: View = CAMERA


@dataclass(frozen=True, slots=True)
class ExtractEvent:
    """A pair of data is taken.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    frames
        Pattern and inverse, in the array's view; in the single mode two patterns.
    poses
        The array's pose in each.
    luminances
        (n, n) normalised luminances x' = level - 2; None of receivers that read pairs at the packet's end.
    number
        Number of the pair among the packet's data, from 0; None where it is not known.
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
        The packet as the receiver hands it out.
    luminances
        (pairs, n, n) from which the receivers "plain" and "screen" decoded it; None of "soft".
    cutouts
        Cut-outs of its pairs, from which the soft receiver decoded it, None for pairs not seen; empty of the plain one.
    exposure_range
        Exposures in T_b between which headers so far put the camera's; None of the plain receiver.
    """

    identity: int
    packet: Packet
    luminances: NDArray[np.float64] | None = None
    cutouts: tuple[Cutout | None, ...] = ()
    exposure_range: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class LostEvent:
    """An array is followed no longer.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    time_s
        Time in seconds of its last pose.
    """

    identity: int
    time_s: float


@dataclass(frozen=True, slots=True)
class MissedStartEvent:
    """A packet of an array began before the first header found of the array; that packet is not read.

    It comes before the first packet with a decoded codeword.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29.
    time_s
        Start in seconds of the first header found.
    """

    identity: int
    time_s: float


@dataclass(frozen=True, slots=True)
class DropEvent:
    """More alternates in the frames than searching them may cost: a part was left out.

    Attributes
    ----------
    time_s
        Time in seconds of the frame with which it was left out.
    load
        What was fitted and what was left out with this frame.
    """

    time_s: float
    load: SearchLoad


@dataclass(frozen=True, slots=True)
class UnseenEvent:
    """The receiver "screen" has seen no screen since the film began. The event comes once.

    Attributes
    ----------
    searched_s
        Seconds of the film that were searched.
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
"""Gets every event: plots, a browser view or timings hang on it. It changes nothing of what is received."""
