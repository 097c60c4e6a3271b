"""Common interface for reading films, and frames read ahead in a thread."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import ClassVar, Self

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Frame
from heliograph.media.record import FASTEST_HZ, LARGEST, SLOWEST_HZ

Frames = Generator[Frame, None, None]

CHANNELS = ("luma", "red", "green", "blue")  # choices of a gray level for a colour


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Options for reading a film."""

    # Frames per second of the camera, 1e-6 to 1e6; None for the rate of the file
    rate_hz: float | None = None
    # True to stretch limited-range video (black at 16, white at 235) to full scale
    expand_range: bool = False
    # One of `CHANNELS`; gray films ignore it
    channel: str = "luma"

    def __post_init__(self) -> None:
        rate_hz = self.rate_hz
        if rate_hz is not None and not (isinstance(rate_hz, Real) and SLOWEST_HZ <= rate_hz <= FASTEST_HZ):
            raise MediaError(f"a camera takes {SLOWEST_HZ:g} to {FASTEST_HZ:g} frames/s, not {shown(rate_hz)}")
        if self.channel not in CHANNELS:
            raise MediaError(f"there is no channel {shown(self.channel)}: choose one of {', '.join(CHANNELS)}")


class FilmReader(ABC):
    """A film opened for reading: iterate it for the frames; each iteration starts at the first frame.

    Memory does not grow with the film. Pixels are read-only. Use it as a context manager, or call `close`.
    """

    # True if frames are decoded, which takes longer than a change of threads
    _decodes: ClassVar[bool] = False
    # False if a decoder limits the levels
    _checks_levels: bool = True

    path: Path
    width: int
    height: int
    bits: int
    claimed_hz: float
    frame_count: int | None
    metadata: dict[str, str]

    def __init__(self, path: Path, rate_hz: float | None = None) -> None:
        self.path, self._true_hz = path, rate_hz
        self.frame_count, self.metadata, self.read_s = None, {}, 0.0
        self._running: Frames | None = None
        self._closed = False

    @property
    def rate_hz(self) -> float:
        """Frames per second of the camera: the rate given to `open_film`, or the rate of the file."""
        return self._true_hz or self.claimed_hz

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order of time."""
        if self._closed:
            raise MediaError(f"{self.path} is closed: iterate it inside its 'with' block")
        self._running = self._clocked()
        return self._running

    def _clocked(self) -> Frames:
        """Yield the frames and count the reading time."""
        with closing(read_ahead(self._checked()) if self._decodes else self._checked()) as frames:
            while True:
                start = time.perf_counter()
                frame = next(frames, None)
                self.read_s += time.perf_counter() - start
                if frame is None:
                    return
                yield frame

    def _checked(self) -> Frames:
        """Yield read-only frames, and refuse a level above the film's bits."""
        with closing(self._frames()) as frames:
            for count, frame in enumerate(frames):
                pixels, bits = frame.pixels, frame.bits
                if self._checks_levels and bits < 8 * pixels.itemsize and int(pixels.max()) >> bits:
                    level = f"a gray level of {int(pixels.max())} after {count} whole frames"
                    raise MediaError(f"{self.path} has {level}, and its header says {bits} bits: correct the header")
                pixels.setflags(write=False)  # receivers copy writable pixels
                yield frame

    @abstractmethod
    def _frames(self) -> Frames: ...

    def close(self) -> None:
        """Close the film; may be called twice."""
        self._closed = True
        if self._running is not None:
            self._running.close()
        self._running = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_ahead(frames: Frames, queued: int = 8) -> Frames:
    """Yield frames in order while a thread reads the next ones.

    The thread starts with the first request. At the last frame, at an error, at Ctrl-C or when the iterator is closed,
    the thread closes `frames`, and so the film's file, and ends.
    """
    with ThreadPoolExecutor(1, "film-reader") as thread:
        pending = deque(thread.submit(next, frames, None) for _ in range(queued + 1))
        try:
            while (frame := pending.popleft().result()) is not None:
                pending.append(thread.submit(next, frames, None))
                yield frame
        finally:
            for future in pending:
                future.cancel()
            thread.submit(frames.close).result()


def checked_size(path: Path, width: int, height: int) -> None:
    """Refuse an impossible size."""
    if not 0 < width * height <= LARGEST:
        raise MediaError(f"{path} has frames of {width}x{height} pixels: it is no film, or damaged; copy it again")


@contextmanager
def clear_read_errors(path: Path | str) -> Iterator[None]:
    """Turn an OSError into a MediaError."""
    try:
        yield
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror or error}") from error


def truncated(path: Path, count: int) -> MediaError:
    """Return the error for a truncated file."""
    return MediaError(f"{path} ends in the middle, after {count} whole frames: copy it again")


def read_blocks(path: Path, places: Iterable[int], size: int) -> Iterator[bytearray]:
    """Yield the bytes of each frame of a file, writable because kernels are compiled for writable arrays."""
    with clear_read_errors(path), path.open("rb") as file:
        length = path.stat().st_size
        for count, place in enumerate(places):
            if place + size > length:  # checked before the allocation
                raise truncated(path, count)
            file.seek(place)
            block = bytearray(size)
            if file.readinto(block) < size:
                raise truncated(path, count)
            yield block
