"""Webcams through PyAV, replaced by FFmpeg's synthetic "lavfi" device."""

import re
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from film_checks import counts_of
from waiting import HANG_S

from heliograph.base.errors import HeliographError, MediaError
from heliograph.media import open_film
from heliograph.media.live import webcam
from heliograph.media.live.camera import register_camera
from heliograph.media.live.reader import LiveReader
from heliograph.media.live.settings import CameraSettings, camera_settings
from heliograph.media.live.webcam import Webcam


class Drawn(Webcam):
    """FFmpeg "lavfi" filter chain that delivers pictures in real time."""

    device = "lavfi"


RAMP = "nullsrc=size=64x48:rate={rate},geq=lum='mod(4*N,256)':cb=128:cr=128,format=gray{end}"
"""Picture k has level 4 k (modulo 256)."""


@pytest.fixture(scope="module", autouse=True)
def lavfi() -> None:
    if "lavfi" not in av.formats_available:
        pytest.skip("this PyAV has no device lavfi")
    register_camera("drawn", Drawn)


def drawn(rate: int, end: str = "", **asked: Any) -> LiveReader:
    reader = open_film(f"camera:drawn:{RAMP.format(rate=rate, end=end)}", camera=asked)
    assert isinstance(reader, LiveReader)
    return reader


def test_a_webcam_has_form_levels_and_stamps() -> None:
    with drawn(50, ",trim=end_frame=60") as film:
        assert (film.width, film.height, film.bits, film.rate_hz) == (64, 48, 8, 50)
        frames = list(film)
        counts = counts_of(film)
    assert [frame.index for frame in frames] == list(range(60))
    assert [frame.time_s for frame in frames] == pytest.approx([k / 50 for k in range(60)])
    assert all(np.all(frame.pixels == 4 * frame.index % 256) for frame in frames)
    assert not counts.host_clock


def test_lost_pictures_show_in_the_stamps() -> None:
    with drawn(50, ",select='not(between(n\\,20\\,22))',trim=end_frame=40") as film:
        assert [frame.index for frame in film] == [*range(20), *range(23, 43)]
        counts = counts_of(film)
    assert (counts.lost, counts.skipped) == (0, 3)


@pytest.mark.slow
def test_a_webcam_waits_no_longer_than_requested() -> None:
    camera = Drawn(RAMP.format(rate=0.25, end=",realtime=limit=60"))
    camera.open(CameraSettings())
    assert camera.frames(HANG_S)
    asked = time.monotonic()
    assert camera.frames(0.05) == []
    assert time.monotonic() - asked < 3  # the second picture arrives after 4 s
    camera.close()


@pytest.mark.parametrize(("asked", "says"), [
    ({"exposure_us": 500}, "'v4l2-ctl -d /dev/video7 -c auto_exposure=1,exposure_time_absolute=...'"),
    ({"gain": 3}, "'v4l2-ctl -d /dev/video7 -c gain=...'"),
    ({"trigger": "Line1"}, "a webcam has no trigger and no features"),
    ({"Brightness": 3}, "a webcam has no trigger and no features"),
    ({"region": "8,0,64,48"}, "region 8,0,64,48: a webcam's begins at 0,0; use --crop for a part"),
    ({}, "/dev/video7 cannot be opened as a webcam (No such file or directory)"),
])  # fmt: skip
def test_refused_settings_are_named(asked: dict[str, Any], says: str) -> None:
    with pytest.raises(HeliographError, match=re.escape(says)):
        open_film("camera:webcam:/dev/video7", camera=asked)


def test_settings_become_options_of_ffmpeg() -> None:
    camera = Webcam("")
    options = camera._options(camera_settings({"region": "0,0,640,480", "rate_hz": 60, "pixel_format": "gray"}))
    assert options == {"video_size": "640x480", "framerate": "60", "input_format": "gray"}


def test_devices_are_listed_with_their_names(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match="Linux knows of none"):
        webcam.find(CameraSettings(), tmp_path)
    for number, index, name in ((10, 0, "Second"), (2, 0, "First"), (3, 1, "First, without pictures")):
        (tmp_path / f"video{number}").mkdir()
        (tmp_path / f"video{number}/name").write_text(f"{name}\n")
        (tmp_path / f"video{number}/index").write_text(f"{index}\n")
    found = [(one.address, one.text) for one in webcam.find(CameraSettings(), tmp_path)]
    assert found == [("/dev/video2", "First"), ("/dev/video10", "Second")]


def test_a_stamp_is_the_drivers() -> None:
    picture = av.VideoFrame.from_ndarray(np.zeros((4, 4), np.uint8), "gray")
    picture.pts, picture.time_base = 1_234_567, Fraction(1, 1_000_000)
    assert Webcam("")._convert(picture).stamp_ns == 1_234_567_000
