"""Video files of any origin as gray frames, by PyAV."""

import heapq
import logging
import struct
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media import planes, whole
from heliograph.media.libraries import av
from heliograph.media.reader import Reading, checked_size
from heliograph.media.record import from_tags, restored_time
from heliograph.media.stamps import SAMPLE_FRAMES, StampClock, TimedReader


class VideoReader(TimedReader):
    """A video file; see `FilmReader`."""

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        self._clock_values: tuple[list[float], float, list[float]] | None = None
        with _opened(path) as container:
            stream = _film_stream(path, container)
            context = stream.codec_context
            self._track, self._record = stream.index, from_tags(container.metadata)
            checked_size(path, context.width, context.height)
            self.metadata = self._record.metadata if self._record else {**container.metadata, **stream.metadata}
            # FFmpeg's AVFMT_NOTIMESTAMPS: coded pictures only, such as .h264, with artificial stamps
            self._unstamped = bool(int(container.format.flags) & 0x80)
            self._has_end = container.format.name in ("matroska,webm", "nut")
            first, sample_s = _sample(container, stream)
            # the most credible rate first: container, coded stream, FFmpeg's guess
            rates = (stream.average_rate, context.framerate, stream.guessed_rate, stream.base_rate)
            if self._record:
                self._number_frames(self._record.rate_hz)
            elif not self._unstamped:
                stated = [float(rate) for rate in rates if rate]
                self._clock_values = sample_s, float(stream.time_base or 0), stated
                clock = StampClock(*self._clock_values)
                self.claimed_hz, self._pace = clock.rate_hz, clock.pace
            else:
                self._set_rate(float(context.framerate or 0))
            form = first.format if first is not None else context.format
            bits = min(max(8, form.components[0].bits), 16) if form else 8
            self.bits = self._record.bits if self._record else bits
            self.frame_count = None if self._unstamped else _frame_count(container, stream, self.claimed_hz)
            is_gray = first is not None and first.format.name.startswith("gray")
            self._checks_levels = self._record is not None or is_gray
            # films of this package in limited range had all levels before
            self._expanded = reading.expand_range or self._record is not None
            self._turn = planes.NO_TURN if self._record or first is None else _orientation(first)
            self.width, self.height = (context.width, context.height)[:: -1 if self._turn[0] else 1]

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        with _opened(self.path) as container:
            clock = StampClock(*self._clock_values) if self._clock_values else None
            for count, (picture, stamp_s, next_s) in enumerate(self._in_order(container)):
                if clock is not None:
                    time_s = clock.time(stamp_s, next_s)
                elif self._record is not None and picture.time_base is not None:
                    time_s = restored_time(self._record, stamp_s, float(picture.time_base))
                else:
                    time_s = stamp_s
                pixels, bits = self._gray(picture, count)
                is_noted = self._record is not None and (bits > 8) == (self.bits > 8)
                yield time_s, pixels, self.bits if is_noted else bits

    def _gray(self, picture: "av.VideoFrame", count: int) -> tuple[Pixels, int]:
        try:
            pixels, bits = planes.to_gray(picture, self._expanded, self._channel)
        except (av.error.FFmpegError, ValueError) as error:
            form = f"pictures of the form {picture.format.name} after {count} whole frames"
            raise MediaError(f"{self.path} has {form}, which give no gray levels: convert it") from error
        return planes.upright(pixels, *self._turn), bits

    def _stream(self, container: "av.container.InputContainer") -> "av.VideoStream":
        return next(stream for stream in container.streams.video if stream.index == self._track)

    def _decoded(self, container: "av.container.InputContainer") -> Iterator["av.VideoFrame"]:
        """Yield decoded pictures, then raise a MediaError if the rest of the file is damaged."""
        stream = self._stream(container)
        context = stream.codec_context
        stream.thread_type, context.thread_count = "AUTO", 2
        if self._record:  # films of this package are perfect or damaged; the decoder may repair others
            context.options = {"err_detect": "explode"}
        crc = zlib.crc32(context.extradata or b"")
        has_checksums = self._record is not None and context.name == "ffv1" and self._record.codec_crc == crc
        count, damaged, picture_bytes = 0, False, 0
        try:
            for packet in container.demux(stream):
                picture_bytes = packet.size or picture_bytes
                if has_checksums and packet.size and not whole.slices_whole(bytes(packet)):
                    damaged = True
                # flush the decoder at the first damaged picture
                for picture in context.decode(None) if damaged else packet.decode():
                    count += 1
                    yield picture
                if damaged:
                    break
        except av.error.FFmpegError:
            damaged = True
        is_cut = whole.ends_early(self.path, picture_bytes)
        if is_cut or (is_cut is None and self._record and self._has_end):
            raise MediaError(f"{self.path} ends in the middle, after {count} whole frames: copy or record it again")
        if damaged:
            raise MediaError(f"{self.path} is damaged after {count} whole frames: copy or record it again")

    def _in_order(
        self, container: "av.container.InputContainer"
    ) -> Iterator[tuple["av.VideoFrame", float, float | None]]:
        """Yield pictures in display order, each with the earliest remaining stamp in s and the next stamp.

        Some writers stamp pictures in coding order: the set of stamps is right, and the order is not.
        """
        # H.264 and H.265 hold back 16 pictures for bidirectional prediction
        held_back = 16 if self._stream(container).codec_context.has_b_frames else 1
        pictures, stamps, stamp_s = deque["av.VideoFrame"](), list[float](), -1 / self.claimed_hz
        damage: MediaError | None = None
        try:
            for picture in self._decoded(container):
                if self._unstamped or picture.pts is None or picture.time_base is None:
                    stamp_s += 1 / self.claimed_hz
                else:
                    stamp_s = float(picture.pts * picture.time_base)
                pictures.append(picture)
                heapq.heappush(stamps, stamp_s)
                while len(pictures) > held_back:
                    yield pictures.popleft(), heapq.heappop(stamps), stamps[0]
        except MediaError as error:  # raised after the good pictures
            damage = error
        while pictures:
            yield pictures.popleft(), heapq.heappop(stamps), stamps[0] if stamps else None
        if damage is not None:
            raise damage


def _orientation(picture: "av.VideoFrame") -> tuple[bool, bool, bool]:
    """Return whether to transpose a picture, then to flip rows and columns; other angles are ignored."""
    from av.sidedata.sidedata import Type

    side_data: Any = picture.side_data
    matrix = side_data.get(Type.DISPLAYMATRIX)
    if matrix is None or len(bytes(matrix)) < 36:
        return planes.NO_TURN
    # the place on the display, y down: x' = a x + c y, y' = b x + d y
    a, b, _, c, d, *_ = struct.unpack_from("<9i", bytes(matrix))
    if not b and not c:
        return False, d < 0, a < 0
    return (True, b < 0, c < 0) if not a and not d else planes.NO_TURN


def _tag_options() -> dict[str, Any]:
    """Return the options of PyAV for tags that are no UTF-8; from PyAV 19 on none are needed."""
    return {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}


@contextmanager
def _opened(path: Path) -> Iterator["av.container.InputContainer"]:
    try:
        # "file:" because a colon in a name would denote a protocol
        container = av.open(f"file:{path}", "r", **_tag_options())
    except PermissionError as error:
        raise MediaError(f"not allowed to read {path}: check its rights") from error
    except (av.error.FFmpegError, OSError) as error:
        if whole.ends_early(path):
            raise MediaError(f"{path} ends in the middle, and is not readable: copy or record it again") from error
        kinds = "a video (.mkv, .mp4 ...), .h5, .mraw, .cine, TIFF, .npy or a folder of pictures"
        raise MediaError(f"{path} is not a video that can be read: give {kinds}") from error
    with container:
        yield container


def _film_stream(path: Path, container: "av.container.InputContainer") -> "av.VideoStream":
    """Return the track with the most pixels in all frames; ignore single pictures."""
    # FFmpeg reads text files and some binary files as films of letters on a terminal
    is_text = container.format.name in ("tty", "bin", "adf", "idf", "xbin", "lrc", "srt", "ass", "webvtt")
    streams = () if is_text else container.streams.video
    if not streams:
        raise MediaError(f"{path} holds no pictures: give a video or an .h5 film")
    # dispositions: attached picture, timed thumbnails, still image
    films = [stream for stream in streams if not int(stream.disposition) & (0x400 | 0x800 | 0x100000)]
    if not films:
        raise MediaError(f"{path} holds a cover picture and no film: give the video itself, or save the picture as PNG")
    films = [stream for stream in films if stream.codec_context is not None]
    if not films:
        raise MediaError(f"{path} is coded in a way that this FFmpeg cannot read, or damaged: convert it")
    if len(films) == 1:
        return films[0]
    counts = _count_frames(container, films)
    pixels = {stream.index: stream.codec_context.width * stream.codec_context.height for stream in films}
    film = max(films, key=lambda stream: (counts[stream.index] > 1, pixels[stream.index] * counts[stream.index]))
    form = f"track {film.index} of {film.codec_context.width}x{film.codec_context.height} pixels"
    logging.getLogger(__name__).warning("%s has %d video tracks: the largest is read, %s", path, len(films), form)
    return film


def _count_frames(container: "av.container.InputContainer", films: "list[av.VideoStream]") -> dict[int, int]:
    """Return the frames of each track in 500 packets."""
    counts = {stream.index: 0 for stream in films}
    with suppress(av.error.FFmpegError):  # reading reports damage after the good frames
        for packet in islice(container.demux(films), 500):
            if packet.size:  # empty packets at the end may have the index of another track
                counts[packet.stream_index] += 1
        container.seek(0)
    return counts


def _sample(
    container: "av.container.InputContainer", stream: "av.VideoStream"
) -> tuple["av.VideoFrame | None", list[float]]:
    """Return the first picture of a track and the stamps in s of the first packets before any damage."""
    first: av.VideoFrame | None = None
    stamps: list[float] = []
    with suppress(av.error.FFmpegError, ValueError):
        for packet in container.demux(stream):
            stamp = packet.dts if packet.pts is None else packet.pts
            if packet.size and stamp is not None and packet.time_base is not None:
                stamps.append(float(stamp * packet.time_base))
            if first is None:
                first = next(iter(packet.decode()), None)
            if len(stamps) >= SAMPLE_FRAMES:
                break
    return first, sorted(stamps)


def _frame_count(container: "av.container.InputContainer", stream: "av.VideoStream", rate_hz: float) -> int | None:
    """Return the smaller of the container's count and the duration times the rate: edit lists hide stored frames."""
    counts = [stream.frames] if stream.frames else []
    if stream.duration and stream.time_base:
        counts.append(round(stream.duration * float(stream.time_base) * rate_hz))
    elif container.duration:
        is_nut = "nut" in container.format.name  # the duration lacks the last frame
        counts.append(round(container.duration * 1e-6 * rate_hz) + is_nut)
    return min(counts, default=None)
