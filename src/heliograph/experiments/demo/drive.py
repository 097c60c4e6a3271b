"""The demonstration: the paper's drive filmed, received, and shown."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from heliograph.base.config import from_mapping
from heliograph.base.errors import HeliographError
from heliograph.base.files import write_whole
from heliograph.channel.street_view import draw_street
from heliograph.experiments.demo.animation import Filmed, animated, is_picture
from heliograph.experiments.demo.page import write_page
from heliograph.experiments.demo.recorder import TrackRecorder
from heliograph.link.film import frames_of, sent_s, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.receive.events import Event
from heliograph.road.codec import is_there, kind_of
from heliograph.road.encode import mapem, updates
from heliograph.road.junction import Junction, example
from heliograph.signal.message import Message, Updates
from heliograph.transmit import Content

FILM_CRF = 18
"""Quality of the film as H.264. Before the drawn street the paper's drive takes 34 MB, and 66 high, 118 middle and 45
low codewords are read; 338 MB at 12, with as many high, one middle and two low ones more."""

FILM_BYTES_PER_PIXEL = 0.01
"""Bytes of a pixel in the film: 0.0097 over the whole drive before the drawn street."""

CUT_OUTS = 8
"""Moments at which the array is cut out for the report."""

SIZES = ((48, 32), (96, 64), (288, 192))
"""Widths and heights in px of the picture that the low layer sends: 29 codewords, 2.9 s, all together."""

PICTURE_QUALITY, PICTURE_SEED = 32, 11
"""Of the picture as WebP, 0 to 100; and of its drawing. Chosen by eye."""

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]
"""Makes a progress bar of a title and a number of frames; it is called with the frames done."""


def demo_messages(settings: LinkSettings) -> list[Messages]:
    """What the light shows and a warning, the map and a description, a picture that grows: by priority."""
    road = _road(settings)
    warning = "Signal ahead: red for 12 s. Prepare to stop."
    details = (
        "Junction 7, northbound. Right lane closed for works until 18:00. Pedestrians on the east crossing. "
        "Green at 50 km/h in 12 s, at 30 km/h in 19 s. Tram 4 crosses from the left in 41 s. "
    )
    high, middle = [warning.encode()], [(details * 3).encode()]
    content: Messages = {"high": [*high, *road[:1]], "middle": [*middle, *road[1:]], "low": pictures()}
    return [content for _ in settings.transmit.identities]


def _road(settings: LinkSettings) -> list[Content]:
    """What the lights show, a message a second, and the map; nothing where their package is not installed."""
    if not is_there():
        return []
    junction = from_mapping(Junction, example())
    return [Updates(updates(junction, sent_s(settings))), mapem(junction)]


def pictures() -> list[bytes]:
    """A camera's picture of the junction as WebP: small, larger and large, so that the first is soon there."""
    scene = draw_street((SIZES[-1][1], SIZES[-1][0]), np.random.default_rng(PICTURE_SEED))
    sent = []
    for size in SIZES:
        scaled = cv2.resize(scene, size, interpolation=cv2.INTER_AREA)
        sent.append(cv2.imencode(".webp", scaled, [cv2.IMWRITE_WEBP_QUALITY, PICTURE_QUALITY])[1].tobytes())
    return sent


def film_bytes(settings: LinkSettings) -> int:
    """About how large the film of the demonstration becomes, in bytes."""
    camera = settings.channel.camera
    return round(frames_of(settings) * camera.width * camera.height * FILM_BYTES_PER_PIXEL)


@dataclass(frozen=True)
class Demonstration:
    """Result of the demonstration."""

    # All counts as plain values, see `Reception.report`
    counts: dict[str, Any]
    # The error or interruption that broke the reception off; None: it came to its end. The page shows the results so
    # far
    ending: BaseException | None = None


def run(folder: Path, settings: LinkSettings, seed: int, recordings: Recordings, bar: Bar) -> Demonstration:
    """Simulate, receive and report."""
    film = folder / "drive.mp4"
    with bar("simulating", frames_of(settings)) as advance:
        count = write_film(film, settings, demo_messages(settings), seed, recordings, advance, crf=FILM_CRF)
    truth = open_truth(truth_path(film))
    filmed = Filmed()
    recorder = TrackRecorder([int(k) for k in np.linspace(0.02, 0.98, CUT_OUTS) * count])
    reception = Reception(truth)
    messages: list[Message] = []
    began = time.perf_counter()
    ending: BaseException | None = None
    try:
        with bar("receiving", count) as advance, open_film(film) as source:
            observe = _both(recorder, filmed)
            for packet, whole in receive_film(source, settings.signal, settings, reception, observe, advance):
                messages += whole
                filmed.packet(packet, whole)
    except (HeliographError, KeyboardInterrupt) as error:
        ending = error
    counts = reception.report(time.perf_counter() - began)
    for message in messages:
        write_whole(folder / message_name(message), message.data)
    moving = animated(filmed.moments)
    if moving:
        write_whole(folder / "drive.webp", moving)
    write_page(folder / "report.html", truth, (recorder, moving), reception, counts, messages)
    return Demonstration(counts, ending)


def message_name(message: Message) -> str:
    """File name of a message, by its array, layer, stream and kind."""
    suffix = kind_of(message.data)
    if suffix is None:
        suffix = "txt" if not is_picture(message.data) else "png" if message.data.startswith(b"\x89PNG") else "webp"
    return f"array-{message.identity}-{message.layer}-{message.stream}.{suffix.lower()}"


def _both(*observers: Callable[[Event], None]) -> Callable[[Event], None]:
    def observe(event: Event) -> None:
        for one in observers:
            one(event)

    return observe
