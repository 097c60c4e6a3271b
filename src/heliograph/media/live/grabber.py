"""The thread that takes a camera's pictures, numbers them, and looks for the camera again where it was lost."""

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

DRAINED = 0.5
"""Fraction of a full queue that must be taken before frames are queued again. Chosen: frames are then dropped in one
run, and come in one: what is between can hold whole packets, every second frame cannot."""


class FrameQueue:
    """Frames that wait for the receiver. Where it is full, new frames are dropped until half of it is taken."""

    def __init__(self, most: int):
        self.dropped = 0
        self._most, self._frames = most, deque[Frame]()
        self._changed = threading.Condition()
        self._full = self._ended = False

    def put(self, frame: Frame) -> None:
        """Queue a frame, or drop it."""
        with self._changed:
            waiting = len(self._frames)
            self._full = waiting >= self._most or (self._full and waiting > DRAINED * self._most)
            if self._full:
                self.dropped += 1
                return
            self._frames.append(frame)
            self._changed.notify()

    def end(self) -> None:
        """Say that no frame comes any more."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    @property
    def over(self) -> bool:
        """Whether all frames are taken and none comes any more."""
        with self._changed:
            return self._ended and not self._frames

    def __len__(self) -> int:
        return len(self._frames)

    def get(self, wait_s: float) -> Frame | None:
        """Take the oldest frame; None where none comes in time."""
        with self._changed:
            if not self._frames and not self._ended:
                self._changed.wait(wait_s)
            return self._frames.popleft() if self._frames else None


WAIT_S = 0.1
"""Longest wait for a picture at a time: within it a reader notices that it is to end. Chosen."""

SILENT_S = 5.0
"""Time without a picture from which on a camera that runs freely counts as lost. Chosen: longer than the longest usual
exposure, and than a switch takes to find its way."""

WAITS_S = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
"""Times between the tries to reach a lost camera; the last one holds for all after it. Chosen: the first six take a
minute, in which a camera that was plugged in again has started."""

CLOSING_S = 5.0
"""Time that a camera gets to end. Chosen; its thread ends with the program in any case."""


@dataclass(frozen=True, slots=True)
class CameraCounts:
    """What became of a camera's frames so far.

    Attributes
    ----------
    frames
        Frames that came whole.
    lost
        Frames that the camera numbered and of which nothing came.
    incomplete
        Frames of which a part came; they are left out.
    skipped
        Frame periods for which the camera has no frame, by its stamps.
    dropped
        Frames that came whole and found no place before the receiver.
    waiting
        Frames that came whole and still wait for the receiver; they are left out where it is stopped.
    jumps
        Times the camera's clock was set or began anew.
    reconnections
        Times the camera was lost and came back.
    host_clock
        Whether times are the host's, as the camera has no stamps.
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
    """Takes a camera's pictures into a queue, in a thread of its own, until it is stopped or the camera ends."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Camera],
        camera: Camera,
        form: CameraForm,
        settings: CameraSettings,
        rate_hz: float,
        queue: FrameQueue,
    ):
        self.error: MediaError | None = None
        self.news: deque[str] = deque()
        self._name, self._make, self._camera, self._form = name, make, camera, form
        self._settings, self._queue = settings, queue
        self._numbering = Numbering(rate_hz, even=not settings.triggered)
        self._frames = self._reconnections = self._tries = 0
        self._stopping = threading.Event()
        self._heard_s = self._end_s = 0.0
        self._quiet = False
        self._thread = threading.Thread(target=self._work, name="camera", daemon=True)

    def start(self) -> None:
        """Begin to take pictures."""
        self._heard_s = time.monotonic()
        self._end_s = self._heard_s + (self._settings.duration_s or float("inf"))
        self._thread.start()

    def stop(self) -> None:
        """Take no more pictures, and let go of the camera; waits for that at most `CLOSING_S`."""
        self._stopping.set()
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            self.news.append(f"{self._name} did not stop within {CLOSING_S:g} s; it is left as it is")

    @property
    def counts(self) -> CameraCounts:
        """What became of the frames so far."""
        kept = self._numbering
        return CameraCounts(
            frames=self._frames,
            lost=kept.lost,
            incomplete=kept.incomplete,
            skipped=kept.skipped,
            dropped=self._queue.dropped,
            waiting=len(self._queue),
            jumps=kept.jumps,
            reconnections=self._reconnections,
            host_clock=kept.host_clock,
            rate_hz=1 / kept.period_s,
        )

    def _work(self) -> None:
        try:
            self._run()
        except HeliographError as error:
            self.error = error if isinstance(error, MediaError) else MediaError(str(error))
        except BaseException as error:  # whatever goes wrong within somebody else's camera
            self.error = CameraCrashError(f"{self._name} ended by {type(error).__name__}: {brief(error)}")
            self.error.__cause__ = error
        finally:
            try:
                self._let_go()
            finally:  # the receiver waits for it
                self._queue.end()

    def _run(self) -> None:
        while not self._over:
            try:
                pictures = self._camera.frames(min(WAIT_S, max(0.0, self._end_s - time.monotonic())))
                if pictures is None:
                    return
                for picture in pictures:
                    if picture.pixels is None:
                        self._numbering.broke()
                        continue
                    place = self._numbering.place(picture.number, picture.stamp_ns, time.monotonic_ns())
                    if place is not None:
                        self._frames += 1
                        frame = Frame(place.index, place.time_s, picture.pixels, self._form.bits)
                        self._queue.put(frame.copied())
                self._listen(bool(pictures))
            except CameraLostError as error:
                self._look_again(error)

    @property
    def _over(self) -> bool:
        return self._stopping.is_set() or time.monotonic() >= self._end_s

    def _listen(self, heard: bool) -> None:
        """Notice where nothing comes any more."""
        now_s = time.monotonic()
        if heard:
            self._heard_s, self._tries, self._quiet = now_s, 0, False
        if now_s - self._heard_s < max(SILENT_S, 5 * self._numbering.period_s) or self._quiet:
            return
        if self._settings.triggered:
            self._quiet = True
            self.news.append(f"{self._name}: no pulse of {self._settings.trigger} for {SILENT_S:g} s; still waiting")
        elif not self._frames and not self._numbering.incomplete:
            raise MediaError(
                f"{self._name} is set, but sends no frames: see that its trigger is off, that no firewall keeps its "
                "packets back, and that nobody else uses it"
            )
        else:
            raise CameraLostError(f"no frame came for {SILENT_S:g} s")

    def _look_again(self, error: MediaError) -> None:
        """Open a camera that was lost once more, or give up."""
        self._let_go()
        lost_s, why = time.monotonic(), str(error)
        while True:
            self._tries += 1
            if self._tries > self._settings.reconnect:
                raise MediaError(f"{self._name} is lost after {self._frames} frames ({why}): check cable and power")
            wait_s = WAITS_S[min(self._tries, len(WAITS_S)) - 1]
            of = f"try {self._tries} of {self._settings.reconnect}"
            self.news.append(f"{self._name} is lost after {self._frames} frames ({why}); {of} in {wait_s:g} s")
            self._stopping.wait(min(wait_s, max(0.0, self._end_s - time.monotonic())))
            if self._over:
                return
            try:
                self._camera = self._make()
                form = self._camera.open(self._settings)
                break
            except HeliographError as failed:
                self._let_go()
                why = str(failed)
        if (form.width, form.height, form.bits) != (self._form.width, self._form.height, self._form.bits):
            raise MediaError(
                f"{self._name} came back with {form.width}x{form.height} pixels of {form.bits} bits in place of "
                f"{self._form.width}x{self._form.height} of {self._form.bits}: begin anew"
            )
        self._reconnections += 1
        self._numbering.restart()
        self._heard_s = time.monotonic()
        self.news.append(f"{self._name} is back after {self._heard_s - lost_s:.1f} s")

    def _let_go(self) -> None:
        try:
            self._camera.close()
        except BaseException as error:  # somebody else's camera, which is not needed any more
            self.news.append(f"{self._name} could not be closed: {type(error).__name__}: {brief(error)}")
