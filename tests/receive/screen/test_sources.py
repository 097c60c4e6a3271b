"""Screen reception from picture folders and webcams."""

from collections.abc import Callable
from pathlib import Path

import av
import cv2
import pytest

import heliograph
from heliograph.link.film import write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages
from heliograph.media.live.camera import register_camera
from heliograph.media.live.webcam import Webcam
from heliograph.media.reader import FilmReader

SMALL = (
    "channel.camera.width=480",
    "channel.camera.height=270",
    "channel.camera.pixel_m=1.1e-5",
    "channel.camera.row_time_s=5e-5",
    "channel.distance_m=0.75",
    "channel.duration_s=1.2",
)


class FilterCamera(Webcam):
    """FFmpeg's lavfi device: a filter graph as a real-time webcam."""

    device = "lavfi"


register_camera("screen-drawn", FilterCamera)


@pytest.fixture(scope="module")
def settings() -> LinkSettings:
    return load_settings("phone-60", None, SMALL)


@pytest.fixture(scope="module")
def film(settings: LinkSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "phone.mp4"
    write_film(path, settings, default_messages(settings), 3, mbit_s=8)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["{}.png", "IMG_{:04d}.JPG"])
def test_a_folder_of_pictures(settings: LinkSettings, film: Path, tmp_path: Path, name: str) -> None:
    with heliograph.open_film(film) as frames:
        for frame in frames:
            picture = frame.pixels if "png" in name else cv2.cvtColor(frame.pixels, cv2.COLOR_GRAY2BGR)
            assert cv2.imwrite(str(tmp_path / name.format(frame.index)), picture)
    assert _statuses(settings, lambda: heliograph.open_film(tmp_path, rate_hz=60)) == ["ok"]


@pytest.mark.slow
def test_a_webcam(settings: LinkSettings, film: Path) -> None:
    if "lavfi" not in av.formats_available:
        pytest.skip("this PyAV has no device lavfi")
    address = f"camera:screen-drawn:movie={film},format=gray,realtime"
    assert _statuses(settings, lambda: heliograph.open_film(address)) == ["ok"]


def _statuses(settings: LinkSettings, opened: Callable[[], FilmReader]) -> list[str]:
    with opened() as frames:
        return [one.status for one in heliograph.receive_frames(frames, settings.signal, settings.receive)]
