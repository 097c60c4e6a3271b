"""Video files of any origin as gray frames, by PyAV."""

import heapq
import logging
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media import planes, whole
from heliograph.media.reader import Reading, camera_rate, checked_size
from heliograph.media.record import from_tags, restored_time
from heliograph.media.stamps import LIMITS, Pace, StampClock, TimedReader

if TYPE_CHECKING:
    import av
    from av.container import InputContainer


_MATRIX = struct.Struct("<9i")
"""A display matrix, FFmpeg's AV_FRAME_DATA_DISPLAYMATRIX: (x, y, 1) times it is the place on the display, y down."""


@dataclass(frozen=True, slots=True)
class Orientation:
    """How pictures are put upright: rows and columns changed about first, then turned back to front."""

    # Whether rows become columns
    transposed: bool = False
    # rows_back, columns_back: whether rows, and columns, then run the other way
    rows_back: bool = False
    columns_back: bool = False

    def upright(self, pixels: Pixels) -> Pixels:
        """Return a picture the right way up."""
        turned: Any = pixels.T if self.transposed else pixels
        turned = turned[:: -1 if self.rows_back else 1, :: -1 if self.columns_back else 1]
        upright: Pixels = np.ascontiguousarray(turned)
        return upright

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return columns and rows of an upright picture."""
        return (height, width) if self.transposed else (width, height)


def orientation(picture: "av.VideoFrame") -> Orientation:
    """Return how a picture is put upright; turns by other angles than quarters are left as they are."""
    from av.sidedata.sidedata import Type

    held: Any = picture.side_data
    note = held.get(Type.DISPLAYMATRIX)
    if note is None or len(bytes(note)) < _MATRIX.size:
        return Orientation()
    # x' = a x + c y, y' = b x + d y
    a, b, _, c, d, *_ = _MATRIX.unpack_from(bytes(note))
    if not b and not c:
        return Orientation(rows_back=d < 0, columns_back=a < 0)
    return Orientation(True, rows_back=b < 0, columns_back=c < 0) if not a and not d else Orientation()


LOG = logging.getLogger(__name__)

DECODER_THREADS = 2
"""Threads of a decoder: the cores of the machine that films were measured on. Chosen: a frame takes the same time of
processors with 1 to 4 threads, of pictures or of parts of one: 13.4 to 14.1 ms with FFV1, 6.1 to 6.9 ms with H.264."""

_NO_TIMESTAMPS = 0x80
"""Flag of FFmpeg's formats that hold coded pictures alone, such as .h264: their stamps are made up, 25 a second."""

_TEXT_FORMATS = ("tty", "lrc", "srt", "ass", "webvtt")
"""Formats as which FFmpeg opens text files, as films of letters on a terminal."""

_ENDED_FORMATS = ("matroska,webm", "nut")
"""Formats whose end tells that the muxer finished."""

_NO_FILM = 0x400 | 0x800 | 0x100000
"""Dispositions of FFmpeg's streams that are no film: attached picture, timed thumbnails, still image."""

_COUNTED_PACKETS = 500
"""Packets by which tracks are compared where the container does not state their frames."""

_LEAST_BITS = 8
"""Least bits of a gray level."""

_REORDERED = 16
"""Pictures whose stamps may be out of order: as many as H.264 and H.265 hold back for pictures between others."""


class VideoReader(TimedReader):
    """A video file; see `FilmReader`."""

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._reading = reading
        with _opened(path) as container:
            stream = _film_stream(path, container)
            self._track = stream.index
            self._record = from_tags(container.metadata)
            self._make_clock: Callable[[], StampClock] | None = None
            self.width, self.height = stream.codec_context.width, stream.codec_context.height
            checked_size(path, self.width, self.height)
            self.faster = ("HDF5",) if stream.codec_context.name == "h264" else ("HDF5", "lossless H.264")
            self.metadata = self._record.metadata if self._record else {**container.metadata, **stream.metadata}
            self._unstamped = bool(int(container.format.flags) & _NO_TIMESTAMPS)
            self._has_end = container.format.name in _ENDED_FORMATS
            first, sample_s = _sample(container, stream)
            stated = [float(rate) for rate in _stated_rates(stream) if rate]
            if self._record:
                self.claimed_hz, self._states_numbers = self._record.rate_hz, True
                self._pace = Pace(self.claimed_hz, is_even=True)
            elif not self._unstamped:
                self._make_clock = partial(StampClock, sample_s, float(stream.time_base or 0), stated)
                clock = self._make_clock()
                self.claimed_hz, self._pace = clock.rate_hz, clock.pace
            else:  # a stream of coded pictures alone, of which some say their rate
                self.claimed_hz = camera_rate(path, reading.rate_hz, float(stream.codec_context.framerate or 0))
            self.bits = self._record.bits if self._record else _bits(stream)
            self.frame_count = _frame_count(container, stream, self.claimed_hz) if not self._unstamped else None
            self._way_up = Orientation() if self._record or first is None else orientation(first)
            self._checks_levels = self._record is not None or (
                first is not None and first.format.name.startswith("gray")
            )
            # what was written in limited range had all levels before
            self._expanded = reading.expand_range or self._record is not None
            self.width, self.height = self._way_up.size(self.width, self.height)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        with _opened(self.path) as container:
            clock = self._make_clock() if self._make_clock else None
            for count, (picture, stamp_s, next_s) in enumerate(self._in_order(container)):
                if clock is not None:
                    time_s = clock.time(stamp_s, next_s)
                elif self._record is not None and picture.time_base is not None:
                    time_s = restored_time(self._record, stamp_s, float(picture.time_base))
                else:
                    time_s = stamp_s
                pixels, bits = self._gray(picture, count)
                self._check_form(pixels, bits, count)
                yield time_s, pixels, self.bits if self._record else bits

    def _gray(self, picture: "av.VideoFrame", count: int) -> tuple[Pixels, int]:
        import av

        try:
            pixels, bits = planes.to_gray(picture, self._expanded, self._reading.channel)
        except (av.error.FFmpegError, ValueError) as error:  # a form of pixels that FFmpeg cannot turn into gray
            raise MediaError(
                f"{self.path} has pictures of the form {picture.format.name}, which give no gray levels, after {count} "
                "whole frames: convert it, such as to FFV1"
            ) from error
        return (pixels if self._way_up == Orientation() else self._way_up.upright(pixels)), bits

    def _check_form(self, pixels: Pixels, bits: int, count: int) -> None:
        if self._record and (bits > _LEAST_BITS) != (self.bits > _LEAST_BITS):
            raise MediaError(
                f"{self.path} has pictures of {bits} bits, but notes {self.bits}: it was converted or is damaged; "
                f"convert it without its metadata, or copy it again"
            )
        if pixels.shape != (self.height, self.width):
            sizes = f"{self.width}x{self.height} to {pixels.shape[1]}x{pixels.shape[0]}"
            raise MediaError(f"{self.path} changes its size from {sizes} pixels after {count} frames: cut it there")

    def _decoded(self, container: "InputContainer") -> Iterator["av.VideoFrame"]:
        """Yield decoded pictures, then raise a MediaError if the rest of the file is damaged."""
        import av

        stream = _prepared(self._stream(container), strict=self._record is not None)
        count, damaged = 0, False
        try:
            for packet in self._sound_packets(container, stream):
                for picture in packet.decode() if packet is not None else stream.codec_context.decode(None):
                    count += 1
                    yield picture
                damaged = packet is None
        except av.error.FFmpegError:
            damaged = True
        self._judge_end(count, damaged)

    def _stream(self, container: "InputContainer") -> "av.VideoStream":
        return next(stream for stream in container.streams.video if stream.index == self._track)

    def _sound_packets(
        self, container: "InputContainer", stream: "av.VideoStream"
    ) -> Iterator["av.Packet[av.VideoStream] | None"]:
        """Yield packets up to the first FFV1 picture with a wrong checksum, and None in its place."""
        check = self._is_own_ffv1(stream)
        for packet in container.demux(stream):
            if check and packet.size and not whole.slices_whole(bytes(packet)):
                yield None
                return
            yield packet

    def _is_own_ffv1(self, stream: "av.VideoStream") -> bool:
        context = stream.codec_context
        crc = zlib.crc32(context.extradata or b"")
        return self._record is not None and context.name == "ffv1" and self._record.codec_crc == crc

    def _judge_end(self, count: int, damaged: bool) -> None:
        cut = whole.ends_early(self.path)
        if cut or (cut is None and self._record and self._has_end):
            raise MediaError(f"{self.path} ends in the middle, after {count} whole frames: copy or record it again")
        if damaged:
            raise MediaError(f"{self.path} is damaged after {count} whole frames: copy or record it again")
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    def _in_order(self, container: "InputContainer") -> Iterator[tuple["av.VideoFrame", float, float | None]]:
        """Yield pictures as they are shown, each with the earliest stamp in s that is left, and the one after it.

        Some writers stamp pictures in the order in which they are coded; pictures between others then have later stamps
        than they should, but all together have the right ones.
        """
        context = self._stream(container).codec_context
        held, stamps, stamp_s = deque["av.VideoFrame"](), list[float](), -1 / self.claimed_hz
        broken: MediaError | None = None
        try:
            for picture in self._decoded(container):
                if self._unstamped or picture.pts is None or picture.time_base is None:
                    stamp_s += 1 / self.claimed_hz
                else:
                    stamp_s = float(picture.pts * picture.time_base)
                held.append(picture)
                heapq.heappush(stamps, stamp_s)
                while len(held) > (_REORDERED if context.has_b_frames else 1):
                    yield held.popleft(), heapq.heappop(stamps), stamps[0]
        except MediaError as error:  # after the whole pictures before
            broken = error
        while held:
            yield held.popleft(), heapq.heappop(stamps), stamps[0] if stamps else None
        if broken is not None:
            raise broken


@contextmanager
def _opened(path: Path) -> Iterator["InputContainer"]:
    import av

    try:
        # "file:" because a colon in a name would be taken for a protocol
        container = av.open(f"file:{path}", "r", metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise _unreadable(path, error) from error
    with container:
        yield container


def _film_stream(path: Path, container: "InputContainer") -> "av.VideoStream":
    """The track that is the film: of several the one of most pixels in all of its frames; single pictures are none."""
    streams = () if container.format.name in _TEXT_FORMATS else container.streams.video
    if not streams:
        raise MediaError(f"{path} holds no pictures: give a video or an .h5 film")
    films = [stream for stream in streams if not int(stream.disposition) & _NO_FILM]
    if not films:
        raise MediaError(f"{path} holds a cover picture and no film: give the video itself, or save the picture as PNG")
    films = [stream for stream in films if stream.codec_context is not None]
    if not films:
        raise MediaError(f"{path} is coded in a way that this FFmpeg cannot read, or damaged: convert it")
    if len(films) == 1:
        return films[0]
    frames = _frames_of_tracks(container, films)

    def size(stream: "av.VideoStream") -> tuple[bool, int]:
        count = frames[stream.index]
        return count > 1, stream.codec_context.width * stream.codec_context.height * count

    film = max(films, key=size)
    form = f"{film.codec_context.width}x{film.codec_context.height} pixels"
    LOG.warning("%s has %d video tracks: the largest is read, track %d of %s", path, len(films), film.index, form)
    return film


def _frames_of_tracks(container: "InputContainer", films: "list[av.VideoStream]") -> dict[int, int]:
    """Frames of each track as the container states them, else among its first packets."""
    if all(stream.frames for stream in films):
        return {stream.index: stream.frames for stream in films}
    import av

    counts = {stream.index: 0 for stream in films}
    with suppress(av.error.FFmpegError):  # damage is reported after the whole frames
        for packet in islice(container.demux(films), _COUNTED_PACKETS):
            counts[packet.stream_index] += bool(packet.size)
        container.seek(0)
    return counts


def _sample(container: "InputContainer", stream: "av.VideoStream") -> tuple["av.VideoFrame | None", list[float]]:
    """The first picture of a track and the stamps in s of its first packets, as far as they are sound."""
    import av

    first: av.VideoFrame | None = None
    stamps: list[float] = []
    with suppress(av.error.FFmpegError, ValueError):
        for packet in container.demux(stream):
            stamp = packet.dts if packet.pts is None else packet.pts
            if packet.size and stamp is not None and packet.time_base is not None:
                stamps.append(float(stamp * packet.time_base))
            if first is None:
                first = next(iter(packet.decode()), None)
            if len(stamps) >= LIMITS.sample_frames:
                break
    return first, sorted(stamps)


def _stated_rates(stream: "av.VideoStream") -> tuple[Any, ...]:
    """Frame rates that the container, the coded stream and FFmpeg's guess state, the most credible first."""
    return stream.average_rate, stream.codec_context.framerate, stream.guessed_rate, stream.base_rate


def _unreadable(path: Path, error: Exception) -> MediaError:
    if isinstance(error, PermissionError):
        return MediaError(f"not allowed to read {path}: check its rights")
    if whole.ends_early(path):
        return MediaError(f"{path} ends in the middle and cannot be read without its end: copy or record it again")
    return MediaError(
        f"{path} is not a video that can be read: give a video (.mkv, .mp4 ...), .h5, .mraw, .cine, TIFF, .npy or "
        "a folder of pictures"
    )


def _prepared(stream: "av.VideoStream", strict: bool) -> "av.VideoStream":
    # pictures side by side, or parts of one, as the codec has them
    stream.thread_type = "AUTO"
    stream.codec_context.thread_count = DECODER_THREADS
    if strict:  # our own films are perfect or damaged; other footage is taken as the decoder mends it
        stream.codec_context.options = {"err_detect": "explode"}
    return stream


def _bits(stream: "av.VideoStream") -> int:
    layout = stream.codec_context.format
    return max(_LEAST_BITS, layout.components[0].bits) if layout else _LEAST_BITS


def _frame_count(container: "InputContainer", stream: "av.VideoStream", rate_hz: float) -> int | None:
    """Return the smaller of the container's count and its duration times the rate: edit lists hide stored frames."""
    counts = [stream.frames] if stream.frames else []
    if stream.duration and stream.time_base:
        counts.append(round(stream.duration * float(stream.time_base) * rate_hz))
    elif container.duration:
        last = "nut" in container.format.name  # NUT knows the start of the last frame, not its end
        counts.append(round(container.duration * 1e-6 * rate_hz) + last)
    return min(counts, default=None)
