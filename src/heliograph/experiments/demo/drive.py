"""The demonstration: the paper's drive filmed, received, and shown."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.files import write_whole
from heliograph.experiments.demo.page import write_page
from heliograph.experiments.demo.recorder import TrackRecorder
from heliograph.link.film import frames_of, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.signal.message import Message

FILM_BYTES_PER_PIXEL = 0.07
"""Bytes of a pixel in the film: 0.067 over the whole drive before the drawn street, 0.13 where all is noise."""

CUT_OUTS = 8
"""Moments at which the array is cut out for the report."""

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]
"""Makes a progress bar of a title and a number of frames; it is called with the frames done."""


def demo_messages(settings: LinkSettings) -> list[Messages]:
    """A warning, a description and a picture, by priority.

    Parameters
    ----------
    settings
        The link; each of its arrays sends the same messages.
    """
    warning = "Signal ahead: red for 12 s. Prepare to stop."
    details = (
        "Junction 7, northbound. Right lane closed for works until 18:00. Pedestrians on the east crossing. "
        "Green at 50 km/h in 12 s, at 30 km/h in 19 s. Tram 4 crosses from the left in 41 s. "
    )
    content = {"high": [warning.encode()], "middle": [(details * 3).encode()], "low": [_map_picture()]}
    return [content for _ in settings.transmit.identities]


def film_bytes(settings: LinkSettings) -> int:
    """About how large the film of the demonstration becomes, in bytes.

    Parameters
    ----------
    settings
        The link, whose camera and length of film count.
    """
    camera = settings.channel.camera
    return round(frames_of(settings) * camera.width * camera.height * FILM_BYTES_PER_PIXEL)


@dataclass(frozen=True)
class Demonstration:
    """Result of the demonstration.

    Attributes
    ----------
    counts
        All counts as plain values, see `Reception.report`.
    ending
        The error or interruption that broke the reception off; None: it came to its end. The page shows the results
        so far.
    """

    counts: dict[str, Any]
    ending: BaseException | None = None


def run(folder: Path, settings: LinkSettings, seed: int, recordings: Recordings, bar: Bar) -> Demonstration:
    """Simulate, receive and report.

    Parameters
    ----------
    folder
        Gets drive.mp4, its truth, the messages and report.html.
    settings, seed, recordings
        The link, the seed of road, scene and noise, and the real background and motion; see `simulate`.
    bar
        Makes the progress bars, one of the simulation and one of the reception.

    Raises
    ------
    MediaError
        A file cannot be written.
    """
    film = folder / "drive.mp4"
    with bar("simulating", frames_of(settings)) as advance:
        count = write_film(film, settings, demo_messages(settings), seed, recordings, advance)
    truth = open_truth(truth_path(film))
    recorder = TrackRecorder([int(k) for k in np.linspace(0.02, 0.98, CUT_OUTS) * count])
    reception = Reception(truth)
    messages: list[Message] = []
    began = time.perf_counter()
    ending: BaseException | None = None
    try:
        with bar("receiving", count) as advance, open_film(film) as source:
            for _, whole in receive_film(source, settings.signal, settings, reception, recorder, advance):
                messages += whole
    except (HeliographError, KeyboardInterrupt) as error:
        ending = error
    counts = reception.report(time.perf_counter() - began)
    for message in messages:
        write_whole(folder / message_name(message), message.data)
    write_page(folder / "report.html", truth, recorder, reception, counts, messages)
    return Demonstration(counts, ending)


def message_name(message: Message) -> str:
    """File name of a message, by its array, layer, stream and kind.

    Parameters
    ----------
    message
        A whole message; its data make it a picture (.png) if they begin as PNG does, else a text (.txt).
    """
    suffix = "png" if message.data.startswith(b"\x89PNG") else "txt"
    return f"array-{message.identity}-{message.layer}-{message.stream}.{suffix}"


def _map_picture() -> bytes:
    """A small map of a junction as PNG."""
    image = np.full((64, 96), 235, np.uint8)
    cv2.rectangle(image, (0, 26), (95, 40), 120, -1)
    cv2.rectangle(image, (44, 0), (58, 63), 120, -1)
    for x in range(2, 96, 8):
        cv2.line(image, (x, 33), (x + 3, 33), 250, 1)
    cv2.circle(image, (63, 21), 3, 30, -1)
    cv2.putText(image, "7", (70, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 30, 1)
    return bytes(cv2.imencode(".png", image)[1])
