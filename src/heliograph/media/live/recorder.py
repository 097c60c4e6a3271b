"""Record the last seconds of a live camera after a failure."""

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media.film import create_film
from heliograph.media.hdf5 import SUFFIXES
from heliograph.media.reader import FilmReader
from heliograph.media.record import FASTEST_HZ


class Recorder:
    """Keeps the last frames; a failure writes a film, which replaces the previous film.

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
        most = max(2, max_bytes // size)
        self.seconds = min(seconds, most / source.rate_hz)
        self._frames: deque[Frame] = deque(maxlen=most)
        self._waiting: list[Frame] = []
        self._failed = False
        self._covered_s = float("-inf")
        self._executor = ThreadPoolExecutor(1, "recorder")
        self._running: Future[None] | None = None

    def saw(self, frame: Frame) -> None:
        """Keep a frame, and start a film after a failure."""
        while self._frames and self._frames[0].time_s < frame.time_s - self.seconds:
            self._frames.popleft()
        self._frames.append(frame)
        if self._failed and frame.time_s >= self._covered_s + self.seconds:
            self._covered_s, self._failed, self._waiting = frame.time_s, False, [*self._frames]
        if self._waiting and (self._running is None or self._running.done()):
            self._finish()
            self._running = self._executor.submit(self._write, self._waiting)
            self._waiting = []

    def failed(self) -> None:
        """Note a failure in the frames so far."""
        self._failed = True

    def close(self) -> None:
        """Write the remaining film."""
        self._finish()
        self._executor.shutdown()
        left = [*self._frames] if self._failed else self._waiting
        self._failed, self._waiting = False, []
        if left:
            self._write(left)

    def _finish(self) -> None:
        """Wait for the running film, and raise any error."""
        running, self._running = self._running, None
        if running is not None:
            running.result()

    def _write(self, frames: list[Frame]) -> None:
        source = self._source
        form: dict[str, Any] = {"width": source.width, "height": source.height, "bits": source.bits}
        rate_hz = min(source.rate_hz, FASTEST_HZ)
        with create_film(self.path, rate_hz=rate_hz, metadata=self._metadata, **form) as film:
            for frame in frames:
                film.write(frame)
        self.written = len(frames)
