"""A phone's film or a browser's camera read in a worker's thread: rate and size are found, and all is told."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
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
from heliograph.probe.cells import cells_of_a_side
from heliograph.probe.pace import patterns_per_s
from heliograph.receive import make_receiver
from heliograph.receive.events import DetectEvent
from heliograph.web.camera_frames import CameraFrames
from heliograph.web.screen import screen_settings
from heliograph.web.words import why_unread

Tell = Callable[[Mapping[str, Any]], None]
"""Tells a page something; what it raises ends the reading."""

SIDES_TRIED = (16, 8, 32, 24, 12, 20, 28)
"""Cells of a side in the order in which they are tried where nobody says. Chosen: by what the page offers first."""

USUAL_HZ = 10.0
"""Patterns a second that are taken where nothing tells: those that page *Transmit* offers first."""

LOOK_S = 7.0
"""Seconds of a film by which rate and size are found: two packets of 3 s and a rest, so that one is whole."""

LOOK_BYTES = 160 << 20
"""Most bytes of frames that are looked at: 170 frames of 1280 x 720 pixels."""

MOST_PIXELS = 1_300_000
"""Pixels of a frame above which squares of pixels are replaced by their means. Chosen: a film of 1920 x 1080 pixels is
read three times as fast so, and LEDs of an array of 50 px of it are still 1.5 px apart."""

TELL_S = 0.25
"""Seconds from one word about progress to the next. Chosen."""

AGAIN_S = 2.0
"""Seconds of new frames after which a light that was not found is looked for again. Chosen."""

PATIENCE_S = 12.0
"""Seconds without a codeword after which it is said why, and the light is looked for anew: three packets. Chosen."""

MOST_MISSING = 8
"""Frames that may be missing among those by which a light is looked for. Chosen: a quarter of a second."""

WHY_FRAMES = 128
"""Frames that are looked at to tell why nothing is read. Chosen: some seconds of work."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a page asks for.

    Attributes
    ----------
    side
        Cells of a side; None where they are to be found.
    rate_hz
        Patterns a second; None where they are to be found.
    """

    side: int | None = None
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames in a film's place."""

    path: str
    frames: Iterable[Frame]
    rate_hz: float = 30.0
    frame_count: int | None = None

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames


def read_upload(path: Path, asked: Asked, tell: Tell) -> None:
    """Read a film, and tell all of it.

    Parameters
    ----------
    path
        The film.
    asked
        Size and rate, as far as they are known.
    tell
        Gets the rows of the journal, and "light", "progress", "why" and "end".

    Raises
    ------
    MediaError
        It is no film, or breaks off at once.
    """
    doubted, reception = set[int](), Reception()
    for binning, again in product(_binnings(path), (False, True)):
        with open_film(path, expand_range=True, binning=binning) as film:
            head = list(_first(film, LOOK_S, LOOK_BYTES))
        if again and asked.side is not None:
            continue
        settings = _found(head, asked, tell, doubted if again else frozenset())
        if again and settings.signal.side in doubted:
            continue
        reception = Reception()
        with open_film(path, expand_range=True, binning=binning) as film:
            _read(film, settings, reception, tell, film.frame_count)
        if _words(reception):
            break
        doubted.add(settings.signal.side)
    else:
        _tell_why(head, settings, tell)
    tell({"event": "end", **_counts(reception)})


def read_camera(camera: CameraFrames, asked: Asked, tell: Tell, look: Callable[[LinkSettings], None]) -> None:
    """Read a camera until it ends, and tell all that is read.

    Parameters
    ----------
    camera
        Its frames.
    asked
        Size and rate, as far as they are known.
    tell
        Gets the rows of the journal, and "light", "progress", "why" and "end".
    look
        Gets the settings of the link that is looked for, whenever they change.
    """
    reception, frames, doubted = Reception(), _told_of(camera, tell), set[int]()
    while window := list(_awaited(frames, asked, tell)):
        settings = _found(window, asked, tell, doubted)
        look(settings)
        patient = _Patient(chain(window, frames), reception)
        _read(Frames("the camera", patient), settings, reception, tell, None)
        if not patient.ran_out:
            break
        doubted = {settings.signal.side} - doubted
        _tell_why(patient.last, settings, tell)
    tell({"event": "end", **_counts(reception)})


class _Patient:
    """Frames until nothing was read of them for too long."""

    def __init__(self, frames: Iterator[Frame], reception: Reception):
        self._frames, self._reception = frames, reception
        self.ran_out, self.last = False, list[Frame]()

    def __iter__(self) -> Iterator[Frame]:
        words, since = 0, None
        for frame in self._frames:
            now = _words(self._reception)
            since = frame.time_s if since is None or now > words else since
            words = now
            self.last = [*self.last[1 - WHY_FRAMES :], frame]
            yield frame
            if frame.time_s - since > PATIENCE_S:
                self.ran_out = True
                return


def _awaited(frames: Iterator[Frame], asked: Asked, tell: Tell) -> Iterator[Frame]:
    """The first frames that show a light; all that there were where the camera ends before."""
    window, next_s, why_s = list[Frame](), None, None
    for frame in frames:
        if window and frame.index - window[-1].index > MOST_MISSING:
            window.clear()
        window.append(frame)
        if next_s is None or why_s is None:
            next_s, why_s = frame.time_s + LOOK_S, frame.time_s + PATIENCE_S
        while window[-1].time_s - window[0].time_s > LOOK_S or len(window) * frame.pixels.size > LOOK_BYTES:
            window.pop(0)
        if frame.time_s < next_s:
            continue
        next_s = frame.time_s + AGAIN_S
        if _shows_light(window, asked):
            break
        tell({"event": "light", "rate_hz": None})
        if frame.time_s >= why_s:
            why_s = frame.time_s + PATIENCE_S
            _tell_why(window[-WHY_FRAMES:], screen_settings(asked.side or SIDES_TRIED[0], USUAL_HZ), tell)
    return iter(window)


def _shows_light(frames: list[Frame], asked: Asked) -> bool:
    """Whether it is worth while to look for packets; a display that skips refreshes has no rate, but lines of cells."""
    return asked.rate_hz is not None or patterns_per_s(frames) is not None or cells_of_a_side(frames) is not None


def _told_of(camera: CameraFrames, tell: Tell) -> Iterator[Frame]:
    """Frames of a camera; the page hears of each that was taken, and sends another."""
    for frame in camera:
        tell({"event": "took", "frames": camera.taken, "dropped": camera.dropped})
        yield frame


def _found(frames: list[Frame], asked: Asked, tell: Tell, doubted: AbstractSet[int] = frozenset()) -> LinkSettings:
    """The link that some frames show; the usual one where they do not tell."""
    rate = asked.rate_hz or patterns_per_s(frames)
    tell({"event": "light", "rate_hz": rate})
    # a receiver that is told a wrong rate finds the right one, but later
    side = asked.side or _side_of(frames, rate or USUAL_HZ, tell, doubted)
    if rate or side:
        tell({"event": "light", "rate_hz": rate, "side": side})
    return screen_settings(side or SIDES_TRIED[0], rate or USUAL_HZ)


def _side_of(frames: list[Frame], rate_hz: float, tell: Tell, doubted: AbstractSet[int]) -> int | None:
    """The size by the lines between cells, else the one whose packets are read; None where there is none."""
    likely = cells_of_a_side(frames)
    if likely is not None and likely not in doubted:
        return likely
    for side in (side for side in SIDES_TRIED if side not in doubted):
        tell({"event": "trying", "side": side})
        try:
            found, read = _tried(frames, screen_settings(side, rate_hz))
        except HeliographError:  # such as too few frames for such a rate: reading says so
            return None
        if read:
            return side
        if not found:  # headers of all sizes look alike
            return None
    return None


def _tried(frames: list[Frame], settings: LinkSettings) -> tuple[bool, bool]:
    """Whether a header is found in some frames, and whether a codeword is read."""
    found = list[DetectEvent]()

    def observe(event: object) -> None:
        if isinstance(event, DetectEvent):
            found.append(event)

    receiver = make_receiver(settings.signal, settings.receive, observe)
    packets = chain(chain.from_iterable(map(receiver.push, frames)), receiver.finish())
    read = any(word.block for packet in packets for words in packet.layers.values() for word in words)
    return bool(found), read


def _read(film: FrameSource, settings: LinkSettings, reception: Reception, tell: Tell, count: int | None) -> None:
    journal, told = Journal(settings.receive.calibration, tell), [0.0]

    def progress(frames: int) -> None:
        now = time.monotonic()
        if now - told[0] > TELL_S:
            told[0] = now
            tell({"event": "progress", "frames": frames, "of": count})

    for packet, messages in receive_film(film, settings.signal, settings, reception, journal.observe, progress):
        journal.read(packet, messages, reception.progress)


def _tell_why(frames: list[Frame], settings: LinkSettings, tell: Tell) -> None:
    """Tell in words why nothing is read."""
    tell({"event": "asking why"})
    try:
        shown = Frames("the film", frames, _rate_of(frames), len(frames))
        # regions are looked into for a receiver of arrays alone
        receiver = replace(settings.receive, receiver="soft")
        found = probe_film(shown, settings.signal, receiver, reading=False, most=WHY_FRAMES, trials=False)
        lines = why_unread(found)
    except HeliographError as error:
        lines = [str(error)]
    tell({"event": "why", "lines": lines})


def _binnings(path: Path) -> tuple[int, ...]:
    """Sides of squares of pixels that are joined, in the order in which they are tried."""
    with open_film(path) as film:
        first = next(iter(film), None)
    if first is None:
        raise MediaError("the film holds no frames: record it again")
    binning = 1
    while first.pixels.size > MOST_PIXELS * binning**2:
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
