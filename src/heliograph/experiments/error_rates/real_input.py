"""Recorded input: drives over real footage, clips with no array, and films transcoded by another program.

Frames pass from channel to receiver with no file, as in a lossless film.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.film import FrameSource, is_packet
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.link.truth import TruthFile
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ReceptionCounter, TruthSource, receive_and_count
from heliograph.measure.statistics import Count
from heliograph.media import open_film
from heliograph.receive.api import make_receiver
from heliograph.receive.events import DetectEvent, Event
from heliograph.receive.packet import Packet


@dataclass(frozen=True, slots=True)
class RealScene:
    """Simulation over a clip with recorded shake."""

    # Files of footage and motion
    clip: Path
    imu: Path
    seed: int
    # Changes ``key=value`` of the preset "paper"
    changes: Sequence[str] = ()

    def load(self) -> tuple[LinkSettings, Recordings]:
        """Load settings and recordings."""
        recorded = ("channel.background.kind='footage'", "channel.shake='imu'")
        settings = load_settings("paper", None, [*recorded, *self.changes])
        return settings, Recordings(footage=load_footage(self.clip), imu=load_imu(self.imu))


def drive(scene: RealScene, margin_px: int | None = None) -> ReceptionCounter:
    """Receive and count a drive over real footage."""
    settings, recordings = scene.load()
    film = LiveFilm(settings, default_messages(settings), scene.seed, recordings, margin_px)
    return _received(film, film)


def _received(film: FrameSource, truth: TruthSource) -> ReceptionCounter:
    reception = ReceptionCounter(truth)
    deque(receive_and_count(film, truth.settings.signal, truth.settings, reception), maxlen=0)
    return reception


@dataclass(frozen=True, slots=True)
class EmptyCounts:
    """False results of a receiver on frames with no array."""

    frames: int
    detections: int
    packets: int
    # Packets with an accepted codeword
    right: int
    # Accepted codewords
    words: int
    # Results with no header
    without_header: int

    def __add__(self, other: "EmptyCounts") -> "EmptyCounts":
        return EmptyCounts(*map(sum, zip(astuple(self), astuple(other), strict=True)))

    def text(self) -> str:
        """Counts in a line, with bounds per frame."""
        names = ("detections", "packets", "packets with a right codeword")
        counts = (self.detections, self.packets, self.right)
        parts = [f"{_count_text(Count(self.frames, n))} {name}" for n, name in zip(counts, names, strict=True)]
        return ", ".join([*parts, f"{self.words} right codewords"])


def empty(scene: RealScene, max_frames: int | None = None, *, native: bool = False) -> EmptyCounts:
    """Receive a clip with no array, in the simulation or in native frames."""
    changes = ("channel.arrays=[]", "transmit.identities=[]", *scene.changes)
    settings, recordings = replace(scene, changes=changes).load()
    rendered = (frame for frame, _ in simulate(settings, [], scene.seed, recordings))
    events, packets, frames = list[Event](), list[Packet](), 0
    receiver = make_receiver(settings.signal, settings.receive, events.append)
    for frame in islice(native_frames(scene.clip, settings) if native else rendered, max_frames):
        packets += receiver.push(frame)
        frames += 1
    packets += receiver.finish()
    headers = sum(map(is_packet, packets))
    return EmptyCounts(
        frames,
        detections=sum(isinstance(event, DetectEvent) for event in events),
        packets=headers,
        right=sum(p.status in ("ok", "partial") for p in packets),
        words=sum(w.status == "ok" for p in packets for layer in p.layers.values() for w in layer),
        without_header=len(packets) - headers,
    )


def native_frames(clip: Path, settings: LinkSettings) -> Iterator[Frame]:
    """Frames of a clip, a frame per pattern period, resized to the camera."""
    size = settings.channel.camera.width, settings.channel.camera.height
    for index, pixels in enumerate(load_footage(clip).frames()):
        small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        yield Frame(index, index * settings.signal.pattern_period_s, small)


def encode_again(source: Path, target: Path) -> None:
    """Transcode a film like other programs (libx264, yuv420p), with no metadata."""
    if source.resolve() == target.resolve():
        raise MediaError(f"{target} is the film itself; write the new one to another file")
    with open_film(source) as film, av.open(str(target), "w") as out:
        if film.width % 2 or film.height % 2:
            raise MediaError(f"yuv420p needs an even width and height, not {film.width}x{film.height}")
        rate = Fraction(film.rate_hz).limit_denominator(1001)
        stream = out.add_stream("libx264", rate=rate, options={"crf": "18", "preset": "medium"})
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, "yuv420p"
        stream.codec_context.color_range = 2  # full range
        gray = np.full((film.height // 2, film.width), 128, np.uint8)
        for frame in film:
            luma = (frame.pixels >> (frame.bits - 8)).astype(np.uint8)
            picture = av.VideoFrame.from_ndarray(np.vstack([luma, gray]), format="yuv420p")
            picture.color_range = 2
            picture.pts, picture.time_base = frame.index, 1 / rate
            out.mux(stream.encode(picture))
        out.mux(stream.encode())


def receive_again(film: Path, truth: TruthFile) -> ReceptionCounter:
    """Receive a transcoded film, with the truth of the original film."""
    with open_film(film) as source:
        return _received(source, truth)


def error_lines(errors: ErrorCounter | None) -> Iterator[str]:
    """Wrong and sent codewords as lines, by distance and in total; no lines if the truth is unknown."""
    if errors is None:
        return
    for start, layers in errors.bins().items():
        row = ", ".join(f"{name} {e.codeword_errors}/{e.codewords}" for name, e in layers.items())
        yield f"{start:g}-{start + BIN_M:g} m: {row}"
    for name, e in errors.total().items():
        yield f"{name}: {_count_text(e.words)} wrong, {e.missed} of them missed"
    yield f"false codewords {errors.false_codewords}, false packets {errors.false_packets}"


def _count_text(count: Count) -> str:
    """Errors of trials with 95 % interval, or the upper bound 3 / n for no error."""
    if count.errors:
        low, high = count.interval()
        return f"{count.errors}/{count.trials} [{low:.1e}, {high:.1e}]"
    return f"0/{count.trials} ({count.text()})"
