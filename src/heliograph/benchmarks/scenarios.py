"""Scenarios of the benchmark: presets with changed settings, by name."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib.resources import files
from typing import Any

from heliograph.base.errors import SettingsError, brief, shown

VERSION = 1  # version of the scenarios; results of different versions are not comparable

ARRAY = "channel.arrays.0."  # prefix of the settings of the first array


@dataclass(frozen=True)
class Scenario:
    """Scenario of the benchmark.

    Attributes
    ----------
    summary
        Description on a line.
    changes
        Changed settings of the preset by dotted key.
    preset
        Name of the preset, see `list_presets`.
    is_small
        True if the set "small" has the scenario.
    """

    summary: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    preset: str = "static"
    is_small: bool = False


def _at(distance_m: float, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return changes at a distance."""
    return {"channel.distance_m": distance_m, **changes}


def _camera(fps: float) -> Mapping[str, Any]:
    """Return changes for a free-running camera: frame rate, phase, and both clocks 100 ppm apart."""
    camera = {"channel.camera.fps": fps, "channel.camera.exposure_s": 0.95 / fps}
    return _at(60, {**camera, f"{ARRAY}start_s": 0.3e-3, f"{ARRAY}clock_ppm": 100})


def _behind(vehicle: str, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return changes for an array at the rear of a vehicle with a trajectory."""
    place = {f"{ARRAY}x_m": 0, f"{ARRAY}y_m": 0.4, f"{ARRAY}trajectory": _trajectory(vehicle)}
    return {**place, **changes}


def _trajectory(name: str) -> str:
    """Return the path of a CSV file of the package."""
    return str(files("heliograph.benchmarks") / "trajectories" / f"{name}.csv")


_PLACES = [{"x_m": x, "y_m": y} for x, y in ((-5, 0.6), (-3, -0.4), (-1, 0.2), (1, -0.8), (3, 0.9), (5, -0.1))]

SCENARIOS: Mapping[str, Scenario] = {
    "static-25": Scenario("at rest, 25 m away", _at(25, {})),
    "static-40": Scenario("at rest, 40 m away", _at(40, {})),
    "static-60": Scenario("at rest, 60 m away", _at(60, {}), is_small=True),
    "static-80": Scenario("at rest, 80 m away", _at(80, {}), is_small=True),
    "static-105": Scenario("at rest, 105 m away", _at(105, {}), is_small=True),
    "static-150": Scenario("at rest, 150 m away", _at(150, {})),
    "static-220": Scenario("at rest, 220 m away", _at(220, {})),
    "drive": Scenario("80 m to 25 m at 30 km/h by day, road of class B", preset="paper", is_small=True),
    "drive-night": Scenario("the drive by night, LEDs four times dimmer", preset="night"),
    "drive-street": Scenario("the drive in a drawn street", {"channel.background.kind": "street"}, "paper"),
    "drive-bumps": Scenario("the drive on a very rough road, class D", {"channel.road_class": "D"}, "paper"),
    "drive-clock": Scenario("the drive, clocks of camera and array 100 ppm apart", {f"{ARRAY}clock_ppm": 100}, "paper"),
    "drive-two": Scenario("the drive past two arrays", preset="two-arrays"),
    "motorway": Scenario("120 m to 25 m at 100 km/h, road of class A", preset="motorway"),
    "motorway-360": Scenario("120 m to 25 m at 360 km/h", {"channel.speed_m_s": 100}, "motorway"),
    "crossing": Scenario("a camera passes a turned array, 25 m away, at 25 km/h", preset="crossing"),
    # lateral motion of 3.5 m in 3 s by a polynomial of degree 5, 5 m/s faster than the camera
    "lane-change": Scenario(
        "an array of 0.32 m on a vehicle that changes lane, 32 m to 47 m ahead at 100 km/h",
        _behind("lane-change", {"channel.duration_s": 3}),
        "motorway",
    ),
    # distance 17 m + 6 m cos(2 pi t / 8 s)
    "platoon": Scenario(
        "an array of 0.32 m on the vehicle ahead at 80 km/h, distance 23 m to 11 m",
        _behind("platoon-leader", {"channel.trajectory": _trajectory("platoon-follower"), "channel.duration_s": 4}),
        "motorway",
    ),
    "phase": Scenario("60 m, frames half a pattern late", _at(60, {f"{ARRAY}start_s": 0.5e-3})),
    "rate-1.3": Scenario("60 m, free-running camera, 1.3 frames per pattern", _camera(1300)),
    "rate-2": Scenario("60 m, free-running camera, 2 frames per pattern", _camera(2000), is_small=True),
    "rate-4": Scenario("60 m, free-running camera, 4 frames per pattern", _camera(4000)),
    "drops": Scenario("60 m, 2 % of the frames lost", _at(60, {"channel.camera.dropped": 0.02})),
    "drops-unnumbered": Scenario(
        "the same, without gaps in frame numbers and times",
        _at(60, {"channel.camera.dropped": 0.02, "channel.camera.gaps": False}),
    ),
    "spread": Scenario("80 m, light of the LEDs spread by 20 %", _at(80, {f"{ARRAY}spread": 0.2})),
    "dead": Scenario("80 m, 15 % of the LEDs dead", _at(80, {f"{ARRAY}dead": 0.15}), is_small=True),
    "hidden": Scenario("60 m, a quarter of the array hidden", _at(60, {f"{ARRAY}hidden": [0, 0, 0.5, 0.5]})),
    "clutter": Scenario("60 m, before a street of many lamps", _at(60, {"channel.background.kind": "synthetic"})),
    "flicker": Scenario(
        "60 m, light of the image varies by 30 % at 10 Hz",
        _at(60, {"channel.camera.gain_swing": 0.3, "channel.camera.gain_period_s": 0.1}),
    ),
    "fog-200": Scenario("60 m, fog of 200 m visibility", _at(60, {"channel.weather.visibility_m": 200})),
    "fog-100": Scenario("60 m, fog of 100 m visibility", _at(60, {"channel.weather.visibility_m": 100}), is_small=True),
    "rain": Scenario("60 m, rain of 50 mm/h on the windscreen", _at(60, {"channel.weather.rain_mm_h": 50})),
    "glare": Scenario("60 m, low sun", _at(60, {"channel.weather.glare": 0.3})),
    "six-arrays": Scenario(
        "six arrays, 55 m away", _at(55, {"channel.arrays": _PLACES, "transmit.identities": [3, 8, 12, 17, 21, 26]})
    ),
}
"""Scenarios by name."""


def choose_scenarios(names: Iterable[str]) -> dict[str, Scenario]:
    """Return scenarios by name; "small" and "full" are sets of scenarios."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise SettingsError(f'scenarios are a list of names, such as ["small"], not {shown(names)}')
    sets = {"small": [name for name, scenario in SCENARIOS.items() if scenario.is_small], "full": [*SCENARIOS]}
    chosen = dict[str, Scenario]()
    for name in names:
        if name not in {**sets, **SCENARIOS}:
            known = [*sets, *SCENARIOS]
            close = get_close_matches(str(name), known, 1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(known)}"
            raise SettingsError(f"unknown scenario '{brief(name)}'; {hint}")
        chosen |= {member: SCENARIOS[member] for member in sets.get(name, [name])}
    if not chosen:
        raise SettingsError('the benchmark needs a scenario; "small" and "full" are sets')
    return chosen
