"""Write videos as other software does: arbitrary timestamps, several tracks, palettes."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from numpy.typing import NDArray

MS = Fraction(1, 1000)
PIXEL_FORMATS = {"ffv1": "gray", "mjpeg": "yuvj420p"}


def brightness(number: int) -> int:
    """Return a gray level that rises per frame by more than codec errors."""
    return 20 + number % 60 * 3


def write_video(
    path: Path,
    stamps: Sequence[int],
    tick: Fraction = MS,
    codec: str = "libx264",
    rate: float | Fraction = 1000,
    options: dict[str, str] | None = None,
    kind: str | None = None,
) -> Path:
    """Write a 32x32 px video with arbitrary timestamps in ticks and an arbitrary claimed rate."""
    with av.open(str(path), "w", format=kind) as container:
        stream = cast("av.VideoStream", container.add_stream(codec, rate=Fraction(rate), options=options or {}))
        stream.width = stream.height = 32
        stream.pix_fmt = PIXEL_FORMATS.get(codec, "yuv420p")
        stream.time_base = stream.codec_context.time_base = tick
        for number, stamp in enumerate(stamps):
            picture = _picture(number, 32, stream.pix_fmt)
            picture.pts, picture.time_base = stamp, tick
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def write_tracks(path: Path, *tracks: tuple[str, int, int, int]) -> Path:
    """Write tracks given as codec ("sound" is not video), side in px, frames, disposition."""
    with av.open(str(path), "w") as container:
        streams: list[Any] = []
        for codec, side, _, disposition in tracks:
            stream: Any = container.add_stream("pcm_s16le" if codec == "sound" else codec, rate=1000)
            if codec != "sound":
                stream.width = stream.height = side
                stream.pix_fmt = PIXEL_FORMATS.get(codec, "yuv420p")
                stream.time_base = stream.codec_context.time_base = MS
            stream.disposition = disposition
            streams.append(stream)
        for number in range(max(frames for _, _, frames, _ in tracks)):
            for stream, (codec, side, frames, _) in zip(streams, tracks, strict=True):
                if number < frames and codec == "sound":
                    sound = av.AudioFrame.from_ndarray(np.zeros((1, 2), np.int16), "s16", "mono")
                    sound.sample_rate, sound.pts = 1000, 2 * number
                    container.mux(stream.encode(sound))
                elif number < frames:
                    picture = _picture(number, side, stream.pix_fmt)
                    picture.pts, picture.time_base = number, MS
                    container.mux(stream.encode(picture))
        for stream in streams:
            container.mux(stream.encode())
    return path


def write_avi(
    path: Path,
    frames: NDArray[np.uint8] | NDArray[np.uint16],
    palette: NDArray[np.uint8] | None = None,
    fourcc: bytes = bytes(4),
    upwards: bool = False,
) -> Path:
    """Write an uncompressed AVI with gray levels, or with indices into a palette (256 blue, green and red)."""
    count, rows, columns = frames.shape
    bits, line = 8 * frames.itemsize, (columns * frames.itemsize + 3) // 4 * 4
    colours = b"" if palette is None else np.pad(palette, ((0, 0), (0, 1))).astype(np.uint8).tobytes()
    form = struct.pack("<IiiHH4sIiiII", 40, columns, rows if upwards else -rows, 1, bits, fourcc, line * rows, 0, 0,
                       len(colours) // 4, 0)  # fmt: skip
    main = struct.pack("<14I", 1000, 0, 0, 0x10, count, 0, 1, line * rows, columns, rows, 0, 0, 0, 0)
    stream = struct.pack("<4s4s10I4h", b"vids", b"DIB ", 0, 0, 0, 1, 1000, 0, count, line * rows, 0, 0, 0, 0,
                         columns, rows)  # fmt: skip
    lines = [np.ascontiguousarray(frame[:: -1 if upwards else 1]).view(np.uint8) for frame in frames]
    pictures = [_chunk(b"00db", np.pad(one, ((0, 0), (0, line - one.shape[1]))).tobytes()) for one in lines]
    heads = _chunk(b"avih", main) + _list(b"strl", _chunk(b"strh", stream) + _chunk(b"strf", form + colours))
    path.write_bytes(_chunk(b"RIFF", b"AVI " + _list(b"hdrl", heads) + _list(b"movi", b"".join(pictures))))
    return path


def _picture(number: int, side: int, pixel_format: str) -> av.VideoFrame:
    levels = np.full((side, side), brightness(number), np.uint8)
    if pixel_format == "gray":
        return av.VideoFrame.from_ndarray(levels, "gray")
    return av.VideoFrame.from_ndarray(np.vstack([levels, np.full((side // 2, side), 128, np.uint8)]), pixel_format)


def _chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)


def _list(name: bytes, content: bytes) -> bytes:
    return _chunk(b"LIST", name + content)
