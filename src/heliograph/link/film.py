"""Films of simulated drives, and films received: the link with files at its ends."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from heliograph.base.config import from_mapping, to_mapping
from heliograph.base.errors import MediaError, SettingsError
from heliograph.base.frames import Frame
from heliograph.channel import frame_count
from heliograph.link.reception import Reception
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings, simulate
from heliograph.link.truth import TruthWriter, truth_path
from heliograph.media import FilmReader, create_film
from heliograph.receive import Packet, Receiver
from heliograph.receive.packets import Observer, ignore
from heliograph.signal.message import Message
from heliograph.signal.settings import SignalSettings

SIGNAL_TAG = "heliograph_signal"
"""Metadata of a film that tells what the light speaks; a receiver may know that."""

Progress = Callable[[int], None]


def silent(frames: int, /) -> None:
    """Report no progress."""


def write_film(
    path: Path,
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    recordings: Recordings | None = None,
    progress: Progress = silent,
    **codec: Any,
) -> int:
    """Simulate a drive into a film and its truth file.

    Parameters
    ----------
    path
        The film; its suffix chooses the kind. Truth goes to ``path`` + ".truth.npz".
    settings, messages, seed, recordings
        See `simulate`.
    progress
        Called with the number of frames written.
    codec
        Options of `create_film`: codec, crf, lossless.

    Returns
    -------
    Frames written. On Ctrl-C film and truth are closed with the frames so far and KeyboardInterrupt is raised anew.

    Raises
    ------
    MediaError
        The film cannot be written; nothing is left behind then.
    """
    camera = settings.channel.camera
    film = create_film(
        path,
        width=camera.width,
        height=camera.height,
        rate_hz=camera.fps,
        bits=settings.channel.sensor.bits,
        metadata={SIGNAL_TAG: json.dumps(to_mapping(settings.signal))},
        **codec,
    )
    truth = TruthWriter(truth_path(path), settings, messages, seed)
    count = 0
    try:
        for frame, row in simulate(settings, messages, seed, recordings):
            film.write(frame)
            truth.add(row)
            count += 1
            progress(count)
    except KeyboardInterrupt:
        _close(film, truth, count)
        raise
    except BaseException:
        film.abort()
        truth.abort()
        raise
    _close(film, truth, count)
    return count


def frames_of(settings: LinkSettings) -> int:
    """Frames a simulation will have."""
    return frame_count(settings.channel)


def signal_of(film: FilmReader, settings: LinkSettings, chosen: bool) -> SignalSettings:
    """What the light of a film speaks: the settings' signal where it was chosen, else what the film says."""
    text = film.metadata.get(SIGNAL_TAG)
    if chosen or text is None:
        return settings.signal
    try:
        return from_mapping(SignalSettings, json.loads(text))
    except (json.JSONDecodeError, SettingsError) as error:
        raise MediaError(f"the film's note on its signal is unreadable ({error}); give --preset or --set") from None


def receive_film(
    film: FilmReader,
    signal: SignalSettings,
    settings: LinkSettings,
    reception: Reception,
    observe: Observer = ignore,
    progress: Progress = silent,
) -> Iterator[tuple[Packet, list[Message]]]:
    """Packets of a film, each with the messages it completes, as soon as they are read.

    Parameters
    ----------
    film
        The film, open.
    signal
        What its light speaks.
    settings
        The receiver's part is used.
    reception
        Counts what comes; it holds the results so far if reading breaks off.
    observe
        Gets what each stage of the receiver produces.
    progress
        Called with the number of frames read.

    Raises
    ------
    MediaError
        The film breaks off or is shorter than a packet; all packets before have been given.
    """
    receiver = Receiver(signal, settings.receive, observe)
    for frame in _whole_film(film, reception, progress):
        for packet in receiver.push(frame):
            yield packet, list(reception.add(packet))
    for packet in receiver.finish():
        yield packet, list(reception.add(packet))
    if reception.frames < signal.packet_patterns:
        raise MediaError(
            f"{film.path} has {reception.frames} frames; a packet takes {signal.packet_patterns}: record longer"
        )


def _whole_film(film: FilmReader, reception: Reception, progress: Progress) -> Iterator[Frame]:
    for frame in film:
        reception.saw(frame.index)
        yield frame
        progress(reception.frames)


def _close(film: Any, truth: TruthWriter, count: int) -> None:
    if not count:
        film.abort()
        truth.abort()
        raise MediaError("the film has no frames: the drive is shorter than an exposure; raise channel.duration_s")
    film.finish()
    truth.finish()


def packet_row(packet: Packet) -> Mapping[str, Any]:
    """A packet as plain values, for the packet log."""
    return {
        "id": packet.identity,
        "status": packet.status,
        "time_s": round(packet.start_time_s, 6),
        "first_frame": packet.first_frame,
        "last_frame": packet.last_frame,
        "x": round(packet.pose.x, 3),
        "y": round(packet.pose.y, 3),
        "pitch_px": round(packet.pose.pitch, 5),
        "roll_rad": round(packet.pose.roll, 5),
        "blur_px": round(packet.pose.blur, 4),
        "distance_m": round(packet.distance_m, 3),
        "header_score": round(packet.header_score, 3),
        "track_score": round(packet.track_score, 4),
        "pairs_seen": round(packet.pairs_seen, 4),
        "layers": {
            name: [
                {"status": w.status, "iterations": w.iterations, "margin": round(w.margin, 2)}
                | ({"stream": w.block.stream, "sequence": w.block.sequence} if w.block else {})
                for w in words
            ]
            for name, words in packet.layers.items()
        },
    }
