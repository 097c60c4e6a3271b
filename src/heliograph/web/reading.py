"""Reception of an uploaded film or of the camera of a browser: the link is estimated, and the results are reported."""

import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, product
from pathlib import Path
from typing import Any

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.measure.journal import Journal
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import FilmReader, open_film
from heliograph.probe import probe_film
from heliograph.probe.words import in_sentences
from heliograph.web.camera_frames import CameraFrames, Frames
from heliograph.web.failures import Bundles, FailureRecorder
from heliograph.web.link_estimate import LinkRequest, Tell, estimate_link, shows_light

WINDOW_S, WINDOW_BYTES = 7.0, 160 << 20
"""Frames for the estimate of a link: two packets of 3 s and a pause; 170 frames of 1280 x 720 pixels."""

PATIENCE_S = 12.0
"""Waiting time in s for a codeword before a diagnosis and a new estimate: three packets."""

PROBE_FRAMES = 128
"""Frames of a diagnosis: some seconds of computing."""


class Timer:
    """Limit of the rate of rows about progress."""

    def __init__(self) -> None:
        self._last_s = 0.0

    def is_due(self) -> bool:
        """Return True every 0.25 s."""
        now = time.monotonic()
        if now - self._last_s <= 0.25:
            return False
        self._last_s = now
        return True


@dataclass(slots=True)
class _Attempt:
    """State of a reception with one estimate of the link."""

    last_frames: deque[Frame] = field(default_factory=lambda: deque(maxlen=PROBE_FRAMES))
    # True if no codeword was decoded for `PATIENCE_S`
    is_exhausted: bool = False


class PageReader:
    """Reader of frames of a screen for a page; runs in a worker thread."""

    def __init__(self, request: LinkRequest, tell: Tell, recorder: FailureRecorder, bundles: Bundles):
        self._request, self._tell, self._recorder, self._bundles = request, tell, recorder, bundles
        self._reception = Reception()

    def read_upload(self, path: Path) -> None:
        """Read a film; retry with another side and at full resolution if no codeword is decoded."""
        rejected_sides = set[int]()
        for binning, is_retry in product(_binnings(path), (False, True)):
            # headers of all sizes look alike: another side needs a detection
            if is_retry and (self._request.side is not None or not self._reception.arrays):
                continue
            with open_film(path, expand_range=True, binning=binning) as film:
                window = list(_first_frames(film))
            settings = estimate_link(window, self._request, self._tell, rejected_sides if is_retry else frozenset())
            if is_retry and settings.signal.side in rejected_sides:
                continue
            self._reception = Reception()
            self._recorder.restart(settings.signal)
            with open_film(path, expand_range=True, binning=binning) as film:
                self._read(Frames("the film", self._recorded(film)), settings, film.frame_count)
            if self._codewords():
                break
            rejected_sides.add(settings.signal.side)
        else:
            is_complete = self._reception.frames <= min(len(window), PROBE_FRAMES)
            self._explain(window, settings, () if is_complete else ("Short:",))
        self._finish()

    def read_camera(self, camera: CameraFrames) -> None:
        """Read a camera; estimate the link again if no codeword is decoded for `PATIENCE_S`."""
        rejected_sides = set[int]()
        self._recorder.restart(self._request.default_link.signal)
        frames = self._recorded(self._acknowledged(camera))
        while window := self._wait_for_light(frames):
            settings = estimate_link(window, self._request, self._tell, rejected_sides, lambda: camera.ended)
            self._recorder.change_signal(settings.signal)
            attempt = _Attempt()
            try:
                self._read(Frames("the camera", self._attempted(attempt, window, frames, camera)), settings, None)
            except MediaError:  # fewer frames than a packet
                if not camera.late:
                    raise
            if attempt.is_exhausted or not self._codewords():
                self._explain_camera([*attempt.last_frames], settings)
            if not attempt.is_exhausted:
                break
            rejected_sides = {settings.signal.side} - rejected_sides
        self._finish(camera.waiting)

    def _attempted(
        self, attempt: _Attempt, window: list[Frame], frames: Iterator[Frame], camera: CameraFrames
    ) -> Iterator[Frame]:
        """Yield frames until no codeword is decoded for `PATIENCE_S`, or until the deadline of the camera."""
        codewords, start_s, timer = 0, None, Timer()
        for count, frame in enumerate(chain(window, frames), 1):
            decoded = self._codewords()
            start_s = frame.time_s if start_s is None or decoded > codewords else start_s
            codewords = decoded
            attempt.last_frames.append(frame)
            yield frame
            if camera.ended:
                if timer.is_due():
                    self._tell({"event": "left", "frames": max(len(window) - count, 0) + camera.waiting})
            elif frame.time_s - start_s > PATIENCE_S:
                attempt.is_exhausted = True
                return
            if camera.late:
                return

    def _wait_for_light(self, frames: Iterator[Frame]) -> list[Frame]:
        """Return the first frames that show a light, or the last frames of the camera."""
        window, next_s, explain_s = list[Frame](), 0.0, 0.0
        for frame in frames:
            if not window:
                next_s, explain_s = frame.time_s + WINDOW_S, frame.time_s + PATIENCE_S
            elif frame.index - window[-1].index > 8:  # a gap of a quarter of a second
                window.clear()
            window.append(frame)
            while window[-1].time_s - window[0].time_s > WINDOW_S or len(window) * frame.pixels.size > WINDOW_BYTES:
                window.pop(0)
            if frame.time_s < next_s:
                continue
            next_s = frame.time_s + 2.0
            if shows_light(window, self._request):
                break
            self._tell({"event": "light", "rate_hz": None})
            if frame.time_s >= explain_s:
                explain_s = frame.time_s + PATIENCE_S
                self._explain_camera(window[-PROBE_FRAMES:], self._request.default_link)
        return window

    def _acknowledged(self, camera: CameraFrames) -> Iterator[Frame]:
        """Acknowledge frames of a camera; the page sends another frame for each."""
        for frame in camera:
            self._tell({"event": "took", "frames": camera.taken, "dropped": camera.dropped})
            yield frame

    def _recorded(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        for frame in frames:
            self._recorder.add_frame(frame)
            yield frame

    def _read(self, film: Frames, settings: LinkSettings, count: int | None) -> None:
        """Receive frames, and report the packets."""
        journal, timer, reception = Journal(settings.receive.calibration, self._tell), Timer(), self._reception

        def progress(frames: int) -> None:
            if timer.is_due():
                self._tell({"event": "progress", "frames": frames, "of": count})

        for packet, messages in receive_film(film, settings.signal, settings, reception, journal.observe, progress):
            journal.read(packet, messages, reception.progress)
            self._recorder.add_packet(packet)

    def _explain_camera(self, frames: list[Frame], settings: LinkSettings) -> None:
        # a window is always short; the page counts lost frames
        self._explain(frames, settings, ("Short:", "Lost frames:"))

    def _explain(self, frames: list[Frame], settings: LinkSettings, omitted: tuple[str, ...]) -> None:
        """Report why no codeword was decoded, except findings with an omitted prefix."""
        self._tell({"event": "asking why"})
        rate_hz = (len(frames) - 1) / max(frames[-1].time_s - frames[0].time_s, 1e-3)
        film = Frames("the film", frames, rate_hz, len(frames))
        try:
            findings = probe_film(
                film, settings.signal, settings.receive, reading=False, most=PROBE_FRAMES, trials=False
            )
            if findings.broken is not None:
                raise findings.broken
            lines = [line for line in in_sentences(findings) if not line.startswith(omitted)]
        except HeliographError as error:
            lines = [str(error)]
        self._tell({"event": "why", "lines": lines})

    def _finish(self, skipped: int = 0) -> None:
        """Report the counts, and the film of failed packets."""
        counts = self._counts()
        if counts["failed"] or not counts["ok"]:
            try:
                bundle = self._bundles.save(self._recorder)
            except HeliographError:
                bundle = None
            if bundle is not None:
                self._tell({"event": "bundle", **bundle})
        self._tell({"event": "end", **counts, "let_go": skipped})

    def _counts(self) -> dict[str, Any]:
        arrays = self._reception.arrays.values()
        layers = [layer for array in arrays for layer in array.layers.values()]
        return {
            "frames": self._reception.frames, "packets": sum(array.packets for array in arrays),
            "ok": sum(layer.ok for layer in layers), "failed": sum(layer.failed for layer in layers),
        }  # fmt: skip

    def _codewords(self) -> int:
        """Return the number of decoded codewords."""
        return int(self._counts()["ok"])


def _binnings(path: Path) -> tuple[int, ...]:
    """Return the binning factors in the order of attempts."""
    with open_film(path) as film:
        first = next(iter(film), None)
    if first is None:
        raise MediaError("the film holds no frames: record it again")
    binning = 1
    # Binning 2 reads a film of 1920 x 1080 pixels three times as fast, with 1.5 px per LED for an array of 50 px
    while first.pixels.size > 1_300_000 * binning**2:
        binning += 1
    return tuple(dict.fromkeys((binning, 1)))


def _first_frames(film: FilmReader) -> Iterator[Frame]:
    start_s, size = None, 0
    for frame in film:
        start_s = frame.time_s if start_s is None else start_s
        size += frame.pixels.size
        yield frame
        if size + frame.pixels.size > WINDOW_BYTES or frame.time_s - start_s > WINDOW_S:
            return
