"""What receivers hand out: packets as values, with their outcome and margins."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import UPRIGHT, Orientation, Pose
from heliograph.signal.block import AnyBlock
from heliograph.signal.formats import AGREED, Format

Status = Literal["ok", "partial", "crc_fail", "no_header", "no_array"]
"""Outcome of a packet, see `Packet`."""


@dataclass(frozen=True, slots=True)
class Codeword:
    """A decoded codeword.

    Attributes
    ----------
    status
        "ok" (CRC right), "crc_fail", or "mismatch" (CRC right, but of another array or layer: not to be used).
    block
        Its content where the status is "ok", else None: a segment of a message, or symbols of a file.
    bits
        (K,) uint8 information bits as decided, right or not.
    raw
        (E,) uint8 coded bits as decided by the first equalisation, before anything of the packet is decoded; whitening
        undone; 255 where nothing was received.
    iterations
        Iterations of the decoder.
    margin
        Mean magnitude of the information bits' LLRs after decoding.
    final_raw
        The same as `raw` by the last equalisation before the decoder, when codewords decoded by then no longer disturb;
        None if the receiver equalises only once.
    """

    status: Literal["ok", "crc_fail", "mismatch"]
    block: AnyBlock | None
    bits: NDArray[np.uint8]
    raw: NDArray[np.uint8]
    iterations: int
    margin: float
    final_raw: NDArray[np.uint8] | None = None


Words = Mapping[str, tuple[Codeword, ...]]
"""Codewords of a packet by layer, decoded or not."""

MIN_HEADER_SCORE = 0.5
"""Header score from which a header counts as seen: half of the array's light alternates."""

MIN_PAIRS_SEEN = 0.5
"""Fraction of a packet's data pairs that must be seen; no code of a rate above 1/2 survives the loss of more."""


def packet_status(words: Words, header_score: float, pairs_seen: float) -> Status:
    """Status of a packet by its codewords, or else by how much of it was seen."""
    decoded = [word.status == "ok" for layer in words.values() for word in layer]
    if any(decoded):
        return "ok" if all(decoded) else "partial"
    if pairs_seen < MIN_PAIRS_SEEN:
        return "no_array"
    return "crc_fail" if header_score >= MIN_HEADER_SCORE else "no_header"


def with_raw(words: Words, first: Words) -> Words:
    """Return codewords with the raw bits of the first attempt at their packet."""
    return {
        name: tuple(replace(word, raw=before.raw) for word, before in zip(by, first[name], strict=True))
        for name, by in words.items()
    }


@dataclass(frozen=True, slots=True)
class Packet:
    """A received packet.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29; uncertain until a codeword of the array is decoded, see `has_codeword`.
    status
        "ok" (all codewords), "partial" (some), "crc_fail" (none), "no_header" (none, and its header was not seen) or
        "no_array" (none, and the array was out of sight for most of it).
    start_time_s
        When its header began, in seconds of the camera's clock.
    first_frame
        Number of the first camera frame it was read from.
    last_frame
        Number of the last one.
    pose
        The array's pose in its middle.
    distance_m
        Distance in metres by the pitch in the image.
    header_score
        Amplitude of the header as a fraction of the array's light; about 1.
    track_score
        Mean correlation of the pairs' sums with the array, -1 to 1.
    pairs_seen
        Fraction of its data pairs in which the array was seen.
    layers
        Codewords by layer, "high", "middle" and "low".
    format
        The format it was read in, as its header signals it.
    orientation
        How the camera saw the array: upright, turned, mirrored. The pose has the place of the array's square alone; an
        LED's is that of the upright array turned by the orientation.
    reason
        Why nothing was read where the packet's mode is not known or the receiver's equations had no solution; empty
        otherwise.
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
    layers: Words
    format: Format = AGREED
    orientation: Orientation = UPRIGHT
    reason: str = ""

    @property
    def has_codeword(self) -> bool:
        """True if a codeword is decoded: it names the array. A header alone may be clutter that resembles one."""
        return self.status in ("ok", "partial")


class Receiver(Protocol):
    """What every receiver is: frames in, packets out."""

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes.

        Parameters
        ----------
        frame
            A camera frame, or a window of one; frames come in the order of time. The caller may fill its array again
            once the packets are taken, so a receiver copies the pixels that it keeps.
        """

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packets in progress of which enough was seen."""
