"""Simulated films, and packets of films."""

import contextlib
import math
import uuid
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from heliograph.base.errors import MediaError, counted
from heliograph.base.files import room_for
from heliograph.base.frames import Frame
from heliograph.channel.camera import frame_count
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, simulate
from heliograph.link.truth import TRUTH_TAG, TruthWriter, signal_note, truth_path
from heliograph.media import create_film
from heliograph.media.hdf5 import SUFFIXES as HDF5_SUFFIXES
from heliograph.receive.packet import Packet, Receiver
from heliograph.signal.block import AnyBlock, FileBlock, FileNotice, SymbolBlock
from heliograph.signal.settings import SignalSettings
from heliograph.transmit import Messages

FrameProgress = Callable[[int], None]  # callback with the number of completed frames


class FrameSource(Protocol):
    """Frames in temporal order: an open film, or rendered frames."""

    @property
    def path(self) -> Path | str:
        """Film name for messages."""

    def __iter__(self) -> Iterator[Frame]: ...


def silent(frames: int, /) -> None:
    """Report no progress."""


def write_film(
    path: Path,
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    recordings: Recordings | None = None,
    progress: FrameProgress = silent,
    **codec: Any,
) -> int:
    """Simulate a drive; write the film and the truth file."""
    camera, film_id = settings.channel.camera, uuid.uuid4().hex
    if path.suffix.lower() in HDF5_SUFFIXES:  # uncompressed: the size is known
        depth = 1 if settings.channel.sensor.bits == 8 else 2
        room_for(path, frames_of(settings) * camera.width * camera.height * depth)
    film = create_film(
        path,
        width=camera.width,
        height=camera.height,
        rate_hz=camera.fps,
        bits=settings.channel.sensor.bits,
        metadata={**signal_note(settings.signal), TRUTH_TAG: film_id},
        **codec,
    )

    def finish() -> None:
        if film.frames_written:
            with truth.finishing():
                film.finish()

    with contextlib.ExitStack() as undo:
        undo.callback(film.abort)  # no effect on a finished film
        truth = TruthWriter(truth_path(path), settings, messages, seed, film_id)
        undo.callback(truth.close)
        try:
            for frame, row in simulate(settings, messages, seed, recordings):
                film.write(frame)
                truth.add(row)
                progress(film.frames_written)
        except KeyboardInterrupt:
            finish()
            raise
        finish()
    if not film.frames_written:
        raise MediaError("the film has no frames: the drive is shorter than an exposure; raise channel.duration_s")
    return film.frames_written


def frames_of(settings: LinkSettings) -> int:
    """Return the number of frames of a simulation, dropped frames included."""
    return frame_count(settings.channel)


def sent_s(settings: LinkSettings) -> float:
    """Return the longest transmission of an array until the last frame, in s."""
    channel = settings.channel
    first = min((array.start_s for array in channel.arrays), default=0.0)
    return channel.camera.start_s - first + frames_of(settings) * channel.camera.frame_period_s


def read_packets(film: FrameSource, signal: SignalSettings, receiver: Receiver) -> Iterator[Packet]:
    """Yield the packets of a film as soon as they are decoded; drop results that are no packet (`is_packet`)."""
    frames = 0
    try:
        for frame in film:
            frames += 1
            yield from filter(is_packet, receiver.push(frame))
    except MediaError:
        yield from filter(is_packet, receiver.finish())
        raise
    yield from filter(is_packet, receiver.finish())
    if frames < signal.packet_patterns:
        length = counted(frames, "frame")
        remedy = "record longer" if frames > 1 else "give a film, a stack, or the folder of all its pictures"
        raise MediaError(f"{film.path} has {length}; a packet takes {signal.packet_patterns}: {remedy}")


def is_packet(packet: Packet) -> bool:
    """True if a receiver result has a header or a correct codeword; other results are neither counted nor logged."""
    return packet.status not in ("no_header", "no_array")


def packet_row(packet: Packet, confirmed: Container[int] = ()) -> Mapping[str, Any]:
    """Return a packet as plain values for the packet log."""
    uncertain = not packet.has_codeword and packet.identity not in confirmed
    return {
        "id": packet.identity,
        **({"uncertain": True} if uncertain else {}),
        "status": packet.status,
        **({"reason": packet.reason} if packet.reason else {}),
        "format": packet.format.number,
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
        "orientation": str(packet.orientation),
        "track_score": round(packet.track_score, 4),
        **({} if math.isnan(packet.pose_std_px) else {"pose_std_px": round(packet.pose_std_px, 3)}),
        "pairs_seen": round(packet.pairs_seen, 4),
        "layers": {
            name: [
                {"status": w.status, "iterations": w.iterations, "margin": round(w.margin, 2)}
                | ({} if math.isnan(w.information) else {"information": round(w.information, 3)})
                | (_place(w.block) if w.block else {})
                for w in words
            ]
            for name, words in packet.layers.items()
        },
    }


def _place(block: AnyBlock) -> dict[str, Any]:
    """Return the message or file of a block."""
    if isinstance(block, FileBlock):
        return {"file": f"{block.check:08x}", "symbol": block.number}
    if isinstance(block, FileNotice):
        return {"file": f"{block.check:08x}"}
    if isinstance(block, SymbolBlock):
        return {"file": f"{block.tag:02x}", "symbol": block.number}  # prefix of the check value
    return {"stream": block.stream, "sequence": block.sequence}
