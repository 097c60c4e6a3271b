"""Read video files of any origin as gray frames through PyAV."""

import heapq
import math
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame, Pixels
from heliograph.media import planes, whole
from heliograph.media.display import Orientation, orientation
from heliograph.media.numbered import camera_rate
from heliograph.media.reader import FilmReader, checked_size, checked_time
from heliograph.media.reading import Reading
from heliograph.media.record import from_tags, restored_time

if TYPE_CHECKING:
    import av
    from av.container import InputContainer

DECODER_THREADS = 2
"""Threads of a decoder: the cores of the machine that films were measured on. Chosen: a frame takes the same time of
processors with 1 to 4 threads, of pictures or of parts of one: 13.4 to 14.1 ms with FFV1, 6.1 to 6.9 ms with H.264."""

_NO_TIMESTAMPS = 0x80
"""Flag of FFmpeg's formats that hold coded pictures alone, such as .h264: their stamps are made up, 25 a second."""

_TEXT_FORMATS = ("tty", "lrc", "srt", "ass", "webvtt")
"""Formats as which FFmpeg opens text files, as films of letters on a terminal."""

_FALLBACK_HZ = 25.0
"""Frames a second where the file does not state them: FFmpeg's own assumption."""

_LEAST_BITS = 8
"""Least bits of a gray level."""

REORDERED = 16
"""Pictures whose stamps may be out of order: as many as H.264 and H.265 hold back for pictures between others."""


class VideoReader(FilmReader):
    """A video file; see `FilmReader`.

    Parameters
    ----------
    path
        Video of any kind that FFmpeg reads.
    reading
        How the film is to be read.

    Raises
    ------
    MediaError
        The file is no readable video.
    """

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._reading = reading
        with _opened(path) as container:
            stream = container.streams.video[0]
            self._record = from_tags(container.metadata)
            self.width, self.height = stream.codec_context.width, stream.codec_context.height
            self.faster = ("HDF5",) if stream.codec_context.name == "h264" else ("HDF5", "lossless H.264")
            self.metadata = self._record.metadata if self._record else _tags(container)
            self._stamped = not int(container.format.flags) & _NO_TIMESTAMPS
            if self._stamped:
                self.claimed_hz = self._record.rate_hz if self._record else _rate(stream)
            else:  # a stream of coded pictures alone, of which some say their rate
                self.claimed_hz = camera_rate(path, reading.rate_hz, float(stream.codec_context.framerate or 0))
            self.bits = self._record.bits if self._record else _bits(stream)
            self.frame_count = _frame_count(container, self.claimed_hz) if self._stamped else None
            checked_size(path, self.width, self.height)
            self._way_up = Orientation() if self._record else _way_up(container)
            # what was written in limited range had all levels before
            self._expanded = reading.expand_range or self._record is not None
            self.width, self.height = self._way_up.size(self.width, self.height)

    def _frames(self) -> Iterator[Frame]:
        with _opened(self.path) as container:
            index = -1
            for count, (picture, elapsed_s) in enumerate(self._in_order(container)):
                time_s = checked_time(self.path, self._time(picture, elapsed_s), count)
                index = max(index + 1, round(time_s * self.claimed_hz))
                pixels, bits = self._gray(picture, count)
                self._check_form(pixels, bits, count)
                yield Frame(index, time_s, pixels, self.bits if self._record else bits)

    def _gray(self, picture: "av.VideoFrame", count: int) -> tuple[Pixels, int]:
        import av

        try:
            pixels, bits = planes.to_gray(picture, self._expanded, self._reading.channel)
        except (av.error.FFmpegError, ValueError) as error:  # a form of pixels that FFmpeg cannot turn into gray
            raise MediaError(f"{self.path} is damaged after {count} whole frames: copy it again") from error
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

    def _pictures(self, container: "InputContainer") -> Iterator["av.VideoFrame"]:
        """Yield decoded pictures, then raise a MediaError if the rest of the file is damaged."""
        import av

        stream = _prepared(container, strict=self._record is not None)
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
        if cut or (cut is None and self._record and self.path.suffix.lower() in (".mkv", ".nut")):
            raise MediaError(f"{self.path} ends in the middle, after {count} whole frames: copy or record it again")
        if damaged:
            raise MediaError(f"{self.path} is damaged after {count} whole frames: copy or record it again")
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    def _in_order(self, container: "InputContainer") -> Iterator[tuple["av.VideoFrame", float]]:
        """Yield pictures as they are shown, each with the earliest stamp in s that is left.

        Some writers stamp pictures in the order in which they are coded; pictures between others then have later stamps
        than they should, but all together have the right ones. A stamp that comes twice is taken for a period later.
        """
        last_s = -math.inf
        for picture, stamp_s in self._sorted(container):
            last_s = last_s + 1 / self.claimed_hz if stamp_s == last_s else stamp_s
            yield picture, last_s

    def _sorted(self, container: "InputContainer") -> Iterator[tuple["av.VideoFrame", float]]:
        context = container.streams.video[0].codec_context
        held, stamps, stamp_s = deque["av.VideoFrame"](), list[float](), -1 / self.claimed_hz
        broken: MediaError | None = None
        try:
            for picture in self._pictures(container):
                if not self._stamped or picture.pts is None or picture.time_base is None:
                    stamp_s += 1 / self.claimed_hz
                else:
                    stamp_s = float(picture.pts * picture.time_base)
                held.append(picture)
                heapq.heappush(stamps, stamp_s)
                while len(held) > (REORDERED if context.has_b_frames else 0):
                    yield held.popleft(), heapq.heappop(stamps)
        except MediaError as error:  # after the whole pictures before
            broken = error
        while held:
            yield held.popleft(), heapq.heappop(stamps)
        if broken is not None:
            raise broken

    def _time(self, picture: "av.VideoFrame", elapsed_s: float) -> float:
        if self._record is None or picture.time_base is None:
            return elapsed_s
        return restored_time(self._record, elapsed_s, float(picture.time_base))


@contextmanager
def _opened(path: Path) -> Iterator["InputContainer"]:
    import av

    try:
        # "file:" because a colon in a name would be taken for a protocol
        container = av.open(f"file:{path}", "r", metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise _unreadable(path, error) from error
    with container:
        if not container.streams.video or container.format.name in _TEXT_FORMATS:
            raise MediaError(f"{path} holds no pictures: give a video or an .h5 film")
        if container.streams.video[0].codec_context is None:
            raise MediaError(f"{path} is coded in a way that this FFmpeg cannot read, or damaged: convert it")
        yield container


def _unreadable(path: Path, error: Exception) -> MediaError:
    if isinstance(error, PermissionError):
        return MediaError(f"not allowed to read {path}: check its rights")
    if whole.ends_early(path):
        return MediaError(f"{path} ends in the middle and cannot be read without its end: copy or record it again")
    return MediaError(
        f"{path} is not a video that can be read: give a video (.mkv, .mp4 ...), .h5, .mraw, .cine, TIFF, .npy or "
        "a folder of pictures"
    )


def _prepared(container: "InputContainer", strict: bool) -> "av.VideoStream":
    stream = container.streams.video[0]
    # pictures side by side, or parts of one, as the codec has them
    stream.thread_type = "AUTO"
    stream.codec_context.thread_count = DECODER_THREADS
    if strict:  # our own films are perfect or damaged; other footage is taken as the decoder mends it
        stream.codec_context.options = {"err_detect": "explode"}
    return stream


def _way_up(container: "InputContainer") -> Orientation:
    """How pictures are put upright, by the first one; of a film without a whole picture it does not matter."""
    import av

    try:
        first = next(container.decode(video=0), None)
    except (av.error.FFmpegError, ValueError):
        return Orientation()
    return Orientation() if first is None else orientation(first)


def _tags(container: "InputContainer") -> dict[str, str]:
    return {**container.metadata, **container.streams.video[0].metadata}


def _rate(stream: "av.VideoStream") -> float:
    rate = stream.average_rate or stream.guessed_rate or stream.base_rate
    return float(rate) if rate else _FALLBACK_HZ


def _bits(stream: "av.VideoStream") -> int:
    layout = stream.codec_context.format
    return max(_LEAST_BITS, layout.components[0].bits) if layout else _LEAST_BITS


def _frame_count(container: "InputContainer", rate_hz: float) -> int | None:
    """Return the smaller of the container's count and its duration times the rate: edit lists hide stored frames."""
    stream = container.streams.video[0]
    counts = [stream.frames] if stream.frames else []
    if stream.duration and stream.time_base:
        counts.append(round(stream.duration * float(stream.time_base) * rate_hz))
    elif container.duration:
        last = "nut" in container.format.name  # NUT knows the start of the last frame, not its end
        counts.append(round(container.duration * 1e-6 * rate_hz) + last)
    return min(counts, default=None)
