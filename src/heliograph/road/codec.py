"""SPATEM and MAPEM in UPER by `pycrate` (extra `its`): encode junctions, decode messages to plain values."""

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from functools import lru_cache
from typing import Any

from heliograph.base.errors import SettingsError
from heliograph.road.junction import GroupSettings, Junction, LaneSettings, Phase

KINDS = {4: "SPATEM", 5: "MAPEM"}  # kind by message number in the header (ETSI TS 102 894-2)
MAX_BYTES = 8192  # maximum size of a message in bytes; a MAPEM of 100 lanes has about 3000

_LOCK = threading.Lock()  # lock for the types of pycrate, which store the latest value


def kind_of(data: bytes) -> str | None:
    """Return "SPATEM" or "MAPEM" by the header of a message, else None."""
    # header: version, message, station
    if len(data) <= 6 or data[0] not in (1, 2):
        return None
    return KINDS.get(data[1])


def is_there() -> bool:
    """Return True if `pycrate` is installed."""
    try:
        _types()
    except SettingsError:
        return False
    return True


def _encode(number: int, station: int, content: Mapping[str, Any]) -> bytes:
    """Return a message as UPER."""
    header = {"protocolVersion": 1, "messageID": number, "stationID": station}
    with _LOCK:
        kind, name = _types()[number]
        kind.set_val({"header": header, name: dict(content)})
        return bytes(kind.to_uper())


def _decode(data: bytes) -> tuple[int, Mapping[str, Any]]:
    """Return station number and content of a message; raise ValueError for an invalid message."""
    kind = KINDS[data[1]]
    if len(data) > MAX_BYTES:
        raise ValueError(f"this {kind} has {len(data)} bytes, more than {MAX_BYTES}")
    with _LOCK:
        coded, name = _types()[data[1]]
        try:
            coded.from_uper(data)
            value: dict[str, Any] = coded.get_val()
            coded.set_val(value)
            is_canonical = bytes(coded.to_uper()) == data
        except Exception:  # pycrate raises many kinds
            raise ValueError(f"this {kind} is damaged: the data violate ISO TS 19091") from None
    if not is_canonical:
        raise ValueError(f"this {kind} is damaged: the encoding is not canonical")
    return int(value["header"]["stationID"]), value[name]


@lru_cache(maxsize=1)
def _types() -> dict[int, tuple[Any, str]]:
    """Return type and field of the content by message number."""
    try:
        from pycrate_asn1dir import ITS_IS
    except ImportError:
        raise SettingsError("road messages need the package pycrate: pip install 'heliograph[its]'") from None
    return {4: (ITS_IS.SPATEM_PDU_Descriptions.SPATEM, "spat"), 5: (ITS_IS.MAPEM_PDU_Descriptions.MAPEM, "map")}


STATES: dict[Phase, str] = {
    "red": "stop-And-Remain",
    "red-yellow": "pre-Movement",
    "green": "permissive-Movement-Allowed",
    "green-free": "protected-Movement-Allowed",
    "yellow": "protected-clearance",
    "flashing": "caution-Conflicting-Traffic",
    "dark": "dark",
}
"""State of a light in the standard by phase."""


def spatem(junction: Junction, time_s: float) -> bytes:
    """Return the SPATEM of a junction at a time as UPER."""
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
    return _encode(4, junction.station, {"intersections": [state]})


def mapem(junction: Junction) -> bytes:
    """Return the MAPEM of a junction as UPER."""
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
    return _encode(5, junction.station, {"msgIssueRevision": 1, "intersections": [geometry]})


def updates(junction: Junction, duration_s: float) -> tuple[tuple[float, bytes], ...]:
    """Return the SPATEMs of a transmission, each with the start time in s."""
    count = max(1, math.ceil(duration_s / junction.update_s))
    return tuple((k * junction.update_s, spatem(junction, k * junction.update_s)) for k in range(count))


def _movement(junction: Junction, group: GroupSettings, time_s: float) -> dict[str, Any]:
    events: list[dict[str, Any]] = []
    for phase, end_s in group.following(time_s, 2):  # the present and the next phase
        timing = dict.fromkeys(("minEndTime", "maxEndTime"), _mark(junction, end_s))
        if events:
            timing["startTime"] = events[-1]["timing"]["minEndTime"]
        events.append({"eventState": STATES[phase], "timing": timing})
    return {"signalGroup": group.group, "state-time-speed": events}


def _mark(junction: Junction, time_s: float) -> int:
    """Return the time within the hour (UTC) in tenths of a second."""
    when = junction.begins + timedelta(seconds=time_s)
    return round((when.minute * 60 + when.second + when.microsecond * 1e-6) * 10) % 36000


def _encode_lane(lane: LaneSettings) -> dict[str, Any]:
    out: dict[str, Any] = {
        "laneID": lane.lane,
        "laneAttributes": {
            "directionalUse": (0b10 if lane.towards else 0b01, 2),
            "sharedWith": (0, 10),
            "laneType": (lane.kind, (0, 8 if lane.kind == "vehicle" else 16)),
        },
        "nodeList": ("nodes", _nodes(lane)),
    }
    if lane.to:
        group = {} if lane.group is None else {"signalGroup": lane.group}
        out["connectsTo"] = [{"connectingLane": {"lane": to}, **group} for to in lane.to]
    return out


def _nodes(lane: LaneSettings) -> Sequence[dict[str, Any]]:
    """Return the steps between points in cm, free of accumulated rounding."""
    bits = {"node-XY1": 9, "node-XY2": 10, "node-XY3": 11, "node-XY4": 12, "node-XY5": 13, "node-XY6": 15}
    nodes, last = [], (0, 0)
    for point in lane.points_m:
        position = (round(point[0] * 100), round(point[1] * 100))
        step = (position[0] - last[0], position[1] - last[1])
        kind = next((name for name, n in bits.items() if all(-(1 << n) <= s < 1 << n for s in step)), None)
        if kind is None:
            raise SettingsError(f"lane {lane.lane}: points lie at most 327 m apart; add points between")
        nodes.append({"delta": (kind, {"x": step[0], "y": step[1]})})
        last = position
    return nodes


Values = Mapping[str, Any]  # content of a message as JSON values

PHASES = {
    **{state: phase for phase, state in STATES.items()},
    "stop-Then-Proceed": "red",
    "permissive-clearance": "yellow",
    "unavailable": "unknown",
}
"""Phase by state of a light in the standard."""

HOUR_S = 3600.0


def road_values(data: bytes) -> Values | None:
    """Return a road message as plain values; None for other messages."""
    kind = kind_of(data)
    if kind is None:
        return None
    try:
        station, content = _decode(data)
    except (ValueError, SettingsError) as error:
        return {"kind": kind, "junctions": [], "reason": str(error)}
    parse = _lights if kind == "SPATEM" else _map
    junctions = [parse(junction) for junction in content.get("intersections", ())]
    return {"kind": kind, "station": station, "junctions": junctions}


def left_s(end_s: float, now_s: float) -> float:
    """Return the time to an end, both in s of the hour; negative up to half an hour after the end."""
    return (end_s - now_s + HOUR_S / 2) % HOUR_S - HOUR_S / 2


def road_words(values: Values) -> str:
    """Return a road message as a line of text."""
    if "reason" in values:
        return str(values["reason"])
    parts = []
    for junction in values["junctions"]:
        if values["kind"] == "SPATEM":
            parts.append(f"junction {junction['id']}: {', '.join(map(group_words, junction['groups']))}")
        else:
            # received text: remove control characters
            name = "".join(c for c in junction["name"] or "" if c.isprintable())
            suffix = f" ({name})" if name else ""
            parts.append(f"junction {junction['id']}{suffix}: {len(junction['lanes'])} lanes")
    return f"{values['kind']} of " + "; ".join(parts or ["no junction"])


def group_words(group: Values) -> str:
    """Return the phase of a signal group and the remaining time as text."""
    left = group["left_s"]
    return f"group {group['group']} {group['phase']}" + ("" if left is None else f", {max(left, 0.0):.1f} s left")


def _lights(state: Mapping[str, Any]) -> dict[str, Any]:
    minute, ms = state.get("moy"), state.get("timeStamp")
    stamp_s = None if minute is None or ms is None else (minute % 60 * 60 + ms / 1000) % HOUR_S
    return {
        "id": state["id"]["id"],
        "stamp_s": stamp_s,
        "groups": [_group(movement, stamp_s) for movement in state.get("states", ())],
    }


def _group(movement: Mapping[str, Any], stamp_s: float | None) -> dict[str, Any]:
    events: list[dict[str, Any]] = []
    for event in movement["state-time-speed"]:
        # tenths of a second in the hour; 36001 means unknown
        mark = event.get("timing", {}).get("minEndTime", 36001)
        end_s = None if mark >= 36001 else mark / 10
        events.append({"phase": PHASES.get(event["eventState"], "unknown"), "end_s": end_s})
    end_s = events[0]["end_s"]
    left = None if end_s is None or stamp_s is None else round(left_s(end_s, stamp_s), 1)
    return {"group": movement["signalGroup"], **events[0], "left_s": left, "then": events[1:]}


def _map(geometry: Mapping[str, Any]) -> dict[str, Any]:
    place, width = geometry["refPoint"], geometry.get("laneWidth")
    # these values mean unknown
    known = (place["lat"], place["long"]) != (900000001, 1800000001)
    return {
        "id": geometry["id"]["id"],
        "name": geometry.get("name"),
        "latitude": place["lat"] / 1e7 if known else None,
        "longitude": place["long"] / 1e7 if known else None,
        "lane_width_m": None if width is None else width / 100,
        "lanes": [_lane(lane) for lane in geometry["laneSet"]],
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
        # a lane that is a shifted copy of another lane has no points
        "points_m": list(_points(nodes)) if kind == "nodes" else [],
        "groups": sorted({link["signalGroup"] for link in links if "signalGroup" in link}),
        "to": [link["connectingLane"]["lane"] for link in links],
    }


def _points(nodes: Sequence[Mapping[str, Any]]) -> Iterator[tuple[float, float]]:
    """Yield east and north in m from steps in cm, up to a node in latitude and longitude."""
    x = y = 0
    for node in nodes:
        step = node["delta"][1]
        if not isinstance(step, Mapping) or "x" not in step:
            return
        x, y = x + step["x"], y + step["y"]
        yield x / 100, y / 100
