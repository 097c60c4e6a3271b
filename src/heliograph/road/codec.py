"""SPATEM and MAPEM in UPER by `pycrate` (extra `its`): encode a junction, decode messages to plain values."""

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from functools import lru_cache
from typing import Any

from heliograph.base.errors import SettingsError
from heliograph.road.junction import GroupSettings, Junction, LaneSettings, Phase

SPATEM, MAPEM = 4, 5
"""Numbers of the messages in their header (ETSI TS 102 894-2)."""

NAMES = {SPATEM: "SPATEM", MAPEM: "MAPEM"}

MOST_BYTES = 8192
"""Most bytes of a message that is read. Chosen: a MAPEM of 100 lanes has about 3000."""

_LOCK = threading.Lock()
"""The package keeps the value that it last coded in its types: one thread at a time."""


class UnreadableError(ValueError):
    """A message cannot be read; the text says why, in a line."""


def kind_of(data: bytes) -> str | None:
    """Return "SPATEM" or "MAPEM" by a message's header; None of another one."""
    # versions that are read: the messages of both are alike
    # bytes of the header: version, message, station
    if len(data) <= 6 or data[0] not in (1, 2):
        return None
    return NAMES.get(data[1])


def is_there() -> bool:
    """Whether the package `pycrate` is installed."""
    try:
        _type(SPATEM)
    except SettingsError:
        return False
    return True


def packed(message: int, station: int, content: Mapping[str, Any]) -> bytes:
    """Return a message as UPER."""
    # version of the header that is written
    header = {"protocolVersion": 1, "messageID": message, "stationID": station}
    with _LOCK:
        kind = _type(message)
        kind.set_val({"header": header, "spat" if message == SPATEM else "map": dict(content)})
        return bytes(kind.to_uper())


def unpacked(data: bytes) -> tuple[str, int, dict[str, Any]]:
    """Return a message's kind, the number of its station, and what it says, as the package has it."""
    kind = kind_of(data)
    if kind is None:
        raise UnreadableError("it is no SPATEM or MAPEM")
    if len(data) > MOST_BYTES:
        raise UnreadableError(f"this {kind} has {len(data)} bytes, more than {MOST_BYTES}")
    with _LOCK:
        try:
            coded = _type(data[1])
            coded.from_uper(data)
            value: dict[str, Any] = coded.get_val()
            coded.set_val(value)
            same = bytes(coded.to_uper()) == data
        except SettingsError as error:
            raise UnreadableError(str(error)) from None
        except Exception:  # the package raises what its parts raise: IndexError, KeyError, its own
            raise UnreadableError(f"this {kind} is damaged: it is not as ISO TS 19091 has it") from None
    if not same:
        raise UnreadableError(f"this {kind} is damaged: there is one way to write what it says, and it is another")
    return kind, int(value["header"]["stationID"]), value["spat" if kind == "SPATEM" else "map"]


@lru_cache(maxsize=2)
def _type(message: int) -> Any:
    try:
        from pycrate_asn1dir import ITS_IS
    except ImportError:
        raise SettingsError("messages of the road need the package pycrate: pip install 'heliograph[its]'") from None
    return ITS_IS.SPATEM_PDU_Descriptions.SPATEM if message == SPATEM else ITS_IS.MAPEM_PDU_Descriptions.MAPEM


STATES: dict[Phase, str] = {
    "red": "stop-And-Remain",
    "red-yellow": "pre-Movement",
    "green": "permissive-Movement-Allowed",
    "green-free": "protected-Movement-Allowed",
    "yellow": "protected-clearance",
    "flashing": "caution-Conflicting-Traffic",
    "dark": "dark",
}
"""What a light shows, by the name that the standard has for it."""


def spatem(junction: Junction, time_s: float) -> bytes:
    """Return what the lights show, with the time of the message, as UPER."""
    now = junction.begins + timedelta(seconds=time_s)
    minute = now.replace(second=0, microsecond=0)
    state = {
        "id": {"id": junction.id},
        "revision": 1,
        "status": (0, 16),
        "moy": int((minute - minute.replace(month=1, day=1, hour=0, minute=0)).total_seconds()) // 60,
        "timeStamp": int((now - minute).total_seconds() * 1000),
        "states": [_movement(junction, group, time_s) for group in junction.groups],
    }
    return packed(SPATEM, junction.station, {"intersections": [state]})


def mapem(junction: Junction) -> bytes:
    """Return the junction's lanes as UPER."""
    if not junction.lanes:
        raise SettingsError(f"junction {junction.id} has no lanes: a map needs [[lanes]] with lane and points_m")
    geometry = {
        "name": junction.name,
        "id": {"id": junction.id},
        "revision": 1,
        "refPoint": {"lat": round(junction.latitude * 1e7), "long": round(junction.longitude * 1e7)},
        "laneWidth": round(junction.lane_width_m * 100),
        "laneSet": [_encode_lane(lane) for lane in junction.lanes],
    }
    return packed(MAPEM, junction.station, {"msgIssueRevision": 1, "intersections": [geometry]})


def updates(junction: Junction, duration_s: float) -> tuple[tuple[float, bytes], ...]:
    """Return the SPATEMs of a transmission, each with the time in s from which on it is sent."""
    count = max(1, math.ceil(duration_s / junction.update_s))
    return tuple((k * junction.update_s, spatem(junction, k * junction.update_s)) for k in range(count))


def _movement(junction: Junction, group: GroupSettings, time_s: float) -> dict[str, Any]:
    events: list[dict[str, Any]] = []
    # phases that a SPATEM tells of each group: that of now and the next
    for phase, end_s in group.following(time_s, 2):
        timing: dict[str, int] = {"minEndTime": _mark(junction, end_s), "maxEndTime": _mark(junction, end_s)}
        if events:
            timing["startTime"] = events[-1]["timing"]["minEndTime"]
        events.append({"eventState": STATES[phase], "timing": timing})
    return {"signalGroup": group.group, "state-time-speed": events}


def _mark(junction: Junction, time_s: float) -> int:
    """Tenths of a second in the hour of UTC."""
    when = junction.begins + timedelta(seconds=time_s)
    return round((when.minute * 60 + when.second + when.microsecond * 1e-6) * 10) % 36000


def _encode_lane(lane: LaneSettings) -> dict[str, Any]:
    out: dict[str, Any] = {
        "laneID": lane.lane,
        "laneAttributes": {
            "directionalUse": (0b10 if lane.towards else 0b01, 2),
            "sharedWith": (0, 10),
            "laneType": (lane.kind, (0, 16 if lane.kind not in ("vehicle",) else 8)),
        },
        "nodeList": ("nodes", _nodes(lane)),
    }
    if lane.to:
        group = {} if lane.group is None else {"signalGroup": lane.group}
        out["connectsTo"] = [{"connectingLane": {"lane": to}, **group} for to in lane.to]
    return out


def _nodes(lane: LaneSettings) -> Sequence[dict[str, Any]]:
    """Steps from point to point in whole cm, which do not add up their rounding."""
    nodes, at = [], (0, 0)
    for point in lane.points_m:
        place = (round(point[0] * 100), round(point[1] * 100))
        step = (place[0] - at[0], place[1] - at[1])
        # kinds of a step from point to point, and the bits of its size in cm
        kind = next(
            (
                name
                for name, bits in (
                    ("node-XY1", 9),
                    ("node-XY2", 10),
                    ("node-XY3", 11),
                    ("node-XY4", 12),
                    ("node-XY5", 13),
                    ("node-XY6", 15),
                )
                if all(-(1 << bits) <= s < 1 << bits for s in step)
            ),
            None,
        )
        if kind is None:
            raise SettingsError(f"lane {lane.lane}: points lie at most 327 m apart; add points between")
        nodes.append({"delta": (kind, {"x": step[0], "y": step[1]})})
        at = place
    return nodes


Values = Mapping[str, Any]
"""What a message says: numbers, texts, lists and mappings by text, as JSON has them."""

PHASES = {
    "stop-And-Remain": "red",
    "stop-Then-Proceed": "red",
    "pre-Movement": "red-yellow",
    "permissive-Movement-Allowed": "green",
    "protected-Movement-Allowed": "green-free",
    "permissive-clearance": "yellow",
    "protected-clearance": "yellow",
    "caution-Conflicting-Traffic": "flashing",
    "dark": "dark",
    "unavailable": "unknown",
}
"""What a light shows by the standard's name."""

HOUR_S = 3600.0


def road_values(data: bytes) -> Values | None:
    """Return what a message of the road says; None of any other message."""
    kind = kind_of(data)
    if kind is None:
        return None
    try:
        _, station, content = unpacked(data)
    except UnreadableError as error:
        return {"kind": kind, "junctions": [], "reason": str(error)}
    of = _lights if kind == "SPATEM" else _map
    return {"kind": kind, "station": station, "junctions": [of(one) for one in content.get("intersections", ())]}


def left_s(end_s: float, now_s: float) -> float:
    """Return the seconds from now to an end, both in s of the hour; an end of up to half an hour ago is below 0."""
    return (end_s - now_s + HOUR_S / 2) % HOUR_S - HOUR_S / 2


def road_words(values: Values) -> str:
    """Return what a message of the road says in a line."""
    if "reason" in values:
        return str(values["reason"])
    parts = [
        f"junction {one['id']}: {', '.join(map(group_words, one['groups']))}"
        if values["kind"] == "SPATEM"
        else f"junction {one['id']}{_named(one)}: {len(one['lanes'])} lanes"
        for one in values["junctions"]
    ]
    return f"{values['kind']} of " + "; ".join(parts or ["no junction"])


def group_words(group: Values) -> str:
    """Return what the lights of a group show, and for how long."""
    left = group["left_s"]
    return f"group {group['group']} {group['phase']}" + ("" if left is None else f", {max(left, 0.0):.1f} s left")


def _named(junction: Values) -> str:
    # from the air: nothing of it reaches a terminal as it is
    name = "".join(c for c in junction["name"] or "" if c.isprintable())
    return f" ({name})" if name else ""


def _lights(state: Mapping[str, Any]) -> dict[str, Any]:
    minute, ms = state.get("moy"), state.get("timeStamp")
    stamp_s = None if minute is None or ms is None else (minute % 60 * 60 + ms / 1000) % HOUR_S
    return {
        "id": state["id"]["id"],
        "stamp_s": stamp_s,
        "groups": [_group(one, stamp_s) for one in state.get("states", ())],
    }


def _group(movement: Mapping[str, Any], stamp_s: float | None) -> dict[str, Any]:
    events = [
        {"phase": PHASES.get(event["eventState"], "unknown"), "end_s": _end(event.get("timing", {}))}
        for event in movement["state-time-speed"]
    ]
    end_s = _end(movement["state-time-speed"][0].get("timing", {}))
    left = None if end_s is None or stamp_s is None else round(left_s(end_s, stamp_s), 1)
    return {"group": movement["signalGroup"], **events[0], "left_s": left, "then": events[1:]}


def _end(timing: Mapping[str, Any]) -> float | None:
    mark = timing.get("minEndTime")
    # times in a message count tenths of a second in the hour; this one stands for none
    return None if mark is None or mark >= 36001 else mark / 10


def _map(geometry: Mapping[str, Any]) -> dict[str, Any]:
    place, width = geometry["refPoint"], geometry.get("laneWidth")
    # latitude and longitude that stand for none
    known = (place["lat"], place["long"]) != (900000001, 1800000001)
    return {
        "id": geometry["id"]["id"],
        "name": geometry.get("name"),
        "latitude": place["lat"] / 1e7 if known else None,
        "longitude": place["long"] / 1e7 if known else None,
        "lane_width_m": None if width is None else width / 100,
        "lanes": [_lane(one) for one in geometry["laneSet"]],
    }


def _lane(lane: Mapping[str, Any]) -> dict[str, Any]:
    attributes = lane["laneAttributes"]
    use = attributes["directionalUse"][0]
    links = lane.get("connectsTo", ())
    kind, nodes = lane["nodeList"]
    return {
        "lane": lane["laneID"],
        "kind": attributes["laneType"][0],
        "towards": bool(use & 2),
        "away": bool(use & 1),
        # a lane may be said to be like another one, moved: it has no points of its own
        "points_m": list(_points(nodes)) if kind == "nodes" else [],
        "groups": sorted({one["signalGroup"] for one in links if "signalGroup" in one}),
        "to": [one["connectingLane"]["lane"] for one in links],
    }


def _points(nodes: Sequence[Mapping[str, Any]]) -> Iterator[tuple[float, float]]:
    """East and north in m, of steps in cm; a place by latitude and longitude ends them."""
    x = y = 0
    for node in nodes:
        step = node["delta"][1]
        if not isinstance(step, Mapping) or "x" not in step:
            return
        x, y = x + step["x"], y + step["y"]
        yield x / 100, y / 100
