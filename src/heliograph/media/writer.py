"""Common interface for writing films: checks, atomic replacement of the file, encoding in a thread."""

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from heliograph.base import files
from heliograph.base.errors import MediaError, brief, shown
from heliograph.base.frames import Frame
from heliograph.media.libraries import av
from heliograph.media.record import FilmSpec


class Sink(Protocol):
    """A file of some kind for frames."""

    def put(self, frame: Frame) -> None:
        """Store a frame."""

    def close(self) -> None:
        """Finish the file."""

    def discard(self) -> None:
        """Close the file in any state; never raise."""


class ThreadedSink:
    """A sink in a thread: codecs release the GIL and run in parallel to the caller."""

    def __init__(self, sink: Sink, queued: int = 8) -> None:
        self._sink, self._queued = sink, queued
        self._thread = ThreadPoolExecutor(1, "film-encoder")
        self._pending = deque[Future[None]]()

    def put(self, frame: Frame) -> None:
        """Queue a copy of a frame, and raise the error of an earlier frame; see `Sink`."""
        while self._pending and (len(self._pending) > self._queued or self._pending[0].done()):
            self._pending[0].result()
            self._pending.popleft()
        # the caller may reuse the array
        self._pending.append(self._thread.submit(self._sink.put, frame.copied()))

    def close(self) -> None:
        """Encode the queued frames, then finish the file, or raise an error."""
        for future in self._pending:
            future.result()
        self._thread.shutdown()
        self._sink.close()

    def discard(self) -> None:
        """Drop the queued frames and close the file."""
        self._thread.shutdown(cancel_futures=True)
        self._sink.discard()


class FilmWriter:
    """A film for writing; made by `heliograph.media.create_film`.

    The file grows under a hidden name in the target's folder and replaces the target when finished; the target is
    always complete. Leaving the ``with`` block finishes the film; an exception removes it. To keep the frames before
    Ctrl-C, catch `KeyboardInterrupt` inside the block and call `finish`.
    """

    def __init__(self, target: Path, partial: Path, spec: FilmSpec, sink: Sink) -> None:
        self.path = target
        self.spec = spec
        self.frames_written = 0
        self._partial = partial
        self._sink = sink
        self._last_time_s = -np.inf
        self._open = True

    def write(self, frame: Frame) -> None:
        """Append a frame; the pixels are copied, so the caller may reuse the array."""
        if not self._open:
            raise MediaError(f"{self.path} is already finished or aborted: no frame can be added")
        self._check(frame)
        try:
            with clear_errors(self.path):
                self._sink.put(frame)
        except Exception:  # Ctrl-C mostly arrives here; then the caller may finish
            self.abort()
            raise
        self._last_time_s = frame.time_s
        self.frames_written += 1

    def finish(self) -> None:
        """Finish the film and replace the target; no effect if already finished or aborted."""
        if not self._open:
            return
        if not self.frames_written:
            self.abort()
            raise MediaError(f"no frames were written to {self.path}: a film needs at least one")
        try:
            with clear_errors(self.path):
                self._sink.close()
                with self._partial.open("rb+") as file:
                    os.fsync(file.fileno())  # a power cut could otherwise leave the new name on an empty file
                os.replace(self._partial, self.path)
        except BaseException:
            self.abort()
            raise
        self._open = False

    def abort(self) -> None:
        """Remove the unfinished film; may be called twice, and after `finish`."""
        if self._open:
            self._open = False
            self._sink.discard()
            self._partial.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.finish()
        else:
            self.abort()

    def _check(self, frame: Frame) -> None:
        """Refuse a frame of wrong size, type, levels or time."""
        if not isinstance(frame, Frame):
            cure = "write Frame(index, time_s, pixels, bits)"
            raise MediaError(f"a film takes heliograph.Frame, not {shown(frame)}; {cure}")
        pixels, spec = frame.pixels, self.spec
        if pixels.shape != (spec.height, spec.width):
            size = f"{pixels.shape[1]}x{pixels.shape[0]}"
            raise MediaError(f"the film is {spec.width}x{spec.height} pixels, the frame is {size}")
        if frame.bits != spec.bits:
            raise MediaError(f"the film has {spec.bits} bits, the frame {frame.bits}: they must be the same")
        if spec.bits not in (8, 16) and int(pixels.max()) >> spec.bits:
            raise MediaError(f"gray level {int(pixels.max())} does not fit into the film's {spec.bits} bits")
        if frame.time_s <= self._last_time_s:
            raise MediaError(f"frames must follow each other in time: got {frame.time_s} s after {self._last_time_s} s")


def partial_path(target: Path) -> Path:
    """Return a hidden, unique name in the target's folder, with the same suffix, which selects the muxer."""
    with files.clear_write_errors(target):
        if target.is_dir():
            raise MediaError(f"{target} is a folder: give the film a file name in it")
        if not target.parent.is_dir():
            raise MediaError(f"the folder {target.parent} does not exist: create it first")
        return files.partial_path(target, target.suffix)


@contextmanager
def clear_errors(target: Path) -> Iterator[None]:
    """Turn errors of the system, HDF5 and codecs into a MediaError."""
    with files.clear_write_errors(target):
        try:
            yield
        except OSError:
            raise
        except (RuntimeError, av.error.FFmpegError) as error:
            raise MediaError(f"cannot write {target}: {brief(error)}") from error
