"""Journal of a reception as rows of plain values: arrays found and lost, packets, messages."""

from base64 import b64encode
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.film import packet_row
from heliograph.measure.reception import file_counts
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, LostEvent, MissedStartEvent
from heliograph.receive.packet import Packet
from heliograph.receive.settings import CalibrationSettings
from heliograph.road.codec import group_words, road_values, road_words
from heliograph.road.countdown import Countdown
from heliograph.signal.fountain.files import FileProgress
from heliograph.signal.message import Message

Row = Mapping[str, Any]
"""Plain values; `event` is "found", "missed_start", "packet", "message", "lights", "file" or "lost"."""


class Journal:
    """Reporter of the events of a reception in temporal order."""

    def __init__(self, calibration: CalibrationSettings, report: Callable[[Row], None]):
        self._calibration, self._report = calibration, report
        self._paths: dict[int, deque[tuple[float, float]]] = {}
        self._orientations: dict[int, str] = {}
        self._confirmed: set[int] = set()
        self._lights: dict[int, Countdown] = defaultdict(Countdown)

    def observe(self, event: object) -> None:
        """Report arrays found and lost from an event of the receiver."""
        if isinstance(event, DetectEvent):
            self._orientations[event.detection.identity] = str(event.detection.orientation)
            self._report(self._found(event.detection, event.frames))
        elif isinstance(event, MissedStartEvent):
            self._report({"event": "missed_start", "id": event.identity, "time_s": round(event.time_s, 6)})
        elif isinstance(event, LostEvent):
            path = self._paths.pop(event.identity, ())
            last = {"distance_m": round(path[-1][1], 3)} if path else {}
            row = {"event": "lost", **self._named(event.identity), "time_s": round(event.time_s, 6), **last}
            orientation = self._orientations.get(event.identity, "upright")
            self._report({**row, "orientation": orientation, "approach_m_s": approach(path)})

    def read(self, packet: Packet, messages: Sequence[Message], files: Sequence[FileProgress] = ()) -> None:
        """Report a packet, the completed messages and the progress of files."""
        # 8 packets, 0.8 s of the reference link, give the speed
        path = self._paths.setdefault(packet.identity, deque(maxlen=8))
        path.append((packet.start_time_s, packet.distance_m))
        self._orientations[packet.identity] = str(packet.orientation)
        if packet.has_codeword:
            self._confirmed.add(packet.identity)
        row: dict[str, Any] = {"event": "packet", **packet_row(packet, self._confirmed), "approach_m_s": approach(path)}
        if packet.status != "ok":
            row["explanation"] = packet.explain()
        self._report(row)
        for message in messages:
            message_values = message_row(message)
            self._report(message_values)
            if "road" in message_values:
                self._lights[packet.identity].take(message_values["road"], packet.start_time_s)
        lights = self._lights[packet.identity].at(packet.start_time_s)
        if lights:
            when = round(packet.start_time_s, 6)
            self._report({"event": "lights", "id": packet.identity, "time_s": when, "junctions": lights})
        for progress in files:
            self._report(file_row(progress, packet.identity))

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
        """Return the identity, marked as uncertain until a codeword is decoded."""
        return {"id": identity} | ({} if identity in self._confirmed else {"uncertain": True})


def approach(path: Sequence[tuple[float, float]]) -> float | None:
    """Return the approach speed in m/s from times and distances; None for fewer than 3 packets."""
    if len(path) < 3:
        return None
    times_s, distances_m = np.array(path).T
    times_s = times_s - times_s.mean()
    power = float(times_s @ times_s)
    return round(-float(times_s @ distances_m) / power, 2) if power else None


def message_row(message: Message) -> Row:
    """Return a message as plain values: Base64 data, and the road message or UTF-8 text, if valid."""
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
    """Return the progress of a file as plain values, with Base64 data if complete."""
    row: dict[str, Any] = {"event": "file", "id": identity, **file_counts(progress)}
    if progress.reason:
        row["reason"] = progress.reason
    if (file := progress.whole) is not None:
        row |= {"name": file.name, "bytes": len(file.data), "data": b64encode(file.data).decode("ascii")}
    return row


def sentence(row: Row) -> str:
    """Return a row as a sentence."""
    array = f"array {row['id']}"
    if row["event"] == "message":
        road = f"; {road_words(row['road'])}" if "road" in row else ""
        return f"{array}: message {row['stream']} of the {row['layer']} layer is whole, {row['bytes']} bytes{road}"
    if row["event"] == "file":
        return f"{array}: {file_words(row)}"
    when = f"{row['time_s']:z.3f} s: {array}"
    if row["event"] == "lights":
        return f"{when} tells of " + "; ".join(
            f"junction {junction['id']}: {', '.join(map(group_words, junction['groups']))}"
            for junction in row["junctions"]
        )
    if row["event"] == "found":
        moves = f"moving by {float(np.hypot(*row['drift_px_s'])):.0f} px/s in the image"
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
    """Return a sentence about a lost packet before the first header of an array."""
    first = f"before the first header found, at {row['time_s']:z.3f} s"
    return f"array {row['id']}: a packet began {first}; that packet is lost"


def file_words(row: Row) -> str:
    """Return the progress of a file in words."""
    if row["whole"]:
        return f"file {row['file']} is whole: {row['name']!r}, {row['bytes']} bytes"
    part = f"file {row['file']}: {row['symbols']} of {row['needed']} symbols, {row['bytes']} bytes in all"
    return f"{part}; {row['reason']}" if "reason" in row else part


def _doubt(row: Row) -> str:
    """Return a note for an uncertain identity, or an empty text."""
    return "; identity uncertain: no codeword decoded yet" if row.get("uncertain") else ""


def _moves(row: Row) -> str:
    """Return the approach speed in words; an empty text if unknown."""
    speed = row["approach_m_s"]
    if speed is None:
        return ""
    kmh = f"{abs(speed) * 3.6:.0f}"
    return ", at rest" if kmh == "0" else f", {'nearing' if speed >= 0 else 'receding'} at {kmh} km/h"
