"""HDF5 films are identified by content; errors name the cause."""

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import create_film, open_film

COUNT = 5
LEVELS = np.random.default_rng(0).integers(0, 256, (COUNT, 6, 8), dtype=np.uint8)
TIMES = np.arange(COUNT) / 1000


def hdf5(path: Path, levels: NDArray[Any] = LEVELS, times: Any = TIMES, **options: Any) -> Path:
    with h5py.File(path, "w", **options) as file:
        file["frames"], file["times_s"] = levels, times
    return path


def refused(path: Path) -> str:
    with pytest.raises(MediaError) as caught, open_film(path) as film:
        list(film)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def read(path: Path) -> NDArray[Any]:
    with open_film(path) as film:
        assert film.rate_hz == pytest.approx(1000)
        frames = list(film)
    assert [frame.time_s for frame in frames] == pytest.approx(TIMES[: len(frames)])
    return np.array([frame.pixels for frame in frames])


@pytest.mark.parametrize("block", [0, 512, 1024, 2048, 4096])
@pytest.mark.parametrize("name", ["a.h5", "a.mat", "a.dat", "a.mkv", "a.png", "a.TIF", "a", "a.H5"])
def test_hdf5_is_known_by_its_content(tmp_path: Path, name: str, block: int) -> None:
    assert np.array_equal(read(hdf5(tmp_path / name, userblock_size=block)), LEVELS)


@pytest.mark.parametrize("name", ["a.h5", "a.tif", "a.npy", "a.cine", "a.jpg", "a.dat", "a", "a.AVI"])
@pytest.mark.parametrize("suffix", [".mkv", ".mp4", ".nut", ".avi"])
def test_videos_are_known_by_their_content(tmp_path: Path, name: str, suffix: str) -> None:
    with create_film(tmp_path / f"b{suffix}", width=8, height=6, rate_hz=1000) as film:
        for number, pixels in enumerate(LEVELS):
            film.write(Frame(number, number / 1000, pixels))
    assert len(read((tmp_path / f"b{suffix}").rename(tmp_path / name))) == COUNT


@pytest.mark.parametrize("name", ["a.mkv", "a.NUT", "a.dat"])
def test_a_film_of_another_name_that_was_never_finished_ends_in_the_middle(tmp_path: Path, name: str) -> None:
    film = create_film(tmp_path / "a.mkv", width=64, height=32, rate_hz=1000)
    for number in range(400):
        film.write(Frame(number, number / 1000, np.random.default_rng(number).integers(0, 256, (32, 64), np.uint8)))
    (left,) = tmp_path.iterdir()
    (tmp_path / "left").mkdir()
    target = tmp_path / "left" / name
    target.write_bytes(left.read_bytes())
    film.abort()
    assert "ends in the middle" in refused(target)


@pytest.mark.parametrize(
    ("head", "says"),
    [
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "is of MATLAB before 7.3: save it there with '-v7.3'"),
        (b"PK\x03\x04 archive", "is an archive"),
        (b"\x1f\x8b\x08 packed", "is compressed by gzip: unpack it first"),
    ],
)
def test_files_of_other_kinds_are_named(tmp_path: Path, head: bytes, says: str) -> None:
    for name in ("a.mat", "a.h5", "a.mkv"):
        (tmp_path / name).write_bytes(head + bytes(600))
        assert says in refused(tmp_path / name)


def matlab(path: Path, levels: NDArray[Any], times: NDArray[Any]) -> Path:
    """Write a file as MATLAB does: reversed axes, at least two dimensions."""
    hdf5(path, np.transpose(levels), np.transpose(times), userblock_size=512)
    with h5py.File(path, "a") as file:
        file["frames"].attrs["MATLAB_class"] = np.bytes_("uint8")
        file["times_s"].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan 01 2024".ljust(124) + b"\0\2IM")
    return path


@pytest.mark.parametrize("times", [TIMES[:, None], TIMES[None]], ids=["column", "row"])
def test_frames_of_matlab_are_upright(tmp_path: Path, times: NDArray[Any]) -> None:
    path = matlab(tmp_path / "a.mat", np.moveaxis(LEVELS, 0, 2), times)
    with open_film(path) as film:
        assert (film.width, film.height) == (8, 6)
    assert np.array_equal(read(path), LEVELS)


@pytest.mark.parametrize("name", ["a.mat", "a.h5"])
def test_frames_counted_along_the_last_axis_are_an_error(tmp_path: Path, name: str) -> None:
    if name == "a.mat":  # (frame, row, column) in MATLAB
        path = matlab(tmp_path / name, LEVELS, TIMES[None])
    else:
        path = hdf5(tmp_path / name, np.moveaxis(LEVELS, 0, 2))
    assert "counts its frames along the last axis: save it as (frame, row, column)" in refused(path)


@pytest.mark.parametrize("chunks", [(1, 6, 8), (2, 6, 8), (5, 3, 3), (5, 6, 8)])
@pytest.mark.parametrize("packed", [None, "gzip", "lzf"])
def test_frames_of_shared_chunks_are_read(tmp_path: Path, chunks: tuple[int, ...], packed: str | None) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("frames", data=LEVELS, chunks=chunks, compression=packed)
        file["times_s"] = TIMES
    assert np.array_equal(read(tmp_path / "a.h5"), LEVELS)


FILTERS = [
    (32001, "Blosc"),
    (32004, "LZ4"),
    (32008, "Bitshuffle"),
    (32015, "Zstandard"),
    (32026, "Blosc2"),
    (307, "bzip2"),
]


def filtered(path: Path, number: int, dataset: str = "frames") -> Path:
    """Write a film with an uninstalled filter and raw chunks marked as filtered."""
    with h5py.File(path, "w") as file:
        for name, values in (("frames", LEVELS), ("times_s", TIMES)):
            made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            made.set_chunk(values.shape)
            if name == dataset:
                made.set_filter(number, h5py.h5z.FLAG_OPTIONAL, ())
            space = h5py.h5s.create_simple(values.shape)
            held = h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(values.dtype), space, made)
            held.write_direct_chunk((0,) * values.ndim, values.tobytes())
    return path


@pytest.mark.parametrize("dataset", ["frames", "times_s"])
@pytest.mark.parametrize(("number", "name"), FILTERS)
def test_a_filter_that_is_not_installed_is_named(
    tmp_path: Path, number: int, name: str, dataset: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    if h5py.h5z.filter_avail(number):
        pytest.skip("installed here")
    says = refused(filtered(tmp_path / "a.h5", number, dataset))
    assert f"'{dataset}' is packed by the filter {name} (number {number}), which is not installed" in says
    assert "pip install hdf5plugin" in says


def test_installed_filters_are_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing hdf5plugin registers its filters."""
    imported: list[str] = []

    class Finder:
        def find_spec(self, name: str, *_: object) -> None:
            imported.append(name)

    monkeypatch.delitem(sys.modules, "hdf5plugin", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    refused(filtered(tmp_path / "a.h5", 32767))
    assert "hdf5plugin" in imported


WRITER = """
import h5py, numpy as np, sys
path, version, swmr = sys.argv[1:]
file = h5py.File(path, "w", libver=version or None)
file.create_dataset("frames", data=np.zeros((5, 6, 8), "u1"), maxshape=(None, 6, 8), chunks=(1, 6, 8))
file.create_dataset("times_s", data=np.arange(5) / 1000, maxshape=(None,), chunks=(64,))
file.flush()
if swmr:
    file.swmr_mode = True
    file["frames"].resize(6, axis=0)
    file["frames"].flush()
print("ready", flush=True)
sys.stdin.read()
"""


@contextmanager
def writing(path: Path, version: str = "", swmr: str = "") -> Iterator[subprocess.Popen[bytes]]:
    """Hold a film open for writing in another process."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {key: text for key, text in os.environ.items() if key != "HDF5_USE_FILE_LOCKING"}
    with subprocess.Popen([sys.executable, "-c", WRITER, path, version, swmr], env=environment, **pipes) as process:  # type: ignore[call-overload]
        assert process.stdout.readline() == b"ready\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("version", ["", "latest"])
def test_a_film_that_is_being_written_is_locked(tmp_path: Path, version: str) -> None:
    with writing(tmp_path / "a.h5", version):
        says = refused(tmp_path / "a.h5")
    assert "is locked, as by a program that still writes it: wait for that program" in says
    assert "HDF5_USE_FILE_LOCKING=FALSE" in says


def test_a_film_whose_writer_died_names_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with writing(path, "latest"):
        pass
    assert f"'h5clear -s {path}'" in refused(path)


@pytest.mark.parametrize("alive", [True, False])
def test_a_film_written_for_readers_meanwhile_is_read(tmp_path: Path, alive: bool) -> None:
    with writing(tmp_path / "a.h5", "latest", "swmr"):
        if alive:
            assert len(read(tmp_path / "a.h5")) == COUNT
    if not alive:
        assert len(read(tmp_path / "a.h5")) == COUNT


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_system_without_locks_needs_none(tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    real, path = h5py.File, hdf5(tmp_path / "a.h5")

    def without_locks(*given: Any, locking: Any = None, **more: Any) -> Any:
        if locking is None:
            raise OSError(number, f"Unable to open file (unable to lock file, errno = {number}, error message = 'x')")
        return real(*given, locking=locking, **more)

    monkeypatch.setattr(h5py, "File", without_locks)
    assert np.array_equal(read(path), LEVELS)


def test_a_cause_that_hdf5_does_not_tell_is_not_made_up(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + b"x" * 1000)
    assert "HDF5 reports only 'bad superblock version number': it may be damaged, or of a newer" in refused(
        tmp_path / "a.h5"
    )


def test_a_failing_disk_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: Any) -> Any:
        raise OSError("Can't read data (file read failed: errno = 5, error message = 'Input/output error')")

    path = hdf5(tmp_path / "a.h5")
    with open_film(path) as film:
        monkeypatch.setattr(h5py.Dataset, "__getitem__", failing)
        with pytest.raises(MediaError, match=r"cannot read .* after 0 whole frames: .*Input/output error"):
            list(film)


def test_a_damaged_chunk_is_damage(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        frames = file.create_dataset("frames", data=LEVELS, chunks=(1, 6, 8), compression="gzip")
        file["times_s"] = TIMES
        place = frames.id.get_chunk_info(3).byte_offset
    with (tmp_path / "a.h5").open("r+b") as raw:
        raw.seek(place)
        raw.write(bytes(8))
    got: list[Frame] = []
    with (
        open_film(tmp_path / "a.h5") as film,
        pytest.raises(MediaError, match=r"is damaged after 3 whole frames \(.+\)"),
    ):
        got.extend(film)
    assert len(got) == 3


def test_an_hdf5_file_that_an_interrupt_left_open_says_nothing_at_exit(tmp_path: Path) -> None:
    code = (
        "import sys, h5py; from pathlib import Path; from heliograph.media.hdf5 import PatientFile\n"
        "disk = PatientFile(Path(sys.argv[1])); file = h5py.File(disk, 'w')\n"
        "file.create_dataset('frames', (10,), 'f8')[3] = 1.0; disk.close()"
    )
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.h5")], capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
