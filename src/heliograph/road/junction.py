"""A junction with its lanes and the plan of its lights, as settings; what it shows at a time."""

from collections.abc import Iterator
from dataclasses import field
from datetime import UTC, datetime
from itertools import accumulate
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors

Phase = Literal["red", "red-yellow", "green", "green-free", "yellow", "flashing", "dark"]
"""What a light shows; "green-free" is a green on which no other movement may cross."""

LaneKind = Literal["vehicle", "crosswalk", "bikeLane", "sidewalk", "trackedVehicle"]
Text = Annotated[str, Field(min_length=1, max_length=63, pattern=r"^[ -~]*$")]
Group = Annotated[int, Field(ge=1, le=254)]
Lane = Annotated[int, Field(ge=1, le=254)]
OffsetM = Annotated[float, Field(ge=-600, le=600)]
Point = tuple[OffsetM, OffsetM]


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PhaseSettings:
    """A phase of a light.

    Attributes
    ----------
    phase
        What it shows: "red", "red-yellow", "green", "green-free", "yellow", "flashing" or "dark".
    seconds
        How long it lasts in s, up to half an hour.
    """

    phase: Phase
    seconds: Annotated[float, Field(ge=0.1, le=1800)]


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GroupSettings:
    """Lights that show the same: a signal group.

    Attributes
    ----------
    group
        Number of the group, 1 to 254, by which lanes name it.
    phases
        Its phases in turn, again and again.
    offset_s
        Seconds of its cycle that are over when the transmission begins.
    """

    group: Group
    phases: Annotated[tuple[PhaseSettings, ...], Field(min_length=1, max_length=16)]
    offset_s: Annotated[float, Field(ge=0, le=86400)] = 0.0

    def following(self, time_s: float, count: int) -> Iterator[tuple[Phase, float]]:
        """Yield the phase at a time and those that follow, each with its end in s from the start of the transmission.

        Parameters
        ----------
        time_s
            Time from the start of the transmission in s.
        count
            How many phases are asked for.
        """
        ends = list(accumulate(phase.seconds for phase in self.phases))
        turns, over = divmod(self.offset_s + time_s + 1e-6, ends[-1])
        first = next((i for i, end in enumerate(ends) if over < end), len(ends) - 1)
        for number in range(first, first + count):
            more, place = divmod(number, len(ends))
            yield self.phases[place].phase, (turns + more) * ends[-1] + ends[place] - self.offset_s


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LaneSettings:
    """A lane.

    Attributes
    ----------
    lane
        Number of the lane, 1 to 254.
    points_m
        Its middle line from the stop line outwards: east and north of the junction's middle in m, two points or more.
    kind
        "vehicle", "crosswalk", "bikeLane", "sidewalk" or "trackedVehicle".
    towards
        Whether it leads to the junction; else it leads away.
    group
        Signal group that lets it go; left out: none.
    to
        Numbers of the lanes that it leads to.
    """

    lane: Lane
    points_m: Annotated[tuple[Point, ...], Field(min_length=2, max_length=63)]
    kind: LaneKind = "vehicle"
    towards: bool = True
    group: Group | None = None
    to: Annotated[tuple[Lane, ...], Field(max_length=16)] = ()


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Junction:
    """A junction: where it is, its lanes, and the plan of its lights.

    Attributes
    ----------
    id
        Number of the junction, 0 to 65535.
    name
        Its name, up to 63 characters of ASCII.
    station
        Number of the sending station, 0 to 4294967295.
    latitude
        Latitude of its middle in degrees, north is above 0.
    longitude
        Longitude of its middle in degrees, east is above 0.
    lane_width_m
        Width of its lanes in m.
    begins
        Date and time in UTC at which the transmission begins.
    update_s
        Seconds from one message about the lights to the next.
    groups
        Its signal groups, each with a number of its own.
    lanes
        Its lanes, each with a number of its own; a map needs at least one.
    """

    id: Annotated[int, Field(ge=0, le=65535)]
    name: Text = "Junction"
    station: Annotated[int, Field(ge=0, le=(1 << 32) - 1)] = 0
    latitude: Annotated[float, Field(ge=-90, le=90)] = 0.0
    longitude: Annotated[float, Field(ge=-180, le=180)] = 0.0
    lane_width_m: Annotated[float, Field(ge=0.5, le=50)] = 3.25
    begins: datetime = datetime(2026, 6, 1, 12, 0, 0, tzinfo=UTC)
    update_s: Annotated[float, Field(ge=0.1, le=60)] = 1.0
    groups: Annotated[tuple[GroupSettings, ...], Field(min_length=1, max_length=32)]
    lanes: Annotated[tuple[LaneSettings, ...], Field(max_length=100)] = field(default=())

    @model_validator(mode="after")
    def _consistent(self) -> "Junction":
        groups, lanes = [one.group for one in self.groups], [one.lane for one in self.lanes]
        for what, numbers in (("groups", groups), ("lanes", lanes)):
            if len(set(numbers)) != len(numbers):
                raise ValueError(f"{what} have different numbers, not {numbers}")
        for lane in self.lanes:
            if lane.group is not None and lane.group not in groups:
                raise ValueError(f"lane {lane.lane} names the group {lane.group}, which is none of {groups}")
            if unknown := [to for to in lane.to if to not in lanes]:
                raise ValueError(f"lane {lane.lane} leads to the lane {unknown[0]}, which is none of {lanes}")
            if lane.group is not None and not lane.to:
                raise ValueError(f"lane {lane.lane} has a group, so it needs 'to', the lanes that it leads to")
        return self


def example() -> dict[str, Any]:
    """A junction of two streets as a mapping of settings, of which a `Junction` can be made."""
    red_first = [("red", 12.0), ("red-yellow", 2.0), ("green", 18.0), ("yellow", 3.0)]
    green_first = [("green", 9.0), ("yellow", 3.0), ("red", 21.0), ("red-yellow", 2.0)]

    def group(number: int, phases: list[tuple[str, float]]) -> dict[str, Any]:
        return {"group": number, "phases": [{"phase": name, "seconds": s} for name, s in phases]}

    def arm(number: int, east: float, north: float, group: int, ahead: int) -> list[dict[str, Any]]:
        """Lane 2 k + 1 in, 2 k + 2 out, to the right of the middle line as one comes."""
        side = (-1.7 * north, 1.7 * east)
        near, far = 10.0, 60.0

        def points(sign: float) -> list[tuple[float, float]]:
            return [(east * d + sign * side[0], north * d + sign * side[1]) for d in (near, far)]

        first = 2 * number + 1
        return [
            {"lane": first, "points_m": points(1), "group": group, "to": [ahead]},
            {"lane": first + 1, "points_m": points(-1), "towards": False},
        ]

    arms = [arm(0, 0, -1, 1, 4), arm(1, 0, 1, 1, 2), arm(2, 1, 0, 2, 8), arm(3, -1, 0, 2, 6)]
    crossing = [{"lane": 9, "kind": "crosswalk", "points_m": [(7.0, -5.0), (7.0, 5.0)], "towards": True}]
    return {
        "id": 7,
        "name": "Harbour Road",
        "station": 7,
        "latitude": 35.155,
        "longitude": 136.966,
        "groups": [group(1, red_first), group(2, green_first)],
        "lanes": [*(lane for pair in arms for lane in pair), *crossing],
    }
