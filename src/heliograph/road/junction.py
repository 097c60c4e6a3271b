"""Settings of a junction: lanes, and signal plan of the lights."""

from collections.abc import Iterator
from dataclasses import field
from datetime import UTC, datetime
from itertools import accumulate
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors

Phase = Literal["red", "red-yellow", "green", "green-free", "yellow", "flashing", "dark"]
"""Phase of a light; "green-free" is a protected green."""

LaneKind = Literal["vehicle", "crosswalk", "bikeLane", "sidewalk", "trackedVehicle"]
Text = Annotated[str, Field(min_length=1, max_length=63, pattern=r"^[ -~]*$")]
Group = Annotated[int, Field(ge=1, le=254)]
Lane = Annotated[int, Field(ge=1, le=254)]
OffsetM = Annotated[float, Field(ge=-600, le=600)]
Point = tuple[OffsetM, OffsetM]


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PhaseSettings:
    """A phase of a light."""

    # Phase: "red", "red-yellow", "green", "green-free", "yellow", "flashing" or "dark"
    phase: Phase
    # Duration in s, up to half an hour
    seconds: Annotated[float, Field(ge=0.1, le=1800)]


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GroupSettings:
    """Signal group: lights with equal phases."""

    # Number of the group, 1 to 254
    group: Group
    # Cyclic sequence of phases
    phases: Annotated[tuple[PhaseSettings, ...], Field(min_length=1, max_length=16)]
    # Position in the cycle at the start of the transmission in s
    offset_s: Annotated[float, Field(ge=0, le=86400)] = 0.0

    def following(self, time_s: float, count: int) -> Iterator[tuple[Phase, float]]:
        """Yield the phases from a time on, each with its end; times in s from the start of the transmission."""
        ends = list(accumulate(phase.seconds for phase in self.phases))
        turns, elapsed = divmod(self.offset_s + time_s + 1e-6, ends[-1])
        first = next((i for i, end in enumerate(ends) if elapsed < end), len(ends) - 1)
        for number in range(first, first + count):
            more, place = divmod(number, len(ends))
            yield self.phases[place].phase, (turns + more) * ends[-1] + ends[place] - self.offset_s


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LaneSettings:
    """A lane."""

    # Number of the lane, 1 to 254
    lane: Lane
    # Centre line from the stop line outwards: east and north of the junction centre in m, at least two points
    points_m: Annotated[tuple[Point, ...], Field(min_length=2, max_length=63)]
    # "vehicle", "crosswalk", "bikeLane", "sidewalk" or "trackedVehicle"
    kind: LaneKind = "vehicle"
    # True for a lane towards the junction, false for a lane away from the junction
    towards: bool = True
    # Signal group of the lane, if any
    group: Group | None = None
    # Numbers of the connected lanes
    to: Annotated[tuple[Lane, ...], Field(max_length=16)] = ()


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Junction:
    """Junction with position, lanes and signal plan."""

    # Number of the junction, 0 to 65535
    id: Annotated[int, Field(ge=0, le=65535)]
    # Name, up to 63 ASCII characters
    name: Text = "Junction"
    # Number of the sending station, 0 to 4294967295
    station: Annotated[int, Field(ge=0, le=(1 << 32) - 1)] = 0
    # Latitude of the centre in degrees, positive to the north
    latitude: Annotated[float, Field(ge=-90, le=90)] = 0.0
    # Longitude of the centre in degrees, positive to the east
    longitude: Annotated[float, Field(ge=-180, le=180)] = 0.0
    # Lane width in m
    lane_width_m: Annotated[float, Field(ge=0.5, le=50)] = 3.25
    # Start of the transmission in UTC
    begins: datetime = datetime(2026, 6, 1, 12, 0, 0, tzinfo=UTC)
    # Interval between SPATEMs in s
    update_s: Annotated[float, Field(ge=0.1, le=60)] = 1.0
    # Signal groups with distinct numbers
    groups: Annotated[tuple[GroupSettings, ...], Field(min_length=1, max_length=32)]
    # Lanes with distinct numbers; a map needs at least one lane
    lanes: Annotated[tuple[LaneSettings, ...], Field(max_length=100)] = field(default=())

    @model_validator(mode="after")
    def _consistent(self) -> "Junction":
        groups, lanes = [group.group for group in self.groups], [lane.lane for lane in self.lanes]
        for kind, numbers in (("groups", groups), ("lanes", lanes)):
            if len(set(numbers)) != len(numbers):
                raise ValueError(f"{kind} have different numbers, not {numbers}")
        for lane in self.lanes:
            if lane.group is not None and lane.group not in groups:
                raise ValueError(f"lane {lane.lane} names the unknown group {lane.group}; the groups are {groups}")
            if unknown := [to for to in lane.to if to not in lanes]:
                raise ValueError(f"lane {lane.lane} leads to the unknown lane {unknown[0]}; the lanes are {lanes}")
            if lane.group is not None and not lane.to:
                raise ValueError(f"lane {lane.lane} has a group and needs 'to', the connected lanes")
        return self


def example() -> dict[str, Any]:
    """Return the settings of a junction of two streets as a mapping for `Junction`."""
    red_first = [("red", 12.0), ("red-yellow", 2.0), ("green", 18.0), ("yellow", 3.0)]
    green_first = [("green", 9.0), ("yellow", 3.0), ("red", 21.0), ("red-yellow", 2.0)]
    groups = [
        {"group": number, "phases": [{"phase": name, "seconds": s} for name, s in phases]}
        for number, phases in ((1, red_first), (2, green_first))
    ]
    lanes: list[dict[str, Any]] = []
    # direction, signal group and opposite lane of each arm, for right-hand traffic
    arms = (((0, -1), 1, 4), ((0, 1), 1, 2), ((1, 0), 2, 8), ((-1, 0), 2, 6))
    for number, ((east, north), group, ahead) in enumerate(arms):
        inwards, outwards = (
            [(east * d - 1.7 * sign * north, north * d + 1.7 * sign * east) for d in (10.0, 60.0)] for sign in (1, -1)
        )
        lanes.append({"lane": 2 * number + 1, "points_m": inwards, "group": group, "to": [ahead]})
        lanes.append({"lane": 2 * number + 2, "points_m": outwards, "towards": False})
    lanes.append({"lane": 9, "kind": "crosswalk", "points_m": [(7.0, -5.0), (7.0, 5.0)], "towards": True})
    return {
        "id": 7,
        "name": "Harbour Road",
        "station": 7,
        "latitude": 35.155,
        "longitude": 136.966,
        "groups": groups,
        "lanes": lanes,
    }
