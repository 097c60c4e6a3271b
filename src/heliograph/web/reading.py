"""Reception of an uploaded film or of the camera of a browser: the link is estimated, and the results are reported."""

import contextlib
import time
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain, product
from math import ceil, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.measure.journal import Journal
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import FilmReader, open_film
from heliograph.probe import probe_film
from heliograph.probe.words import in_sentences
from heliograph.web.camera_frames import CameraFrames, Frames
from heliograph.web.failures import FailureRecorder
from heliograph.web.link_estimate import LinkRequest, Tell, estimate_link, shows_light
from heliograph.web.outline import OutlineFinder
from heliograph.web.stores import Store, StoredFilm
from heliograph.web.wording import page_words

WINDOW_S, WINDOW_BYTES = 7.0, 160 << 20
"""Frames for the estimate of a link: two packets of 3 s and a pause; 170 frames of 1280 x 720 pixels."""

PATIENCE_S, PATIENCE_PACKETS = 12.0, 2.5
"""Minimum waiting time for a codeword before a diagnosis and a new estimate, in s and in packets."""

PROBE_FRAMES = 128  # frames of a diagnosis: some seconds of computing

EARLY_S, EARLY_FRAMES = 3.5, 32
"""Time of a camera before the early diagnosis, a packet and its header, and number of frames: a second of computing."""

EARLY_OMITTED = ("Short:", "Lost frames:", "Cells:", "Unread:")  # findings that require more frames or an estimate


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


class PageReader:
    """Reader of frames of a screen for a page; runs in a worker thread."""

    def __init__(self, request: LinkRequest, tell: Tell, recorder: FailureRecorder, bundles: Store[StoredFilm]):
        self._request, self._tell, self._recorder, self._bundles = request, tell, recorder, bundles
        self._reception = ReceptionCounter()
        # Last frames of a camera with the present settings; True if no codeword was decoded in time
        self._last_frames, self._is_exhausted = deque[Frame](maxlen=PROBE_FRAMES), False
        self._has_early_diagnosis = False

    def read_upload(self, path: Path) -> None:
        """Read a film; retry with another side and at full resolution if no codeword is decoded."""
        rejected_sides = set[int]()
        for binning, is_retry in product(_binnings(path), (False, True)):
            # headers of all sizes look alike: another side needs a detection
            if is_retry and (self._request.side is not None or not self._reception.arrays):
                continue
            with open_film(path, expand_range=True, binning=binning) as film:
                window = [*_first_frames(film)]
            self._explain_early(window)
            settings = estimate_link(window, self._request, self._tell, rejected_sides if is_retry else ())
            if is_retry and settings.signal.side in rejected_sides:
                continue
            self._reception = ReceptionCounter()
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
        """Read a camera; estimate the link again if no codeword is decoded in time."""
        rejected_sides = set[int]()
        frames = self._recorded(self._acknowledged(camera))
        while window := self._wait_for_light(frames):
            settings = estimate_link(window, self._request, self._tell, rejected_sides, lambda: camera.ended)
            self._recorder.signal = settings.signal
            self._last_frames.clear()
            self._is_exhausted = False
            try:
                patience_s = max(PATIENCE_S, PATIENCE_PACKETS * settings.signal.packet_s)
                attempt = self._attempted(window, frames, camera, patience_s)
                self._read(Frames("the camera", attempt), settings, None)
            except MediaError:  # fewer frames than a packet
                if not camera.late:
                    raise
            if self._is_exhausted or not self._codewords():
                self._explain([*self._last_frames], settings)
            if not self._is_exhausted:
                break
            rejected_sides = {settings.signal.side} - rejected_sides
        self._finish(camera.waiting)

    def _attempted(
        self, window: list[Frame], frames: Iterator[Frame], camera: CameraFrames, patience_s: float
    ) -> Iterator[Frame]:
        """Yield frames until no codeword is decoded in time, or until the deadline of the camera."""
        codewords, start_s, timer = 0, None, Timer()
        for count, frame in enumerate(chain(window, frames), 1):
            decoded = self._codewords()
            start_s = frame.time_s if start_s is None or decoded > codewords else start_s
            codewords = decoded
            self._last_frames.append(frame)
            yield frame
            if camera.ended:
                if timer.is_due():
                    self._tell({"event": "left", "frames": max(len(window) - count, 0) + camera.waiting})
            elif frame.time_s - start_s > patience_s:
                self._is_exhausted = True
                return
            if camera.late:
                return

    def _wait_for_light(self, frames: Iterator[Frame]) -> list[Frame]:
        """Return the first frames that show a light, or the last frames of the camera."""
        window, early_s, next_s, explain_s = list[Frame](), 0.0, 0.0, 0.0
        for frame in frames:
            if not window:
                early_s, next_s, explain_s = (frame.time_s + wait_s for wait_s in (EARLY_S, WINDOW_S, PATIENCE_S))
            elif frame.index - window[-1].index > 8:  # a gap of a quarter of a second
                window.clear()
            window.append(frame)
            if frame.time_s >= early_s and len(window) >= EARLY_FRAMES // 2:
                self._explain_early(window)
            while window[-1].time_s - window[0].time_s > WINDOW_S or len(window) * frame.pixels.size > WINDOW_BYTES:
                window.pop(0)
            if frame.time_s < next_s:
                continue
            next_s = frame.time_s + 2.0
            if shows_light(window, self._request):
                break
            self._tell({"event": "no light"})
            if frame.time_s >= explain_s:
                explain_s = frame.time_s + PATIENCE_S
                self._explain(window[-PROBE_FRAMES:], self._request.default_link)
        return window

    def _acknowledged(self, camera: CameraFrames) -> Iterator[Frame]:
        """Acknowledge frames of a camera, and report the outline of the screen; the page sends a frame for each."""
        finder = OutlineFinder()
        for frame in camera:
            self._tell({"event": "took", "frames": camera.taken, "dropped": camera.dropped})
            if (corners := finder.add(frame)) is not None:
                self._tell({"event": "outline", "corners": corners})
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

        for packet, messages in receive_and_count(
            film, settings.signal, settings, reception, journal.observe, progress
        ):
            journal.read(packet, messages, reception.progress)
            self._recorder.add_packet(packet)

    def _explain_early(self, frames: list[Frame]) -> None:
        """Report likely causes of a failure once, from the frames that change most: a header shows the most light."""
        if not self._has_early_diagnosis:
            self._has_early_diagnosis = True
            reduced = np.array([frame.pixels[::4, ::4] for frame in frames], np.float32)
            changes = np.abs(np.diff(reduced, axis=0)).mean((1, 2))
            starts = range(max(1, len(frames) - EARLY_FRAMES))
            start = max(starts, key=lambda k: changes[k : k + EARLY_FRAMES].sum())
            lines = _causes(frames[start : start + EARLY_FRAMES], self._request.default_link, EARLY_OMITTED)
            self._tell({"event": "early", "lines": lines})

    def _explain(
        self, frames: list[Frame], settings: LinkSettings, omitted: tuple[str, ...] = ("Short:", "Lost frames:")
    ) -> None:
        """Report why no codeword was decoded, except findings with an omitted prefix.

        A window of a camera is always short, and the page counts lost frames.
        """
        self._tell({"event": "asking why"})
        self._tell({"event": "why", "lines": _causes(frames, settings, omitted), "bytes": self._recorder.size})

    def _finish(self, skipped: int = 0) -> None:
        """Report the counts, and the film of failed packets."""
        counts = self._counts()
        if counts["failed"] or not counts["ok"]:
            with contextlib.suppress(HeliographError):
                self._tell({"event": "bundle", **self._recorder.save(self._bundles)})
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


def _causes(frames: list[Frame], settings: LinkSettings, omitted: tuple[str, ...]) -> list[str]:
    """Return causes of a failed reception in the words of pages, except findings with an omitted prefix."""
    # a gap of a camera may leave a single frame
    rate_hz = max(len(frames) - 1, 1) / max(frames[-1].time_s - frames[0].time_s, 1e-3)
    film = Frames("the film", frames, rate_hz, len(frames))
    signal, receiver = settings.signal, settings.receive
    try:
        findings = probe_film(film, signal, receiver, reading=False, most=PROBE_FRAMES, trials=False)
        if findings.broken:  # frames in memory have no other error
            raise MemoryError(findings.broken)
        lines = [line for line in in_sentences(findings) if not line.startswith(omitted)]
    except HeliographError as error:
        lines = [str(error)]
    return [page_words(line) for line in lines]


def _binnings(path: Path) -> tuple[int, ...]:
    """Return the binning factors in the order of attempts."""
    with open_film(path) as film:
        first = next(iter(film), None)
    if first is None:
        raise MediaError("the film holds no frames: record it again")
    # Binning 2 reads a film of 1920 x 1080 pixels three times as fast, with 1.5 px per LED for an array of 50 px
    binning = max(1, ceil(sqrt(first.pixels.size / 1_300_000)))
    return tuple(dict.fromkeys((binning, 1)))


def _first_frames(film: FilmReader) -> Iterator[Frame]:
    start_s, size = None, 0
    for frame in film:
        start_s = frame.time_s if start_s is None else start_s
        size += frame.pixels.size
        yield frame
        if size + frame.pixels.size > WINDOW_BYTES or frame.time_s - start_s > WINDOW_S:
            return
