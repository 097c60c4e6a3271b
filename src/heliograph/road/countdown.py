"""The seconds that a light has left, counted down between messages, by the camera's clock."""

from typing import Any

from heliograph.road.codec import HOUR_S, Values, left_s


class Countdown:
    """Lights of the junctions that an array tells of.

    A SPATEM says when it was made, and is sent for a while. So the clock of its sender is behind that of the camera by
    the least difference that was seen between a packet's time and its message's stamp.
    """

    def __init__(self) -> None:
        self._lights: dict[int, tuple[float, Values]] = {}
        self._ahead_s: dict[int, float] = {}

    def take(self, values: Values, time_s: float) -> None:
        """Take a SPATEM; anything else is passed over."""
        if values["kind"] != "SPATEM":
            return
        for junction in values["junctions"]:
            if junction["stamp_s"] is None:
                continue
            number, ahead = junction["id"], (time_s - junction["stamp_s"]) % HOUR_S
            known = self._ahead_s.get(number, ahead)
            # around the hour, too, the least is the one that comes first
            self._ahead_s[number] = ahead if left_s(ahead, known) < 0 else known
            self._lights[number] = (time_s, junction)

    def at(self, time_s: float) -> list[dict[str, Any]]:
        """Return what the lights show at a time: junctions with `id` and `groups` of `group`, `phase` and `left_s`."""
        out = []
        for number, (seen_s, junction) in self._lights.items():
            # Seconds without a message after which a light is not counted down any more. Chosen
            if time_s - seen_s <= 10.0:
                now_s = (time_s - self._ahead_s[number]) % HOUR_S
                out.append({"id": number, "groups": [_now(group, now_s) for group in junction["groups"]]})
        return out


def _now(group: Values, now_s: float) -> dict[str, Any]:
    """The phase that is on: that of the message, or one that has followed it."""
    for event in (group, *group["then"]):
        if event["end_s"] is None:
            return {"group": group["group"], "phase": event["phase"], "left_s": None}
        left = left_s(event["end_s"], now_s)
        if left > 0:
            return {"group": group["group"], "phase": event["phase"], "left_s": round(left, 1)}
    return {"group": group["group"], "phase": "unknown", "left_s": None}
