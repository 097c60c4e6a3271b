"""A junction's SPATEM and MAPEM in UPER (ISO TS 19091, ETSI TS 103 301), by the package `pycrate`."""

import math
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from heliograph.base.errors import SettingsError
from heliograph.road.codec import MAPEM, SPATEM, packed
from heliograph.road.junction import GroupSettings, Junction, LaneSettings, Phase

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

EVENTS = 2
"""Phases that a SPATEM tells of each group: that of now and the next."""

NODES = (("node-XY1", 9), ("node-XY2", 10), ("node-XY3", 11), ("node-XY4", 12), ("node-XY5", 13), ("node-XY6", 15))
"""Kinds of a step from point to point, and the bits of its size in cm."""


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
        "laneSet": [_lane(lane) for lane in junction.lanes],
    }
    return packed(MAPEM, junction.station, {"msgIssueRevision": 1, "intersections": [geometry]})


def updates(junction: Junction, duration_s: float) -> tuple[tuple[float, bytes], ...]:
    """Return the SPATEMs of a transmission, each with the time in s from which on it is sent."""
    count = max(1, math.ceil(duration_s / junction.update_s))
    return tuple((k * junction.update_s, spatem(junction, k * junction.update_s)) for k in range(count))


def _movement(junction: Junction, group: GroupSettings, time_s: float) -> dict[str, Any]:
    events: list[dict[str, Any]] = []
    for phase, end_s in group.following(time_s, EVENTS):
        timing: dict[str, int] = {"minEndTime": _mark(junction, end_s), "maxEndTime": _mark(junction, end_s)}
        if events:
            timing["startTime"] = events[-1]["timing"]["minEndTime"]
        events.append({"eventState": STATES[phase], "timing": timing})
    return {"signalGroup": group.group, "state-time-speed": events}


def _mark(junction: Junction, time_s: float) -> int:
    """Tenths of a second in the hour of UTC."""
    when = junction.begins + timedelta(seconds=time_s)
    return round((when.minute * 60 + when.second + when.microsecond * 1e-6) * 10) % 36000


def _lane(lane: LaneSettings) -> dict[str, Any]:
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
        kind = next((name for name, bits in NODES if all(-(1 << bits) <= s < 1 << bits for s in step)), None)
        if kind is None:
            raise SettingsError(f"lane {lane.lane}: points lie at most 327 m apart; add points between")
        nodes.append({"delta": (kind, {"x": step[0], "y": step[1]})})
        at = place
    return nodes
