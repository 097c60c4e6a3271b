"""What happens in a reception as it happens, in rows of plain values: arrays found and lost, packets, messages."""

from base64 import b64encode
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.film import packet_row
from heliograph.receive import Packet
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, LostEvent, MissedStartEvent
from heliograph.receive.settings import CalibrationSettings
from heliograph.road.codec import group_words, road_values, road_words
from heliograph.road.countdown import Countdown
from heliograph.signal.fountain.files import FileProgress
from heliograph.signal.message import Message

Row = Mapping[str, Any]
"""What happened, as plain values; its `event` is "found", "missed_start", "packet", "message", "lights", "file" or
"lost"."""

FEWEST_PACKETS = 3
"""Fewest packets that tell a speed. Chosen."""


class Journal:
    """Tells what happens in a reception, in the order in which it happens."""

    def __init__(self, calibration: CalibrationSettings, tell: Callable[[Row], None]):
        self._calibration, self._tell = calibration, tell
        self._ways: dict[int, deque[tuple[float, float]]] = {}
        self._orientations: dict[int, str] = {}
        self._confirmed: set[int] = set()
        self._lights: dict[int, Countdown] = defaultdict(Countdown)

    def observe(self, event: object) -> None:
        """Take an event of the receiver; arrays found and lost are told."""
        if isinstance(event, DetectEvent):
            self._orientations[event.detection.identity] = str(event.detection.orientation)
            self._tell(self._found(event.detection, event.frames))
        elif isinstance(event, MissedStartEvent):
            self._tell({"event": "missed_start", "id": event.identity, "time_s": round(event.time_s, 6)})
        elif isinstance(event, LostEvent):
            way = self._ways.pop(event.identity, None)
            last = {"distance_m": round(way[-1][1], 3)} if way else {}
            row = {"event": "lost", **self._named(event.identity), "time_s": round(event.time_s, 6), **last}
            seen_as = self._orientations.get(event.identity, "upright")
            self._tell({**row, "orientation": seen_as, "approach_m_s": approach(way or ())})

    def read(self, packet: Packet, messages: Sequence[Message], files: Sequence[FileProgress] = ()) -> None:
        """Tell a packet, the messages that it completes, and how far files have come with it."""
        # Most packets over which a speed is averaged: 0.8 s of the reference link. Chosen
        way = self._ways.setdefault(packet.identity, deque(maxlen=8))
        way.append((packet.start_time_s, packet.distance_m))
        self._orientations[packet.identity] = str(packet.orientation)
        if packet.has_codeword:
            self._confirmed.add(packet.identity)
        row: dict[str, Any] = {"event": "packet", **packet_row(packet, self._confirmed), "approach_m_s": approach(way)}
        if packet.status != "ok":
            row["explanation"] = packet.explain()
        self._tell(row)
        for message in messages:
            said = message_row(message)
            self._tell(said)
            if "road" in said:
                self._lights[packet.identity].take(said["road"], packet.start_time_s)
        lights = self._lights[packet.identity].at(packet.start_time_s)
        if lights:
            when = round(packet.start_time_s, 6)
            self._tell({"event": "lights", "id": packet.identity, "time_s": when, "junctions": lights})
        for progress in files:
            self._tell(file_row(progress, packet.identity))

    def _found(self, detection: Detection, frames: Sequence[Frame]) -> Row:
        return {
            "event": "found",
            **self._named(detection.identity),
            "time_s": round(detection.start_time_s, 6),
            "frame": frames[-1].index,
            "x": round(detection.fit.pose.x, 3),
            "y": round(detection.fit.pose.y, 3),
            "distance_m": round(self._calibration.distance_m(detection.fit.pose), 3),
            "orientation": str(detection.orientation),
            "drift_px_s": [round(speed, 1) for speed in detection.drift],
            "score": round(detection.score, 3),
        }

    def _named(self, identity: int) -> Row:
        """The identity of an array, marked as uncertain until a codeword of the array is decoded."""
        return {"id": identity} | ({} if identity in self._confirmed else {"uncertain": True})


def approach(way: Sequence[tuple[float, float]]) -> float | None:
    """Speed at which an array comes nearer, in m/s; None of fewer than `FEWEST_PACKETS` places."""
    if len(way) < FEWEST_PACKETS:
        return None
    times_s, distances_m = np.array(way).T
    times_s = times_s - times_s.mean()
    power = float(times_s @ times_s)
    return round(-float(times_s @ distances_m) / power, 2) if power else None


def message_row(message: Message) -> Row:
    """A message as plain values: its bytes in Base64, as text where they are UTF-8, what it says of the road."""
    row = {
        "event": "message",
        "id": message.identity,
        "layer": message.layer,
        "stream": message.stream,
        "bytes": len(message.data),
        "data": b64encode(message.data).decode("ascii"),
    }
    road = road_values(message.data)
    if road is not None:
        return {**row, "road": road}
    try:
        return {**row, "text": message.data.decode("utf-8")}
    except UnicodeDecodeError:
        return row


def file_row(progress: FileProgress, identity: int) -> Row:
    """What is there of a file, as plain values; its content in Base64 where it is whole."""
    key, whole = progress.key, progress.whole
    row: dict[str, Any] = {
        "event": "file", "id": identity, "file": str(key), "bytes": key.length, "symbols": progress.had,
        "needed": key.count, "whole": whole is not None,
    }  # fmt: skip
    if progress.reason:
        row["reason"] = progress.reason
    if whole is not None:
        row |= {"name": whole.name, "bytes": len(whole.data), "data": b64encode(whole.data).decode("ascii")}
    return row


def sentence(row: Row) -> str:
    """A row in words, for people."""
    array = f"array {row['id']}"
    if row["event"] == "message":
        said = f"; {road_words(row['road'])}" if "road" in row else ""
        return f"{array}: message {row['stream']} of the {row['layer']} layer is whole, {row['bytes']} bytes{said}"
    if row["event"] == "file":
        return f"{array}: {file_words(row)}"
    when = f"{row['time_s']:.3f} s: {array}"
    if row["event"] == "lights":
        return f"{when} tells of " + "; ".join(
            f"junction {one['id']}: {', '.join(map(group_words, one['groups']))}" for one in row["junctions"]
        )
    if row["event"] == "found":
        drift = float(np.hypot(*row["drift_px_s"]))
        moves = f"moving by {drift:.0f} px/s in the image"
        return f"{when} found {row['distance_m']:.1f} m away, {moves}, {row['orientation']}{_doubt(row)}"
    if row["event"] == "missed_start":
        return missed_words(row)
    if row["event"] == "lost":
        if "distance_m" not in row:
            return f"{when} lost, no packet of it was read, {row['orientation']}{_doubt(row)}"
        last = f"last seen {row['distance_m']:.1f} m away{_moves(row)}, {row['orientation']}"
        return f"{when} lost, {last}{_doubt(row)}"
    words = ", ".join(
        f"{name} {sum(word['status'] == 'ok' for word in words)} of {len(words)}"
        for name, words in row["layers"].items()
    )
    read = f"{when} read: {words}; {row['distance_m']:.1f} m away{_moves(row)}, {row['orientation']}{_doubt(row)}"
    return "\n  ".join([read, *row.get("explanation", "").splitlines()])


def missed_words(row: Row) -> str:
    """Say that the packet before the first header of an array is lost."""
    first = f"before the first header found, at {row['time_s']:.3f} s"
    return f"array {row['id']}: a packet began {first}; that packet is lost"


def file_words(row: Row) -> str:
    """How far a file has come, in words."""
    if row["whole"]:
        return f"file {row['file']} is whole: {row['name']!r}, {row['bytes']} bytes"
    part = f"file {row['file']}: {row['symbols']} of {row['needed']} symbols, {row['bytes']} bytes in all"
    return f"{part}; {row['reason']}" if "reason" in row else part


def _doubt(row: Row) -> str:
    """Note that the identity is uncertain; empty once a codeword is decoded."""
    return "; identity uncertain: no codeword decoded yet" if row.get("uncertain") else ""


def _moves(row: Row) -> str:
    """How fast an array comes nearer, in words; nothing where too few packets tell."""
    speed = row["approach_m_s"]
    if speed is None:
        return ""
    kmh = f"{abs(speed) * 3.6:.0f}"
    return ", at rest" if kmh == "0" else f", {'nearing' if speed >= 0 else 'receding'} at {kmh} km/h"
