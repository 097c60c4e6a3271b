"""A phone's film or a browser's camera read in a worker's thread: rate and size are found, and all is told."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path
from typing import Any

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.film import FrameSource
from heliograph.link.settings import LinkSettings
from heliograph.measure.journal import Journal
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import FilmReader, open_film
from heliograph.probe import probe_film
from heliograph.probe.words import in_sentences
from heliograph.web.camera_frames import CameraFrames
from heliograph.web.failures import Saver
from heliograph.web.looking import Asked, Tell, link_shown, shows_light

LOOK_S = 7.0
"""Seconds of a film by which rate and size are found: two packets of 3 s and a rest, so that one is whole."""

LOOK_BYTES = 160 << 20
"""Most bytes of frames that are looked at: 170 frames of 1280 x 720 pixels."""

TELL_S = 0.25
"""Seconds from one word about progress to the next. Chosen."""

PATIENCE_S = 12.0
"""Seconds without a codeword after which it is said why, and the light is looked for anew: three packets. Chosen."""

WHY_FRAMES = 128
"""Frames that are looked at to tell why nothing is read. Chosen: some seconds of work."""


OF_CAMERAS = ("Short:", "Lost frames:")
"""What is not said of the last frames of a camera: they are some of many, and those that were not sent are counted."""


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames in a film's place."""

    path: str
    frames: Iterable[Frame]
    rate_hz: float = 30.0
    frame_count: int | None = None

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames


def read_upload(path: Path, asked: Asked, tell: Tell, saver: Saver) -> None:
    """Read a film, and tell all of it."""
    doubted, reception = set[int](), Reception()
    for binning, again in product(_binnings(path), (False, True)):
        # headers of all sizes look alike: where none was found, another size is of no use
        if again and (asked.side is not None or not reception.arrays):
            continue
        with open_film(path, expand_range=True, binning=binning) as film:
            head = list(_first(film, LOOK_S, LOOK_BYTES))
        settings = link_shown(head, asked, tell, doubted if again else frozenset())
        if again and settings.signal.side in doubted:
            continue
        reception = Reception()
        saver.begin(settings.signal)
        with open_film(path, expand_range=True, binning=binning) as film:
            kept = Frames("the film", _kept(film, saver), film.rate_hz, film.frame_count)
            _read(kept, settings, reception, tell, saver, film.frame_count)
        if _words(reception):
            break
        doubted.add(settings.signal.side)
    else:
        _tell_why(head, settings, tell, () if reception.frames <= min(len(head), WHY_FRAMES) else ("Short:",))
    _tell_end(reception, tell, saver)


def read_camera(camera: CameraFrames, asked: Asked, tell: Tell, saver: Saver) -> None:
    """Read a camera until it ends, and tell all that is read."""
    reception, doubted = Reception(), set[int]()
    saver.begin(asked.usual.signal)
    frames = _kept(_told_of(camera, tell), saver)
    while window := list(_awaited(frames, asked, tell)):
        settings = link_shown(window, asked, tell, doubted, lambda: camera.ended)
        saver.expect(settings.signal)
        patient = _Patient(window, frames, reception, camera, tell)
        try:
            _read(Frames("the camera", patient), settings, reception, tell, saver, None)
        except MediaError:  # fewer frames than a packet has
            if not camera.late:
                raise
        if not patient.ran_out:
            if not _words(reception):
                _tell_why(patient.last, settings, tell, OF_CAMERAS)
            break
        doubted = {settings.signal.side} - doubted
        _tell_why(patient.last, settings, tell, OF_CAMERAS)
    _tell_end(reception, tell, saver, camera.waiting)


class _Patient:
    """Frames until nothing was read of them for too long, or the camera's time is over."""

    def __init__(
        self, window: list[Frame], frames: Iterator[Frame], reception: Reception, camera: CameraFrames, tell: Tell
    ):
        self._window, self._frames, self._reception, self._camera, self._tell = window, frames, reception, camera, tell
        self._told_s = 0.0
        self.ran_out, self.last = False, list[Frame]()

    def __iter__(self) -> Iterator[Frame]:
        words, since = 0, None
        for count, frame in enumerate(chain(self._window, self._frames), 1):
            now = _words(self._reception)
            since = frame.time_s if since is None or now > words else since
            words = now
            self.last = [*self.last[1 - WHY_FRAMES :], frame]
            yield frame
            if self._camera.ended:
                self._tell_left(max(len(self._window) - count, 0) + self._camera.waiting)
            elif frame.time_s - since > PATIENCE_S:
                self.ran_out = True
                return
            if self._camera.late:
                return

    def _tell_left(self, count: int) -> None:
        now = time.monotonic()
        if now - self._told_s > TELL_S:
            self._told_s = now
            self._tell({"event": "left", "frames": count})


def _awaited(frames: Iterator[Frame], asked: Asked, tell: Tell) -> Iterator[Frame]:
    """The first frames that show a light; all that there were where the camera ends before."""
    window, next_s, why_s = list[Frame](), None, None
    for frame in frames:
        # Frames that may be missing among those by which a light is looked for. Chosen: a quarter of a second
        if window and frame.index - window[-1].index > 8:
            window.clear()
        window.append(frame)
        if next_s is None or why_s is None:
            next_s, why_s = frame.time_s + LOOK_S, frame.time_s + PATIENCE_S
        while window[-1].time_s - window[0].time_s > LOOK_S or len(window) * frame.pixels.size > LOOK_BYTES:
            window.pop(0)
        if frame.time_s < next_s:
            continue
        # Seconds of new frames after which a light that was not found is looked for again. Chosen
        next_s = frame.time_s + 2.0
        if shows_light(window, asked):
            break
        tell({"event": "light", "rate_hz": None})
        if frame.time_s >= why_s:
            why_s = frame.time_s + PATIENCE_S
            _tell_why(window[-WHY_FRAMES:], asked.usual, tell, OF_CAMERAS)
    return iter(window)


def _told_of(camera: CameraFrames, tell: Tell) -> Iterator[Frame]:
    """Frames of a camera; the page hears of each that was taken, and sends another."""
    for frame in camera:
        tell({"event": "took", "frames": camera.taken, "dropped": camera.dropped})
        yield frame


def _kept(frames: Iterable[Frame], saver: Saver) -> Iterator[Frame]:
    for frame in frames:
        saver.saw(frame)
        yield frame


def _read(
    film: FrameSource, settings: LinkSettings, reception: Reception, tell: Tell, saver: Saver, count: int | None
) -> None:  # fmt: skip
    journal, told = Journal(settings.receive.calibration, tell), [0.0]

    def progress(frames: int) -> None:
        now = time.monotonic()
        if now - told[0] > TELL_S:
            told[0] = now
            tell({"event": "progress", "frames": frames, "of": count})

    for packet, messages in receive_film(film, settings.signal, settings, reception, journal.observe, progress):
        journal.read(packet, messages, reception.progress)
        saver.read(packet)


def _tell_why(frames: list[Frame], settings: LinkSettings, tell: Tell, unsaid: tuple[str, ...]) -> None:
    """Tell in words why nothing is read, but for causes that lie in how the frames were taken out."""
    tell({"event": "asking why"})
    try:
        shown = Frames("the film", frames, _rate_of(frames), len(frames))
        found = probe_film(shown, settings.signal, settings.receive, reading=False, most=WHY_FRAMES, trials=False)
        if found.broken is not None:
            raise found.broken
        lines = [line for line in in_sentences(found) if not line.startswith(unsaid)]
    except HeliographError as error:
        lines = [str(error)]
    tell({"event": "why", "lines": lines})


def _tell_end(reception: Reception, tell: Tell, saver: Saver, let_go: int = 0) -> None:
    """Tell the counts, and of what failed the film that may be fetched."""
    counts = _counts(reception)
    if counts["failed"] or not counts["ok"]:
        offered = saver.offered()
        if offered is not None:
            tell({"event": "bundle", **offered})
    tell({"event": "end", **counts, "let_go": let_go})


def _binnings(path: Path) -> tuple[int, ...]:
    """Sides of squares of pixels that are joined, in the order in which they are tried."""
    with open_film(path) as film:
        first = next(iter(film), None)
    if first is None:
        raise MediaError("the film holds no frames: record it again")
    binning = 1
    # Pixels of a frame above which squares of pixels are replaced by their means. Chosen: a film of 1920 x 1080 pixels
    # is read three times as fast so, and LEDs of an array of 50 px of it are still 1.5 px apart
    while first.pixels.size > 1_300_000 * binning**2:
        binning += 1
    return tuple(dict.fromkeys((binning, 1)))


def _first(film: FilmReader, seconds: float, most: int) -> Iterator[Frame]:
    begun = None
    for frame in film:
        begun = frame.time_s if begun is None else begun
        most -= frame.pixels.size
        yield frame
        if most < frame.pixels.size or frame.time_s - begun > seconds:
            return


def _rate_of(frames: list[Frame]) -> float:
    return (len(frames) - 1) / max(frames[-1].time_s - frames[0].time_s, 1e-3)


def _words(reception: Reception) -> int:
    return sum(layer.ok for array in reception.arrays.values() for layer in array.layers.values())


def _counts(reception: Reception) -> dict[str, Any]:
    layers = [layer for array in reception.arrays.values() for layer in array.layers.values()]
    return {
        "frames": reception.frames, "packets": sum(array.packets for array in reception.arrays.values()),
        "ok": sum(one.ok for one in layers), "failed": sum(one.failed for one in layers),
    }  # fmt: skip
