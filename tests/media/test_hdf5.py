"""HDF5 films are identified by content; errors name the cause."""

import errno
import math
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
from film_checks import ends, form, holds, read, refused, write_levels
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.media import open_film

COUNT = 5
LEVELS = np.random.default_rng(0).integers(0, 256, (COUNT, 6, 8), dtype=np.uint8)
TIMES = np.arange(COUNT) / 1000


def hdf5(path: Path, times: Any = TIMES, levels: Any = LEVELS, block: int = 0, **attributes: Any) -> Path:
    with h5py.File(path, "w", userblock_size=block) as file:
        file["frames"], file["times_s"] = levels, times
        file.attrs.update(attributes)
    return path


def has_all(path: Path) -> bool:
    return holds(path, LEVELS, TIMES)


@pytest.mark.parametrize(("name", "block"), [
    ("a.h5", 0), ("a.mat", 512), ("a.dat", 1024), ("a.mkv", 2048), ("a.png", 4096), ("a.TIF", 0), ("a", 512),
])  # fmt: skip
def test_hdf5_is_recognised_by_its_content(tmp_path: Path, name: str, block: int) -> None:
    assert has_all(hdf5(tmp_path / name, block=block))


@pytest.mark.parametrize(("suffix", "name"), [
    (".mkv", "a.h5"), (".mkv", "a.tif"), (".mp4", "a.npy"), (".mp4", "a.cine"), (".nut", "a.jpg"), (".nut", "a.dat"),
    (".avi", "a"), (".avi", "a.MKV"),
])  # fmt: skip
def test_videos_are_recognised_by_their_content(tmp_path: Path, suffix: str, name: str) -> None:
    assert len(read(write_levels(tmp_path / f"b{suffix}", LEVELS).rename(tmp_path / name))) == COUNT


@pytest.mark.parametrize(("head", "says"), [
    (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "is of MATLAB before 7.3: save it there with '-v7.3'"),
    (b"PK\x03\x04 archive", "is an archive"), (b"\x1f\x8b\x08 packed", "is compressed by gzip: unpack it first"),
    (b"\x89HDF\r\n\x1a\nx", "reports only 'bad superblock version number': it may be damaged, or of a newer"),
])  # fmt: skip
def test_files_of_other_kinds_are_named(tmp_path: Path, head: bytes, says: str) -> None:
    for name in ("a.mat", "a.h5", "a.mkv"):
        (tmp_path / name).write_bytes(head.ljust(600, head[-1:]))
        assert ends(tmp_path / name, [], says)


def matlab(path: Path, levels: NDArray[Any], times: NDArray[Any]) -> Path:
    """Write a file as MATLAB does: reversed axes, at least two dimensions."""
    hdf5(path, np.transpose(times), np.transpose(levels), block=512)
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
    assert has_all(path)


def test_frames_along_the_last_axis_are_refused(tmp_path: Path) -> None:
    says = "counts its frames along the last axis: save it as (frame, row, column)"
    assert says in refused(matlab(tmp_path / "a.mat", LEVELS, TIMES[None]))[1]  # (frame, row, column) in MATLAB
    assert says in refused(hdf5(tmp_path / "a.h5", levels=np.moveaxis(LEVELS, 0, 2)))[1]


@pytest.mark.parametrize("layout", [
    {}, {"chunks": (1, 6, 8)}, {"chunks": (2, 6, 8), "compression": "gzip"}, {"chunks": (5, 3, 3)},
    {"chunks": (5, 6, 8), "compression": "lzf"},
], ids=str)  # fmt: skip
@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2"])
def test_frames_of_any_layout_are_read(tmp_path: Path, layout: dict[str, Any], dtype: str) -> None:
    """Frames 2 and 3 are unwritten and have the fill value."""
    levels = LEVELS.copy()
    levels[2:4] = 3
    with h5py.File(tmp_path / "a.h5", "w") as file:
        frames = file.create_dataset("frames", LEVELS.shape, dtype, fillvalue=3, **layout)
        frames[:2], frames[4:], file["times_s"] = levels[:2], levels[4:], TIMES
    assert holds(tmp_path / "a.h5", levels)
    assert not any(frame.pixels.flags.writeable for frame in read(tmp_path / "a.h5"))


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
@pytest.mark.parametrize(("number", "name"), [(32001, "Blosc"), (32004, "LZ4"), (32015, "Zstandard"), (307, "bzip2")])
def test_a_missing_filter_is_named(
    tmp_path: Path, number: int, name: str, dataset: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    if h5py.h5z.filter_avail(number):
        pytest.skip("installed here")
    says = refused(filtered(tmp_path / "a.h5", number, dataset))[1]
    assert f"'{dataset}' is packed by the filter {name} (number {number}), which is not installed" in says
    assert "pip install hdf5plugin" in says


def test_the_package_of_filters_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.slow
def test_a_film_of_a_running_or_dead_writer_is_read_or_names_the_remedy(tmp_path: Path) -> None:
    path, shared = tmp_path / "a.h5", tmp_path / "b.h5"
    with writing(path, "latest"), writing(shared, "latest", "swmr"):
        says = refused(path)[1]
        assert len(read(shared)) == COUNT
    assert len(read(shared)) == COUNT
    assert "is locked, as by its writer: wait for that program, or set HDF5_USE_FILE_LOCKING=FALSE" in says
    assert f"'h5clear -s {path}'" in refused(path)[1]


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_system_without_locks_needs_none(tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    real, path = h5py.File, hdf5(tmp_path / "a.h5")

    def without_locks(*given: Any, locking: Any = None, **more: Any) -> Any:
        if locking is None:
            raise OSError(number, f"Unable to open file (unable to lock file, errno = {number}, error message = 'x')")
        return real(*given, locking=locking, **more)

    monkeypatch.setattr(h5py, "File", without_locks)
    assert has_all(path)


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
        file["times_s"], place = TIMES, frames.id.get_chunk_info(3).byte_offset
    data = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(data[:place] + bytes(8) + data[place + 8 :])
    assert ends(tmp_path / "a.h5", LEVELS[:3], "is damaged after 3 whole frames (")


@pytest.mark.parametrize("wrong", [math.nan, -math.inf, 1e18, np.finfo(np.longdouble).max])
def test_an_impossible_time_ends_the_film_after_the_frames_before(tmp_path: Path, wrong: Any) -> None:
    times = TIMES.astype(np.longdouble if isinstance(wrong, np.longdouble) else float)
    times[3] = wrong
    assert ends(hdf5(tmp_path / "a.h5", times), LEVELS[:3], "after 3 whole frames: times are in seconds")


WRONG_VALUES: list[tuple[dict[str, Any], str]] = [
    *[({"times": times}, "is not a film: expected 'frames'")
      for times in (np.array([b"a"] * COUNT), ["a"] * COUNT, TIMES * 1j, np.zeros(COUNT, bool))],
    *[({"times": times, **rate}, "times_s do not rise; write the time of each frame")
      for times in (np.zeros(COUNT), TIMES[::-1]) for rate in ({}, {"rate_hz": 1000.0})],
    *[({"rate_hz": rate}, "attribute 'rate_hz' is")
      for rate in (-1.0, math.nan, math.inf, 1e300, 1e-300, 1e7, "fast", [1, 2], 1j)],
    *[({"bits": bits}, "attribute 'bits' is") for bits in (-1, 7, 9, 99, 10**18, "x", [8, 8], 8.5, math.nan)],
    *[({"times": TIMES * unit, "rate_hz": 1000.0}, "write times_s in seconds") for unit in (1e3, 1e6, 1e9, 1e-3)],
]  # fmt: skip


@pytest.mark.parametrize(("values", "says"), WRONG_VALUES)
def test_wrong_times_and_attributes_are_named(tmp_path: Path, values: dict[str, Any], says: str) -> None:
    path = hdf5(tmp_path / "a.h5", **values)
    assert says in refused(path)[1]
    if says == "write times_s in seconds":
        with open_film(path, rate_hz=1000.0) as film:
            assert film.claimed_hz == 1000.0
    elif says.startswith("times_s do not rise"):
        assert says in refused(path, rate_hz=1000.0)[1]


def test_lost_frames_do_not_contradict_the_rate(tmp_path: Path) -> None:
    assert holds(hdf5(tmp_path / "a.h5", TIMES * 3, rate_hz=1000.0), LEVELS, indices=[0, 3, 6, 9, 12])


@pytest.mark.parametrize("name", ["rate_hz", "bits"])
def test_a_list_of_variable_length_is_no_number(tmp_path: Path, name: str) -> None:
    held = np.empty(1, h5py.vlen_dtype(np.int64))
    held[0] = np.array([8])
    path = hdf5(tmp_path / "a.h5", metadata="[" * 20_000 + "]" * 20_000)  # foreign metadata are ignored
    with open_film(path) as film:
        assert (film.metadata, len(list(film))) == ({}, COUNT)
    with h5py.File(path, "a") as file:
        file.attrs.create(name, held, dtype=held.dtype)
    assert f"attribute '{name}' is a list, not" in refused(path)[1]


def test_damaged_texts_neither_loop_nor_crash(tmp_path: Path) -> None:
    path = write_levels(tmp_path / "a.h5", np.zeros((1, 16, 16), np.uint8), metadata={"a": "b"})
    data = path.read_bytes()
    # HDF5 would read a variable-length type with an invalid base type and abort the process
    kind = data.index(b"metadata\0") + 17  # after the name, padded to 16 bytes, and the class
    assert data[kind - 1 : kind + 1] == b"\x19\x01"  # version 1, variable-length string
    path.write_bytes(data[:kind] + b"\2" + data[kind + 1 :])
    with open_film(path) as read_film:
        assert read_film.metadata == {}
    # HDF5 would loop forever at the end of the heap, on an object of length zero
    heap = data.index(b"GCOL")
    free = heap + 32 + (int.from_bytes(data[heap + 24 : heap + 32], "little") + 7) // 8 * 8
    path.write_bytes(data[:free] + bytes(16) + data[free + 16 :])
    assert "damaged where its texts lie" in refused(path)[1]


PIECES = {"shape": (COUNT, 8192, 8192), "chunks": (1, 8192, 8192)}
FRAMES: dict[str, tuple[dict[str, Any], str]] = {
    "not held": (PIECES, "pieces of 67108864 bytes in a file of"),
    "packed": (PIECES | {"chunks": (COUNT, 8192, 8192), "compression": "gzip"},
               "too large to unpack: repack it with one frame a chunk"),
    "too large": ({"shape": (COUNT, 1 << 31, 1 << 31), "chunks": (1, 64, 64)}, "2147483648x2147483648 pixels"),
    "too small": ({"shape": (COUNT, 0, 8)}, "8x0 pixels"),
    "/frames": ({}, "expected the datasets"), "/one": ({}, "expected the datasets"),
    "/none/frames": ({}, "expected the datasets"), "/times_s/x": ({}, "is not a film"),
}  # fmt: skip
"""Datasets, or paths of links, and the error."""


@pytest.mark.parametrize("name", FRAMES)
def test_missing_or_impossible_frames_are_named(tmp_path: Path, name: str) -> None:
    form, says = FRAMES[name]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["times_s"], file["one"] = TIMES, h5py.SoftLink("/one/more")
        if form:
            file.create_dataset("frames", dtype="u1", **form)
        else:
            file["frames"] = h5py.SoftLink(name)
    assert says in refused(tmp_path / "a.h5")[1]


@pytest.mark.parametrize("name", ["frames", "times_s"])
@pytest.mark.parametrize("kind", ["link", "link by links", "external bytes", "virtual"])
def test_pictures_in_other_files_are_refused(tmp_path: Path, kind: str, name: str) -> None:
    """The other file is a pipe without a writer, so that opening it would block forever."""
    os.mkfifo(tmp_path / "pipe")
    held: dict[str, Any] = {"frames": np.zeros((COUNT, 8, 8), np.uint8), "times_s": TIMES}
    shape = held.pop(name).shape
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for other, values in held.items():
            file[other] = values
        if kind == "link":
            file[name] = h5py.ExternalLink("pipe", "/x")
        elif kind == "link by links":
            file["group/out"] = h5py.ExternalLink("pipe", "/")
            file["group/inner"], file[name] = h5py.SoftLink("out/there"), h5py.SoftLink("/group/./inner")
        elif kind == "external bytes":
            file.create_dataset(name, shape, "u1", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
        else:
            layout = h5py.VirtualLayout(shape, "u1", maxshape=(None, *shape[1:]))
            source = h5py.VirtualSource("pipe", "x", shape, "u1", maxshape=(None, *shape[1:]))
            everything = (slice(None, h5py.h5s.UNLIMITED), *[slice(None)] * (len(shape) - 1))
            layout[everything] = source[everything]
            file.create_virtual_dataset(name, layout)
    assert "its pictures lie in other files: copy them into one" in refused(tmp_path / "a.h5")[1]


def test_links_within_a_film_are_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["take/camera/pictures"], file["take/frames"] = LEVELS, h5py.SoftLink("camera//pictures")
        file["frames"], file["times_s"] = h5py.SoftLink("/take/frames"), TIMES
    assert has_all(tmp_path / "a.h5")


def test_packed_pieces_of_268_megabytes_are_held_but_not_times_larger_than_the_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file, h5py.File(tmp_path / "b.h5", "w") as other:
        file.create_dataset("frames", (4, 8192, 8192), "u1", chunks=(4, 8192, 8192), compression="gzip")
        file["times_s"], other["frames"] = TIMES[:4], LEVELS
        other.create_dataset("times_s", (COUNT,), "f8", chunks=(1 << 24,), maxshape=(None,))
    assert form(tmp_path / "a.h5")[-1] == 4
    assert "'times_s' has pieces of 134217728 bytes in a file of" in refused(tmp_path / "b.h5")[1]
