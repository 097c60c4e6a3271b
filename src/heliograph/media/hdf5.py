"""Films in HDF5 read: a dataset of frames, one a chunk where it was written here, and a dataset of their times."""

import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import BITS, LATEST_S, Frame, Pixels
from heliograph.media.reader import FilmReader, checked_size, checked_time
from heliograph.media.reading import Reading
from heliograph.media.record import FASTEST_HZ, SLOWEST_HZ

SUFFIXES = (".h5", ".hdf5")
"""Suffixes of HDF5 films."""

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file, by its format specification."""

_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, NotImplementedError, OverflowError)
"""All that h5py makes of a damaged file."""

_EXPECTED = "'frames' (frame, row, column) of uint8 or uint16 and 'times_s' (frame,) in seconds"

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

_MOST_RATIO = 10.0
"""Most that times and the claimed rate may differ by, as a ratio: lost frames make gaps, but not most of them.

Times in milliseconds make it 1000.
"""

_DIRECT_SINCE = (3, 9)
"""Release of h5py that first reads a chunk into an array of the caller's (its release notes)."""

_READ_TIMES = 4096
"""Times read at once: 32 kB. Chosen; it bounds memory."""


class Hdf5Reader(FilmReader):
    """An HDF5 film; see `FilmReader`.

    Parameters
    ----------
    path
        HDF5 film to read.
    reading
        How the film is to be read; its levels are gray, so the channel has no effect.

    Raises
    ------
    MediaError
        The file is no readable film.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        with _opened(path) as file, _damage_is_clear(path, 0):
            frames = file["frames"]
            self.frame_count, self.height, self.width = frames.shape
            checked_size(path, self.width, self.height)
            _check_held(path, frames, file["times_s"])
            self.bits = int(_number(path, file.attrs, "bits", *BITS[frames.dtype]) or 8 * frames.dtype.itemsize)
            self.metadata = _read_metadata(file.attrs)
            _check_rising(path, file["times_s"])
            claimed_hz = _number(path, file.attrs, "rate_hz", SLOWEST_HZ, FASTEST_HZ)
            if claimed_hz and reading.rate_hz is None:
                _check_unit(path, file["times_s"], claimed_hz)
            self.claimed_hz = claimed_hz or _median_rate(file["times_s"])

    def _frames(self) -> Iterator[Frame]:
        if not self.frame_count:
            raise MediaError(f"{self.path} holds no frames: record it again")
        with _opened(self.path) as file:
            read, index = _frame_reading(file, file["frames"]), -1
            for place, time_s in enumerate(_times(self.path, file["times_s"])):
                with _damage_is_clear(self.path, place):
                    pixels = read(place)
                index = max(index + 1, round(checked_time(self.path, time_s, place) * self.claimed_hz))
                yield Frame(index, time_s, pixels, self.bits)


def _frame_reading(file: Any, frames: Any) -> Callable[[int], Pixels]:
    """What reads the frame of a number; where each is a chunk without a filter, past HDF5's own copy of the chunk."""
    import h5py

    with suppress(OSError, AttributeError, ValueError):  # systems that take no such advice
        # the system reads ahead of use: a thread takes longer to hand a frame over than to read it
        os.posix_fadvise(file.id.get_vfd_handle(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
    shape, held = frames.shape[1:], frames.dtype
    plain = frames.chunks == (1, *shape) and held.isnative and not frames.id.get_create_plist().get_nfilters()
    plain = plain and h5py.version.version_tuple[:2] >= _DIRECT_SINCE

    def read(place: int) -> Pixels:
        where, pixels = (place, 0, 0), np.empty(shape, held)
        # chunks that were never written, or are damaged, have another size
        if not plain or frames.id.get_chunk_info_by_coord(where).size != pixels.nbytes:
            return np.asarray(frames[place])
        frames.id.read_direct_chunk(where, out=pixels.reshape(-1).view(np.uint8))
        return pixels

    return read


def _times(path: Path, dataset: Any) -> Iterator[float]:
    for start in range(0, dataset.shape[0], _READ_TIMES):
        with _damage_is_clear(path, start), np.errstate(over="ignore", invalid="ignore"):
            times = dataset[start : start + _READ_TIMES].astype(np.float64).tolist()
        yield from times


def _median_rate(times: Any) -> float:
    """Rate by the median gap of the first frames: where frames are missing, the mean gap is too long."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that no double holds become infinite
        known = np.asarray(times[:_READ_TIMES], np.float64)
    gaps = np.diff(known[np.abs(known) <= LATEST_S])
    gap = float(np.median(gaps)) if gaps.size else 0.0
    return 1 / gap if gap >= 1 / FASTEST_HZ else 1.0


def _check_rising(path: Path, times: Any) -> None:
    """Say so where the times are none of frames one after another; a few that are damaged are told where they stand."""
    with _damage_is_clear(path, 0), np.errstate(over="ignore", invalid="ignore"):
        known = np.asarray(times[:_READ_TIMES], np.float64)
    gaps = np.diff(known[np.abs(known) <= LATEST_S])
    if gaps.size and np.median(gaps) <= 0:
        raise MediaError(f"{path}: times_s do not rise; write the time of each frame there, in seconds")


def _check_unit(path: Path, times: Any, claimed_hz: float) -> None:
    """Say so where times are in another unit than seconds, by the rate that the film claims."""
    known_hz = _median_rate(times)
    if times.shape[0] > 1 and not 1 / _MOST_RATIO < known_hz / claimed_hz < _MOST_RATIO:
        raise MediaError(
            f"{path}: times_s show {shown(known_hz)} frames/s and rate_hz says {shown(claimed_hz)}; write times_s in "
            "seconds, or say what the camera did with --fps"
        )


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
        raise MediaError(f"{path} is damaged after {count} whole frames: copy it again") from error


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import h5py

    with path.open("rb") as raw:
        _check_heaps(path, raw.read(_HEAD_BYTES))
    try:
        file = h5py.File(path, "r")
    except _BROKEN as error:
        if "truncated file" in str(error):
            raise MediaError(f"{path} ends in the middle and cannot be read: copy or record it again") from error
        raise MediaError(f"{path} is not a readable HDF5 file, it may be damaged: copy or record it again") from error
    with file:
        with _damage_is_clear(path, 0):
            _check_form(path, file)
        yield file


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
    wrong = frames.ndim != 3 or frames.dtype not in BITS or times.shape != frames.shape[:1]
    if wrong or times.dtype.kind not in "fiu":
        got = f"'frames' {frames.shape} of {frames.dtype} and 'times_s' {times.shape} of {times.dtype}"
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
