"""The demonstration in motion: the tracked array beside the picture that grows, and the light's seconds."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.measure.journal import message_row
from heliograph.receive import Packet, Pose
from heliograph.receive.events import DetectEvent, Event, ExtractEvent
from heliograph.road.countdown import Countdown
from heliograph.signal.message import Message

WIDTH, HEIGHT = 640, 304
CUT = (12, 12, 240)
"""Left, top and side of the array's place in px."""

RATE_HZ = 10
"""Frames a second: one for each packet of the reference link."""

Colour = tuple[int, int, int]
PALE: Colour = (201, 206, 214)
DIM: Colour = (110, 118, 128)
LIGHTS: Mapping[str, Colour] = {
    "red": (235, 64, 52), "red-yellow": (245, 140, 40), "yellow": (245, 200, 60), "flashing": (245, 200, 60),
    "green": (70, 190, 100), "green-free": (70, 190, 100),
}  # fmt: skip
"""Red, green and blue of what a light shows."""

Rgb = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Moment:
    """What is shown after a packet."""

    # (h, w) uint8: the array as the camera saw it, cut out where it was tracked; None where it was not
    cut: NDArray[np.uint8] | None
    # The newest picture received, as a file; None before the first
    picture: bytes | None
    # Distance of the array in m
    distance_m: float
    # Codewords read and sent of each layer, by name
    layers: Mapping[str, tuple[int, int]]
    # Phase and seconds left of each signal group, of `Countdown`
    lights: Sequence[Mapping[str, Any]]


@dataclass(slots=True)
class Filmed:
    """Observer of the receiver that keeps a moment for each packet of the array that was found first."""

    # Number of that array, 0 to 29; None before it is found
    identity: int | None = None
    # What is shown, packet by packet
    moments: list[Moment] = field(default_factory=list)
    _seen: tuple[Pose, Frame] | None = None
    _picture: bytes | None = None
    _lights: Countdown = field(default_factory=Countdown)

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, DetectEvent) and self.identity is None:
            self.identity = event.detection.identity
        # combined frames show the array's surroundings alone
        if isinstance(event, ExtractEvent) and event.identity == self.identity and isinstance(event.frames[0], Frame):
            self._seen = event.poses[0], event.frames[0]

    def packet(self, packet: Packet, messages: Sequence[Message]) -> None:
        """Take a packet and the messages that it completes; those of other arrays are passed over."""
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
    """Whether a message is a picture: PNG or WebP."""
    return data.startswith(b"\x89PNG") or (data.startswith(b"RIFF") and data[8:12] == b"WEBP")


def pixels_of(data: bytes) -> Rgb | None:
    """Return a picture's pixels, (height, width, 3) uint8 red, green, blue; None where it is damaged."""
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return None if found is None else np.asarray(found[..., ::-1], np.uint8)


def cut_out_of(pose: Pose, frame: Frame) -> NDArray[np.uint8]:
    """Return the array and its surroundings, always as large, with the camera's own pixels."""
    side = CUT[2]
    # side of what is cut out, in pitches of the array, which has 16
    scale = side / (22.0 * pose.pitch)
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    place = np.array([[scale, 0, side / 2 - scale * x], [0, scale, side / 2 - scale * y]])
    pixels = (frame.pixels.astype(np.float32) * (255 / frame.full_scale)).astype(np.uint8)
    return np.asarray(cv2.warpAffine(pixels, place, (side, side), flags=cv2.INTER_NEAREST), np.uint8)


def drawn(moment: Moment) -> Rgb:
    """Return a moment as an image, (304, 640, 3) uint8 red, green, blue."""
    image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    image[:] = (24, 27, 32)
    left, top, side = CUT
    if moment.cut is not None:
        image[top : top + side, left : left + side] = moment.cut[..., None]
    # left, top, width and height of the picture's place in px
    x, y, width, height = (268, 12, 360, 240)
    picture = pixels_of(moment.picture) if moment.picture else None
    if picture is None:
        cv2.rectangle(image, (x, y), (x + width - 1, y + height - 1), (44, 48, 56), -1)
        _write(image, "the picture comes with the low layer", (x + 46, y + 124), DIM)
    else:
        image[y : y + height, x : x + width] = cv2.resize(picture, (width, height), interpolation=cv2.INTER_NEAREST)
    _write(image, f"{moment.distance_m:.0f} m", (left, 286), PALE, 0.7)
    for k, (name, (read, sent)) in enumerate(moment.layers.items()):
        _write(image, f"{name} {read}/{sent}", (left + 90, 266 + 15 * k), PALE if read == sent else DIM, 0.38)
    for k, group in enumerate(moment.lights[:2]):
        at = 268 + 180 * k
        cv2.circle(image, (at + 12, 279), 10, LIGHTS.get(group["phase"], DIM), -1, cv2.LINE_AA)
        left_s = "" if group["left_s"] is None else f"{max(group['left_s'], 0):.0f} s"
        _write(image, f"{group['phase']} {left_s}", (at + 30, 284), PALE, 0.55)
    return image


def animated(moments: Sequence[Moment]) -> bytes:
    """Return moments as an animated WebP that runs again and again; empty without any."""
    import av

    if not moments:
        return b""
    out = io.BytesIO()
    with av.open(out, "w", format="webp", options={"loop": "0"}) as container:
        stream = container.add_stream("libwebp_anim", rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        # quality of the animation as WebP, 0 to 100
        stream.options = {"quality": str(60)}
        last = drawn(moments[-1])
        for image in [*map(drawn, moments), *[last] * RATE_HZ]:  # it rests at its end for a second
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return out.getvalue()


def _write(image: Rgb, text: str, place: tuple[int, int], colour: Colour, size: float = 0.45) -> None:
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
