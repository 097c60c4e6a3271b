"""Thread for the pictures of a camera, with numbers, times and reconnection."""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from heliograph.base.errors import HeliographError, MediaError, brief
from heliograph.base.frames import Frame
from heliograph.media.live.camera import Camera, CameraCrashError, CameraForm, CameraLostError
from heliograph.media.live.numbering import Numbering
from heliograph.media.live.settings import CameraSettings


class FrameQueue:
    """Queue of frames before the receiver. A full queue drops new frames until half of the queue is free.

    Lost frames then form long runs, and so do received frames, which can hold complete packets.
    """

    def __init__(self, most: int):
        self.dropped, self.over = 0, False
        self._most, self._frames = most, queue.SimpleQueue[Frame | None]()
        self._full = self._ended = False

    def put(self, frame: Frame) -> None:
        """Queue a frame, or drop it."""
        self._full = len(self) >= self._most or (self._full and len(self) > self._most / 2)
        if self._full:
            self.dropped += 1
        else:
            self._frames.put(frame)

    def end(self) -> None:
        """Mark the end of the frames."""
        self._ended = True
        self._frames.put(None)

    def __len__(self) -> int:
        return max(0, self._frames.qsize() - self._ended)

    def get(self, wait_s: float) -> Frame | None:
        """Take the oldest frame; None if none comes in time, and after the last frame, when the queue is over."""
        if self.over:
            return None
        try:
            frame = self._frames.get(timeout=wait_s)
        except queue.Empty:
            return None
        self.over = frame is None
        return frame


@dataclass(frozen=True, slots=True)
class CameraSource:
    """A camera that can be opened again."""

    name: str
    make: Callable[[], Camera]
    settings: CameraSettings

    def open(self) -> tuple[Camera, CameraForm]:
        """Make and open the camera; close it again after a failure."""
        camera: Camera | None = None
        try:
            camera = self.make()
            return camera, camera.open(self.settings)
        except Exception as error:  # cameras may be user code
            if camera is not None:
                camera.close()
            if isinstance(error, HeliographError):
                raise
            raise CameraCrashError(f"{self.name} cannot be opened: {type(error).__name__}: {brief(error)}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTiming:
    """Times of waiting for a camera, in s."""

    # Longest single wait for a picture, and so for the reaction to a stop
    picture_s: float = 0.1
    # Silence after which a freely running camera counts as lost; longer than usual exposures
    silent_s: float = 5.0
    # Pauses before the attempts to reach a lost camera; the last value repeats. Six take a minute, a camera's start
    retry_s: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
    # Time for the camera to end
    closing_s: float = 5.0


@dataclass(frozen=True, slots=True)
class CameraCounts:
    """Counts of a camera's frames so far.

    Attributes
    ----------
    frames
        Complete frames.
    lost
        Frames missing in the camera's numbers.
    incomplete
        Partly received frames; they are left out.
    skipped
        Frame periods missing in the camera's stamps.
    dropped
        Complete frames dropped by the full queue of the receiver.
    waiting
        Complete frames in the queue; they are left out if the receiver stops.
    jumps
        Number of resets of the camera's clock.
    reconnections
        Number of successful reconnections.
    host_clock
        True if times come from the host's clock, as the camera has no stamps.
    rate_hz
        Frames per second by the stamps of the last frames.
    """

    frames: int
    lost: int
    incomplete: int
    skipped: int
    dropped: int
    waiting: int
    jumps: int
    reconnections: int
    host_clock: bool
    rate_hz: float


class Grabber:
    """Queues the pictures of a camera in a thread until it is stopped or the camera ends."""

    def __init__(
        self, source: CameraSource, camera: Camera, form: CameraForm, rate_hz: float, frames: FrameQueue,
        timing: CameraTiming,
    ):  # fmt: skip
        self.error: MediaError | None = None
        self.news: deque[str] = deque()
        self._source, self._form, self._queue, self._timing = source, form, frames, timing
        self._camera: Camera | None = camera
        self._name, self._settings = source.name, source.settings
        self._numbering = Numbering(rate_hz, even=not source.settings.triggered)
        self._frames = self._reconnections = self._tries = 0
        self._stopping = threading.Event()
        self._quiet = False
        self._heard_s = time.monotonic()
        self._end_s = self._heard_s + (self._settings.duration_s or float("inf"))
        self._thread = threading.Thread(target=self._work, name="camera", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread and release the camera."""
        self._stopping.set()
        self._thread.join(self._timing.closing_s)
        if self._thread.is_alive():
            self.news.append(f"{self._name} did not stop within {self._timing.closing_s:g} s; it is left as it is")

    @property
    def counts(self) -> CameraCounts:
        """Counts of the frames so far."""
        numbering = self._numbering
        return CameraCounts(
            self._frames, numbering.lost, numbering.incomplete, numbering.skipped, self._queue.dropped,
            len(self._queue), numbering.jumps, self._reconnections, numbering.host_clock, 1 / numbering.period_s,
        )  # fmt: skip

    def _work(self) -> None:
        try:
            self._run()
        except HeliographError as error:
            self.error = error if isinstance(error, MediaError) else MediaError(str(error))
        except BaseException as error:  # cameras may be user code
            self.error = CameraCrashError(f"{self._name} ended by {type(error).__name__}: {brief(error)}")
            self.error.__cause__ = error
        finally:
            try:
                self._release()
            finally:  # the receiver waits for the end
                self._queue.end()

    def _run(self) -> None:
        while self._camera is not None and not self._over:
            try:
                pictures = self._camera.frames(min(self._timing.picture_s, max(0.0, self._end_s - time.monotonic())))
                if pictures is None:
                    return
                for picture in pictures:
                    if picture.pixels is None:
                        self._numbering.broke()
                        continue
                    place = self._numbering.place(picture.number, picture.stamp_ns, time.monotonic_ns())
                    if place is not None:
                        self._frames += 1
                        self._queue.put(Frame(*place, picture.pixels, self._form.bits).copied())
                self._check_silence(bool(pictures))
            except CameraLostError as error:
                self._reconnect(error)

    @property
    def _over(self) -> bool:
        return self._stopping.is_set() or time.monotonic() >= self._end_s

    def _check_silence(self, heard: bool) -> None:
        """Report a silent camera."""
        now_s, silent_s = time.monotonic(), self._timing.silent_s
        if heard:
            self._heard_s, self._tries, self._quiet = now_s, 0, False
        if now_s - self._heard_s < max(silent_s, 5 * self._numbering.period_s) or self._quiet:
            return
        if self._settings.triggered:
            self._quiet = True
            self.news.append(f"{self._name}: no pulse of {self._settings.trigger} for {silent_s:g} s; still waiting")
        elif not self._frames and not self._numbering.incomplete:
            cure = "check its trigger, the firewall, and other programs with the camera"
            raise MediaError(f"{self._name} is set, but sends no frames: {cure}")
        else:
            raise CameraLostError(f"no frame came for {silent_s:g} s")

    def _reconnect(self, error: MediaError) -> None:
        """Open a lost camera again, or give up."""
        lost_s, why = time.monotonic(), str(error)
        while True:
            self._tries += 1
            if self._tries > self._settings.reconnect:
                raise MediaError(f"{self._name} is lost after {self._frames} frames ({why}): check cable and power")
            wait_s = self._timing.retry_s[min(self._tries, len(self._timing.retry_s)) - 1]
            of = f"try {self._tries} of {self._settings.reconnect}"
            self.news.append(f"{self._name} is lost after {self._frames} frames ({why}); {of} in {wait_s:g} s")
            self._release()  # after the report: a lost camera answers late
            self._stopping.wait(min(wait_s, max(0.0, self._end_s - time.monotonic())))
            if self._over:
                return
            try:
                self._camera, form = self._source.open()
                break
            except CameraCrashError:
                raise
            except HeliographError as failed:
                why = str(failed)
        before, now = (f"{each.width}x{each.height} pixels of {each.bits} bits" for each in (self._form, form))
        if now != before:
            raise MediaError(f"{self._name} came back with {now} in place of {before}: start again")
        self._reconnections += 1
        self._numbering.restart()
        self._heard_s = time.monotonic()
        self.news.append(f"{self._name} is back after {self._heard_s - lost_s:.1f} s")

    def _release(self) -> None:
        camera, self._camera = self._camera, None
        try:
            if camera is not None:
                camera.close()
        except BaseException as error:  # the camera is not needed any more
            self.news.append(f"{self._name} could not be closed: {type(error).__name__}: {brief(error)}")
