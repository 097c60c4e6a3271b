"""The common interface for writing films: checks, a file that appears only when whole, encoding in a thread."""

import dataclasses
import errno
import os
import queue
import threading
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from heliograph.base import files
from heliograph.base.errors import MediaError, shown
from heliograph.base.files import clear_write_errors
from heliograph.base.frames import Frame
from heliograph.media.record import FilmSpec

QUEUED_FRAMES = 8
"""Frames that wait for the encoder at most; bounds memory. Chosen: with 4 and with 16 FFV1 is written at the same speed
within the noise of a shared machine, 30 %."""


class Sink(Protocol):
    """A file of some kind that takes frames."""

    def put(self, frame: Frame) -> None:
        """Store a frame; a MediaError where the file cannot be written."""

    def close(self) -> None:
        """Finish the file; a MediaError where it cannot be written."""

    def discard(self) -> None:
        """Close the file whatever its state; never raises."""


class ThreadedSink:
    """A sink that works in its own thread: the caller renders while the codec encodes, which holds no GIL."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._queue: queue.Queue[Frame | None] = queue.Queue(QUEUED_FRAMES)
        self._error: BaseException | None = None
        self._stopping = False
        self._thread = threading.Thread(target=self._work, name="film-encoder", daemon=True)
        self._thread.start()

    def put(self, frame: Frame) -> None:
        """Queue a copy of a frame, and raise the error of an earlier one; see `Sink`."""
        self._raise_error()
        self._queue.put(dataclasses.replace(frame, pixels=frame.pixels.copy()))  # the caller may reuse its buffer

    def close(self) -> None:
        """Encode the queued frames, then finish the file; errors are raised here."""
        self._queue.put(None)
        self._thread.join()
        self._raise_error()
        self._sink.close()

    def discard(self) -> None:
        """Drop the queued frames and close the file."""
        self._stopping = True
        self._queue.put(None)
        self._thread.join()
        self._sink.discard()

    def _work(self) -> None:
        while (frame := self._queue.get()) is not None:
            if self._error is None and not self._stopping:  # else only empty the queue, so that no one waits for it
                self._store(frame)

    def _store(self, frame: Frame) -> None:
        try:
            self._sink.put(frame)
        except BaseException as error:  # kept for the caller's thread
            self._error = error

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error


class FilmWriter:
    """A film being written; made by `heliograph.media.create_film`.

    The file grows under a hidden name beside the target and takes the target's place when finished, so that the target
    is always whole. Leaving the ``with`` block finishes the film, leaving it by an exception removes it. To keep the
    frames written so far after Ctrl-C, catch `KeyboardInterrupt` inside the block and call `finish`.
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
        """Append a frame; its pixels are copied, so the caller may reuse the array."""
        if not self._open:
            raise MediaError(f"{self.path} is already finished or aborted: no frame can be added")
        self._check(frame)
        try:
            self._sink.put(frame)
        except Exception:  # not Ctrl-C, which mostly arrives here, waiting for the encoder: the caller may finish
            self.abort()
            raise
        self._last_time_s = frame.time_s
        self.frames_written += 1

    def finish(self) -> None:
        """Finish the film and put it in its place; does nothing the second time."""
        if not self._open:
            return
        try:
            if not self.frames_written:
                raise MediaError(f"no frames were written to {self.path}: a film needs at least one")
            self._sink.close()
            _publish(self._partial, self.path)
        except BaseException:  # Ctrl-C while waiting too: no half film may stay
            self.abort()
            raise
        self._open = False

    def abort(self) -> None:
        """Throw the film away; the target, if there was one, stays as it was. Does nothing after `finish`."""
        if self._open:
            self._open = False
            self._sink.discard()
            self._partial.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self.abort()

    def _check(self, frame: Frame) -> None:
        if not isinstance(frame, Frame):
            raise MediaError(
                f"a film takes heliograph.Frame, not {shown(frame)}; write Frame(index, time_s, pixels, bits)"
            )
        check_pixels(frame, self.spec)
        if frame.time_s <= self._last_time_s:
            raise MediaError(f"frames must follow each other in time: got {frame.time_s} s after {self._last_time_s} s")


def check_pixels(frame: Frame, spec: FilmSpec) -> None:
    """Check that a frame fits a film in size, type and range of gray levels."""
    pixels, dtype = frame.pixels, np.dtype(np.uint8 if spec.bits == 8 else np.uint16)
    if pixels.shape != (spec.height, spec.width):
        got = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise MediaError(f"the film is {spec.width}x{spec.height} pixels, the frame is {got}")
    if pixels.dtype != dtype:
        raise MediaError(f"a film of {spec.bits} bits takes {dtype} pixels, got {pixels.dtype}")
    if frame.bits != spec.bits:
        raise MediaError(f"the film has {spec.bits} bits, the frame {frame.bits}: create the film with the same bits")
    if spec.bits not in (8, 16) and int(pixels.max()) >> spec.bits:
        raise MediaError(f"gray level {int(pixels.max())} does not fit into the film's {spec.bits} bits")


def partial_path(target: Path) -> Path:
    """Return a hidden, unique name beside the target, with its suffix, by which muxers choose the format."""
    with clear_write_errors(target):
        if target.is_dir():
            raise MediaError(f"{target} is a folder: give the film a file name in it")
        if not target.parent.is_dir():
            raise MediaError(f"the folder {target.parent} does not exist: create it first")
        return files.partial_path(target, target.suffix)


def write_error(error: Exception, target: Path) -> MediaError:
    """Return a codec's or file library's error as a MediaError of one line."""
    code = getattr(error, "errno", None)
    if code in (errno.ENOSPC, errno.EDQUOT) or "No space left" in str(error):
        return MediaError(f"disk full while writing {target}: free some space or write elsewhere (nothing was kept)")
    if code in (errno.EACCES, errno.EPERM, errno.EROFS):
        return MediaError(f"not allowed to write {target}: check the rights of its folder")
    reason = " ".join(str(getattr(error, "strerror", None) or error).split())
    return MediaError(f"cannot write {target}: {reason}")


def _publish(partial: Path, target: Path) -> None:
    try:
        with partial.open("rb+") as file:
            os.fsync(file.fileno())  # else a power cut could leave the new name on an empty file
        os.replace(partial, target)
    except OSError as error:
        raise write_error(error, target) from error
