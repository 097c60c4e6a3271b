"""Record the last seconds of a live camera after a failure."""

import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media.film import create_film
from heliograph.media.hdf5 import SUFFIXES
from heliograph.media.reader import FilmReader
from heliograph.media.record import FASTEST_HZ


class Recorder:
    """Keeps the last frames, and writes them to a film after a failure; each film replaces the previous one.

    Films do not overlap: a failure within the time of a new film is in the next film. A thread writes the films
    completely or not at all. Memory holds up to three times `max_bytes` of frames if the disk is slow.
    """

    def __init__(
        self, path: Path, seconds: float, source: FilmReader, metadata: Mapping[str, str], max_bytes: int = 1 << 30
    ):
        if path.suffix.lower() not in SUFFIXES:
            raise MediaError(f"{path}: a camera is recorded as HDF5, so its name ends in one of {', '.join(SUFFIXES)}")
        if not path.parent.is_dir() or path.is_dir():
            raise MediaError(f"cannot record to {path}: name a file in a folder that exists")
        self.written = 0
        self.path, self._source, self._metadata = path, source, {**source.metadata, **metadata}
        size = source.width * source.height * (1 if source.bits == 8 else 2)
        self._most = max(2, max_bytes // size)
        self.seconds = min(seconds, self._most / source.rate_hz)
        self._frames: deque[Frame] = deque(maxlen=self._most)
        self._waiting: list[Frame] = []
        self._failed = False
        self._covered_s = float("-inf")
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    def saw(self, frame: Frame) -> None:
        """Keep a frame, and start a film after a failure."""
        while self._frames and self._frames[0].time_s < frame.time_s - self.seconds:
            self._frames.popleft()
        self._frames.append(frame)
        if self._failed and frame.time_s >= self._covered_s + self.seconds:
            self._covered_s, self._failed, self._waiting = frame.time_s, False, [*self._frames]
        if self._waiting and not (self._thread is not None and self._thread.is_alive()):
            self._finish()
            self._thread = threading.Thread(target=self._write, args=(self._waiting,), name="recorder")
            self._waiting = []
            self._thread.start()

    def failed(self) -> None:
        """Note a failure in the frames so far."""
        self._failed = True

    def close(self) -> None:
        """Write the remaining film."""
        self._finish()
        left = [*self._frames] if self._failed else self._waiting
        self._failed, self._waiting = False, []
        if left:
            self._write(left)
            self._finish()

    def _finish(self) -> None:
        """Wait for the running film, and raise its error."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _write(self, frames: list[Frame]) -> None:
        try:
            with create_film(
                self.path,
                width=self._source.width,
                height=self._source.height,
                rate_hz=min(self._source.rate_hz, FASTEST_HZ),
                bits=self._source.bits,
                metadata=self._metadata,
            ) as film:
                for frame in frames:
                    film.write(frame)
            self.written = len(frames)
        except BaseException as error:  # raised by `saw` or `close`, in the receiver's thread
            self._error = error
