"""Write video files through PyAV: FFV1 and lossless H.264 bit for bit, H.264, H.265 and MJPEG lossy, in full range.

With a bit rate H.264 and H.265 are written as by phones: 4:2:0, limited range, a key frame each second.
"""

import zlib
from contextlib import suppress
from fractions import Fraction
from numbers import Real
from pathlib import Path
from typing import cast

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Frame
from heliograph.media import planes
from heliograph.media.libraries import av
from heliograph.media.record import FilmRecord, FilmSpec, fine_time_base, rational_rate, to_tags

CODECS = {
    ".mkv": ("ffv1", "h264", "h265", "mjpeg"),
    ".nut": ("ffv1", "h264", "h265", "mjpeg"),
    ".mp4": ("h264", "h265"),
    ".avi": ("mjpeg",),
}
"""Codecs by suffix, the default first."""


def choose_codec(
    spec: FilmSpec, suffix: str, name: str | None, crf: float | None, lossless: bool, mbit_s: float | None
) -> str:
    """Return the codec of a film, or refuse settings unsupported by codec or container."""
    known = CODECS[suffix]
    name = name or ("h264" if mbit_s is not None and "h264" in known else known[0])
    if name not in known:
        raise MediaError(f"codec {name!r} does not go into {suffix}: choose one of {', '.join(known)}")
    qualities = (("crf", crf, 0, 51, "0 (best) and 51 (smallest)"), ("mbit_s", mbit_s, 0.1, 1000, "0.1 and 1000"))
    for label, value, least, most, limits in qualities:
        if value is not None and name in ("ffv1", "mjpeg"):
            raise MediaError(f"{label} is a setting of h264 and h265, the codec of this film is {name}: leave it out")
        if value is not None and not (isinstance(value, Real) and least <= value <= most):
            raise MediaError(f"{label} lies between {limits}, got {shown(value)}")
    if (crf is not None) + (mbit_s is not None) + lossless > 1:
        raise MediaError("give one of mbit_s, crf and lossless: each decides the size of the film")
    if name in ("mjpeg", "h265") and lossless:
        raise MediaError(f"{name} cannot be lossless: choose codec='ffv1' or 'h264' in a .mkv or .nut file")
    if name == "h265" and (spec.width % 2 or spec.height % 2):
        raise MediaError(f"h265 takes an even width and height, not {spec.width}x{spec.height}: use h264 or ffv1")
    most_bits = {"ffv1": 16, "h264": 10, "h265": 8, "mjpeg": 8}[name]
    if spec.bits > most_bits:
        raise MediaError(f"{name} holds at most {most_bits} bits, the film has {spec.bits}: use ffv1 or .h5")
    if suffix in (".mkv", ".avi") and spec.rate_hz > 1000:  # FFmpeg's reader of AVI takes no higher rate
        raise MediaError(f"{suffix} keeps 1 ms, too coarse for {spec.rate_hz:g} frames/s: use .nut, .mp4 or .h5")
    return name


class VideoSink:
    """Sink for a video file; the header holds the time of the first frame, so both are written together."""

    def __init__(
        self, partial: Path, suffix: str, spec: FilmSpec, codec: str, crf: float | None, lossless: bool,
        mbit_s: float | None,
    ) -> None:  # fmt: skip
        self._spec, self._suffix = spec, suffix
        self._time_base = _time_base(self._suffix, spec.rate_hz)
        self._pixel_format, options = _coding(spec, codec, crf, lossless, mbit_s)
        self._range = planes.FULL if mbit_s is None else planes.LIMITED
        self._start_s: float | None = None
        self._last_tick = -1
        flags = {"movflags": "use_metadata_tags"} if self._suffix == ".mp4" else {}  # MP4 would drop the record
        # "file:" because a colon in a name would denote a protocol
        self._container = av.open(f"file:{partial}", "w", options=flags)
        self._stream = self._add_stream(codec, options, mbit_s)

    def put(self, frame: Frame) -> None:
        """Encode a frame; see `Sink`."""
        if self._start_s is None:
            self._start_s = frame.time_s
            self._write_record(frame.time_s)
        picture = planes.to_video(frame.pixels, self._pixel_format, self._range)
        picture.pts = self._tick(frame.time_s - self._start_s)
        picture.time_base = self._time_base
        self._mux(self._stream.encode(picture))

    def close(self) -> None:
        """Encode the remaining frames and write the index."""
        self._mux(self._stream.encode())
        self._container.close()

    def discard(self) -> None:
        """Close the file in any state; never raises."""
        with suppress(Exception):
            self._container.close()

    def _add_stream(self, codec: str, options: dict[str, str], mbit_s: float | None) -> "av.VideoStream":
        encoder = {"h264": "libx264", "h265": "libx265"}.get(codec, codec)
        rate = rational_rate(self._spec.rate_hz)
        stream = cast("av.VideoStream", self._container.add_stream(encoder, rate=rate, options=options))
        stream.width, stream.height = self._spec.width, self._spec.height
        stream.pix_fmt, stream.time_base = self._pixel_format, self._time_base
        context = stream.codec_context
        context.time_base, context.color_range = self._time_base, self._range
        if mbit_s is not None:
            context.bit_rate, context.gop_size = round(mbit_s * 1e6), max(1, round(self._spec.rate_hz))
        context.thread_count = 2
        if codec == "ffv1":
            context.gop_size = 1  # damage stays within a picture
        context.open()
        return stream

    def _mux(self, packets: "list[av.Packet[av.VideoStream]]") -> None:
        for packet in packets:
            # the next time stamp gives the end of a frame; the last frame needs a duration
            packet.duration = round(1 / (self._spec.rate_hz * self._time_base))
            self._container.mux(packet)

    def _write_record(self, start_s: float) -> None:
        crc, spec = zlib.crc32(self._stream.codec_context.extradata or b""), self._spec
        notes = dict(spec.metadata)
        record = FilmRecord(rate_hz=spec.rate_hz, bits=spec.bits, start_s=start_s, metadata=notes, codec_crc=crc)
        self._container.metadata.update(to_tags(record, self._suffix))

    def _tick(self, elapsed_s: float) -> int:
        tick = round(elapsed_s * self._time_base.denominator / self._time_base.numerator)
        if tick <= self._last_tick:
            tick_s, cure = f"{float(self._time_base):.3g} s tick of {self._suffix}", "use .nut or .h5"
            raise MediaError(f"two frames fall on the same {tick_s}, {elapsed_s:.9f} s after the start: {cure}")
        if self._suffix == ".avi" and abs(tick - elapsed_s * self._spec.rate_hz) > 0.01:
            raise MediaError(f".avi holds whole frame periods only, got {elapsed_s:.9f} s: use .nut, .mp4 or .h5")
        self._last_tick = tick
        return tick


def _time_base(suffix: str, rate_hz: float) -> Fraction:
    if suffix == ".avi":
        return 1 / rational_rate(rate_hz)
    return Fraction(1, 1000) if suffix == ".mkv" else fine_time_base(rate_hz)


def _coding(
    spec: FilmSpec, codec: str, crf: float | None, lossless: bool, mbit_s: float | None
) -> tuple[str, dict[str, str]]:
    """Return pixel format and options of the encoder, the fastest of those measured."""
    quality = f"{12.0 if crf is None else crf:g}"
    if codec == "ffv1":
        # Golomb-Rice codes 8 bits at nearly twice the speed of the range coder; more bits need the latter
        coder = "0" if spec.bits == 8 else "1"
        slices = "6" if spec.width >= 3 and spec.height >= 2 else "1"  # three slices side by side need a pixel each
        options = {"level": "3", "coder": coder, "context": "0", "slices": slices, "slicecrc": "1"}
        return planes.gray_format(spec.bits), options
    if codec == "mjpeg":
        return "yuv420p", {"qmin": "2", "qmax": "2"}
    if mbit_s is not None:
        quiet = {"x265-params": "log-level=none"} if codec == "h265" else {}
        return "yuv420p", {"preset": "veryfast", "bf": "0", **quiet}
    if codec == "h265":
        return "yuv420p", {"preset": "ultrafast", "crf": quality, "x265-params": "log-level=none:bframes=0"}
    # players show only 4:2:0, and lossless films in no format
    is_colour = spec.bits == 8 and (spec.width % 2 == 0 and spec.height % 2 == 0) and not lossless
    pixel_format = "yuv420p" if is_colour else planes.gray_format(max(spec.bits, 10) if spec.bits > 8 else 8)
    return pixel_format, {"preset": "ultrafast", "bf": "0", **({"qp": "0"} if lossless else {"crf": quality})}
