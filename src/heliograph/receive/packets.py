"""What the receiver hands out: packets as values, with their outcome and margins."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.pose import Pose
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, Format

Status = Literal["ok", "partial", "crc_fail", "no_header", "no_array"]
"""Outcome of a packet, see `Packet`."""


@dataclass(frozen=True, slots=True)
class Codeword:
    """A decoded codeword.

    Attributes
    ----------
    status
        "ok" (CRC right), "crc_fail", or "mismatch" (CRC right but of another array or layer: not to be used).
    block
        Its content where the status is "ok".
    bits
        (K,) uint8 information bits as decided, right or not.
    raw
        (E,) uint8 coded bits as decided before the turbo decoder, whitening undone; 255 where nothing was received.
    iterations
        Iterations of the turbo decoder.
    margin
        Mean magnitude of the LLRs after decoding.
    """

    status: Literal["ok", "crc_fail", "mismatch"]
    block: Block | None
    bits: NDArray[np.uint8]
    raw: NDArray[np.uint8]
    iterations: int
    margin: float


@dataclass(frozen=True, slots=True)
class Packet:
    """A received packet.

    Attributes
    ----------
    identity
        Number of the array.
    status
        "ok" (all codewords), "partial" (some), "crc_fail" (none), "no_header" (none, and its header was not seen),
        "no_array" (none, and the array was out of sight for most of it).
    start_time_s
        When its header began.
    first_frame, last_frame
        Camera frames it was read from.
    pose
        The array's pose in its middle.
    distance_m
        Distance from the pitch in the image.
    header_score
        Alternation of the header as a share of the array's luminance; about 1.
    track_score
        Mean correlation of the pairs' sums with the array.
    pairs_seen
        Share of its data pairs in which the array was seen.
    layers
        Codewords by layer.
    named
        The format it was read in, as its header names it.
    """

    identity: int
    status: Status
    start_time_s: float
    first_frame: int
    last_frame: int
    pose: Pose
    distance_m: float
    header_score: float
    track_score: float
    pairs_seen: float
    layers: Mapping[str, tuple[Codeword, ...]]
    named: Format = AGREED


class FrameReceiver(Protocol):
    """What every receiver is: frames in, packets out.

    Attributes
    ----------
    detections
        Times it has taken something for an array.
    """

    detections: int

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes."""

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packets in progress of which enough was seen."""


class Observer(Protocol):
    """Gets what each stage produces: plots, a browser view or timings hang on it."""

    def __call__(self, stage: str, data: Mapping[str, object], /) -> None:
        """Take the named stage's data: "detect", "track", "extract", "equalise" (soft), "decode", "lost"."""


def ignore(stage: str, data: Mapping[str, object], /) -> None:
    """Observe nothing."""
