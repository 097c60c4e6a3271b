"""Live camera as a film: frames as they come."""

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from heliograph.base.config import from_mapping
from heliograph.base.errors import MediaError, shown
from heliograph.media.live.camera import PREFIX, Camera, CameraForm, camera_kind
from heliograph.media.live.grabber import CameraCounts, CameraSource, CameraTiming, FrameQueue, Grabber
from heliograph.media.live.settings import CameraSettings
from heliograph.media.reader import FilmReader, Frames, Reading, checked_size
from heliograph.media.record import FASTEST_HZ


class LiveReader(FilmReader):
    """A live camera; see `FilmReader`. The film ends with the camera, or by `stop`.

    Times are by the camera's clock, from 0 at the first frame; numbers count the camera's frames, with a gap for
    each missing frame. Each iteration starts with the next frame of the camera. `frame_count` is None.

    Parameters
    ----------
    name
        Name of the camera, ``camera:KIND`` or ``camera:KIND:ADDRESS``.
    reading
        The rate replaces a missing rate of the camera; times do not depend on the rate.
    settings
        Requested settings.

    Attributes
    ----------
    form
        Form of the pictures, and the actual settings.
    say
        Called with a line of text when the camera is lost or comes back.
    timing
        Times of waiting for the camera, to be set before iterating.

    Raises
    ------
    HeliographError
        The camera is missing, refuses a setting, or has an unknown rate.
    """

    def __init__(self, name: str, reading: Reading, settings: CameraSettings) -> None:
        super().__init__(Path(name))
        kind, address = camera_kind(name)
        if reading.channel != CameraSettings().channel:
            settings = from_mapping(CameraSettings, asdict(settings) | {"channel": reading.channel})
        self._source = CameraSource(name, lambda: kind.make(address), settings)
        self._grabber: Grabber | None = None
        self._stopping = False
        self.say: Callable[[str], None] = lambda _: None
        self.timing = CameraTiming()
        self._camera: Camera | None
        self._camera, self.form = self._source.open()
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
        """Counts of the frames so far; None before the first iteration."""
        return self._grabber.counts if self._grabber else None

    def stop(self) -> None:
        """End the iteration before the next frame; a signal handler or another thread may call this."""
        self._stopping = True

    def close(self) -> None:
        """Release the camera; may be called twice."""
        super().close()
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _frames(self) -> Frames:
        camera, self._camera, self._stopping = self._camera or self._source.open()[0], None, False
        size = self.width * self.height * (1 if self.bits == 8 else 2)
        # 512 MB are half a second of 2048 x 1024 pixels at 500 frames/s
        most, wanted = max(1, (1 << 29) // size), round(self._source.settings.queue_s * self.claimed_hz)
        queue = FrameQueue(min(max(8, wanted), most))
        grabber = self._grabber = Grabber(self._source, camera, self.form, self.claimed_hz, queue, self.timing)
        try:
            while not (self._stopping or queue.over):
                frame = queue.get(self.timing.picture_s)
                self._report(grabber)
                if frame is not None:
                    yield frame
        finally:
            grabber.stop()
            self._report(grabber)
        if grabber.error is not None:
            raise grabber.error

    def _report(self, grabber: Grabber) -> None:
        while grabber.news:
            self.say(grabber.news.popleft())


def is_camera(path: Any) -> bool:
    """True if the name of a film denotes a live camera, and no file has this name."""
    return str(path).startswith(PREFIX) and not os.path.lexists(path)


def film_path(text: str | os.PathLike[str]) -> Path:
    """Return the path of a film or the name of a camera; ``./camera:x`` is a file."""
    if not isinstance(text, (str, os.PathLike)):
        raise MediaError(f"a film's path is text or a pathlib.Path, not {shown(text)}")
    path = Path(text)
    return path.absolute() if str(path).startswith(PREFIX) and not os.fspath(text).startswith(PREFIX) else path


def live_of(film: FilmReader) -> LiveReader | None:
    """Return the live camera behind a film or a crop; None for a recording."""
    source = getattr(film, "film", film)
    return source if isinstance(source, LiveReader) else None


def _rate(name: str, given_hz: float | None, settings: CameraSettings, form: CameraForm) -> float:
    """Return the user's rate, or the camera's."""
    rate_hz = given_hz or (None if settings.triggered else form.rate_hz)
    if rate_hz is None:
        reason = "its trigger sets its rate" if settings.triggered else "it does not say its rate"
        raise MediaError(f"{name}: {reason}; give it by --fps (rate_hz of open_film)")
    if not 0 < rate_hz <= FASTEST_HZ:
        raise MediaError(f"{name} says that it takes {rate_hz:g} frames/s; give its rate by --fps (rate_hz)")
    return rate_hz
