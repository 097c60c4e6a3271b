"""Films of simulated drives, and films received: the link with files at its ends."""

import contextlib
import json
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from heliograph.base.config import from_mapping, keys_of, merge, to_mapping
from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.channel import frame_count
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings, simulate
from heliograph.link.truth import TruthFile, TruthWriter, truth_path
from heliograph.measure.reception import Reception, is_packet
from heliograph.media import FilmReader, create_film
from heliograph.receive import Packet, make_receiver
from heliograph.receive.packets import Observer, ignore
from heliograph.signal.message import Message
from heliograph.signal.settings import SignalSettings

SIGNAL_TAG = "heliograph_signal"
"""Metadata of a film that tells what the light speaks; a receiver may know that."""

RATE_TOLERANCE = 1e-3
"""Departure of a film's rate from its truth's, as a share, that a container's rounding explains."""

TRUTH_TAG = "heliograph_simulation"
"""Metadata of a simulated film that tells which truth file is its own: a random id both have."""

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
        The film or its truth cannot be written; nothing is left behind then, and what was there stays.
    """
    camera, film_id = settings.channel.camera, uuid.uuid4().hex
    film = create_film(
        path,
        width=camera.width,
        height=camera.height,
        rate_hz=camera.fps,
        bits=settings.channel.sensor.bits,
        metadata={SIGNAL_TAG: json.dumps(to_mapping(settings.signal)), TRUTH_TAG: film_id},
        **codec,
    )
    interrupted: KeyboardInterrupt | None = None
    with contextlib.ExitStack() as undo:
        undo.callback(film.abort)  # does nothing once the film is finished
        truth = TruthWriter(truth_path(path), settings, messages, seed, film_id)
        undo.callback(truth.abort)
        try:
            for frame, row in simulate(settings, messages, seed, recordings):
                film.write(frame)
                truth.add(row)
                progress(film.frames_written)
        except KeyboardInterrupt as error:
            interrupted = error
        if film.frames_written:
            with truth.finishing():
                film.finish()
    if interrupted is not None:
        raise interrupted
    if not film.frames_written:
        raise MediaError("the film has no frames: the drive is shorter than an exposure; raise channel.duration_s")
    return film.frames_written


def frames_of(settings: LinkSettings) -> int:
    """Frames a simulation will have."""
    return frame_count(settings.channel)


def noted_signal(film: FilmReader) -> dict[str, Any]:
    """What a film notes of its signal, as nested mappings; empty where it notes nothing.

    Raises
    ------
    MediaError
        The note is unreadable.
    """
    text = film.metadata.get(SIGNAL_TAG)
    if text is None:
        return {}
    try:
        note = json.loads(text)
        from_mapping(SignalSettings, note)
    except ValueError as error:  # no JSON, or no settings
        raise MediaError(f"the film's note on its signal is unreadable ({error}); set signal.* yourself") from None
    return dict(note)


def signal_of(
    film: FilmReader, preset: SignalSettings, changes: Sequence[Mapping[str, Any]] = ()
) -> tuple[SignalSettings, str]:
    """What the light of a film speaks: the preset's signal, over it the film's note, over it the changes.

    Parameters
    ----------
    film
        Its note wins over the preset. One that is unreadable is passed over where the changes say something.
    preset
        What is not noted.
    changes
        Nested mappings of signal settings, laid over the note key by key.

    Returns
    -------
    The signal, and where the changes differ from the note: empty, or a line on it.

    Raises
    ------
    MediaError
        The film's note is unreadable.
    """
    try:
        note = noted_signal(film)
    except MediaError:
        if not any(changes):
            raise
        note = {}
    noted = merge(to_mapping(preset), note)
    tree = noted
    for change in changes:
        tree = merge(tree, change)
    signal = from_mapping(SignalSettings, tree)
    departures = _differences(signal, from_mapping(SignalSettings, noted)) if note else []
    listed = ", ".join(f"{key}={ours} instead of {theirs}" for key, ours, theirs in departures)
    return signal, f"not as the film's note says: {listed}" if listed else ""


def _differences(one: SignalSettings, other: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Dotted keys in which two signals differ, with both values."""
    pairs = [(key, _value(one, key), _value(other, key)) for key in keys_of(SignalSettings)]
    return [(f"signal.{key}", _shown(a), _shown(b)) for key, a, b in pairs if a != b]


def _value(settings: Any, key: str) -> Any:
    for part in key.split("."):
        settings = getattr(settings, part)
    return settings


def _shown(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def check_truth(film: FilmReader, truth: TruthFile, signal: SignalSettings) -> None:
    """Raise a MediaError where counting against a truth would invent errors.

    It must be that of the film, and the signal the film is read with must be that sent.
    """
    camera, own = truth.settings.channel.camera, film.metadata.get(TRUTH_TAG)
    size, rate = (camera.width, camera.height), camera.fps
    if own and truth.film_id and own != truth.film_id:
        differs = "they come from different simulations"
    elif size != (film.width, film.height):
        differs = f"it has frames of {size[0]}x{size[1]} pixels, the film of {film.width}x{film.height}"
    elif abs(rate / film.rate_hz - 1) > RATE_TOLERANCE:
        differs = f"it has {rate:g} frames/s, the film {film.rate_hz:g}"
    elif departures := _differences(signal, truth.settings.signal):
        key, ours, sent = departures[0]
        raise MediaError(
            f"{key} is {ours}, but {truth.path} says {sent} was sent: errors cannot be counted; "
            f"leave signal.* as the film notes it, or give no truth"
        )
    else:
        return
    raise MediaError(f"{truth.path} is not the truth of {film.path}: {differs}; give the one written beside the film")


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
    receiver = make_receiver(signal, settings.receive, observe)
    broken: MediaError | None = None
    try:
        for frame in _whole_film(film, reception, progress):
            for packet in filter(is_packet, receiver.push(frame)):
                yield packet, list(reception.add(packet))
            reception.detections = receiver.detections
    except MediaError as error:
        broken = error
    for packet in filter(is_packet, receiver.finish()):
        yield packet, list(reception.add(packet))
    if broken is not None:
        raise broken
    if reception.frames < signal.packet_patterns:
        raise MediaError(
            f"{film.path} has {reception.frames} frames; a packet takes {signal.packet_patterns}: record longer"
        )


def _whole_film(film: FilmReader, reception: Reception, progress: Progress) -> Iterator[Frame]:
    for frame in film:
        reception.saw(frame.index)
        yield frame
        progress(reception.frames)


def packet_row(packet: Packet) -> Mapping[str, Any]:
    """A packet as plain values, for the packet log."""
    return {
        "id": packet.identity,
        "status": packet.status,
        "format": packet.named.number,
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
