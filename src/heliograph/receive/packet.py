"""Received packets as values, with outcome and margins."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import UPRIGHT, Orientation, Pose
from heliograph.signal.block import AnyBlock
from heliograph.signal.formats import AGREED, Format

DECODING_RATIO = 1.3  # information per coded bit that the turbo code of rate 1/3 and 1000 bits needs, over its rate
ERASED = 255  # raw bit that was not received


def hard_decisions(llr: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Decide bits by LLRs; `ERASED` where an LLR is 0."""
    return np.where(llr == 0, ERASED, llr < 0).astype(np.uint8)


Status = Literal["ok", "partial", "crc_fail", "no_header", "no_array"]  # outcome of a packet, see `Packet`


@dataclass(frozen=True, slots=True)
class Codeword:
    """A decoded codeword.

    Attributes
    ----------
    status
        "ok" (CRC right), "crc_fail", or "mismatch" (CRC right, but of another array or layer: not to be used).
    block
        Segment of a message, or symbols of a file; None unless the status is "ok".
    bits
        (K,) uint8 decided information bits, right or not.
    raw
        (E,) uint8 coded bits as decided by the first equalisation, before any codeword is decoded; whitening undone;
        255 for bits that were not received.
    iterations
        Iterations of the decoder.
    margin
        Mean magnitude of the information bits' LLRs after decoding.
    llr
        (E,) float32 LLRs ln P(b=0)/P(b=1) of the coded bits by the last equalisation, when the light of decoded
        codewords no longer disturbs; whitening undone; 0 for bits that were not received.
    information
        Mean information in the LLRs that the decoder got, in bit per coded bit, 0 to 1. The turbo code needs about 1.3
        times its rate. NaN if unknown.
    """

    status: Literal["ok", "crc_fail", "mismatch"]
    block: AnyBlock | None
    bits: NDArray[np.uint8]
    raw: NDArray[np.uint8]
    iterations: int
    margin: float
    llr: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    information: float = math.nan

    @property
    def final_raw(self) -> NDArray[np.uint8]:
        """(E,) uint8 like `raw` by the last equalisation; `raw` if the receiver gives no LLRs."""
        return hard_decisions(self.llr) if self.llr.size else self.raw


Words = Mapping[str, tuple[Codeword, ...]]  # codewords of a packet by layer, decoded or not

MIN_HEADER_SCORE = 0.5  # minimum header score of a received header: half of the array's light alternates
MIN_PAIRS_SEEN = 0.5  # minimum fraction of visible data pairs: a code of a rate above 1/2 fails if more are lost


def ok_flags(words: Words) -> list[bool]:
    """True for each decoded codeword, layer by layer."""
    return [word.status == "ok" for layer in words.values() for word in layer]


def packet_status(words: Words, header_score: float, pairs_seen: float) -> Status:
    """Status of a packet by the codewords, or by the visible part if none decoded."""
    decoded = ok_flags(words)
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
class SpatialPose:
    """A pose of an array in the axes of the camera: right, down, forward.

    Attributes
    ----------
    time_s
        Time in seconds of the camera's clock.
    translation_m
        (3,) centre of the array in metres from the camera.
    rotation_rad
        (3,) rotation vector in radians; 0 for an upright array parallel to the sensor.
    covariance
        (6, 6) covariance of the errors: of the translation, and of the rotation vector that turns the stated
        orientation to the true one.
    """

    time_s: float
    translation_m: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Packet:
    """A received packet.

    Attributes
    ----------
    identity
        Number of the array, 0 to 29; uncertain before a codeword of the array is decoded, see `has_codeword`.
    status
        "ok" (all codewords), "partial" (some), "crc_fail" (none), "no_header" (none, and no header) or "no_array"
        (none, and the array was out of sight for most of the packet).
    start_time_s
        Start of the header in seconds of the camera's clock.
    first_frame
        Number of the first camera frame of the packet.
    last_frame
        Number of the last camera frame.
    pose
        Pose of the array in the middle of the packet.
    distance_m
        Distance in metres by the pitch in the image.
    header_score
        Amplitude of the header as a fraction of the array's light; about 1.
    track_score
        Mean correlation of the pairs' sums with the array, -1 to 1.
    pairs_seen
        Fraction of data pairs in which the array was visible.
    layers
        Codewords by layer, "high", "middle" and "low".
    format
        Format that the header signals.
    orientation
        Orientation of the array in the image: upright, turned or mirrored. The pose is that of the square; the position
        of an LED is that in the upright array, turned by the orientation.
    reason
        Reason if the mode of the packet is unknown or the receiver's equations had no solution; empty otherwise.
    pose_std_px
        Standard deviation of the tracked position in px, by the tracker's own covariance in the packet's middle; NaN if
        the receiver has none.
    compute_poses
        Function that computes `spatial_poses`.
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
    pose_std_px: float = math.nan
    # functions of equal results differ
    compute_poses: Callable[[], tuple[SpatialPose, ...]] = field(default=tuple, compare=False, repr=False)

    def explain(self) -> str:
        """Explain missing codewords: return the conditions of the reception, one per line.

        The first line has the scores of header and tracking (1 for an ideal image), the fraction of visible pairs and
        the error of the tracked position. A line for each layer has the number of decoded codewords and, for failed
        codewords, the information in the LLRs and the minimum that the code needs.
        """
        pose = "" if math.isnan(self.pose_std_px) else f", position error {self.pose_std_px:.2f} px"
        lines = [
            f"array {self.identity}, {self.distance_m:.1f} m, pitch {self.pose.pitch:.2f} px: header score "
            f"{self.header_score:.2f}, tracking score {self.track_score:.2f}, visible in {self.pairs_seen:.0%} of the "
            f"pairs{pose}"
        ]
        if self.reason:
            lines.append(self.reason)
        for name, words in self.layers.items():
            lines.append(f"{name} layer: {sum(word.status == 'ok' for word in words)} of {len(words)} codewords")
            failed = [word for word in words if word.status != "ok" and not math.isnan(word.information)]
            if failed:
                least = DECODING_RATIO * len(failed[0].bits) / len(failed[0].raw)
                best = max(word.information for word in failed)
                lines[-1] += f"; the others have at most {best:.2f} bit per coded bit, the code needs about {least:.2f}"
        return "\n".join(lines)

    @property
    def spatial_poses(self) -> tuple[SpatialPose, ...]:
        """The two poses in space that fit the image, computed at each call; empty if the receiver states none.

        Both are equally probable, of opposite tilt, so that the sign of the yaw stays open. Each has the covariance if
        it is the true one.
        """
        return self.compute_poses()

    @property
    def has_codeword(self) -> bool:
        """True if a codeword is decoded, which names the array; a header may be clutter."""
        return self.status in ("ok", "partial")


class Receiver(Protocol):
    """Protocol of receivers: frames in, packets out."""

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes.

        Parameters
        ----------
        frame
            A camera frame, or a window of a frame; in the order of time. The caller may fill the array again after the
            call, so a receiver copies the pixels that it keeps.
        """

    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress that were visible for half of the data."""
