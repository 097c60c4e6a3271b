"""Countdown of traffic light phases between messages by the camera clock."""

from typing import Any

from heliograph.road.codec import HOUR_S, Values, left_s


class Countdown:
    """Lights of the junctions in the messages of an array.

    The sender repeats a SPATEM. The clock offset between camera and sender is the smallest difference between packet
    time and message stamp.
    """

    def __init__(self) -> None:
        self._lights: dict[int, tuple[float, Values]] = {}
        self._ahead_s: dict[int, float] = {}

    def take(self, values: Values, time_s: float) -> None:
        """Add a SPATEM; ignore other messages."""
        if values["kind"] != "SPATEM":
            return
        for junction in values["junctions"]:
            if junction["stamp_s"] is None:
                continue
            number, ahead = junction["id"], (time_s - junction["stamp_s"]) % HOUR_S
            known = self._ahead_s.get(number, ahead)
            # the smaller difference, also around the hour
            self._ahead_s[number] = ahead if left_s(ahead, known) < 0 else known
            self._lights[number] = (time_s, junction)

    def at(self, time_s: float) -> list[dict[str, Any]]:
        """Return the lights at a time: junctions with `id` and `groups` of `group`, `phase` and `left_s`."""
        out = []
        for number, (updated_s, junction) in self._lights.items():
            if time_s - updated_s <= 10.0:  # older messages expire
                now_s = (time_s - self._ahead_s[number]) % HOUR_S
                out.append({"id": number, "groups": [_now(group, now_s) for group in junction["groups"]]})
        return out


def _now(group: Values, now_s: float) -> dict[str, Any]:
    """Return the present phase: the phase of the message or a later phase."""
    for event in (group, *group["then"]):
        if event["end_s"] is None:
            return {"group": group["group"], "phase": event["phase"], "left_s": None}
        left = left_s(event["end_s"], now_s)
        if left > 0:
            return {"group": group["group"], "phase": event["phase"], "left_s": round(left, 1)}
    return {"group": group["group"], "phase": "unknown", "left_s": None}
