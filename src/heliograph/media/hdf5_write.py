"""Films in HDF5 written: a dataset of frames, one a chunk and without a filter, and a dataset of their times."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.media.record import FilmSpec
from heliograph.media.writer import write_error

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
