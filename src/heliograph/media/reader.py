"""Common interface for reading films, and frames read ahead in a thread."""

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import LATEST_S, Frame, Pixels
from heliograph.media.record import FASTEST_HZ, SLOWEST_HZ

CHANNELS = ("luma", "red", "green", "blue")
"""What is taken of a colour for a gray level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """How a film is to be read."""

    # Frames per second that the camera took, 1e-6 to 1e6; None believes the file
    rate_hz: float | None = None
    # Whether to stretch limited-range video (black at 16, white at 235) to the full scale
    expand_range: bool = False
    # One of `CHANNELS`; of gray films all of them are the gray levels
    channel: str = "luma"

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not _is_rate(self.rate_hz):
            raise MediaError(
                f"a camera takes {SLOWEST_HZ:g} to {FASTEST_HZ:g} frames/s, not {shown(self.rate_hz)}; give the rate "
                "it was set to"
            )
        if self.channel not in CHANNELS:
            raise MediaError(f"there is no channel {shown(self.channel)}: choose one of {', '.join(CHANNELS)}")


def _is_rate(value: object) -> bool:
    return isinstance(value, Real) and bool(value <= FASTEST_HZ) and not value < SLOWEST_HZ


FRAMES_AHEAD = 8
"""Frames that wait for their use at most; bounds memory. Chosen, as for films that are written: a receiver that stops
for 50 ms, looking for an array, then goes on with frames of FFV1 that were decoded meanwhile."""


def read_ahead(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield frames in their order while the next ones are read.

    The thread begins with the first frame that is asked for. It ends with the frames, or where no more are asked for:
    by an error, by Ctrl-C, or when the iterator is closed. It is then waited for, so that the film's file is closed.
    """
    waiting: queue.Queue[Frame | BaseException | None] = queue.Queue(FRAMES_AHEAD)
    wanted = threading.Event()
    wanted.set()
    thread = threading.Thread(target=_read, args=(frames, waiting, wanted), name="film-reader", daemon=True)
    thread.start()
    ended = False
    try:
        while True:
            got = waiting.get()
            if not isinstance(got, Frame):
                ended = True
                if got is not None:
                    raise got
                return
            yield got
    finally:
        wanted.clear()
        while not ended:  # the thread may wait for room
            ended = not isinstance(waiting.get(), Frame)
        thread.join()


def _read(
    frames: Iterator[Frame], waiting: "queue.Queue[Frame | BaseException | None]", wanted: threading.Event
) -> None:  # fmt: skip
    """Put frames in the queue while they are wanted, and last of all the error that ended them, or None."""
    end: BaseException | None = None
    try:
        for frame in frames:
            waiting.put(frame)
            if not wanted.is_set():
                break
        close = getattr(frames, "close", None)
        if close is not None:
            close()
    except BaseException as error:  # raised in the thread that asks for the frames, which waits for an end
        end = error
    waiting.put(end)


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

    Memory does not grow with the film. Pixels are read-only. Use it as a context manager, or call `close`.
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
                # receivers copy pixels that may change
                frame.pixels.setflags(write=False)
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
