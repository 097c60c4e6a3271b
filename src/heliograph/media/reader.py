"""The common interface for reading films."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self

from heliograph.base.errors import MediaError
from heliograph.base.frames import LATEST_S, Frame, Pixels
from heliograph.media.ahead import read_ahead

MOST_PIXELS = 1 << 27
"""Most pixels of a frame: twice those of the largest camera of the settings. A damaged film may claim more."""


def checked_size(path: Path, width: int, height: int) -> None:
    """Check the size of a film's frames."""
    if not 0 < width * height <= MOST_PIXELS:
        raise MediaError(f"{path} has frames of {width}x{height} pixels: it is no film, or damaged; copy it again")


def checked_time(path: Path, time_s: float, count: int) -> float:
    """Return the time of a frame if it is one."""
    if not abs(time_s) <= LATEST_S:
        raise MediaError(
            f"{path} has a frame at {time_s:g} s after {count} whole frames: times are in seconds, at most "
            f"{LATEST_S:g}; correct them, or cut the film there"
        )
    return time_s


def check_levels(path: Path, pixels: Pixels, bits: int, count: int) -> None:
    """Check that gray levels have no more bits than the file says."""
    if bits < 8 * pixels.itemsize and int(pixels.max()) >> bits:
        raise MediaError(
            f"{path} has a gray level of {int(pixels.max())} after {count} whole frames, and its header says {bits} "
            "bits: correct the header, or save the recording again"
        )


class FilmReader(ABC):
    """A film opened for reading: iterate it for its frames, one at a time; each iteration starts at the first frame.

    Memory does not grow with the film. Use it as a context manager, or call `close`.
    """

    _decodes: ClassVar[bool] = False
    """Whether its frames are decoded, which takes longer than to hand them from thread to thread."""

    _checks_levels: bool = True
    """False if a decoder keeps the levels within their bits."""

    path: Path
    width: int
    height: int
    bits: int
    claimed_hz: float
    frame_count: int | None
    metadata: dict[str, str]
    faster: tuple[str, ...] = ()

    def __init__(self, path: Path, rate_hz: float | None = None) -> None:
        self.path, self._true_hz = path, rate_hz
        self.read_s = 0.0
        self._running: Iterator[Frame] | None = None
        self._closed = False

    @property
    def rate_hz(self) -> float:
        """Frames per second of the camera: as it was said where the film was opened, or else as the file says."""
        return self._true_hz or self.claimed_hz

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order of time."""
        if self._closed:
            raise MediaError(f"{self.path} is closed: iterate it inside its 'with' block")
        frames = self._checked()
        self._running = self._clocked(read_ahead(frames) if self._decodes else frames)
        return self._running

    def _clocked(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The frames, the time that they take counted."""
        try:
            while True:
                start = time.perf_counter()
                frame = next(frames, None)
                self.read_s += time.perf_counter() - start
                if frame is None:
                    return
                yield frame
        finally:
            _stop(frames)

    def _checked(self) -> Iterator[Frame]:
        """Frames whose levels fit into the film's bits."""
        frames = self._frames()
        try:
            for count, frame in enumerate(frames):
                if self._checks_levels:
                    check_levels(self.path, frame.pixels, frame.bits, count)
                yield frame
        finally:
            _stop(frames)

    @abstractmethod
    def _frames(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Close the film; may be called twice."""
        self._closed = True
        _stop(self._running)
        self._running = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _stop(frames: Iterator[Frame] | None) -> None:
    """Close a generator of frames: it holds the file open until then."""
    stop = getattr(frames, "close", None)
    if stop is not None:
        stop()
