"""Films in HDF5, read and written: a dataset of frames and a dataset of times."""

import errno
import importlib
import json
import logging
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Frame, Pixels
from heliograph.media.reader import Reading, checked_size
from heliograph.media.record import FASTEST_HZ, SLOWEST_HZ, FilmSpec
from heliograph.media.stamps import TimedReader, agrees, check_times
from heliograph.media.writer import write_error

LOG = logging.getLogger(__name__)

SUFFIXES = (".h5", ".hdf5")
"""Suffixes of HDF5 films."""

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file, by its format specification."""

_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, NotImplementedError, OverflowError)
"""All that h5py makes of a damaged file."""

_EXPECTED = "'frames' (frame, row, column) of uint8 or uint16 and 'times_s' (frame,) in seconds"

_LEAST_USER_BLOCK = 512
"""First place of HDF5's signature after the file's first byte; each further place is twice as far (III.A there)."""

_FILTERS = {
    4: "szip", 307: "bzip2", 32000: "LZF", 32001: "Blosc", 32004: "LZ4", 32008: "Bitshuffle", 32013: "ZFP",
    32015: "Zstandard", 32017: "SZ", 32018: "FCIDECOMP", 32024: "SZ3", 32026: "Blosc2", 32028: "SPERR",
}  # fmt: skip
"""Names of filters by their numbers in the HDF Group's register."""

_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)
"""What systems say of files that they cannot lock, as on some network drives."""

_HEAP = b"GCOL\x01\0\0\0"
"""First bytes of a heap of texts in HDF5, of version 1 (its format specification, III.E)."""

_HEAP_HEADER = 16
"""Bytes before the objects of a heap, and before each object: its index (2), references (2), zeros (4), length (8)."""

_HEAD_BYTES = 1 << 20
"""Bytes of a file that are searched for heaps: films written here have theirs in the first 12 kB."""

_MOST_STEPS = 100
"""Most steps by which a dataset is reached, groups and links. Chosen; HDF5 itself follows 16 links."""

_MOST_PIECE = 300_000_000
"""Most bytes of a piece with a filter, such as gzip, which is held as a whole to read a frame. Chosen: a frame of the
largest size (`MOST_PIXELS`) in 16 bits has 268 MB, so that one frame a piece is always taken."""

_MOST_BLOCK = 1 << 26
"""Most bytes of frames that are read at once because they share chunks: 67 MB. Chosen; it bounds memory."""

_DIRECT_SINCE = (3, 9)
"""Release of h5py that first reads a chunk into an array of the caller's (its release notes)."""

_TIMES_AT_ONCE = 4096
"""Times read at once: 32 kB. Chosen; it bounds memory."""


class Hdf5Reader(TimedReader):
    """An HDF5 film; see `FilmReader`."""

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        with _opened(path) as file, _damage_is_clear(path, 0):
            frames = file["frames"]
            self.frame_count, *shape = frames.shape
            self.height, self.width = reversed(shape) if _is_by_columns(frames) else shape
            checked_size(path, self.width, self.height)
            _check_held(path, frames, file["times_s"])
            self.bits = int(_number(path, file.attrs, "bits", *BITS[frames.dtype]) or 8 * frames.dtype.itemsize)
            self.metadata = _read_metadata(file.attrs)
            stated_hz = _number(path, file.attrs, "rate_hz", SLOWEST_HZ, FASTEST_HZ)
            first = _read_times(file["times_s"], slice(_TIMES_AT_ONCE))
            self._pace = check_times(path, first, stated_hz, numbered=reading.rate_hz is not None)
            self.claimed_hz = stated_hz or (self._pace.rate_hz if self._pace else 1.0)
            self._states_numbers = self._pace is not None and agrees(stated_hz, self._pace)
            if file.swmr_mode:
                self.frame_count = min(self.frame_count, file["times_s"].size)
                LOG.warning("%s is still open for writing: the frames written so far are read", path)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        if not self.frame_count:
            raise MediaError(f"{self.path} holds no frames: record it again")
        with _opened(self.path) as file:
            frames, times = file["frames"], file["times_s"]
            read, by_columns = _frame_reading(file, frames), _is_by_columns(frames)
            for place, time_s in enumerate(islice(_times(self.path, times), frames.shape[0])):
                with _damage_is_clear(self.path, place):
                    pixels = read(place)
                levels: Any = np.ascontiguousarray(pixels.T) if by_columns else pixels
                yield time_s, levels, self.bits


def is_hdf5(path: Path) -> bool:
    """Return whether a file is HDF5, which may begin behind a block of the user's, as MATLAB's files do."""
    size, place = path.stat().st_size, 0
    with path.open("rb") as file:
        while place < size:
            file.seek(place)
            if file.read(len(SIGNATURE)) == SIGNATURE:
                return True
            place = max(_LEAST_USER_BLOCK, 2 * place)
    return False


def _is_by_columns(frames: Any) -> bool:
    """Whether MATLAB wrote the frames: (rows, columns, frames) there are (frames, columns, rows) in HDF5."""
    return "MATLAB_class" in frames.attrs


def _frame_reading(file: Any, frames: Any) -> Callable[[int], Pixels]:
    """What reads the frame of a number; where each is a chunk without a filter, past HDF5's own copy of the chunk."""
    import h5py

    with suppress(OSError, AttributeError, ValueError):  # systems that take no such advice
        # the system reads ahead of use: a thread takes longer to hand a frame over than to read it
        os.posix_fadvise(file.id.get_vfd_handle(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
    shape, held = frames.shape[1:], frames.dtype
    plain = frames.chunks == (1, *shape) and held.isnative and not frames.id.get_create_plist().get_nfilters()
    plain = plain and h5py.version.version_tuple[:2] >= _DIRECT_SINCE
    # chunks of several frames are unpacked once, not for each of their frames
    chunk_frames = frames.chunks[0] if frames.chunks else 1
    at_once = chunk_frames if chunk_frames * math.prod(shape) * held.itemsize <= _MOST_BLOCK else 1

    @lru_cache(maxsize=1)
    def block(number: int) -> Pixels:
        levels: Pixels = frames[number * at_once : (number + 1) * at_once]
        return levels

    def read(place: int) -> Pixels:
        where, pixels = (place, 0, 0), np.empty(shape, held)
        # chunks that were never written, or are damaged, have another size
        if not plain or frames.id.get_chunk_info_by_coord(where).size != pixels.nbytes:
            return block(place // at_once)[place % at_once].copy()
        frames.id.read_direct_chunk(where, out=pixels.reshape(-1).view(np.uint8))
        return pixels

    return read


def _read_times(dataset: Any, part: slice) -> Any:
    """Part of the times; MATLAB writes them as a row or a column."""
    held = max(range(dataset.ndim), key=lambda axis: dataset.shape[axis])
    return np.asarray(dataset[tuple(part if axis == held else 0 for axis in range(dataset.ndim))])


def _times(path: Path, dataset: Any) -> Iterator[float]:
    for start in range(0, dataset.size, _TIMES_AT_ONCE):
        with _damage_is_clear(path, start), np.errstate(over="ignore", invalid="ignore"):
            times = _read_times(dataset, slice(start, start + _TIMES_AT_ONCE)).astype(np.float64).tolist()
        yield from times


def _read_metadata(attributes: Any) -> dict[str, str]:
    try:
        return {str(name): str(text) for name, text in json.loads(_attribute(attributes, "metadata", "{}")).items()}
    except (ValueError, TypeError, AttributeError, RecursionError):  # somebody else's attribute of the same name
        return {}


def _number(path: Path, attributes: Any, name: str, least: float, most: float) -> float:
    """Read an attribute that is a number; 0 where it is missing."""
    held = _attribute(attributes, name, 0)
    try:
        value = math.nan if np.iscomplexobj(held) else float(np.asarray(held).item())
    except (ValueError, TypeError, OverflowError):
        value = math.nan
    if value and not least <= value <= most:
        says = " ".join(f"{held!s:.40}".split())
        allowed = f"{least:g}" if least == most else f"{least:g} to {most:g}"
        raise MediaError(f"{path}: its attribute '{name}' is {says}, not {allowed}: correct it or delete it")
    return value


def _attribute(attributes: Any, name: str, missing: Any) -> Any:
    """Read an attribute; a list of any length is not read, as HDF5 crashes where a damaged type makes one of a text."""
    import h5py

    try:
        held = attributes.get_id(name)
    except KeyError:
        return missing
    return "a list" if held.get_type().detect_class(h5py.h5t.VLEN) else attributes[name]


@contextmanager
def _damage_is_clear(path: Path, count: int) -> Iterator[None]:
    """Turn what HDF5 makes of a damaged file into a MediaError."""
    try:
        yield
    except MediaError:
        raise
    except _BROKEN as error:
        if "errno" in str(error):  # the system, not the file
            raise MediaError(f"cannot read {path}, after {count} whole frames: {_reason(error)}") from error
        raise MediaError(f"{path} is damaged after {count} whole frames ({_reason(error)}): copy it again") from error


def _reason(error: Exception) -> str:
    """HDF5's own reason, which stands in brackets at the end."""
    return brief(str(error).rstrip(")").rpartition(" (")[2] or type(error).__name__)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with path.open("rb") as raw:
            head = raw.read(_HEAD_BYTES)
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from error
    _check_heaps(path, head)
    with _file(path) as file:
        with _damage_is_clear(path, 0):
            _check_form(path, file)
            for name in ("frames", "times_s"):
                _check_filters(path, file[name])
        yield file


def _file(path: Path) -> Any:
    """The open file; its writer may have it open for readers (SWMR), and the system may have no locks."""
    import h5py

    try:
        return h5py.File(path, "r")
    except _BROKEN as error:
        said, why = str(error), error
    with suppress(*_BROKEN):
        if "already open for write" in said:
            return h5py.File(path, "r", swmr=True)
        if "unable to lock file" in said and getattr(why, "errno", None) in _NO_LOCKS:
            return h5py.File(path, "r", locking=False)
    raise _unreadable(path, said, why)


def _unreadable(path: Path, said: str, error: Exception) -> MediaError:
    """What is known of a file that HDF5 does not open."""
    if "truncated file" in said:
        text = f"{path} ends in the middle and cannot be read: copy or record it again"
    elif "already open for write" in said:
        text = (
            f"{path} was left open for writing, or a program still writes it: wait for that program; where it ended "
            f"without closing the film, run 'h5clear -s {path}', on a copy"
        )
    elif "unable to lock file" in said:
        text = (
            f"{path} is locked, as by a program that still writes it: wait for that program; where there is none, set "
            "HDF5_USE_FILE_LOCKING=FALSE"
        )
    elif "signature not found" in said:
        text = f"{path} is not a readable HDF5 file, it has no signature of HDF5: check that it is a film"
    else:
        text = (
            f"{path} is not a readable HDF5 file, and HDF5 says only {_reason(error)!r}: it may be damaged, or of a "
            "newer HDF5"
        )
    return MediaError(text)


def _check_filters(path: Path, dataset: Any) -> None:
    """Refuse what is packed by a filter that is not installed."""
    import h5py

    made = dataset.id.get_create_plist()
    for number, _, _, named in (made.get_filter(place) for place in range(made.get_nfilters())):
        if h5py.h5z.filter_avail(number):
            continue
        with suppress(ImportError):  # it brings the usual filters, and makes them known when it is imported
            importlib.import_module("hdf5plugin")
        if not h5py.h5z.filter_avail(number):
            name = _FILTERS.get(number) or named.decode(errors="replace").strip("\0") or "no known name"
            raise MediaError(
                f"{path}: '{dataset.name.strip('/')}' is packed by the filter {name} (number {number}), which is not "
                "installed: 'pip install hdf5plugin', or save the film without it"
            )


def _check_heaps(path: Path, head: bytes) -> None:
    """Refuse a film whose texts HDF5 would look for without end: an object of no length follows itself."""
    start = head.find(_HEAP)
    while start >= 0:
        size = int.from_bytes(head[start + 8 : start + 16], "little")
        place, end = start + _HEAP_HEADER, min(start + size, len(head))
        while place + _HEAP_HEADER <= end:
            index = int.from_bytes(head[place : place + 2], "little")
            length = int.from_bytes(head[place + 8 : place + 16], "little")
            if not index and not length:
                raise MediaError(f"{path} is damaged where its texts lie: copy or record it again")
            place += _HEAP_HEADER + (length + 7) // 8 * 8 if index else length
        start = head.find(_HEAP, start + 1)


def _check_form(path: Path, file: Any) -> None:
    import h5py

    try:
        elsewhere = _leads_elsewhere(file, b"frames") or _leads_elsewhere(file, b"times_s")
        frames, times = (None, None) if elsewhere else (file.get("frames"), file.get("times_s"))
    except _BROKEN as error:
        raise MediaError(f"{path} is not a film: its links lead nowhere; expected the datasets {_EXPECTED}") from error
    if elsewhere:
        raise _elsewhere(path)
    if not (isinstance(frames, h5py.Dataset) and isinstance(times, h5py.Dataset)):
        held = ", ".join(sorted(file)) or "nothing"
        raise MediaError(f"{path} is not a film: expected the datasets {_EXPECTED}, it holds {held}")
    # before their shapes are asked for, as for that of a virtual dataset other files are opened
    if any(dataset.is_virtual or dataset.external for dataset in (frames, times)):
        raise _elsewhere(path)
    form: tuple[int, ...] = frames.shape or ()
    lengths: tuple[int, ...] = times.shape or ()  # None of a dataset without any
    times_known = bool(lengths) and math.prod(lengths) == max(lengths)
    if times_known and len(form) == 3 and max(lengths) == form[2] != form[0]:
        raise MediaError(
            f"{path}: 'frames' {form} counts its frames along the last axis: save it as (frame, row, column), "
            "such as by numpy.moveaxis; from MATLAB as (row, column, frame)"
        )
    # a writer that still has the film open may have written a frame and not its time
    fit = times_known and len(form) == 3 and (max(lengths) == form[0] or file.swmr_mode)
    wrong = not fit or frames.dtype not in BITS
    if wrong or times.dtype.kind not in "fiu":
        got = f"'frames' {form} of {frames.dtype} and 'times_s' {lengths} of {times.dtype}"
        raise MediaError(f"{path} is not a film: expected {_EXPECTED}, got {got}")


def _leads_elsewhere(file: Any, name: bytes) -> bool:
    """Whether a name leads out of a file. It is asked step by step: h5py opens what a link leads to, be it a pipe."""
    import h5py

    group, left = file.id, [name]
    for _ in range(_MOST_STEPS):
        if not left:
            return False
        part = left.pop(0)
        if part in (b"", b"."):
            continue
        if not (isinstance(group, h5py.h5g.GroupID) and group.links.exists(part)):
            return False
        kind = group.links.get_info(part).type
        if kind == h5py.h5l.TYPE_SOFT:
            target = group.links.get_val(part)
            group = file.id if target.startswith(b"/") else group
            left = target.split(b"/") + left
        elif kind == h5py.h5l.TYPE_HARD:
            group = h5py.h5o.open(group, part)
        else:
            return True
    raise KeyError(name)  # round and round


def _elsewhere(path: Path) -> MediaError:
    return MediaError(f"{path} is no whole film, its pictures lie in other files: copy them into one")


def _check_held(path: Path, *datasets: Any) -> None:
    """Refuse pieces larger than the file, or too large to unpack: HDF5 takes memory for a whole piece at once."""
    size = path.stat().st_size
    for dataset in datasets:
        piece = math.prod(dataset.chunks or dataset.shape[1:]) * dataset.dtype.itemsize
        name, packed = dataset.name.strip("/"), dataset.id.get_create_plist().get_nfilters()
        if dataset.size and piece > size and not packed:
            raise MediaError(
                f"{path} is damaged: '{name}' claims pieces of {piece} bytes, the file has {size}: copy or record it "
                "again"
            )
        if packed and piece > _MOST_PIECE:
            raise MediaError(
                f"{path}: '{name}' has pieces of {piece / 1e9:.2g} GB, more than {_MOST_PIECE / 1e9:g} GB, which are "
                "unpacked as a whole: repack it with one frame a chunk"
            )


_STEP_FRAMES = 256
"""Frames by which the datasets grow, so that they are rarely resized. Chosen: at half and at twice the value a film was
written at the same speed within the noise of a shared machine, 30 %."""


class PatientFile:
    """A file that hides a failed write from HDF5, which would crash the process at exit; its user reads ``error``."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        self.error: OSError | None = None
        self.read, self.close = self._file.read, self._file.close

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""

    def seek(self, offset: int, whence: int = 0) -> int:
        """Seek; an interrupt may leave the HDF5 file open, which is then written in vain at exit."""
        return offset if self._file.closed else self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place reached."""
        return 0 if self._file.closed else self._file.tell()

    def readinto(self, buffer: memoryview) -> int:
        """Read."""
        got = 0 if self._file.closed else self._file.readinto(buffer)
        return len(buffer) if self.error else got  # what was never written may be asked for again

    def write(self, data: memoryview) -> int:
        """Write, or note why that failed."""
        left = memoryview(data).cast("B")
        while (
            self.error is None and len(left) and not self._file.closed
        ):  # near the end of the disk only a part is taken
            left = left[self._tried(self._file.write, left) :]
        return len(data)

    def truncate(self, size: int) -> int:
        """Cut the file, or note why that failed."""
        self._tried(self._file.truncate, size)
        return size

    def _tried(self, call: Callable[..., int], argument: object) -> int:
        try:
            return 0 if self._file.closed else call(argument)
        except OSError as error:
            self.error = error
            return 0


class Hdf5Sink:
    """An HDF5 film being written; a `Sink`."""

    def __init__(self, partial: Path, target: Path, spec: FilmSpec) -> None:
        import h5py

        self._target = target
        self._count = 0
        with self._clear_errors():
            self._disk = PatientFile(partial)
            self._file = h5py.File(self._disk, "w")
            shape, dtype = (spec.height, spec.width), "u1" if spec.bits == 8 else "<u2"
            limits = {"maxshape": (None, *shape), "chunks": (1, *shape)}
            self._frames = self._file.create_dataset("frames", (0, *shape), dtype, fillvalue=0, **limits)
            self._times = self._file.create_dataset("times_s", (0,), "<f8", maxshape=(None,), chunks=(_STEP_FRAMES,))
            _write_attributes(self._file.attrs, spec)

    def put(self, frame: Frame) -> None:
        """Append a frame; see `Sink`."""
        with self._clear_errors():
            if self._count == self._times.shape[0]:
                self._resize(self._count + _STEP_FRAMES)
            pixels = np.ascontiguousarray(frame.pixels, dtype=self._frames.dtype)
            self._frames.id.write_direct_chunk((self._count, 0, 0), pixels)
            self._times[self._count] = frame.time_s
            self._count += 1

    def close(self) -> None:
        """Cut the datasets to the frames written and close the file."""
        with self._clear_errors():
            self._resize(self._count)
            self._file.close()
            self._disk.close()

    def discard(self) -> None:
        """Close the file whatever its state: it is about to be removed. Never raises."""
        with suppress(Exception):
            self._file.close()
        self._disk.close()

    def _resize(self, count: int) -> None:
        self._frames.resize(count, axis=0)
        self._times.resize(count, axis=0)

    @contextmanager
    def _clear_errors(self) -> Iterator[None]:
        try:
            yield
            if self._disk.error is not None:
                raise self._disk.error
        except (OSError, RuntimeError) as error:  # HDF5 raises either
            raise write_error(error, self._target) from error


def _write_attributes(attributes: Any, spec: FilmSpec) -> None:
    attributes["format"] = "heliograph film"
    attributes["version"] = 1
    attributes["rate_hz"] = spec.rate_hz
    attributes["bits"] = spec.bits
    attributes["metadata"] = json.dumps(dict(spec.metadata))
