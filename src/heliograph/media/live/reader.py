"""Live camera as a film: frames as they come."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from heliograph.base.config import from_mapping, to_mapping
from heliograph.base.errors import HeliographError, MediaError, brief
from heliograph.base.frames import Frame
from heliograph.media.live.camera import PREFIX, Camera, CameraCrashError, CameraForm, camera_kind
from heliograph.media.live.grabber import WAIT_S, CameraCounts, FrameQueue, Grabber
from heliograph.media.live.settings import CameraSettings
from heliograph.media.reader import FilmReader, Reading, checked_size
from heliograph.media.record import FASTEST_HZ

FEWEST_QUEUED = 8
"""Frames that the queue holds at least. Chosen; a slow camera's come one by one."""

MOST_QUEUED = 1 << 29
"""Most bytes of frames in the queue. Chosen: half a second of 2048 x 1024 pixels at 500 frames/s."""


class LiveReader(FilmReader):
    """A live camera; see `FilmReader`. Frames are those from now on, until it is stopped or the camera ends.

    Times are by the camera's own clock, from 0 at the first frame; numbers count its frames, with a gap for each that
    is missing. Each iteration begins with the next frame of the camera. It has no `frame_count`.

    Parameters
    ----------
    name
        The camera's name, ``camera:KIND`` or ``camera:KIND:ADDRESS``.
    reading
        Its rate is that of the camera's exposures where the camera does not know it; times are not changed by it.
    settings
        What the camera is asked for.

    Attributes
    ----------
    form
        Form of its pictures, and what it made of the settings.
    say
        Called with a line of text where the camera is lost or comes back; set it to hear of that.

    Raises
    ------
    HeliographError
        There is no such camera, it cannot be set so, or its rate is not known.
    """

    def __init__(self, name: str, reading: Reading, settings: CameraSettings) -> None:
        super().__init__(Path(name))
        kind, address = camera_kind(name)
        self._name = name
        if reading.channel != CameraSettings().channel:
            settings = from_mapping(CameraSettings, to_mapping(settings) | {"channel": reading.channel})
        self._settings = settings
        self._make: Callable[[], Camera] = lambda: kind.make(address)
        self._camera: Camera | None = None
        self._grabber: Grabber | None = None
        self._stopping = False
        self.say: Callable[[str], None] = _hush
        self.form = self._open()
        self.width, self.height, self.bits = self.form.width, self.form.height, self.form.bits
        self.frame_count = None
        self.metadata = {"camera": self.form.model or name}
        self.metadata |= {f"camera_{key}": str(value) for key, value in self.form.settings.items()}
        try:
            checked_size(self.path, self.width, self.height)
            self.claimed_hz = _rate(name, reading.rate_hz, settings, self.form)
        except MediaError:
            self.close()
            raise

    @property
    def counts(self) -> CameraCounts | None:
        """What became of the frames so far; None before the first iteration."""
        return self._grabber.counts if self._grabber else None

    def stop(self) -> None:
        """End the iteration before its next frame; may be called by a signal's handler or from another thread."""
        self._stopping = True

    def close(self) -> None:
        """Let go of the camera; may be called twice."""
        super().close()
        self._let_go()

    def _open(self) -> CameraForm:
        """Make and open the camera."""
        try:
            self._camera = self._make()
            return self._camera.open(self._settings)
        except HeliographError:
            self._let_go()
            raise
        except Exception as error:  # whatever goes wrong within somebody else's camera
            self._let_go()
            reason = f"{type(error).__name__}: {brief(error)}"
            raise CameraCrashError(f"{self._name} cannot be opened: {reason}") from error

    def _let_go(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _frames(self) -> Iterator[Frame]:
        if self._camera is None:
            self._open()
        camera, self._camera, self._stopping = self._camera, None, False
        assert camera is not None
        size = self.width * self.height * (1 if self.bits == 8 else 2)
        most = min(max(FEWEST_QUEUED, round(self._settings.queue_s * self.claimed_hz)), max(1, MOST_QUEUED // size))
        queue = FrameQueue(most)
        grabber = self._grabber = Grabber(
            self._name, self._make, camera, self.form, self._settings, self.claimed_hz, queue
        )
        grabber.start()
        try:
            while not (self._stopping or queue.over):
                frame = queue.get(WAIT_S)
                self._tell(grabber)
                if frame is not None:
                    yield frame
        finally:
            grabber.stop()
            self._tell(grabber)
        if grabber.error is not None:
            raise grabber.error

    def _tell(self, grabber: Grabber) -> None:
        while grabber.news:
            self.say(grabber.news.popleft())


def is_camera(path: Any) -> bool:
    """Return True if a film's name is that of a live camera, and no file has that name."""
    return str(path).startswith(PREFIX) and not os.path.lexists(path)


def film_path(text: str | os.PathLike[str]) -> Path:
    """Return the path of a film or the name of a camera; ``./camera:x`` is a file."""
    path = Path(text)
    named_file = str(path).startswith(PREFIX) and not os.fspath(text).startswith(PREFIX)
    return path.absolute() if named_file else path


def live_of(film: FilmReader) -> LiveReader | None:
    """Return the live camera behind a film, which may be seen through a crop; None of a recording."""
    behind = getattr(film, "film", film)
    return behind if isinstance(behind, LiveReader) else None


def _rate(name: str, said_hz: float | None, settings: CameraSettings, form: CameraForm) -> float:
    """Frames a second, as the user or else the camera says."""
    rate_hz = said_hz or (None if settings.triggered else form.rate_hz)
    if rate_hz is None:
        why = "its trigger sets its rate" if settings.triggered else "it does not say its rate"
        raise MediaError(f"{name}: {why}; give it by --fps (rate_hz of open_film)")
    if not 0 < rate_hz <= FASTEST_HZ:
        raise MediaError(f"{name} says that it takes {rate_hz:g} frames/s; give its rate by --fps (rate_hz)")
    return rate_hz


def _hush(_text: str, /) -> None:
    """Say nothing."""
