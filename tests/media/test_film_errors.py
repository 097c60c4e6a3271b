"""Each failure is reported in a single line and leaves no partial film."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import av
import h5py
import numpy as np
import pytest

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import FilmWriter, create_film, open_film, planes, whole

W, H = 64, 32
ALL = [".nut", ".mkv", ".mp4", ".avi", ".h5"]


def frame(index: int, seed: int = 0) -> Frame:
    pixels = np.random.default_rng((seed, index)).integers(0, 256, (H, W), dtype=np.uint8)
    return Frame(index, index / 1000, pixels)


def create(path: Path, **options: object) -> FilmWriter:
    return create_film(path, **{"width": W, "height": H, "rate_hz": 1000.0, **options})  # type: ignore[arg-type]


def film_of(path: Path, count: int = 20, **options: object) -> Path:
    with create(path, **options) as film:
        write_frames(film, count)
    return path


def write_frames(film: FilmWriter, count: int) -> None:
    for index in range(count):
        film.write(frame(index))


def write_at(film: FilmWriter, times: list[float]) -> None:
    for time_s in times:
        film.write(Frame(0, time_s, np.zeros((H, W), np.uint8)))


def read_until_error(path: Path) -> tuple[list[Frame], str]:
    frames: list[Frame] = []
    with pytest.raises(MediaError) as caught, open_film(path) as film:
        frames.extend(film)  # keeps frames before the error
    assert "\n" not in str(caught.value)
    return frames, str(caught.value)


def test_missing_folder_text_and_empty(tmp_path: Path) -> None:
    (tmp_path / "text.mkv").write_text("Dear film,\nthis is a letter.\n" * 40)
    (tmp_path / "text.txt").write_text("Dear film,\nthis is a letter.\n" * 40)
    (tmp_path / "text.h5").write_text("Dear film,\nthis is a letter.\n" * 40)
    (tmp_path / "empty.mp4").touch()
    for name, says in {
        "no.mkv": "there is no file",
        "": "is a folder",
        "text.mkv": "text.mkv",
        "text.txt": "text.txt",
        "text.h5": "not a readable HDF5 file",
        "empty.mp4": "is empty",
    }.items():
        frames, message = read_until_error(tmp_path / name)
        assert not frames
        assert says in message


@pytest.mark.parametrize(("suffix", "codec", "least"), [
    (".mkv", "ffv1", 10), (".mkv", "h264", 10), (".mkv", "mjpeg", 10),
    (".nut", "ffv1", 10), (".nut", "h264", 10), (".avi", None, 10), (".mp4", None, 0), (".h5", None, 0),
])  # fmt: skip
@pytest.mark.parametrize("kept", [0.7, 0.731, 0.76])
def test_a_cut_film_gives_its_whole_frames_first(
    tmp_path: Path, suffix: str, codec: str | None, least: int, kept: float
) -> None:
    path = film_of(tmp_path / f"a{suffix}", codec=codec)
    whole_film = [f.pixels for f in open_film(path)]
    os.truncate(path, int(path.stat().st_size * kept))
    frames, message = read_until_error(path)
    assert "ends in the middle" in message
    assert least <= len(frames) < 20
    assert all(np.array_equal(f.pixels, p) for f, p in zip(frames, whole_film, strict=False))
    if frames:
        assert f"after {len(frames)} whole frames" in message


@pytest.mark.parametrize(("suffix", "codec"), [(".mkv", "ffv1"), (".nut", "ffv1")])
def test_a_damaged_picture_is_found_by_its_checksum(tmp_path: Path, suffix: str, codec: str) -> None:
    path = film_of(tmp_path / f"a{suffix}", codec=codec)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0x10
    path.write_bytes(raw)
    frames, message = read_until_error(path)
    assert f"damaged after {len(frames)} whole frames" in message
    assert 7 <= len(frames) <= 11
    assert all(np.array_equal(f.pixels, frame(n).pixels) for n, f in enumerate(frames))


def test_invalid_packets_of_a_lossy_codec(tmp_path: Path) -> None:
    path = film_of(tmp_path / "a.mp4", lossless=True)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2 : len(raw) // 2 + 3000] = bytes(3000)
    path.write_bytes(raw)
    frames, message = read_until_error(path)
    assert f"damaged after {len(frames)} whole frames" in message


def test_every_slice_is_checked(tmp_path: Path) -> None:
    with av.open(str(film_of(tmp_path / "a.mkv", 1))) as container:
        packet = bytearray(bytes(next(container.demux(video=0))))
    assert whole.slices_whole(bytes(packet))
    for place in range(0, len(packet), 97):
        damaged = packet.copy()
        damaged[place] ^= 1
        assert not whole.slices_whole(bytes(damaged))


@pytest.mark.parametrize("length", ["01ffffffffffff00", "00ffffffffffffff00"])
def test_a_film_whose_head_claims_more_than_any_file_has_ends_early(tmp_path: Path, length: str) -> None:
    path = tmp_path / "a.mkv"
    path.write_bytes(bytes.fromhex(f"1a45dfa3{length}") + bytes(9))
    assert whole.ends_early(path)
    with pytest.raises(MediaError, match="ends in the middle"):
        open_film(path)


def test_whole_films_are_known_as_whole(tmp_path: Path) -> None:
    assert [whole.ends_early(film_of(tmp_path / f"a{suffix}")) for suffix in ALL[:-1]] == [False] * 4
    assert whole.ends_early(Path(__file__)) is None


def test_a_film_never_finished(tmp_path: Path) -> None:
    film = create(tmp_path / "a.mkv")
    write_frames(film, 400)
    (left,) = tmp_path.iterdir()
    (tmp_path / "left.mkv").write_bytes(left.read_bytes())  # as after a power cut
    film.abort()
    frames, message = read_until_error(tmp_path / "left.mkv")
    assert "ends in the middle" in message
    assert frames


def fail_after_a_frame(film: FilmWriter) -> None:
    film.write(frame(0))
    raise ZeroDivisionError


@pytest.mark.parametrize("suffix", ALL)
def test_an_exception_leaves_nothing_and_spares_the_old_film(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text("old")
    film = create(path)
    with pytest.raises(ZeroDivisionError), film:
        fail_after_a_frame(film)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "old"
    with pytest.raises(MediaError, match="already finished or aborted"):
        film.write(frame(1))


@pytest.mark.parametrize("suffix", ALL)
def test_what_is_there_can_be_kept_after_ctrl_c(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with create(path) as film:
        try:
            film.write(frame(0))
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            film.finish()
        film.finish()
        film.abort()
    assert len(list(open_film(path))) == 1
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", ALL)
def test_ctrl_c_while_waiting_for_the_encoder(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: Frame) -> None:
        raise KeyboardInterrupt

    film = create(tmp_path / f"a{suffix}")
    write_frames(film, 3)
    monkeypatch.setattr(film._sink, "put", interrupted)
    with pytest.raises(KeyboardInterrupt):
        film.write(frame(3))
    film.finish()
    assert len(list(open_film(film.path))) == 3


@pytest.mark.parametrize("suffix", ALL)
def test_zero_frames(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(MediaError, match="no frames were written"), create(tmp_path / f"a{suffix}"):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mkv", ".h5"])
def test_disk_full(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    film = create(tmp_path / f"a{suffix}")
    if suffix == ".mkv":
        monkeypatch.setattr(planes, "to_video", full)
    else:
        film._sink._disk.error = OSError(errno.ENOSPC, "")  # type: ignore[attr-defined]
    with pytest.raises(MediaError, match=f"^disk full while writing .*a{suffix}: free some space"), film:
        write_frames(film, 50)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_disk_full_for_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    partial = tmp_path / "link.nut"
    partial.symlink_to("/dev/full")
    monkeypatch.setattr("heliograph.media.film.partial_path", lambda _: partial)
    with pytest.raises(MediaError, match="disk full"), create(tmp_path / "a.nut") as film:
        write_frames(film, 200)
    assert not list(tmp_path.iterdir())


HDF5_AT_A_LIMIT = """
import resource, signal, sys, numpy as np
from heliograph.base.frames import Frame
from heliograph.media import create_film
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with create_film(sys.argv[1], width=64, height=32, rate_hz=1000) as film:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
    for index in range(600):
        film.write(Frame(index, index / 1000, np.ones((32, 64), np.uint8)))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of a file")
@pytest.mark.parametrize("limit", [100, 5000, 600_001])
@pytest.mark.slow
def test_hdf5_survives_a_failed_write(tmp_path: Path, limit: int) -> None:
    command = [sys.executable, "-c", HDF5_AT_A_LIMIT, str(tmp_path / "a.h5"), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr  # not a crash of the HDF5 library
    assert done.stderr.splitlines()[-1].endswith("File too large")
    assert not list(tmp_path.iterdir())


def test_wrong_frames(tmp_path: Path) -> None:
    with create(tmp_path / "a.nut") as film:
        film.write(frame(1))
        for wrong, says in [
            (Frame(2, 0.002, np.zeros((H, W + 1), np.uint8)), "film is 64x32 pixels, the frame is 65x32"),
            (Frame(2, 0.002, np.zeros((H, W), np.uint16), bits=12), "takes uint8 pixels, got uint16"),
            (Frame(2, 0.001, np.zeros((H, W), np.uint8)), "follow each other in time"),
        ]:
            with pytest.raises(MediaError, match=says):
                film.write(wrong)
        film.write(frame(2))
    assert [f.index for f in open_film(tmp_path / "a.nut")] == [1, 2]
    with create(tmp_path / "b.nut", bits=10) as film:
        with pytest.raises(MediaError, match="1024 does not fit into the film's 10 bits"):
            film.write(Frame(0, 0.0, np.full((H, W), 1024, np.uint16), 10))
        with pytest.raises(MediaError, match="has 10 bits, the frame 12"):
            film.write(Frame(0, 0.0, np.zeros((H, W), np.uint16), 12))
        film.write(Frame(0, 0.0, np.full((H, W), 1023, np.uint16), 10))


@pytest.mark.parametrize(("name", "times", "says"), [
    ("a.mkv", [0.0, 0.0001], "same 0.001 s tick of .mkv"),
    ("a.nut", [0.0, 1e-7], "same 1e-06 s tick of .nut"),
    ("a.avi", [0.0, 0.0014], "whole frame periods only"),
])  # fmt: skip
def test_times_a_container_cannot_hold(tmp_path: Path, name: str, times: list[float], says: str) -> None:
    with pytest.raises(MediaError, match=says), create(tmp_path / name) as film:
        write_at(film, times)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "options", "says"), [
    ("a.mpg", {}, r"must end in one of \.mkv, \.nut, \.mp4, \.avi, \.h5"),
    ("a", {}, "must end in one of"),
    ("no/a.mkv", {}, "folder .*no does not exist"),
    ("a.mkv", {"rate_hz": 2000.0}, r"too coarse for 2000 frames/s: use \.nut, \.mp4 or \.h5"),
    ("a.mkv", {"rate_hz": 0.0}, "rate_hz must lie above 0"),
    ("a.mkv", {"rate_hz": float("nan")}, "rate_hz must lie above 0"),
    ("a.mkv", {"bits": 7}, "8 to 16 bits"),
    ("a.mkv", {"width": 0}, "at least 1x1"),
    ("a.mkv", {"metadata": {"n": 1}}, "maps text to text"),
    ("a.mp4", {"bits": 12}, "h264 holds at most 10 bits"),
    ("a.avi", {"bits": 12}, "mjpeg holds at most 8 bits"),
    ("a.mp4", {"codec": "ffv1"}, r"'ffv1' does not go into \.mp4: choose one of h264"),
    ("a.mkv", {"crf": 20.0}, "crf is a setting of h264"),
    ("a.mp4", {"crf": 60.0}, "between 0"),
    ("a.mp4", {"crf": 20.0, "lossless": True}, "not both"),
    ("a.avi", {"lossless": True}, "cannot be lossless"),
    ("a.h5", {"codec": "ffv1"}, "not coded"),
])  # fmt: skip
def test_wrong_settings(tmp_path: Path, name: str, options: dict[str, object], says: str) -> None:
    with pytest.raises(MediaError, match=says):
        create(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_the_target_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "a.mkv").mkdir()
    with pytest.raises(MediaError, match="is a folder"):
        create(tmp_path / "a.mkv")


def test_other_hdf5_files(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["voltage"] = np.zeros(3)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["frames"], file["times_s"] = np.zeros((3, H, W), np.uint8), np.zeros(2)
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["frames"], file["times_s"] = np.zeros((0, H, W), np.uint8), np.zeros(0)
    assert "expected the datasets 'frames'" in read_until_error(tmp_path / "a.h5")[1]
    assert "'times_s' (2,)" in read_until_error(tmp_path / "b.h5")[1]
    assert "holds no frames" in read_until_error(tmp_path / "c.h5")[1]


def test_a_closed_film(tmp_path: Path) -> None:
    with open_film(film_of(tmp_path / "a.nut")) as film:
        frames = iter(film)
        next(frames)
    assert not list(frames)
    with pytest.raises(MediaError, match="is closed"):
        next(iter(film))


def test_a_failing_finish_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "replace", denied)
    with pytest.raises(MediaError, match="not allowed to write"):
        film_of(tmp_path / "a.mkv")
    assert not list(tmp_path.iterdir())


def test_numbers_jump_where_frames_are_missing_though_no_rate_is_noted(tmp_path: Path) -> None:
    times = np.delete(np.arange(200) * 1e-3, [40, 41, 90, 150])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"], file["times_s"] = np.zeros((196, 4, 4), np.uint8), times
    with open_film(tmp_path / "a.h5") as film:
        assert film.rate_hz == pytest.approx(1000)
        assert [frame.index for frame in film] == [round(1000 * time) for time in times]


@pytest.mark.parametrize("name", ["slow.mp4", "slow.mkv", "slow.h5", "slow.avi"])
def test_the_camera_s_own_rate_replaces_that_of_a_file_in_slow_motion(name: str, tmp_path: Path) -> None:
    with create_film(tmp_path / name, width=16, height=16, rate_hz=25) as film:
        for k in (0, 1, 2, 4, 5):
            film.write(Frame(k, k / 25, np.full((16, 16), 20 * k, np.uint8)))
    with open_film(tmp_path / name, rate_hz=1000) as film:
        frames = list(film)
        assert (film.rate_hz, film.claimed_hz) == (1000, 25)
    numbers = [0, 1, 2, 4, 5] if name != "slow.avi" else [frame.index for frame in frames]
    assert [frame.index for frame in frames] == numbers
    assert [frame.time_s for frame in frames] == pytest.approx([k * 1e-3 for k in numbers], abs=1e-6)


@pytest.mark.parametrize("rate_hz", [0.0, -25.0, 1e300, float("inf"), float("nan")])
def test_a_rate_that_no_camera_has_is_refused(rate_hz: float, tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"1e-06 to 1e\+06 frames/s"):
        open_film(tmp_path / "a.mkv", rate_hz=rate_hz)


def test_a_folder_without_rights_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "exists", refused)
    with pytest.raises(MediaError, match=r"cannot read .*shut/film\.mkv: Permission denied"):
        open_film(tmp_path / "shut" / "film.mkv")
