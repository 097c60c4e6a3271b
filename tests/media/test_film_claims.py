"""Impossible claims of films raise a clear error; timestamps in decoding order are corrected."""

import json
import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from film_checks import read, refused

from heliograph.base.frames import Frame
from heliograph.media import create_film
from heliograph.media.record import FilmRecord


@pytest.mark.parametrize("wrong", [
    {"rate_hz": 0}, {"rate_hz": 1e300}, {"rate_hz": "NaN"}, {"bits": 99}, {"bits": 1e999}, {"start_s": 1e300},
], ids=str)  # fmt: skip
def test_an_impossible_record_is_ignored(wrong: dict[str, Any]) -> None:
    good: dict[str, Any] = {"rate_hz": 1000.0, "bits": 8, "start_s": 0.0, "metadata": {}}
    assert FilmRecord.loads(FilmRecord(**good).dumps()) == FilmRecord(**good)
    assert FilmRecord.loads(json.dumps(good | wrong)) is None
    assert FilmRecord.loads('{"a":' * 20_000 + "1" + "}" * 20_000) is None


def test_a_pipe_is_no_film(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mkv")
    assert "is a pipe or a device" in refused(tmp_path / "a.mkv")[1]
    assert "is a pipe or a device" in refused(Path("/dev/zero"))[1]


def test_a_film_of_other_bits_than_its_record_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with create_film(path, width=16, height=16, rate_hz=1000) as film:
        film.write(Frame(0, 0.0, np.zeros((16, 16), np.uint8)))
    held = path.read_bytes()
    assert b'"bits": 8' in held
    path.write_bytes(held.replace(b'"bits": 8,', b'"bits":12,'))
    assert "has 16x16 pixels of 8 bits after 0 whole frames, the film 16x16 of 12" in refused(path)[1]


STEP = 6
"""Gray level increment per picture."""


def coded(path: Path, codec: str, options: dict[str, str]) -> Path:
    """Write a film with rising gray levels and B-frames, stamped in decoding order."""
    tick = Fraction(1, 1000)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=1000, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 32, "yuv420p"
        stream.time_base = stream.codec_context.time_base = tick
        packets = []
        for k in range(40):
            planes = np.vstack([np.full((32, 64), STEP * k, np.uint8), np.full((16, 64), 128, np.uint8)])
            picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            picture.pts, picture.time_base = k, tick
            packets += stream.encode(picture)
        for k, packet in enumerate([*packets, *stream.encode()]):
            packet.pts = packet.dts = k
            container.mux(packet)
    return path


@pytest.mark.parametrize(("name", "codec", "options"), [
    ("a.avi", "mpeg4", {"bf": "2"}), ("a.mkv", "libx265", {"x265-params": "bframes=4:log-level=none"}),
    ("a.mp4", "libx264", {"bf": "3"}), ("a.nut", "libx264", {"bf": "3"}),
])  # fmt: skip
def test_stamps_in_coding_order_are_sorted(tmp_path: Path, name: str, codec: str, options: dict[str, str]) -> None:
    if codec not in av.codecs_available:
        pytest.skip(f"FFmpeg lacks {codec} here")
    frames = read(coded(tmp_path / name, codec, options))
    assert np.diff([frame.time_s for frame in frames]) == pytest.approx(1e-3)
    levels = [int(frame.pixels.mean()) for frame in frames]
    assert len(levels) == 40
    assert levels == sorted(levels)
