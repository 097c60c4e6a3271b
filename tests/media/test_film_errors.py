"""Each failure is reported in a single line and leaves no partial film."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pytest
from film_checks import ends, read, refused, same, starts, write_levels

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import FilmWriter, create_film, open_film, whole
from heliograph.media.record import FilmRecord

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


def test_missing_folder_text_and_empty(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").touch()
    os.mkfifo(tmp_path / "pipe.mkv")
    for number, name in enumerate(("few.h5", "none.h5")):
        with h5py.File(tmp_path / name, "w") as file:
            file["frames"], file["times_s"] = np.zeros((3 - 3 * number, H, W), np.uint8), np.zeros(2 - 2 * number)
    for name, says in {
        "no.mkv": "there is no file", "": "is a folder", "text.mkv": "text.mkv", "text.txt": "text.txt",
        "text.h5": "not a readable HDF5 file", "empty.mp4": "is empty", "pipe.mkv": "is a pipe or a device",
        "/dev/zero": "is a pipe or a device", "few.h5": "'times_s' (2,)", "none.h5": "holds no frames",
    }.items():  # fmt: skip
        if name.startswith("text"):
            (tmp_path / name).write_text("Dear film,\nthis is a letter.\n" * 40)
        assert ends(tmp_path / name, [], says)


@pytest.mark.parametrize(("suffix", "codec", "least"), [
    (".mkv", "ffv1", 10), (".mkv", "h264", 10), (".mkv", "mjpeg", 10),
    (".nut", "ffv1", 10), (".nut", "h264", 10), (".avi", None, 10), (".mp4", None, 0), (".h5", None, 0),
])  # fmt: skip
def test_truncated_film_gives_its_complete_frames(tmp_path: Path, suffix: str, codec: str | None, least: int) -> None:
    path = film_of(tmp_path / f"a{suffix}", codec=codec)
    whole_film = [frame.pixels for frame in read(path)]
    length = path.stat().st_size
    for kept in (0.76, 0.731, 0.7):
        os.truncate(path, int(length * kept))
        frames, message = refused(path)
        assert "ends in the middle" in message
        assert least <= len(frames) < 20
        assert starts(frames, whole_film)
        if frames:
            assert f"after {len(frames)} whole frames" in message


@pytest.mark.parametrize(("suffix", "options", "wrong"), [
    (".mkv", {}, b"\x10"), (".nut", {}, b"\x10"), (".mp4", {"lossless": True}, bytes(3000)),
])  # fmt: skip
def test_damage_is_found_after_frames(tmp_path: Path, suffix: str, options: Any, wrong: bytes) -> None:
    path = film_of(tmp_path / f"a{suffix}", **options)
    raw = bytearray(path.read_bytes())
    half = len(raw) // 2
    raw[half : half + len(wrong)] = wrong if len(wrong) > 1 else bytes([raw[half] ^ wrong[0]])
    path.write_bytes(raw)
    frames, message = refused(path)
    assert f"damaged after {len(frames)} whole frames" in message
    if suffix != ".mp4":
        assert 7 <= len(frames) <= 11
        assert same(frames, [frame(number).pixels for number in range(len(frames))])


def test_every_slice_is_checked(tmp_path: Path) -> None:
    with av.open(str(film_of(tmp_path / "a.mkv", 1))) as container:
        packet = bytearray(bytes(next(container.demux(video=0))))
    assert whole.slices_whole(bytes(packet))
    for place in range(0, len(packet), 97):
        damaged = packet.copy()
        damaged[place] ^= 1
        assert not whole.slices_whole(bytes(damaged))


@pytest.mark.parametrize("length", ["01ffffffffffff00", "00ffffffffffffff00"])
def test_film_with_an_impossible_frame_count_ends_early(tmp_path: Path, length: str) -> None:
    (tmp_path / "a.mkv").write_bytes(bytes.fromhex(f"1a45dfa3{length}") + bytes(9))
    assert "ends in the middle" in refused(tmp_path / "a.mkv")[1]


def test_complete_films_are_recognised(tmp_path: Path) -> None:
    assert [whole.ends_early(film_of(tmp_path / f"a{suffix}")) for suffix in ALL[:-1]] == [False] * 4
    assert whole.ends_early(Path(__file__)) is None


def test_a_film_never_finished(tmp_path: Path) -> None:
    film = create(tmp_path / "a.mkv")
    write_frames(film, 200)
    (left,) = tmp_path.iterdir()
    for name in ("left.mkv", "left.DAT"):
        (tmp_path / name).write_bytes(left.read_bytes())  # as after a power cut
        frames, message = refused(tmp_path / name)
        assert frames
        assert "ends in the middle" in message
    film.abort()


@pytest.mark.parametrize("suffix", ALL)
def test_a_failure_leaves_no_new_film_and_spares_the_old(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(MediaError, match="no frames were written"), create(path):
        pass
    assert not list(tmp_path.iterdir())
    path.write_text("old")
    film = create(path)
    film.write(frame(0))
    with pytest.raises(ZeroDivisionError), film:
        film.write(frame(1 // 0))
    assert ([p.name for p in tmp_path.iterdir()], path.read_text()) == ([path.name], "old")
    with pytest.raises(MediaError, match="already finished or aborted"):
        film.write(frame(1))


@pytest.mark.parametrize("suffix", ALL)
def test_ctrl_c_during_a_write_keeps_the_frames(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: Frame) -> None:
        raise KeyboardInterrupt

    with create(tmp_path / f"a{suffix}") as film:
        write_frames(film, 3)
        monkeypatch.setattr(film._sink, "put", interrupted)
        with pytest.raises(KeyboardInterrupt):
            film.write(frame(3))
        film.finish()
        film.finish()
        film.abort()
    assert (len(list(open_film(film.path))), list(tmp_path.iterdir())) == (3, [film.path])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    partial = tmp_path / "link.nut"
    partial.symlink_to("/dev/full")
    monkeypatch.setattr("heliograph.media.film.partial_path", lambda _: partial)
    says = r"^cannot write .*a\.nut: No space left on device; make room or choose another place$"
    with pytest.raises(MediaError, match=says), create(tmp_path / "a.nut") as film:
        write_frames(film, 200)
    assert not list(tmp_path.iterdir())


FAILED_WRITES = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import create_film
assert not {"av", "h5py", "cv2"} & sys.modules.keys()
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for limit in (100, 5000, 600_001, resource.RLIM_INFINITY):
    try:
        with create_film(sys.argv[1], width=64, height=32, rate_hz=1000) as film:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
            for index in range(600 if limit > 0 else 1):
                film.write(Frame(index, index / 1000, np.ones((32, 64), np.uint8)))
    except MediaError as error:
        print(error)
import h5py
from heliograph.media.hdf5 import PatientFile
disk = PatientFile(Path(sys.argv[1]))  # closed by an interrupt
h5py.File(disk, "w").create_dataset("frames", (10,), "f8")[3] = 1.0
disk.close()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of a file")
@pytest.mark.slow
def test_hdf5_neither_crashes_nor_complains_after_failed_writes(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FAILED_WRITES, str(tmp_path / "a.h5")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert ["File too large; make room" in line for line in done.stdout.splitlines()] == [True] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_wrong_frames(tmp_path: Path) -> None:
    with create(tmp_path / "a.nut") as film, create(tmp_path / "b.nut", bits=10) as fine:
        film.write(frame(1))
        for target, wrong, says in [
            (film, Frame(2, 0.002, np.zeros((H, W + 1), np.uint8)), "film is 64x32 pixels, the frame is 65x32"),
            (film, Frame(2, 0.002, np.zeros((H, W), np.uint16), bits=12), "film has 8 bits, the frame 12"),
            (film, Frame(2, 0.001, np.zeros((H, W), np.uint8)), "follow each other in time"),
            (fine, Frame(0, 0.0, np.full((H, W), 1024, np.uint16), 10), "1024 does not fit into the film's 10 bits"),
            (fine, Frame(0, 0.0, np.zeros((H, W), np.uint16), 12), "has 10 bits, the frame 12"),
        ]:
            with pytest.raises(MediaError, match=says):
                target.write(wrong)
        film.write(frame(2))
        fine.write(Frame(0, 0.0, np.full((H, W), 1023, np.uint16), 10))
    assert [f.index for f in open_film(tmp_path / "a.nut")] == [1, 2]


@pytest.mark.parametrize(("name", "times", "says"), [
    ("a.mkv", [0.0, 0.0001], "same 0.001 s tick of .mkv"), ("a.nut", [0.0, 1e-7], "same 1e-06 s tick of .nut"),
    ("a.avi", [0.0, 0.0014], "whole frame periods only"),
])  # fmt: skip
def test_times_a_container_cannot_hold(tmp_path: Path, name: str, times: list[float], says: str) -> None:
    film = create(tmp_path / name)
    film.write(Frame(0, times[0], np.zeros((H, W), np.uint8)))
    with pytest.raises(MediaError, match=says), film:
        film.write(Frame(1, times[1], np.zeros((H, W), np.uint8)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "options", "says"), [
    ("a.mpg", {}, r"must end in one of \.mkv, \.nut, \.mp4, \.avi, \.h5"), ("a", {}, "must end in one of"),
    ("no/a.mkv", {}, "folder .*no does not exist"),
    ("a.mkv", {"rate_hz": 2000.0}, r"too coarse for 2000 frames/s: use \.nut, \.mp4 or \.h5"),
    ("a.mkv", {"rate_hz": 0.0}, r"rate_hz of a film is a number, got .*: give 1e-06 to 1e\+06"),
    ("a.mkv", {"rate_hz": float("nan")}, r"rate_hz of a film is a number, got .*: give 1e-06 to 1e\+06"),
    ("a.mkv", {"bits": 7}, "bits of a film is a whole number, got 7: give 8 to 16"),
    ("a.mkv", {"width": 0}, "width of a film is a whole number, got 0: give 1 to"),
    ("a.mkv", {"metadata": {"n": 1}}, "maps text to text"), ("a.mp4", {"bits": 12}, "h264 holds at most 10 bits"),
    ("a.avi", {"bits": 12}, "mjpeg holds at most 8 bits"),
    ("a.mp4", {"codec": "ffv1"}, r"'ffv1' does not go into \.mp4: choose one of h264"),
    ("a.mkv", {"crf": 20.0}, "crf is a setting of h264"), ("a.mp4", {"crf": 60.0}, "crf lies between 0 "),
    ("a.mp4", {"crf": 20.0, "lossless": True}, "one of mbit_s, crf and lossless"),
    ("a.avi", {"lossless": True}, "cannot be lossless"), ("a.h5", {"codec": "ffv1"}, "not coded"),
    ("folder.mkv", {}, "is a folder"),
])  # fmt: skip
def test_wrong_settings_are_named(tmp_path: Path, name: str, options: dict[str, object], says: str) -> None:
    (tmp_path / "folder.mkv").mkdir()
    with pytest.raises(MediaError, match=says):
        create(tmp_path / name, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.mkv"]


def test_a_closed_film(tmp_path: Path) -> None:
    with open_film(film_of(tmp_path / "a.nut")) as film:
        frames = iter(film)
        next(frames)
    assert not list(frames)
    with pytest.raises(MediaError, match="is closed"):
        next(iter(film))


def test_failed_finish_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "replace", denied)
    with pytest.raises(MediaError, match="Permission denied; ask for the right to write there"):
        film_of(tmp_path / "a.mkv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rate_hz", [0.0, -25.0, 1e300, float("inf"), float("nan")])
def test_a_rate_that_no_camera_has_is_refused(rate_hz: float, tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"1e-06 to 1e\+06 frames/s"):
        open_film(tmp_path / "a.mkv", rate_hz=rate_hz)


def test_a_folder_without_rights_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "exists", refused)
    with pytest.raises(MediaError, match=r"cannot read .*shut/film\.mkv: Permission denied"):
        open_film(tmp_path / "shut" / "film.mkv")


@pytest.mark.parametrize("wrong", [
    {"rate_hz": 0}, {"rate_hz": 1e300}, {"rate_hz": "NaN"}, {"bits": 99}, {"bits": 1e999}, {"start_s": 1e300},
], ids=str)  # fmt: skip
def test_an_impossible_record_is_ignored(wrong: dict[str, Any]) -> None:
    good: dict[str, Any] = {"rate_hz": 1000.0, "bits": 8, "start_s": 0.0, "metadata": {}}
    assert FilmRecord.loads(FilmRecord(**good).dumps()) == FilmRecord(**good)
    assert FilmRecord.loads(json.dumps(good | wrong)) is None
    assert FilmRecord.loads('{"a":' * 20_000 + "1" + "}" * 20_000) is None


def test_a_film_of_other_bits_than_its_record_is_refused(tmp_path: Path) -> None:
    path = write_levels(tmp_path / "a.mkv", np.zeros((1, 16, 16), np.uint8))
    held = path.read_bytes()
    assert b'"bits": 8' in held
    path.write_bytes(held.replace(b'"bits": 8,', b'"bits":12,'))
    assert "has 16x16 pixels of 8 bits after 0 whole frames, the film 16x16 of 12" in refused(path)[1]
