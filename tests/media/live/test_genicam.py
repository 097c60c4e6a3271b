"""GenICam cameras through harvesters, with the test producer from the genicam package."""

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_checks import counts_of

from heliograph.base.errors import HeliographError, MediaError
from heliograph.media import open_film
from heliograph.media.live import genicam
from heliograph.media.live.reader import LiveReader
from heliograph.media.live.settings import CameraSettings, camera_settings

MONO: dict[str, Any] = {"pixel_format": "Mono8", "region": "0,0,128,112", "rate_hz": 100}


@pytest.fixture(scope="module")
def producer() -> str:
    """Return the path of the producer "viky", which simulates bouncing balls."""
    pytest.importorskip("harvesters", reason="GenICam cameras need 'pip install harvesters'")
    file = Path(pytest.importorskip("genicam").__file__).parent / "viky.cti"
    if not file.is_file():
        pytest.skip(f"this release of genicam has no test producer {file.name}")
    return str(file)


def opened(producer: str, address: str = "", **asked: Any) -> LiveReader:
    reader = open_film(f"camera:genicam{address}", camera={"producer": producer, **asked})
    assert isinstance(reader, LiveReader)
    return reader


def test_listed_cameras_are_found_by_their_addresses(producer: str) -> None:
    found = genicam.find(camera_settings({"producer": producer}))
    assert len(found) == 3
    for camera in found:
        with opened(producer, f":{camera.address}", **MONO) as film:
            assert (film.width, film.height, film.bits, film.rate_hz) == (128, 112, 8, 100)
            assert "Viky" in film.form.model


@pytest.mark.slow
def test_frames_are_numbered_without_a_gap(producer: str) -> None:
    frames = []
    with opened(producer, **MONO) as film:
        for frame in film:
            frames.append(frame)
            if len(frames) == 8:
                film.stop()
        counts = counts_of(film)
    assert len(frames) == counts.frames - counts.waiting >= 8
    assert [frame.index for frame in frames] == list(range(frames[-1].index + 1))
    assert all(one.time_s < other.time_s for one, other in itertools.pairwise(frames))
    assert all(frame.pixels.shape == (112, 128) and frame.pixels.dtype == np.uint8 for frame in frames)
    assert len({frame.pixels.tobytes() for frame in frames}) > 1, "the balls do not move: frames share their memory"
    # this producer has no timestamps
    assert counts.host_clock


@pytest.mark.slow
def test_colours_become_gray(producer: str) -> None:
    levels = {}
    for channel in ("luma", "red", "green"):
        with open_film("camera:genicam:VikyTL_DEV_red", channel=channel, camera={"producer": producer}) as film:
            levels[channel] = next(iter(film)).pixels
        assert levels[channel].shape == (400, 400)
    assert not np.array_equal(levels["red"], levels["green"]), "this camera's ball is red"


def test_settings_are_read_back(producer: str) -> None:
    with opened(producer, **MONO, BouncingBallSize="7") as film:
        settings = film.form.settings
    assert (settings["pixel_format"], settings["region"], settings["BouncingBallSize"]) == ("Mono8", "0,0,128,112", "7")
    assert (film.form.departures, film.metadata["camera_rate_hz"]) == ((), "100")


@pytest.mark.parametrize(("asked", "says"), [
    ({"rate_hz": 5000}, "the camera does not take rate_hz=5000: "), ({"rate_hz": 5000}, "(1 to 200 in steps of 1)"),
    ({"region": "0,0,50,128"}, "(100 to 800 in steps of 1)"), ({"region": "8,0,128,128"}, "it has no feature OffsetX"),
    ({"pixel_format": "Mono12"}, "; it knows RGBa8, Mono8"),
    ({"gain": 3}, "the camera does not take gain=3: it has no feature Gain"),
    ({"exposure_us": 3}, "it has no feature ExposureTime"), ({"trigger": "Line1"}, "it has no feature TriggerSource"),
    ({"Nonsense": 3}, "the camera does not take Nonsense=3: it has no feature Nonsense"),
])  # fmt: skip
def test_refused_settings_are_named(producer: str, asked: dict[str, Any], says: str) -> None:
    with pytest.raises(HeliographError, match=re.escape(says)):
        opened(producer, **asked)


def test_a_missing_camera_and_a_damaged_producer_are_named(producer: str, tmp_path: Path) -> None:
    (tmp_path / "broken.cti").write_bytes(b"no library")
    with pytest.raises(MediaError, match="no producer has a camera 'nobody'"):
        opened(producer, ":nobody")
    with pytest.raises(MediaError, match=r"the producer .*broken.cti cannot be loaded"):
        opened(str(tmp_path / "broken.cti"))


def test_producers_are_found_in_the_folders_of_the_standard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(genicam.FOLDERS, raising=False)
    with pytest.raises(MediaError, match="GENICAM_GENTL64_PATH is not set: install the maker's driver, or give"):
        genicam.producers(CameraSettings())
    monkeypatch.setenv(genicam.FOLDERS, str(tmp_path))
    with pytest.raises(MediaError, match="has none: install"):
        genicam.producers(CameraSettings())
    (tmp_path / "a.cti").touch()
    assert genicam.producers(CameraSettings()) == [str(tmp_path / "a.cti")]
    with pytest.raises(MediaError, match=r"there is no producer nothing\.cti"):
        genicam.producers(camera_settings({"producer": "nothing.cti"}))
