"""Settings of the channel: scene, vehicle, camera, emitters, sensor, background."""

import math
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=4)]
Chance = Annotated[float, Field(ge=0, lt=1)]
Ppm = Annotated[float, Field(ge=-1e4, le=1e4)]
Tilt = Annotated[float, Field(gt=-90, lt=90)]
Part = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Placement:
    """Where an array stands, how it moves and when it shines.

    Attributes
    ----------
    x_m, y_m
        Position of its centre, right of and below the optical axis at time 0 (negative y is above).
    z_offset_m
        How much further away than ``distance_m`` its centre stands at time 0.
    yaw_deg, pitch_deg, roll_deg
        Tilt about the downward, the rightward and the forward axis; roll turns it clockwise as the camera sees it.
    vx_m_s, vy_m_s, vz_m_s
        The array's own velocity, right, down and away.
    brightness
        Factor on the light of all its LEDs.
    dead, stuck
        Shares of its LEDs, anywhere in it, that never shine and that shine all the time.
    hidden
        What a thing right before the panel hides of it: left, top, right and lower edge as shares of the array's side,
        such as (0, 0, 0.5, 0.5); none if empty.
    hidden_level
        Light of that thing, as a share of full scale.
    off_s
        Times (from, to) in s for which it is dark, stuck LEDs too; its clock goes on.
    clock_ppm
        Its pattern period is longer by this than the nominal one.
    start_s
        Time at which its pattern 0 starts; dark before.
    """

    x_m: float = 1.5
    y_m: float = -1.0
    z_offset_m: float = 0.0
    yaw_deg: Tilt = 0.0
    pitch_deg: Tilt = 0.0
    roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    vx_m_s: float = 0.0
    vy_m_s: float = 0.0
    vz_m_s: float = 0.0
    brightness: NotNegative = 1.0
    dead: Part = 0.0
    stuck: Part = 0.0
    hidden: tuple[Part, Part, Part, Part] | tuple[()] = ()
    hidden_level: Share = 0.1
    off_s: tuple[tuple[float, float], ...] = ()
    clock_ppm: Ppm = 0.0
    start_s: float = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> "Placement":
        if self.dead + self.stuck > 1:
            raise ValueError(
                f"dead and stuck are shares of all LEDs, at most 1 together, not {self.dead + self.stuck:g}"
            )
        if self.hidden and not (self.hidden[0] < self.hidden[2] and self.hidden[1] < self.hidden[3]):
            raise ValueError(f"hidden is left, top, right, lower with left < right, top < lower, not {self.hidden}")
        if any(end <= begin for begin, end in self.off_s):
            raise ValueError(f"off_s are times (from, to) with from < to, not {self.off_s}")
        return self


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CameraSettings:
    """Pinhole camera with a global shutter.

    Attributes
    ----------
    fps, exposure_s, start_s
        Frames a second, exposure tau of equation (4), time of the first exposure.
    width, height
        Sensor in pixels.
    focal_m, pixel_m
        Focal length and side of a pixel.
    blur_px
        Standard deviation of the Gaussian optical blur, beside the pixel's box and the emitter's disc.
    clock_ppm
        Its frame period is longer by this than 1 / fps.
    dropped, repeated
        Chance of a frame to be lost on its way, and to come as a copy of the one delivered before it.
    jitter_s
        Rms error of the times that frames are stamped with; the exposures themselves stay even.
    """

    fps: Annotated[float, Field(gt=0, le=1e6)] = 1000.0
    exposure_s: Positive = 1e-3
    start_s: float = 0.0
    width: Annotated[int, Field(ge=16, le=8192)] = 1024
    height: Annotated[int, Field(ge=16, le=8192)] = 512
    focal_m: Positive = 0.035
    pixel_m: Positive = 12e-6
    blur_px: Annotated[float, Field(ge=0.05, le=20)] = 0.5
    clock_ppm: Ppm = 0.0
    dropped: Chance = 0.0
    repeated: Chance = 0.0
    jitter_s: NotNegative = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> "CameraSettings":
        if self.exposure_s * self.fps > 1 + 1e-9:
            raise ValueError(f"exposure_s is at most 1 / fps = {1 / self.fps:g} s, not {self.exposure_s:g} s")
        if self.dropped + self.repeated >= 1:
            raise ValueError(f"dropped and repeated are below 1 together, not {self.dropped + self.repeated:g}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_m / self.pixel_m

    @property
    def frame_period_s(self) -> float:
        """True time from one exposure to the next, the clock's error counted."""
        return (1 + self.clock_ppm * 1e-6) / self.fps


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EmitterSettings:
    """LEDs and the panel that carries them.

    Attributes
    ----------
    pitch_m, diameter_m
        Distance between LEDs and diameter of a round emitter.
    half_angle_deg
        Angle off the axis at which an LED shines half as bright.
    all_on
        Level of the array with every LED on for a whole exposure, seen on axis and not resolved, as a share of
        full scale; the lens and the gain are taken as set so at any exposure time.
    panel_level
        Ambient light reflected by the dark panel, as a share of full scale.
    panel_margin_m
        Panel beyond the cells of the outer LEDs.
    """

    pitch_m: Positive = 0.02
    diameter_m: Positive = 0.005
    half_angle_deg: Annotated[float, Field(gt=0, lt=90)] = 22.6
    all_on: Share = 0.8
    panel_level: Share = 0.02
    panel_margin_m: NotNegative = 0.02

    @model_validator(mode="after")
    def _consistent(self) -> "EmitterSettings":
        if self.diameter_m > self.pitch_m:
            raise ValueError(f"diameter_m is at most pitch_m = {self.pitch_m:g}, not {self.diameter_m:g}")
        return self

    @property
    def lobe_order(self) -> float:
        """Lambertian order m = -ln 2 / ln cos(half angle)."""
        return -math.log(2) / math.log(math.cos(math.radians(self.half_angle_deg)))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SensorSettings:
    """Image sensor by EMVA 1288.

    Attributes
    ----------
    full_well_e
        Electrons at full scale.
    dark_noise_e
        Noise without light, rms, in electrons.
    bits
        Bits of a gray level.
    offset_dn
        Black level in gray levels; with 0 the dark noise is cut at 0, as in the reference link.
    """

    full_well_e: Annotated[float, Field(ge=10, le=1e7)] = 15000.0
    dark_noise_e: Annotated[float, Field(ge=0, le=1e5)] = 40.0
    bits: Annotated[int, Field(ge=8, le=12)] = 8
    offset_dn: NotNegative = 0.0

    @property
    def full_scale(self) -> int:
        """Largest gray level."""
        return (1 << self.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """System gain K: the full well is full scale."""
        return self.full_scale / self.full_well_e


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class BackgroundSettings:
    """What is behind the arrays.

    Attributes
    ----------
    kind
        "flat", "synthetic" (sky, buildings, lamps) or "footage" (recorded frames).
    level
        Level of a flat background, as a share of full scale.
    gain
        Level of white in a synthetic or recorded background, as a share of full scale.
    """

    kind: Literal["flat", "synthetic", "footage"] = "flat"
    level: Share = 0.1
    gain: Share = 1.0


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ChannelSettings:
    """All between the LED patterns and the camera frames; the defaults are the reference link.

    Attributes
    ----------
    distance_m, stop_m
        From the camera to the plane ``z_offset_m`` = 0 at time 0 and at the end of the drive.
    speed_m_s
        Speed of the vehicle; 0 stands still.
    duration_s
        Length of the film; None: until ``stop_m`` is reached, 1 s where the vehicle stands still.
    speed_profile
        Points (time in s, speed in m/s) joined by straight lines, in place of ``speed_m_s``.
    shake
        "none", "road" (half-car model on a random road) or "imu" (a recorded trace).
    road_class
        ISO 8608 class of the road.
    imu_start_s
        Time of the trace that is time 0 of the film.
    """

    distance_m: Positive = 80.0
    stop_m: Positive = 25.0
    speed_m_s: Annotated[float, Field(ge=0, le=60)] = 30 / 3.6
    duration_s: Positive | None = None
    speed_profile: tuple[tuple[float, float], ...] = ()
    shake: Literal["none", "road", "imu"] = "road"
    road_class: Literal["A", "B", "C", "D"] = "B"
    imu_start_s: NotNegative = 0.0
    arrays: tuple[Placement, ...] = (Placement(),)
    camera: CameraSettings = CameraSettings()
    emitter: EmitterSettings = EmitterSettings()
    sensor: SensorSettings = SensorSettings()
    background: BackgroundSettings = BackgroundSettings()

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
        return self

    @property
    def moves(self) -> bool:
        """Whether the vehicle ever drives."""
        return any(speed > 0 for _, speed in self.speed_profile) if self.speed_profile else self.speed_m_s > 0
