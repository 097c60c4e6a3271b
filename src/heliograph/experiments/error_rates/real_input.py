"""Real input: drives over real footage, clips without any array, and films encoded again by another program.

Frames go from channel to receiver without a file, as those of a lossless film do.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.film import is_packet
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.link.truth import TruthFile
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.reception import Reception, receive_film
from heliograph.measure.statistics import Count
from heliograph.media import open_film
from heliograph.receive import Packet, make_receiver, receive_frames
from heliograph.receive.events import DetectEvent

REAL = ("channel.background.kind='footage'", "channel.shake='imu'")
EMPTY = ("channel.arrays=[]", "transmit.identities=[]")
CRF, ENCODER_PRESET = "18", "medium"
"""Quality and speed of libx264."""


@dataclass(frozen=True, slots=True)
class RealScene:
    """A simulation over a clip with recorded shake."""

    # File of the footage
    clip: Path
    # File of the motion
    imu: Path
    # Of place and noise
    seed: int
    # Texts ``key=value`` laid over the preset "paper"
    changes: Sequence[str] = ()

    def load(self) -> tuple[LinkSettings, Recordings]:
        """Settings and recordings; a HeliographError where one is wrong."""
        settings = load_settings("paper", None, [*REAL, *self.changes])
        return settings, Recordings(footage=load_footage(self.clip), imu=load_imu(self.imu))


@dataclass(frozen=True, slots=True)
class DriveCounts:
    """Errors of a drive."""

    # Number of frames in the film
    frames: int
    # Its errors, by distance and layer
    errors: ErrorCounter


def drive(scene: RealScene, margin_px: int | None = None) -> DriveCounts:
    """Receive a drive over real footage, and count."""
    settings, recordings = scene.load()
    messages = default_messages(settings)
    errors, frames = ErrorCounter(settings, messages), Count()

    def counted() -> Iterator[Frame]:
        for frame, truth in simulate(settings, messages, scene.seed, recordings, margin_px):
            errors.saw(truth.time_s, [a.distance_m for a in truth.arrays], [a.visible for a in truth.arrays])
            frames.add(1, 0)
            yield frame

    for packet in receive_frames(counted(), settings.signal, settings.receive):
        if is_packet(packet):
            errors.received(packet)
    return DriveCounts(frames.trials, errors)


@dataclass(frozen=True, slots=True)
class EmptyCounts:
    """Results of a receiver on frames without any array: all of them are false."""

    # detections, packets, right: frames, and detections, packets, and packets with a right codeword among them
    detections: Count
    packets: Count
    right: Count
    # Codewords taken for right, of all packets
    words: int
    # Results that are no packets
    without_header: int

    def __add__(self, other: "EmptyCounts") -> "EmptyCounts":
        return EmptyCounts(
            _both(self.detections, other.detections),
            _both(self.packets, other.packets),
            _both(self.right, other.right),
            self.words + other.words,
            self.without_header + other.without_header,
        )

    def text(self) -> str:
        """The counts in a line, with bounds by frames."""
        parts = [
            f"{counted_text(self.detections)} detections",
            f"{counted_text(self.packets)} packets",
            f"{counted_text(self.right)} packets with a right codeword",
            f"{self.words} right codewords",
        ]
        return ", ".join(parts)


def _both(one: Count, other: Count) -> Count:
    return Count(one.trials + other.trials, one.errors + other.errors)


def empty(scene: RealScene, most_frames: int | None = None, *, native: bool = False) -> EmptyCounts:
    """Receive a clip without any array."""
    settings, recordings = RealScene(scene.clip, scene.imu, scene.seed, (*EMPTY, *scene.changes)).load()
    film = native_frames(scene.clip, settings) if native else _rendered(settings, scene.seed, recordings)
    events, packets, frames = list[Any](), list[Packet](), 0
    receiver = make_receiver(settings.signal, settings.receive, events.append)
    for frame in islice(film, most_frames):
        packets += receiver.push(frame)
        frames += 1
    packets += receiver.finish()
    headed = sum(map(is_packet, packets))
    right = sum(p.status in ("ok", "partial") for p in packets)
    found = sum(isinstance(event, DetectEvent) for event in events)
    words = sum(w.status == "ok" for p in packets for layer in p.layers.values() for w in layer)
    detections, headers, read = (Count(frames, n) for n in (found, headed, right))
    return EmptyCounts(detections, headers, read, words, len(packets) - headed)


def _rendered(settings: LinkSettings, seed: int, recordings: Recordings) -> Iterator[Frame]:
    return (frame for frame, _ in simulate(settings, [], seed, recordings))


def native_frames(clip: Path, settings: LinkSettings) -> Iterator[Frame]:
    """A clip's own frames, one per pattern period, resized to the camera's frame."""
    import cv2

    size = settings.channel.camera.width, settings.channel.camera.height
    for index, pixels in enumerate(load_footage(clip).frames()):
        small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        yield Frame(index, index * settings.signal.pattern_period_s, small)


def encode_again(source: Path, target: Path) -> None:
    """Encode a film again as other programs would (libx264, yuv420p), without its notes."""
    import av

    if source.resolve() == target.resolve():
        raise MediaError(f"{target} is the film itself; write the new one to another file")
    with open_film(source) as film, av.open(str(target), "w") as out:
        if film.width % 2 or film.height % 2:
            raise MediaError(f"yuv420p needs an even width and height, not {film.width}x{film.height}")
        rate = Fraction(film.rate_hz).limit_denominator(1001)
        stream = out.add_stream("libx264", rate=rate, options={"crf": CRF, "preset": ENCODER_PRESET})
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, "yuv420p"
        stream.codec_context.color_range = 2  # full, as the film's
        gray = np.full((film.height // 2, film.width), 128, np.uint8)
        for frame in film:
            luma = (frame.pixels >> (frame.bits - 8)).astype(np.uint8)
            picture = av.VideoFrame.from_ndarray(np.vstack([luma, gray]), format="yuv420p")
            picture.color_range = 2
            picture.pts, picture.time_base = frame.index, 1 / rate
            out.mux(stream.encode(picture))
        out.mux(stream.encode())


def receive_again(film: Path, truth: TruthFile) -> Reception:
    """Receive a film that was encoded again, against the truth of the film it was made from."""
    reception = Reception(truth)
    with open_film(film) as source:
        deque(receive_film(source, truth.settings.signal, truth.settings, reception), maxlen=0)
    return reception


def error_lines(errors: ErrorCounter) -> Iterable[str]:
    """Codewords wrong of sent, by distance and in all, line by line."""
    for start, layers in errors.bins().items():
        row = ", ".join(f"{name} {e.codeword_errors}/{e.codewords}" for name, e in layers.items())
        yield f"{start:g}-{start + BIN_M:g} m: {row}"
    for name, e in errors.total().items():
        yield f"{name}: {counted_text(e.words)} wrong, {e.missed} of them missed"
    yield f"false codewords {errors.false_codewords}, false packets {errors.false_packets}"


def counted_text(count: Count) -> str:
    """Errors of trials with their 95 % interval, or the bound 3 / n where there was none."""
    if count.errors:
        low, high = count.interval()
        return f"{count.errors}/{count.trials} [{low:.1e}, {high:.1e}]"
    return f"0/{count.trials} ({count.text()})"
