"""Animation of the demonstration: the tracked array, the received picture and the countdown of the signals."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.measure.journal import message_row
from heliograph.receive import Packet, Pose
from heliograph.receive.events import DetectEvent, Event, ExtractEvent, TrackEvent
from heliograph.road.countdown import Countdown
from heliograph.signal.message import Message

Rgb = NDArray[np.uint8]
Colour = tuple[int, int, int]

PALE: Colour = (201, 206, 214)
DIM: Colour = (110, 118, 128)

LIGHTS: Mapping[str, Colour] = {
    "red": (220, 60, 48), "red-yellow": (230, 135, 40), "yellow": (235, 185, 50), "flashing": (235, 185, 50),
    "green": (55, 170, 85), "green-free": (55, 170, 85),
}  # fmt: skip
"""Colour of each signal phase."""

CUT_PX = 240
"""Side of the cut-out of the array."""


@dataclass(frozen=True, slots=True)
class Moment:
    """State after a packet."""

    # (h, w) cut-out of the tracked array; None if it was not tracked
    cut: NDArray[np.uint8] | None
    # File of the best received picture
    picture: bytes | None
    distance_m: float
    # Read and sent codewords by layer
    layers: Mapping[str, tuple[int, int]]
    # Phase and remaining seconds of each signal group, from `Countdown`
    lights: Sequence[Mapping[str, Any]]


@dataclass(slots=True)
class DriveRecorder:
    """Observer that records the array detected first."""

    # Numbers of the frames at which pairs are kept
    cut_frames: list[int]
    # Identity of the array
    identity: int | None = None
    # Time in s, number of the first frame and pose of each pair
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    # Number of the first frame, pose and frames of each kept pair
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    # State after each packet
    moments: list[Moment] = field(default_factory=list)
    _seen: tuple[Pose, Frame] | None = None
    _picture: bytes | None = None
    _lights: Countdown = field(default_factory=Countdown)

    def __call__(self, event: Event) -> None:
        """Record an event."""
        if isinstance(event, DetectEvent) and self.identity is None:
            self.identity = event.detection.identity
        elif isinstance(event, TrackEvent) and event.identity == self.identity:
            state = event.tracked.state
            self.track.append((state.time_s, event.frame, state.pose))
        elif isinstance(event, ExtractEvent) and event.identity == self.identity:
            pattern, inverted = event.frames
            # combined frames are sections of the image
            if not isinstance(pattern, Frame) or not isinstance(inverted, Frame):
                return
            self._seen = event.poses[0], pattern
            if self.cut_frames and pattern.index >= self.cut_frames[0]:
                self.cut_frames.pop(0)
                self.cuts.append((pattern.index, event.poses[0], pattern, inverted))

    def add_packet(self, packet: Packet, messages: Sequence[Message]) -> None:
        """Record a packet of the array, and the messages completed by the packet."""
        if packet.identity != self.identity:
            return
        for message in messages:
            row = message_row(message)
            if "road" in row:
                self._lights.take(row["road"], packet.start_time_s)
            if is_picture(message.data) and len(message.data) > len(self._picture or b""):
                self._picture = message.data
        cut = None if self._seen is None else cut_out_of(*self._seen)
        layers = {name: (sum(w.status == "ok" for w in words), len(words)) for name, words in packet.layers.items()}
        lights = [group for one in self._lights.at(packet.start_time_s) for group in one["groups"]]
        self.moments.append(Moment(cut, self._picture, packet.distance_m, layers, lights))
        self._seen = None


def is_picture(data: bytes) -> bool:
    """True for a PNG or WebP file."""
    return data.startswith(b"\x89PNG") or (data.startswith(b"RIFF") and data[8:12] == b"WEBP")


def pixels_of(data: bytes) -> Rgb | None:
    """Pixels of a picture file, (height, width, 3) uint8 red, green, blue; None for a damaged file."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return None if pixels is None else np.asarray(pixels[..., ::-1], np.uint8)


def cut_out_of(pose: Pose, frame: Frame) -> NDArray[np.uint8]:
    """Array and surroundings, 22 pitches wide, scaled to a fixed size with no interpolation."""
    scale = CUT_PX / (22.0 * pose.pitch)
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    place = np.array([[scale, 0, CUT_PX / 2 - scale * x], [0, scale, CUT_PX / 2 - scale * y]])
    pixels = (frame.pixels.astype(np.float32) * (255 / frame.full_scale)).astype(np.uint8)
    return np.asarray(cv2.warpAffine(pixels, place, (CUT_PX, CUT_PX), flags=cv2.INTER_NEAREST), np.uint8)


def drawn(moment: Moment) -> Rgb:
    """Image of a moment, (304, 640, 3) uint8 red, green, blue."""
    image = np.full((304, 640, 3), (24, 27, 32), np.uint8)
    if moment.cut is not None:
        image[12 : 12 + CUT_PX, 12 : 12 + CUT_PX] = moment.cut[..., None]
    x, view = 268, image[12:252, 268:628]
    picture = pixels_of(moment.picture) if moment.picture else None
    if picture is None:
        view[:] = (44, 48, 56)
        _write(image, "the picture comes with the low layer", (x + 46, 136), DIM)
    else:
        view[:] = cv2.resize(picture, view.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    _write(image, f"{moment.distance_m:.0f} m", (12, 286), PALE, 0.7)
    for k, (name, (read, sent)) in enumerate(moment.layers.items()):
        _write(image, f"{name} {read}/{sent}", (102, 266 + 15 * k), PALE if read == sent else DIM, 0.38)
    for k, group in enumerate(moment.lights[:2]):
        at = x + 180 * k
        cv2.circle(image, (at + 12, 279), 10, LIGHTS.get(group["phase"], DIM), -1, cv2.LINE_AA)
        left_s = "" if group["left_s"] is None else f"{max(group['left_s'], 0):.0f} s"
        _write(image, f"{group['phase']} {left_s}", (at + 30, 284), PALE, 0.55)
    return image


def animated(moments: Sequence[Moment]) -> bytes:
    """Animated WebP of moments in an endless loop; empty for no moments."""
    if not moments:
        return b""
    out, rate_hz = io.BytesIO(), 10
    images = [drawn(moment) for moment in moments]
    # the last image stays for a second
    images += [images[-1]] * rate_hz
    with av.open(out, "w", format="webp", options={"loop": "0"}) as container:
        stream = container.add_stream("libwebp_anim", rate=rate_hz)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.options = "yuv420p", {"quality": "60"}
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return out.getvalue()


def _write(image: Rgb, text: str, place: tuple[int, int], colour: Colour, size: float = 0.45) -> None:
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
