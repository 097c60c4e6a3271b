"""What a SPATEM or MAPEM says, as plain values for whoever draws it, and in words."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from heliograph.road.codec import UnreadableError, kind_of, unpacked

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
UNKNOWN_MARK = 36001
"""Times in a message count tenths of a second in the hour; this one stands for none."""

NO_PLACE = (900000001, 1800000001)
"""Latitude and longitude that stand for none."""


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
    return None if mark is None or mark >= UNKNOWN_MARK else mark / 10


def _map(geometry: Mapping[str, Any]) -> dict[str, Any]:
    place, width = geometry["refPoint"], geometry.get("laneWidth")
    known = (place["lat"], place["long"]) != NO_PLACE
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
