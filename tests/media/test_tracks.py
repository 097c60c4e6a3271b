"""Ignore cover pictures and previews in films with several video tracks."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from made_videos import MS, write_tracks

from heliograph.base.errors import MediaError
from heliograph.media import open_film

COVER = 0x400
FILM = ("libx264", 64, 20, 0)
SMALL = ("libx264", 32, 20, 0)


@pytest.mark.parametrize(("name", "tracks"), [
    ("cover_first.mp4", [("mjpeg", 96, 1, COVER), FILM]), ("cover_last.mp4", [FILM, ("mjpeg", 96, 1, COVER)]),
    ("large_cover.mkv", [("mjpeg", 640, 1, 0), ("ffv1", 64, 20, 0)]),
    ("picture_track.mp4", [("mjpeg", 640, 1, 0), FILM]), ("preview_first.mp4", [SMALL, FILM]),
    ("preview_first.mkv", [SMALL, FILM]), ("preview_last.ts", [FILM, SMALL]),
    ("preview_first.avi", [("mjpeg", 32, 20, 0), ("mjpeg", 64, 20, 0)]),
    ("preview_first.nut", [("ffv1", 32, 20, 0), ("ffv1", 64, 20, 0)]),
    ("sound_first.mov", [("sound", 0, 20, 0), SMALL, FILM]), ("long_preview.mp4", [("libx264", 32, 60, 0), FILM]),
])  # fmt: skip
def test_the_largest_track_is_read(tmp_path: Path, name: str, tracks: list[tuple[str, int, int, int]]) -> None:
    with open_film(write_tracks(tmp_path / name, *tracks)) as film:
        frames = list(film)
        assert (film.width, film.height, film.rate_hz) == (64, 64, 1000)
    assert len(frames) == 20
    levels = [float(frame.pixels.mean()) for frame in frames]
    assert levels == sorted(levels)


def test_a_picture_attached_to_matroska_is_no_film(tmp_path: Path) -> None:
    cover = cv2.imencode(".png", np.zeros((96, 96), np.uint8))[1].tobytes()
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        container.add_attachment("cover.png", "image/png", cover)
        stream = container.add_stream("ffv1", rate=1000)
        stream.width = stream.height = 64
        stream.pix_fmt, stream.time_base = "gray", MS
        for number in range(5):
            picture = av.VideoFrame.from_ndarray(np.full((64, 64), number, np.uint8), "gray")
            picture.pts, picture.time_base = number, MS
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    with open_film(tmp_path / "a.mkv") as film:
        assert [int(frame.pixels[0, 0]) for frame in film] == [0, 1, 2, 3, 4]


def test_several_films_in_a_file_are_reported_but_no_covers(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with open_film(write_tracks(tmp_path / "a.mp4", ("mjpeg", 96, 1, COVER), FILM)):
        assert not caplog.messages
    path = write_tracks(tmp_path / "b.mp4", SMALL, FILM)
    with open_film(path):
        assert caplog.messages == [f"{path} has 2 video tracks: the largest is read, track 1 of 64x64 pixels"]


def test_a_cover_picture_without_a_film_is_no_film(tmp_path: Path) -> None:
    path = write_tracks(tmp_path / "a.mp4", ("mjpeg", 96, 1, COVER), ("sound", 0, 20, 0))
    with pytest.raises(MediaError, match="holds a cover picture and no film"):
        open_film(path)
