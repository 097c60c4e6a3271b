"""Films in HDF5, read and written: a dataset of frames and a dataset of times."""

import errno
import importlib
import json
import logging
import math
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Frame, Pixels
from heliograph.media.libraries import h5py
from heliograph.media.reader import Reading, checked_size, clear_read_errors
from heliograph.media.record import FASTEST_HZ, SLOWEST_HZ, FilmSpec
from heliograph.media.stamps import TimedReader, agrees, check_times

SUFFIXES = (".h5", ".hdf5")  # suffixes of HDF5 films

_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, NotImplementedError, OverflowError)
"""Errors of h5py for damaged files."""

_EXPECTED = "'frames' (frame, row, column) of uint8 or uint16 and 'times_s' (frame,) in seconds"

_FILTERS = {
    4: "szip", 307: "bzip2", 32000: "LZF", 32001: "Blosc", 32004: "LZ4", 32008: "Bitshuffle", 32013: "ZFP",
    32015: "Zstandard", 32017: "SZ", 32018: "FCIDECOMP", 32024: "SZ3", 32026: "Blosc2", 32028: "SPERR",
}  # fmt: skip
"""Names of filters by number in the HDF Group's register."""

_BLOCK_TIMES = 4096  # times read at once


class Hdf5Reader(TimedReader):
    """An HDF5 film; see `FilmReader`."""

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        with _opened(path) as file, _clear_damage(path, 0):
            frames, times = file["frames"], file["times_s"]
            self.frame_count, *shape = frames.shape
            # MATLAB's (rows, columns, frames) are (frames, columns, rows) in HDF5
            self._by_columns = "MATLAB_class" in frames.attrs
            self.height, self.width = reversed(shape) if self._by_columns else shape
            checked_size(path, self.width, self.height)
            _check_chunks(path, frames, times)
            dtype = frames.dtype.newbyteorder("=")
            self.bits = int(_number(path, file.attrs, "bits", *BITS[dtype]) or 8 * dtype.itemsize)
            self.metadata = _read_metadata(file.attrs)
            stated_hz = _number(path, file.attrs, "rate_hz", SLOWEST_HZ, FASTEST_HZ)
            first = _read_times(times, 0)
            self._pace = check_times(path, first, stated_hz, numbered=reading.rate_hz is not None)
            self.claimed_hz = stated_hz or (self._pace.rate_hz if self._pace else 1.0)
            self._states_numbers = self._pace is not None and agrees(stated_hz, self._pace)
            if file.swmr_mode:
                self.frame_count = min(self.frame_count, times.size)
                logging.getLogger(__name__).warning("%s is still written: the frames so far are read", path)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        with _opened(self.path) as file:
            frames, times = file["frames"], file["times_s"]
            read = _frame_reader(frames)
            for number, time_s in enumerate(islice(self._times(times), frames.shape[0])):
                with _clear_damage(self.path, number):
                    pixels = read(number)
                levels: Any = np.ascontiguousarray(pixels.T) if self._by_columns else pixels
                yield time_s, levels, self.bits

    def _times(self, times: Any) -> Iterator[float]:
        for start in range(0, times.size, _BLOCK_TIMES):
            with _clear_damage(self.path, start), np.errstate(over="ignore", invalid="ignore"):
                block = _read_times(times, start).astype(np.float64).tolist()
            yield from block


def is_hdf5(path: Path) -> bool:
    """True if a file is HDF5, which may start behind a user block of 512, 1024, 2048 ... bytes, as in MATLAB."""
    size, place = path.stat().st_size, 0
    with path.open("rb") as file:
        while place < size:
            file.seek(place)
            if file.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            place = max(512, 2 * place)
    return False


def _frame_reader(frames: Any) -> Callable[[int], Pixels]:
    """Return a function from number to frame, which avoids HDF5's copy if each frame is a plain chunk."""
    shape, dtype = frames.shape[1:], frames.dtype.newbyteorder("=")
    plain = frames.chunks == (1, *shape) and frames.dtype.isnative and not frames.id.get_create_plist().get_nfilters()
    plain = plain and h5py.version.version_tuple[:2] >= (3, 9)  # which reads into an array

    def read(number: int) -> Pixels:
        place, pixels = (number, 0, 0), np.empty(shape, dtype)
        # a missing or damaged chunk has another size
        if not plain or frames.id.get_chunk_info_by_coord(place).size != pixels.nbytes:
            return frames[number].astype(dtype)
        frames.id.read_direct_chunk(place, out=pixels.reshape(-1).view(np.uint8))
        return pixels

    return read


def _read_times(times: Any, start: int) -> Any:
    """Return a block of times; MATLAB writes a row or a column."""
    longest = max(range(times.ndim), key=lambda axis: times.shape[axis])
    part = slice(start, start + _BLOCK_TIMES)
    return np.asarray(times[tuple(part if axis == longest else 0 for axis in range(times.ndim))])


def _read_metadata(attributes: Any) -> dict[str, str]:
    try:
        return {str(name): str(text) for name, text in json.loads(_attribute(attributes, "metadata", "{}")).items()}
    except (ValueError, TypeError, AttributeError, RecursionError):  # an attribute of another program
        return {}


def _number(path: Path, attributes: Any, name: str, least: float, most: float) -> float:
    """Return a number from an attribute; 0 if missing."""
    held = _attribute(attributes, name, 0)
    try:
        value = float(np.asarray(held).item())
    except (ValueError, TypeError, OverflowError):
        value = math.nan
    if value and not least <= value <= most:
        text = " ".join(f"{held!s:.40}".split())
        allowed = f"{least:g}" if least == most else f"{least:g} to {most:g}"
        raise MediaError(f"{path}: its attribute '{name}' is {text}, not {allowed}: correct it or delete it")
    return value


def _attribute(attributes: Any, name: str, missing: Any) -> Any:
    """Return an attribute except for a list of variable length: HDF5 crashes if damage turns a text into a list."""
    try:
        held = attributes.get_id(name)
    except KeyError:
        return missing
    return "a list" if held.get_type().detect_class(h5py.h5t.VLEN) else attributes[name]


@contextmanager
def _clear_damage(path: Path, count: int) -> Iterator[None]:
    """Turn errors of HDF5 for a damaged file into a MediaError."""
    try:
        yield
    except MediaError:
        raise
    except _BROKEN as error:
        if "errno" in str(error):  # an error of the system
            raise MediaError(f"cannot read {path}, after {count} whole frames: {_reason(error)}") from error
        raise MediaError(f"{path} is damaged after {count} whole frames ({_reason(error)}): copy it again") from error


def _reason(error: Exception) -> str:
    """Return HDF5's reason, which follows in brackets."""
    return brief(str(error).rstrip(")").rpartition(" (")[2] or type(error).__name__)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with clear_read_errors(path), path.open("rb") as raw:
        _check_heaps(path, raw.read(1 << 20))  # films of this package have texts in the first 12 kB
    with _open_file(path) as file:
        with _clear_damage(path, 0):
            _check_form(path, file)
            for name in ("frames", "times_s"):
                _check_filters(path, file[name])
        yield file


def _open_file(path: Path) -> Any:
    """Open a file, even while another program writes (SWMR), or on a system that lacks locks."""
    no_locks = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)
    cache = 1 << 26  # bytes of unpacked chunks: a chunk of several frames is unpacked once
    try:
        return h5py.File(path, "r", rdcc_nbytes=cache)
    except _BROKEN as error:
        text, cause = str(error), error
    with suppress(*_BROKEN):
        if "already open for write" in text:
            return h5py.File(path, "r", rdcc_nbytes=cache, swmr=True)
        if "unable to lock file" in text and getattr(cause, "errno", None) in no_locks:
            return h5py.File(path, "r", rdcc_nbytes=cache, locking=False)
    causes = {
        "truncated file": "ends in the middle and cannot be read: copy or record it again",
        "already open for write": f"was left open, or is still written: wait, or run 'h5clear -s {path}' on a copy",
        "unable to lock file": "is locked, as by its writer: wait for that program, or set HDF5_USE_FILE_LOCKING=FALSE",
        "signature not found": "is not a readable HDF5 file, as the signature is missing: check the file",
        "": f"is not readable, and HDF5 reports only {_reason(cause)!r}: it may be damaged, or of a newer HDF5",
    }
    raise MediaError(f"{path} {next(advice for sign, advice in causes.items() if sign in text)}")


def _check_filters(path: Path, dataset: Any) -> None:
    """Refuse data that need a missing filter."""
    created = dataset.id.get_create_plist()
    for number, _, _, label in map(created.get_filter, range(created.get_nfilters())):
        with suppress(ImportError):
            if not h5py.h5z.filter_avail(number):
                importlib.import_module("hdf5plugin")  # registers the usual filters
        if not h5py.h5z.filter_avail(number):
            name = _FILTERS.get(number) or label.decode(errors="replace").strip("\0") or "no known name"
            text = f"'{dataset.name.strip('/')}' is packed by the filter {name} (number {number})"
            raise MediaError(f"{path}: {text}, which is not installed: 'pip install hdf5plugin'")


def _check_heaps(path: Path, head: bytes) -> None:
    """Refuse a heap of texts that sends HDF5 into an endless loop: an object of length 0 follows itself."""
    start = head.find(b"GCOL\x01\0\0\0")
    while start >= 0:
        # 16 bytes before the objects, and before each object: index (2), references (2), zeros (4), length (8)
        place, end = start + 16, min(start + int.from_bytes(head[start + 8 : start + 16], "little"), len(head))
        while place + 16 <= end:
            index, length = struct.unpack_from("<H6xQ", head, place)
            if not index and not length:
                raise MediaError(f"{path} is damaged where its texts lie: copy or record it again")
            place += 16 + (length + 7) // 8 * 8 if index else length
        start = head.find(b"GCOL\x01\0\0\0", start + 1)


def _check_form(path: Path, file: Any) -> None:
    """Refuse a file if datasets are missing, lie in other files, or are no film."""
    datasets: list[Any] = [None, None]
    with suppress(*_BROKEN):  # links may lead in circles
        datasets = [_find_dataset(file, name) for name in ("frames", "times_s")]
    is_external = any(dataset is False for dataset in datasets)
    if not is_external and not all(isinstance(dataset, h5py.Dataset) for dataset in datasets):
        held = ", ".join(sorted(file)) or "nothing"
        raise MediaError(f"{path} is not a film: expected the datasets {_EXPECTED}, it holds {held}")
    # the shape of a virtual dataset opens other files
    if is_external or any(dataset.is_virtual or dataset.external for dataset in datasets):
        raise MediaError(f"{path} is no complete film, its pictures lie in other files: copy them into one")
    frames, times = datasets
    shape: tuple[int, ...] = frames.shape or ()  # None for an empty dataset
    lengths: tuple[int, ...] = times.shape or ()
    is_list = bool(lengths) and math.prod(lengths) == max(lengths)
    if is_list and len(shape) == 3 and max(lengths) == shape[2] != shape[0]:
        cure = "save it as (frame, row, column); from MATLAB as (row, column, frame)"
        raise MediaError(f"{path}: 'frames' {shape} counts its frames along the last axis: {cure}")
    # a running writer may have written a frame and no time yet
    fits = is_list and len(shape) == 3 and (max(lengths) == shape[0] or file.swmr_mode)
    if not fits or frames.dtype.newbyteorder("=") not in BITS or times.dtype.kind not in "fiu":
        got = f"'frames' {shape} of {frames.dtype} and 'times_s' {lengths} of {times.dtype}"
        raise MediaError(f"{path} is not a film: expected {_EXPECTED}, got {got}")


def _find_dataset(group: Any, path: str) -> Any:
    """Return a dataset by its path, None if missing, or False in another file: h5py would open even a pipe."""
    found = group.file if path.startswith("/") else group
    for name in path.split("/"):
        if name not in ("", ".") and isinstance(found, h5py.Group):
            link = found.get(name, getlink=True)
            if isinstance(link, h5py.SoftLink):
                found = _find_dataset(found, link.path)
            else:
                found = False if isinstance(link, h5py.ExternalLink) else found.get(name)
    return found


def _check_chunks(path: Path, *datasets: Any) -> None:
    """Refuse chunks larger than the file, or too large to decompress: HDF5 allocates complete chunks."""
    size = path.stat().st_size
    for dataset in datasets:
        chunk = math.prod(dataset.chunks or dataset.shape[1:]) * dataset.dtype.itemsize
        packed = dataset.id.get_create_plist().get_nfilters()
        pieces = f"'{dataset.name.strip('/')}' has pieces of {chunk} bytes"
        if dataset.size and chunk > size and not packed:
            raise MediaError(f"{path} is damaged, copy it again: {pieces} in a file of {size}")
        if packed and chunk > 300_000_000:  # the largest frame has 268 MB
            raise MediaError(f"{path}: {pieces}, too large to unpack: repack it with one frame a chunk")


class PatientFile:
    """A file for HDF5, which crashes the process at exit after a failed write; the user reads ``error``.

    After an interrupt HDF5 may use the closed file at exit.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        self.error: OSError | None = None
        self.read, self.tell, self.close = self._file.read, self._file.tell, self._file.close

    def flush(self) -> None:
        """Return: the file has no buffer."""

    def seek(self, offset: int, whence: int = 0) -> int:
        """Seek in the open file."""
        return offset if self._file.closed else self._file.seek(offset, whence)

    def readinto(self, buffer: memoryview) -> int:
        """Read."""
        got = 0 if self._file.closed else self._file.readinto(buffer)
        return len(buffer) if self.error else got  # HDF5 may read back a failed write

    def write(self, data: memoryview) -> int:
        """Write, or keep the error."""
        left = memoryview(data).cast("B")
        with self._kept_errors():
            while self.error is None and len(left) and not self._file.closed:  # a nearly full disk takes a part
                left = left[self._file.write(left) :]
        return len(data)

    def truncate(self, size: int) -> int:
        """Truncate the file, or keep the error."""
        with self._kept_errors():
            return size if self._file.closed else self._file.truncate(size)
        return size

    @contextmanager
    def _kept_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = error


class Hdf5Sink:
    """An HDF5 film for writing; a `Sink`."""

    _step_frames = 256  # the datasets grow in steps

    def __init__(self, partial: Path, spec: FilmSpec) -> None:
        self._count, self._disk = 0, PatientFile(partial)
        with self._disk_errors():
            self._file = h5py.File(self._disk, "w")
            self._frames = self._add("frames", "u1" if spec.bits == 8 else "<u2", 1, spec.height, spec.width)
            self._times = self._add("times_s", "<f8", self._step_frames)
            metadata = json.dumps(dict(spec.metadata))
            values = {"format": "heliograph film", "version": 1, "rate_hz": spec.rate_hz, "bits": spec.bits}
            self._file.attrs.update(values | {"metadata": metadata})

    def _add(self, name: str, dtype: str, chunk_frames: int, *shape: int) -> Any:
        limits = {"maxshape": (None, *shape), "chunks": (chunk_frames, *shape)}
        return self._file.create_dataset(name, (0, *shape), dtype, **limits)

    def put(self, frame: Frame) -> None:
        """Append a frame; see `Sink`."""
        with self._disk_errors():
            if self._count == self._times.shape[0]:
                self._resize(self._count + self._step_frames)
            pixels = np.ascontiguousarray(frame.pixels, dtype=self._frames.dtype)
            self._frames.id.write_direct_chunk((self._count, 0, 0), pixels)
            self._times[self._count] = frame.time_s
            self._count += 1

    def close(self) -> None:
        """Cut the datasets to the written frames and close the file."""
        with self._disk_errors():
            self._resize(self._count)
            self._file.close()
            self._disk.close()

    def discard(self) -> None:
        """Close the file in any state; never raises."""
        with suppress(Exception):
            self._file.close()
        self._disk.close()

    def _resize(self, count: int) -> None:
        self._frames.resize(count, axis=0)
        self._times.resize(count, axis=0)

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        try:
            yield
        finally:
            if self._disk.error is not None:
                raise self._disk.error
