"""Write video files through PyAV: FFV1 and lossless H.264 bit for bit, H.264, H.265 and MJPEG lossy, in full range.

With a bit rate H.264 and H.265 are written as phones write them: 4:2:0, limited range, a whole picture each second.
"""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, cast

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Frame
from heliograph.media import planes
from heliograph.media.record import FilmRecord, FilmSpec, fine_time_base, rational_rate, to_tags
from heliograph.media.writer import write_error

if TYPE_CHECKING:
    import av
    from av.container import OutputContainer

CODECS = {
    ".mkv": ("ffv1", "h264", "h265", "mjpeg"),
    ".nut": ("ffv1", "h264", "h265", "mjpeg"),
    ".mp4": ("h264", "h265"),
    ".avi": ("mjpeg",),
}
"""Codecs by suffix, the default first."""

MOST_BITS = {"ffv1": 16, "h264": 10, "h265": 8, "mjpeg": 8}
"""Most bits of a gray level that FFmpeg's encoder of each codec takes."""

DEFAULT_CRF = 12.0
"""Quality of lossy H.264. Its error in noise of 1.5 gray levels is 1.5 levels rms, about that of the sensor, at 65 kB a
frame of 1024 x 512; at half the value 0.9 levels and 152 kB; at twice 2.4 levels and 4 kB, without the
noise."""

WORST_CRF = 51.0
"""Largest crf of H.264 at 8 bits."""

ENCODER_THREADS = 2
"""Threads of an encoder: the cores of the machine that films were measured on. Chosen: with 1 and with 4 FFV1 and H.264
are written at the same speed within the noise of that shared machine, 30 %."""

_SLICES, _SLICES_ACROSS = 6, 3
"""Slices of an FFV1 picture, which are coded side by side, and how many of them lie beside one another: a picture
needs a pixel for each."""

_RATED = ("h264", "h265")
"""Codecs with a quality or a bit rate."""

_LEAST_MBIT, _MOST_MBIT = 0.1, 1000.0
"""Bounds of a bit rate in Mbit/s. Chosen: phones write 10 to 40."""

_PHONE_PRESET = "veryfast"
"""Preset of the encoders where a bit rate is given. Chosen: encoders in phones are fast ones."""

_COARSE_HZ = 1000
"""Largest frame rate of Matroska, which counts milliseconds, and of AVI, whose reader rejects more frames a second."""

_OFF_GRID = 0.01
"""Frame periods by which a time in AVI may be off the grid. Chosen: a frame that is later by more would be shown at a
wrong time; rounding errors are far smaller."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoCodec:
    """The coding of pictures."""

    # "ffv1", "h264", "h265" or "mjpeg"
    name: str
    # Quality of lossy H.264, 0 (best) to 51
    crf: float = DEFAULT_CRF
    # Whether H.264 keeps every bit
    lossless: bool = False
    # Bit rate of H.264 or H.265 in Mbit/s; None for a constant quality
    mbit_s: float | None = None


def chosen_codec(
    suffix: str, name: str | None, crf: float | None, lossless: bool, mbit_s: float | None = None
) -> VideoCodec:
    """Return the codec of a film."""
    known = CODECS[suffix]
    name = name or ("h264" if mbit_s is not None and "h264" in known else known[0])
    if name not in known:
        raise MediaError(f"codec {name!r} does not go into {suffix}: choose one of {', '.join(known)}")
    given = "crf" if crf is not None else "mbit_s" if mbit_s is not None else ""
    if name not in _RATED and given:
        raise MediaError(f"{given} is a setting of h264 and h265, the codec of this film is {name}: leave it out")
    if mbit_s is not None and (crf is not None or lossless):
        raise MediaError("give one of mbit_s, crf and lossless: each of them decides the size of the film")
    if mbit_s is not None and not (isinstance(mbit_s, Real) and _LEAST_MBIT <= mbit_s <= _MOST_MBIT):
        raise MediaError(f"mbit_s lies between {_LEAST_MBIT:g} and {_MOST_MBIT:g}, got {shown(mbit_s)}")
    if name in ("mjpeg", "h265") and lossless:
        raise MediaError(f"{name} cannot be lossless: choose codec='ffv1' or 'h264' in a .mkv or .nut file")
    if crf is not None and lossless:
        raise MediaError("give either crf or lossless, not both: lossless has no quality to choose")
    if crf is not None and not (isinstance(crf, Real) and 0 <= crf <= WORST_CRF):
        raise MediaError(f"crf lies between 0 (best) and 51 (smallest), got {shown(crf)}")
    return VideoCodec(name=name, crf=DEFAULT_CRF if crf is None else crf, lossless=lossless, mbit_s=mbit_s)


def check_form(spec: FilmSpec, suffix: str, codec: str) -> None:
    """Check that container and codec can hold a film of a form."""
    if codec == "h265" and (spec.width % 2 or spec.height % 2):
        raise MediaError(f"h265 takes an even width and height, not {spec.width}x{spec.height}: use h264 or ffv1")
    if spec.bits > MOST_BITS[codec]:
        raise MediaError(f"{codec} holds at most {MOST_BITS[codec]} bits, the film has {spec.bits}: use ffv1 or .h5")
    if suffix in (".mkv", ".avi") and spec.rate_hz > _COARSE_HZ:
        raise MediaError(
            f"{suffix} keeps time to 1 ms at best, too coarse for {spec.rate_hz:g} frames/s: use .nut, .mp4 or .h5"
        )


class VideoSink:
    """Sink for a video file; the header holds the time of the first frame, so both are written together."""

    def __init__(self, partial: Path, target: Path, spec: FilmSpec, codec: VideoCodec) -> None:
        self._target = target
        self._spec = spec
        self._suffix = target.suffix.lower()
        self._time_base = _time_base(self._suffix, spec.rate_hz)
        self._pixel_format, options = _coding(codec, spec)
        self._range = planes.FULL if codec.mbit_s is None else planes.LIMITED
        self._start_s: float | None = None
        self._last_tick = -1
        with self._clear_errors():
            self._container = _create(partial, self._suffix)
            self._stream = self._add_stream(codec, options)

    def put(self, frame: Frame) -> None:
        """Encode a frame; see `Sink`."""
        with self._clear_errors():
            if self._start_s is None:
                self._start_s = frame.time_s
                self._write_record(frame.time_s)
            picture = planes.to_video(frame.pixels, self._pixel_format, self._range)
            picture.pts = self._tick(frame.time_s - self._start_s)
            picture.time_base = self._time_base
            self._mux(self._stream.encode(picture))

    def close(self) -> None:
        """Encode the frames that the codec holds back and write the index."""
        with self._clear_errors():
            self._mux(self._stream.encode())
            self._container.close()

    def discard(self) -> None:
        """Close the file whatever its state: it is about to be removed. Never raises."""
        with suppress(Exception):
            self._container.close()

    def _add_stream(self, codec: VideoCodec, options: dict[str, str]) -> "av.VideoStream":
        encoder = {"h264": "libx264", "h265": "libx265"}.get(codec.name, codec.name)
        rate = rational_rate(self._spec.rate_hz)
        stream = cast("av.VideoStream", self._container.add_stream(encoder, rate=rate, options=options))
        stream.width, stream.height = self._spec.width, self._spec.height
        stream.pix_fmt = self._pixel_format
        stream.time_base = self._time_base
        context = stream.codec_context
        context.time_base = self._time_base
        context.color_range = self._range
        if codec.mbit_s is not None:
            context.bit_rate = round(codec.mbit_s * 1e6)
            context.gop_size = max(1, round(self._spec.rate_hz))
        context.thread_count = ENCODER_THREADS
        if codec.name == "ffv1":
            context.gop_size = 1  # every picture stands alone: a damaged one spoils no other
        context.open()
        return stream

    def _mux(self, packets: "list[av.Packet[av.VideoStream]]") -> None:
        for packet in packets:
            # a time stamp tells where the frame before ends; the last frame has its duration alone
            packet.duration = round(1 / (self._spec.rate_hz * self._time_base))
            self._container.mux(packet)

    def _write_record(self, start_s: float) -> None:
        record = FilmRecord(
            rate_hz=self._spec.rate_hz,
            bits=self._spec.bits,
            start_s=start_s,
            metadata=dict(self._spec.metadata),
            codec_crc=zlib.crc32(self._stream.codec_context.extradata or b""),
        )
        self._container.metadata.update(to_tags(record, self._suffix))

    def _tick(self, elapsed_s: float) -> int:
        tick = round(elapsed_s * self._time_base.denominator / self._time_base.numerator)
        if tick <= self._last_tick:
            raise MediaError(
                f"two frames fall on the same {float(self._time_base):.3g} s tick of {self._suffix}, the second "
                f"{elapsed_s:.9f} s after the start: leave more time between frames, or use .nut or .h5"
            )
        if self._suffix == ".avi" and abs(tick - elapsed_s * self._spec.rate_hz) > _OFF_GRID:
            raise MediaError(
                f".avi holds whole frame periods only, got a frame {elapsed_s:.9f} s after the start "
                f"at {self._spec.rate_hz:g} frames/s: use .nut, .mp4 or .h5"
            )
        self._last_tick = tick
        return tick

    @contextmanager
    def _clear_errors(self) -> Iterator[None]:
        import av

        try:
            yield
        except MediaError:
            raise
        except (av.error.FFmpegError, OSError) as error:
            raise write_error(error, self._target) from error


def _create(partial: Path, suffix: str) -> "OutputContainer":
    import av

    options = {"movflags": "use_metadata_tags"} if suffix == ".mp4" else {}  # else MP4 drops unknown tags
    # "file:" because a colon in a name would be taken for a protocol
    return av.open(f"file:{partial}", "w", options=options)


def _time_base(suffix: str, rate_hz: float) -> Fraction:
    if suffix == ".avi":
        return 1 / rational_rate(rate_hz)
    return Fraction(1, 1000) if suffix == ".mkv" else fine_time_base(rate_hz)


def _coding(codec: VideoCodec, spec: FilmSpec) -> tuple[str, dict[str, str]]:
    """Return pixel format and options of the encoder, the fastest of those measured."""
    if codec.name == "ffv1":
        # Golomb-Rice codes 8 bits at nearly twice the speed of the range coder; more bits need the latter
        coder = "0" if spec.bits == 8 else "1"
        slices = _SLICES if spec.width >= _SLICES_ACROSS and spec.height >= _SLICES // _SLICES_ACROSS else 1
        options = {"level": "3", "coder": coder, "context": "0", "slices": str(slices), "slicecrc": "1"}
        return planes.gray_format(spec.bits), options
    if codec.name == "mjpeg":
        return "yuv420p", {"qmin": "2", "qmax": "2"}
    if codec.mbit_s is not None:
        quiet = {"x265-params": "log-level=none"} if codec.name == "h265" else {}
        return "yuv420p", {"preset": _PHONE_PRESET, "bf": "0", **quiet}
    if codec.name == "h265":
        return "yuv420p", {"preset": "ultrafast", "crf": f"{codec.crf:g}", "x265-params": "log-level=none:bframes=0"}
    quality = {"qp": "0"} if codec.lossless else {"crf": f"{codec.crf:g}"}
    even = spec.width % 2 == 0 and spec.height % 2 == 0
    # 4:2:0 for players, which show nothing else; lossless films they do not show in any case
    colour = spec.bits == 8 and even and not codec.lossless
    pixel_format = "yuv420p" if colour else planes.gray_format(max(spec.bits, 10) if spec.bits > 8 else 8)
    return pixel_format, {"preset": "ultrafast", "bf": "0", **quality}
