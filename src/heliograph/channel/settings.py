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

from heliograph.base.config import CONFIG, FocalM, Fraction, PitchM, PixelM, clear_errors
from heliograph.channel.bounds import LengthM, LightLevel, Ppm, Probability, SpeedMS, TiltDeg, TimeS
from heliograph.channel.parts import BACKGROUNDS, MOTIONS, POINT_SPREADS

MOST_FOCAL_PX = 1e6
"""Largest focal length in pixels: that of a lens of 1 m and pixels of 1 um. The motion of an array within an exposure
is drawn in steps of pixels, so that a frame would take the longer the larger it is."""

MOST_MOTION_PX = 1e3
"""Most motion of an array in the image within one exposure in px. Chosen: twice the largest array that a receiver
looks for by default. Each quarter of a pixel is drawn on its own, which takes up to 0.13 GB at this value."""

NEAREST_M = 0.3
"""An array whose panel is nearer than this to the camera's plane is not rendered. Chosen: its image is then far larger
than the sensor, 3500 px wide in the reference link; the value only keeps depths above 0."""

EXPOSURE_SLACK = 1e-9
"""Relative excess of the exposure over the frame period, or over T_b, that counts as a rounding error of double
precision."""


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
class CameraSettings:
    """Pinhole camera with a global shutter.

    Attributes
    ----------
    fps
        Frames a second, 0.1 to 1e6. The receiver "plain" needs one frame per pattern, "soft" at least one.
    exposure_s
        Exposure time tau of equation (4) in s, at least 1e-9 and at most 1 / ``fps`` and T_b. A shorter one sees less
        of a pattern's slots and smears less; ``emitter.all_on`` takes lens and gain as set for it. An array moves by at
        most 1000 px in the image meanwhile.
    start_s
        Time of the first exposure in s, -60 to 3600. A fraction of T_b puts the camera out of step with the light.
    width
        Columns of the sensor in pixels, 16 to 8192.
    height
        Rows of the sensor in pixels, 16 to 8192.
    focal_m
        Focal length in m, 1e-4 to 10, and at most 1e6 pixels. A larger one magnifies: the array has more
        pixels, and shake moves it further.
    pixel_m
        Side of a pixel in m, 1e-7 to 1e-3. A smaller one gives the array more pixels.
    blur_px
        Standard deviation of the Gaussian optical blur in pixels, 0.05 to 20, beside the pixel's box and the emitter's
        disc. A larger one mixes neighbouring LEDs, and so loses the low layer first.
    psf
        Point-spread function of the lens: "gaussian", or "halo" (a wide and weak Gaussian beside it); others may be
        registered.
    clock_ppm
        Error of the camera's clock in millionths, -10000 to 10000: the frame period is longer by this than
        1 / ``fps``, shorter if negative.
    dropped
        Probability of a frame to be lost on its way, at least 0 and below 1.
    gaps
        Whether a lost frame leaves a gap in the numbers and times of frames. Without, as of a camera that numbers the
        frames it delivers, nothing but the pictures tells of it.
    repeated
        Probability of a frame to be replaced by a copy of the one delivered before it, at least 0 and below 1, together
        with ``dropped`` below 1.
    jitter_s
        Rms error of the frames' time stamps in s, 0 to 10, cut at 0.45 frame periods; the exposures stay even.
    """

    fps: Annotated[float, Field(ge=0.1, le=1e6)] = 1000.0
    exposure_s: Annotated[float, Field(ge=1e-9, le=10)] = 1e-3
    start_s: TimeS = 0.0
    width: Annotated[int, Field(ge=16, le=8192)] = 1024
    height: Annotated[int, Field(ge=16, le=8192)] = 512
    focal_m: FocalM = 0.035
    pixel_m: PixelM = 12e-6
    blur_px: Annotated[float, Field(ge=0.05, le=20)] = 0.5
    psf: Annotated[str, AfterValidator(POINT_SPREADS.check)] = "gaussian"
    clock_ppm: Ppm = 0.0
    dropped: Probability = 0.0
    gaps: bool = True
    repeated: Probability = 0.0
    jitter_s: Annotated[float, Field(ge=0, le=10)] = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> "CameraSettings":
        if self.exposure_s * self.fps > 1 + EXPOSURE_SLACK:
            raise ValueError(f"exposure_s is at most 1 / fps = {1 / self.fps:g} s, not {self.exposure_s:g} s")
        if self.focal_px > MOST_FOCAL_PX:
            raise ValueError(f"focal_m is at most {MOST_FOCAL_PX:g} pixels of pixel_m, not {self.focal_px:g}")
        if self.dropped + self.repeated >= 1:
            raise ValueError(f"dropped and repeated are below 1 together, not {self.dropped + self.repeated:g}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, ``focal_m`` / ``pixel_m``."""
        return self.focal_m / self.pixel_m

    @property
    def frame_period_s(self) -> float:
        """True time from one exposure to the next in s, with the error of the clock."""
        return (1 + self.clock_ppm * 1e-6) / self.fps


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EmitterSettings:
    """LEDs and the panel that carries them.

    Attributes
    ----------
    pitch_m
        Distance between LEDs in m, 1e-4 to 10. A larger one gives the array more pixels.
    diameter_m
        Diameter of a round emitter in m, at least 1e-5 and at most ``pitch_m``. A smaller one concentrates an
        LED's light.
    half_angle_deg
        Angle off the axis in degrees at which an LED shines half as bright, at least 0.1 and below 90. A smaller one
        dims arrays off the axis more.
    all_on
        Light of the array with every LED on for a whole exposure, on its axis and too far away to be resolved, in full
        scales, 0 to 4. Lens and gain are taken as set to give it at any exposure time. A larger value has less noise
        until it saturates.
    panel_level
        Ambient light reflected by the dark panel, in full scales, 0 to 4.
    panel_margin_m
        Panel in m beyond half a pitch from the outer LEDs, 0 to 100. A larger one keeps the background further away.
    """

    pitch_m: PitchM = 0.02
    diameter_m: Annotated[float, Field(ge=1e-5, le=10)] = 0.005
    half_angle_deg: Annotated[float, Field(ge=0.1, lt=90)] = 22.6
    all_on: LightLevel = 0.8
    panel_level: LightLevel = 0.02
    panel_margin_m: Annotated[float, Field(ge=0, le=100)] = 0.02

    @model_validator(mode="after")
    def _consistent(self) -> "EmitterSettings":
        if self.diameter_m > self.pitch_m:
            raise ValueError(f"diameter_m is at most pitch_m = {self.pitch_m:g}, not {self.diameter_m:g}")
        return self

    @property
    def lobe_order(self) -> float:
        """Lambertian order m = -ln 2 / ln cos(half angle): an LED's intensity at an angle a is cos^m(a)."""
        return -math.log(2) / math.log(math.cos(math.radians(self.half_angle_deg)))


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SensorSettings:
    """Image sensor by EMVA 1288.

    Attributes
    ----------
    full_well_e
        Electrons at full scale, 10 to 1e7. A larger value has less shot noise.
    dark_noise_e
        Rms noise without light in electrons, 0 to 1e5. A larger value hides dim and distant arrays.
    bits
        Bits of a gray level, 8 to 12. More round less.
    offset_dn
        Black level in gray levels, 0 to 4095; at 0 the dark noise is cut at 0, as in the reference link.
    """

    full_well_e: Annotated[float, Field(ge=10, le=1e7)] = 15000.0
    dark_noise_e: Annotated[float, Field(ge=0, le=1e5)] = 40.0
    bits: Annotated[int, Field(ge=8, le=12)] = 8
    offset_dn: Annotated[float, Field(ge=0, le=4095)] = 0.0

    @property
    def full_scale(self) -> int:
        """Largest gray level, 2^bits - 1."""
        return (1 << self.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """System gain K in gray levels an electron: the full well is full scale."""
        return self.full_scale / self.full_well_e


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
    """

    kind: Annotated[str, AfterValidator(BACKGROUNDS.check)] = "flat"
    level: LightLevel = 0.1
    gain: LightLevel = 1.0


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
        Motion of the camera: "none", "road" (half-car model on a random road) or "imu" (a recorded trace); others may
        be registered.
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
    own
        Settings of registered motions, backgrounds and point-spread functions, by name.
    """

    distance_m: Annotated[float, Field(ge=0.1, le=1e4)] = 80.0
    stop_m: Annotated[float, Field(gt=0, le=1e4)] = 25.0
    speed_m_s: Annotated[float, Field(ge=0, le=60)] = 30 / 3.6
    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    speed_profile: tuple[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], Annotated[float, Field(le=60)]], ...] = ()
    shake: Annotated[str, AfterValidator(MOTIONS.check)] = "road"
    road_class: Literal["A", "B", "C", "D"] = "B"
    imu_start_s: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    arrays: tuple[Placement, ...] = (Placement(),)
    camera: CameraSettings = CameraSettings()
    emitter: EmitterSettings = EmitterSettings()
    sensor: SensorSettings = SensorSettings()
    background: BackgroundSettings = BackgroundSettings()
    own: Mapping[str, Any] = field(default_factory=dict, hash=False)

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
        if self.own and all(registry.is_built_in(name) for registry, name in parts):
            keys = ", ".join(f"channel.own.{key}" for key in self.own)
            raise ValueError(
                f"{keys} has no effect, as shake, background.kind and camera.psf are the package's; leave it out"
            )
        return self

    @property
    def moves(self) -> bool:
        """Whether the vehicle ever drives: a speed is above 0."""
        return any(speed > 0 for _, speed in self.speed_profile) if self.speed_profile else self.speed_m_s > 0
