"""Settings of the channel: scene, vehicle, camera, emitters, sensor, background.

Light is measured in full scales: a pixel whose light is 1 just saturates.
"""

import math
from collections.abc import Mapping
from dataclasses import field
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, Fraction, clear_errors
from heliograph.channel.devices import (
    EXPOSURE_SLACK,
    CameraSettings,
    Colour,
    EmitterSettings,
    LengthM,
    LightLevel,
    Ppm,
    SensorSettings,
    SpeedMS,
    TiltDeg,
    TimeS,
)
from heliograph.channel.parts import BACKGROUNDS, MOTIONS, POINT_SPREADS

__all__ = [
    "EXPOSURE_SLACK",
    "MOST_MOTION_PX",
    "NEAREST_M",
    "BackgroundSettings",
    "CameraSettings",
    "ChannelSettings",
    "EmitterSettings",
    "Placement",
    "SensorSettings",
]

MOST_MOTION_PX = 1e3
"""Most motion of an array in the image within one exposure in px. Chosen: twice the largest array that a receiver
looks for by default. Each quarter of a pixel is drawn on its own, which takes up to 0.13 GB at this value."""

NEAREST_M = 0.3
"""An array whose panel is nearer than this to the camera's plane is not rendered. Chosen: its image is then far larger
than the sensor, 3500 px wide in the reference link; the value only keeps depths above 0."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Placement:
    """Position, motion and faults of an array.

    Attributes
    ----------
    x_m
        Position of the array's centre at time 0 in m, right of the optical axis if positive, left if negative; at most
        10 km.
    y_m
        Position of the array's centre at time 0 in m, below the optical axis if positive, above if negative; at most
        10 km.
    z_offset_m
        Distance of the array's centre beyond ``channel.distance_m`` at time 0 in m; negative for nearer, but not behind
        the camera unless it comes from there.
    yaw_deg
        Tilt about the downward axis in degrees, above -90 and below 90. Away from 0 the image is narrower, and dimmer
        as the LEDs shine to the side.
    pitch_deg
        Tilt about the rightward axis in degrees, above -90 and below 90. Away from 0 the image is lower and dimmer.
    roll_deg
        Rotation about the forward axis in degrees, -180 to 180; positive is clockwise as the camera sees it.
    vx_m_s
        Own velocity of the array to the right in m/s, -1000 to 1000; negative to the left.
    vy_m_s
        Own velocity of the array downward in m/s, -1000 to 1000; negative upward.
    vz_m_s
        Own velocity of the array away from the camera in m/s, -1000 to 1000; negative towards it.
    brightness
        Factor on the light of all its LEDs, 0 to 100; a larger value is brighter, 0 is dark.
    dead
        Fraction of its LEDs that never shine, 0 to 1, at random places; a larger value loses more data.
    stuck
        Fraction of its LEDs that shine all the time, 0 to 1, at random places; at most 1 together with ``dead``.
    spread
        Standard deviation of its LEDs' light about 1, 0 to 1, normal, drawn once and at least 0: LEDs differ by that
        much, as 0.2 by 20 %. A larger value disturbs the layers of few LEDs, the low one first.
    hidden
        Part of the array that an obstacle right before the panel hides: left, top, right and lower edge, each 0 to 1 in
        sides of the array from its upper left corner, such as (0, 0, 0.5, 0.5); empty for none.
    hidden_level
        Light of that obstacle in full scales, 0 to 4.
    off_s
        Times (from, to) in s for which the array is dark, stuck LEDs too; its clock runs on.
    clock_ppm
        Error of its clock in millionths, -10000 to 10000: its pattern period is longer by this than the nominal one,
        shorter if negative.
    start_s
        Time in s at which its pattern 0 starts, -60 to 3600; it is dark before. At most 1e6 patterns come before the
        first frame.
    """

    x_m: LengthM = 1.5
    y_m: LengthM = -1.0
    z_offset_m: LengthM = 0.0
    yaw_deg: TiltDeg = 0.0
    pitch_deg: TiltDeg = 0.0
    roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    vx_m_s: SpeedMS = 0.0
    vy_m_s: SpeedMS = 0.0
    vz_m_s: SpeedMS = 0.0
    brightness: Annotated[float, Field(ge=0, le=100)] = 1.0
    dead: Fraction = 0.0
    stuck: Fraction = 0.0
    spread: Fraction = 0.0
    hidden: tuple[Fraction, Fraction, Fraction, Fraction] | tuple[()] = ()
    hidden_level: LightLevel = 0.1
    off_s: tuple[tuple[float, float], ...] = ()
    clock_ppm: Ppm = 0.0
    start_s: TimeS = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> "Placement":
        if self.dead + self.stuck > 1:
            raise ValueError(
                f"dead and stuck are fractions of all LEDs, at most 1 together, not {self.dead + self.stuck:g}"
            )
        if self.hidden and not (self.hidden[0] < self.hidden[2] and self.hidden[1] < self.hidden[3]):
            raise ValueError(f"hidden is left, top, right, lower with left < right, top < lower, not {self.hidden}")
        if any(end <= begin for begin, end in self.off_s):
            raise ValueError(f"off_s are times (from, to) with from < to, not {self.off_s}")
        return self


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class BackgroundSettings:
    """The background of the arrays.

    Attributes
    ----------
    kind
        "flat", "street" or "street-night" (a street in perspective), "synthetic" (sky, buildings and many lamps, which
        disturb) or "footage" (recorded frames); others may be registered.
    level
        Light of a flat background in full scales, 0 to 4. A larger value adds shot noise beside the panel.
    gain
        Light of white in a drawn or recorded background in full scales, 0 to 4. A larger value makes the background
        more disturbing.
    colour
        Red, green and blue of the light of background and panels, as ``emitter.colour``.
    """

    kind: Annotated[str, AfterValidator(BACKGROUNDS.check)] = "flat"
    level: LightLevel = 0.1
    gain: LightLevel = 1.0
    colour: Colour = (1.0, 1.0, 1.0)


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ChannelSettings:
    """Everything between the LED patterns and the camera frames; the defaults are the reference link.

    Attributes
    ----------
    distance_m
        Distance in m from the camera at time 0 to the plane of arrays with ``z_offset_m`` = 0, 0.1 to 10,000. A
        larger one gives the arrays fewer pixels.
    stop_m
        Distance in m to that plane at which the film ends, above 0 and below ``distance_m``; without effect where
        ``duration_s`` is set or the vehicle stands.
    speed_m_s
        Speed of the vehicle in m/s, 0 to 60; 0 for a vehicle at rest. A larger one shakes the camera more and shortens
        the drive.
    duration_s
        Length of the film in s, above 0 and at most an hour; left out: until ``stop_m`` is reached, or 1 s where
        the vehicle stands.
    speed_profile
        Points (time in s, speed in m/s, 0 to 60) at rising times, joined by straight lines, in place of
        ``speed_m_s``; empty for none.
    shake
        Motion of the camera: "none", "road" (half-car model on a random road), "imu" (a recorded trace) or "hand" (a
        camera held in a hand); others may be registered.
    hand_deg
        Rms angle in degrees, 0 to 10, by which a hand turns the camera slowly, for ``shake`` = "hand"; its tremor is a
        tenth of it. A larger one moves the image further.
    road_class
        Class of the road by ISO 8608, "A" (smooth) to "D" (rough): each has twice the amplitude of the one before.
    imu_start_s
        Time of the trace in s that is time 0 of the film, 0 to 1e6.
    arrays
        Arrays in the scene.
    camera
        The camera, its lens and its clock.
    emitter
        LEDs and panel, the same for all arrays.
    sensor
        Noise and levels of the image sensor.
    background
        What is seen behind the arrays.
    custom
        Settings of registered motions, backgrounds and point-spread functions, by name.
    """

    distance_m: Annotated[float, Field(ge=0.1, le=1e4)] = 80.0
    stop_m: Annotated[float, Field(gt=0, le=1e4)] = 25.0
    speed_m_s: Annotated[float, Field(ge=0, le=60)] = 30 / 3.6
    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    speed_profile: tuple[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], Annotated[float, Field(le=60)]], ...] = ()
    shake: Annotated[str, AfterValidator(MOTIONS.check)] = "road"
    hand_deg: Annotated[float, Field(ge=0, le=10)] = 0.3
    road_class: Literal["A", "B", "C", "D"] = "B"
    imu_start_s: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    arrays: tuple[Placement, ...] = (Placement(),)
    camera: CameraSettings = CameraSettings()
    emitter: EmitterSettings = EmitterSettings()
    sensor: SensorSettings = SensorSettings()
    background: BackgroundSettings = BackgroundSettings()
    custom: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelSettings":
        times = [time for time, _ in self.speed_profile]
        if any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"the times of speed_profile rise, not {times}")
        if any(speed < 0 for _, speed in self.speed_profile):
            raise ValueError(f"speeds are at least 0, not {min(speed for _, speed in self.speed_profile):g}")
        if self.moves and self.duration_s is None and self.stop_m >= self.distance_m:
            raise ValueError(
                f"stop_m is below distance_m = {self.distance_m:g}, not {self.stop_m:g}; or set duration_s"
            )
        for k, place in enumerate(self.arrays):
            ahead_m = self.distance_m + place.z_offset_m
            if ahead_m <= 0 and place.vz_m_s <= 0:
                raise ValueError(
                    f"array {k} lies {-ahead_m:g} m behind the camera for the whole film; raise "
                    f"channel.arrays.{k}.z_offset_m above -{self.distance_m:g}"
                )
            # what comes nearer later, and the shake of the camera, are known to the renderer alone
            motion_px = math.hypot(place.vx_m_s, place.vy_m_s) * self.camera.exposure_s * self.camera.focal_px
            motion_px /= max(ahead_m, NEAREST_M)
            if ahead_m > 0 and motion_px > MOST_MOTION_PX:
                raise ValueError(
                    f"array {k} moves {motion_px:g} px in the image within an exposure, at most {MOST_MOTION_PX:g}; "
                    f"lower channel.arrays.{k}.vx_m_s or vy_m_s, channel.camera.exposure_s or focal_m, or raise "
                    "channel.distance_m"
                )
        parts = ((MOTIONS, self.shake), (BACKGROUNDS, self.background.kind), (POINT_SPREADS, self.camera.psf))
        if self.custom and all(registry.is_built_in(name) for registry, name in parts):
            keys = ", ".join(f"channel.custom.{key}" for key in self.custom)
            raise ValueError(
                f"{keys} has no effect, as shake, background.kind and camera.psf are the package's; leave it out"
            )
        return self

    @property
    def moves(self) -> bool:
        """Whether the vehicle ever drives: a speed is above 0."""
        return any(speed > 0 for _, speed in self.speed_profile) if self.speed_profile else self.speed_m_s > 0
