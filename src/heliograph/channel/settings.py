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
from heliograph.channel.parts import BACKGROUNDS, MOTIONS, POINT_SPREADS


def _lit(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(colour):
        raise ValueError("a colour has red, green or blue above 0, not (0, 0, 0)")
    return colour


LightLevel = Annotated[float, Field(ge=0, le=4)]  # light in full scales, up to four times saturation

Colour = Annotated[tuple[LightLevel, LightLevel, LightLevel], AfterValidator(_lit)]
"""Red, green and blue of a light; (1, 1, 1) is neutral for the camera."""

Probability = Annotated[float, Field(ge=0, lt=1)]  # probability of a frame fault

Ppm = Annotated[float, Field(ge=-1e4, le=1e4)]  # relative error of a clock period in millionths, at most 1 %

LengthM = Annotated[float, Field(ge=-1e4, le=1e4)]  # position in the scene in m, at most 10 km

SpeedMS = Annotated[float, Field(ge=-1000, le=1000)]  # velocity in m/s

TimeS = Annotated[float, Field(ge=-60, le=3600)]
"""Start of a clock in s; patterns before the film are computed too, hence at most a minute."""

TiltDeg = Annotated[float, Field(gt=-90, lt=90)]  # tilt of an array in degrees, below an edge-on view at 90

SunDeg = Annotated[float, Field(ge=-90, le=90)]  # angle of the sun from the optical axis in degrees


MAX_POINTS = 36_000  # maximum number of points of a trajectory: an hour at 10 points/s


def _timed(points: "Points") -> "Points":
    if len(points) == 1 or len(points) > MAX_POINTS:
        raise ValueError(f"a trajectory has 2 to {MAX_POINTS} points, not {len(points)}; read fewer points per second")
    late = next((b for a, b in pairwise(points) if b[0] <= a[0]), None)
    if late:
        raise ValueError(f"the times of a trajectory rise, unlike {late[0]:g} s")
    return points


Points = Annotated[tuple[tuple[float, float, float, float, float], ...], AfterValidator(_timed)]
"""Trajectory: time in s, x, y and z in m, yaw in degrees."""

EXPOSURE_SLACK = 1e-9  # relative excess of the exposure over the frame period or T_b that is a rounding error

MAX_MOTION_PX = 1e3
"""Maximum motion of an array in the image during an exposure in px; limits the memory of a frame to 0.13 GB."""

MAX_JITTER = 0.45  # largest error of a frame time in frame periods; below 1/2, so that frame times rise
MIN_DISTANCE_M = 0.3  # minimum distance of a rendered panel; the image is much larger than the sensor there


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Placement:
    """Position, motion and faults of an array.

    Attributes
    ----------
    x_m
        Position of the array centre at time 0 in m, positive to the right of the optical axis; at most 10 km.
    y_m
        Position of the array centre at time 0 in m, positive below the optical axis; at most 10 km.
    z_offset_m
        Distance of the array centre beyond ``channel.distance_m`` at time 0 in m. An array behind the camera must have
        a positive ``vz_m_s``.
    yaw_deg
        Tilt about the downward axis in degrees, above -90 and below 90. Tilt narrows and dims the image.
    pitch_deg
        Tilt about the rightward axis in degrees, above -90 and below 90. Tilt flattens and dims the image.
    roll_deg
        Rotation about the forward axis in degrees, -180 to 180; positive is clockwise in the image.
    vx_m_s
        Velocity of the array to the right in m/s, -1000 to 1000; negative to the left.
    vy_m_s
        Velocity of the array downward in m/s, -1000 to 1000; negative upward.
    vz_m_s
        Velocity of the array away from the camera in m/s, -1000 to 1000; negative for approach.
    brightness
        Relative light of all LEDs, 0 to 100.
    dead
        Fraction of LEDs that are always off, 0 to 1, at random positions.
    stuck
        Fraction of LEDs that are always on, 0 to 1, at random positions; at most 1 together with ``dead``.
    spread
        Relative standard deviation of the LED light, 0 to 1, normal and constant in time, such as 0.2 for 20 %. The
        low layer is the most sensitive.
    hidden
        Rectangle of the array behind an obstacle: left, top, right and bottom edge as fractions of the side, from the
        upper left corner, such as (0, 0, 0.5, 0.5); empty for no obstacle.
    hidden_level
        Light of the obstacle in full scales, 0 to 4.
    off_s
        Intervals (from, to) in s with all LEDs off, stuck LEDs included; the clock continues.
    clock_ppm
        Error of the array clock in millionths, -10000 to 10000; positive for a longer pattern period.
    start_s
        Start of pattern 0 in s, -60 to 3600; the array is dark before. At most 1e6 patterns precede the first frame.
    trajectory
        CSV file, or points (time in s, x, y, z in m, yaw in degrees), of the vehicle with the array, as for
        ``channel.trajectory``. ``x_m``, ``y_m`` and ``z_offset_m`` are then the place of the array on the vehicle:
        right, down and forward; ``channel.distance_m`` has no effect, and the velocities are 0.
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
    trajectory: Points = ()

    @model_validator(mode="after")
    def _consistent(self) -> "Placement":
        if self.trajectory and (self.vx_m_s or self.vy_m_s or self.vz_m_s):
            raise ValueError("an array has a trajectory or velocities: set vx_m_s, vy_m_s and vz_m_s to 0")
        if self.dead + self.stuck > 1:
            raise ValueError(f"dead and stuck are at most 1 together, not {self.dead + self.stuck:g}")
        if self.hidden and not (self.hidden[0] < self.hidden[2] and self.hidden[1] < self.hidden[3]):
            raise ValueError(f"hidden is left, top, right, lower with left < right, top < lower, not {self.hidden}")
        if any(end <= begin for begin, end in self.off_s):
            raise ValueError(f"off_s are times (from, to) with from < to, not {self.off_s}")
        return self


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class BackgroundSettings:
    """Background of the arrays.

    Attributes
    ----------
    kind
        "flat", "street" or "street-night" (a street in perspective), "synthetic" (sky, buildings and many lamps as
        clutter) or "footage" (recorded frames); programs may register others.
    level
        Light of a flat background in full scales, 0 to 4. A larger value adds shot noise around the panel.
    gain
        Light of white in a drawn or recorded background in full scales, 0 to 4. A larger value increases the clutter.
    colour
        Red, green and blue of background and panels, see ``emitter.colour``.
    """

    kind: Annotated[str, AfterValidator(BACKGROUNDS.check)] = "flat"
    level: LightLevel = 0.1
    gain: LightLevel = 1.0
    colour: Colour = (1.0, 1.0, 1.0)


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CameraSettings:
    """Pinhole camera with a global or rolling shutter.

    Attributes
    ----------
    fps
        Frame rate in frames/s, 0.1 to 1e6. The receiver "plain" needs one frame per pattern, "soft" at least one.
    exposure_s
        Exposure time tau of equation (4) in s, at least 1e-9 and at most 1 / ``fps`` and T_b. A shorter exposure covers
        fewer slots of a pattern and has less motion blur; ``emitter.all_on`` assumes lens and gain for this exposure.
        An array moves by at most 1000 px in the image during an exposure.
    start_s
        Time of the first exposure in s, -60 to 3600. A fraction of T_b makes camera and array asynchronous.
    width
        Columns of the sensor in pixels, 16 to 8192.
    height
        Rows of the sensor in pixels, 16 to 8192.
    focal_m
        Focal length in m, 1e-4 to 10, and at most 1e6 pixels. A longer lens magnifies the array and the shake.
    pixel_m
        Pixel size in m, 1e-7 to 1e-3. Smaller pixels resolve the array better.
    blur_px
        Standard deviation of the Gaussian optical blur in pixels, 0.05 to 20, in addition to pixel area and emitter
        disc. More blur mixes neighbouring LEDs and affects the low layer first.
    psf
        Point-spread function of the lens: "gaussian", or "halo" (plus a wide and weak Gaussian); programs may register
        others.
    clock_ppm
        Error of the camera clock in millionths, -10000 to 10000; positive for a frame period longer than 1 / ``fps``.
    dropped
        Probability of a lost frame, at least 0 and below 1.
    gaps
        True if a lost frame leaves a gap in frame numbers and times; false for a camera that numbers delivered frames.
    repeated
        Probability of a copy of the previous frame in place of a frame, at least 0; below 1 together with ``dropped``.
    jitter_s
        Rms error of the time stamps in s, 0 to 10, limited to 0.45 frame periods; the exposures are uniform.
    uneven_s
        Rms variation of the exposure times in s, 0 to 10, limited to 0.45 frame periods: a variable frame rate with
        correct time stamps.
    row_time_s
        Delay between the exposures of successive rows in s, 0 for a global shutter; all rows take at most 1 / ``fps``.
    gain_swing
        Amplitude of the sinusoidal gain of automatic exposure about 1, 0 to 0.9.
    gain_period_s
        Period of automatic exposure in s, 0.1 to 1000.
    white_balance_swing
        Amplitude of the sinusoidal red gain of automatic white balance about 1, 0 to 0.9; blue varies in opposite
        phase. The brightness of gray frames varies with the colour of the light, see ``emitter.colour`` and
        ``background.colour``.
    white_balance_period_s
        Period of automatic white balance in s, 0.1 to 1000.
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
    uneven_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    row_time_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    gain_swing: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    gain_period_s: Annotated[float, Field(ge=0.1, le=1000)] = 3.0
    white_balance_swing: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    white_balance_period_s: Annotated[float, Field(ge=0.1, le=1000)] = 5.0

    @model_validator(mode="after")
    def _consistent(self) -> "CameraSettings":
        if self.exposure_s * self.fps > 1 + EXPOSURE_SLACK:
            raise ValueError(f"exposure_s is at most 1 / fps = {1 / self.fps:g} s, not {self.exposure_s:g} s")
        rows_s = self.row_time_s * self.height
        if rows_s * self.fps > 1 + EXPOSURE_SLACK:
            raise ValueError(f"row_time_s times height is at most 1 / fps = {1 / self.fps:g} s, not {rows_s:g} s")
        if self.focal_px > 1e6:
            raise ValueError(f"focal_m is at most 1e+06 pixels of pixel_m, not {self.focal_px:g}")
        if self.dropped + self.repeated >= 1:
            raise ValueError(f"dropped and repeated are below 1 together, not {self.dropped + self.repeated:g}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, ``focal_m`` / ``pixel_m``."""
        return self.focal_m / self.pixel_m

    def gain(self, time_s: float) -> float:
        """Return the gain of automatic exposure at a true time."""
        return 1 + self.gain_swing * math.sin(2 * math.pi * time_s / self.gain_period_s)

    @property
    def frame_period_s(self) -> float:
        """True frame period in s, clock error included."""
        return (1 + self.clock_ppm * 1e-6) / self.fps


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EmitterSettings:
    """LEDs and panel.

    Attributes
    ----------
    pitch_m
        LED pitch in m, 1e-4 to 10. A larger pitch enlarges the image of the array.
    diameter_m
        Diameter of a round emitter in m, at least 1e-5 and at most ``pitch_m``. A small emitter concentrates light.
    half_angle_deg
        Half-intensity angle off axis in degrees, at least 0.1 and below 90. A smaller angle dims oblique views.
    all_on
        On-axis light of an unresolved array with all LEDs on for an exposure, in full scales, 0 to 4. Lens and gain
        compensate for the exposure time. A larger value improves the signal-to-noise ratio up to saturation.
    panel_level
        Ambient light reflected by the dark panel, in full scales, 0 to 4.
    panel_margin_m
        Margin of the panel in m beyond half a pitch from the outer LEDs, 0 to 100.
    colour
        Red, green and blue of the LED light, 0 to 4 each; (1, 1, 1) is neutral. Effective only with
        ``camera.white_balance_swing``: ``all_on`` is the light in a gray frame.
    shape
        "disc", a round LED of ``diameter_m``, or "cell", a square of a screen that fills ``pitch_m`` and has no lobe.
        The next four settings apply to "cell" only.
    response_s
        Time constant of the step response of a cell in s, 0 to 1. A slow display mixes successive patterns.
    backlight_hz
        Frequency of a pulsed backlight in Hz, up to 1e5; 0 for constant light. A rolling shutter shows bands at low
        frequencies.
    backlight_duty
        Duty cycle of the backlight, 0.01 to 1, at constant mean light.
    scan_s
        Delay in s, 0 to 1, of a new pattern from the top row of cells to the bottom row.
    """

    pitch_m: PitchM = 0.02
    diameter_m: Annotated[float, Field(ge=1e-5, le=10)] = 0.005
    half_angle_deg: Annotated[float, Field(ge=0.1, lt=90)] = 22.6
    all_on: LightLevel = 0.8
    panel_level: LightLevel = 0.02
    panel_margin_m: Annotated[float, Field(ge=0, le=100)] = 0.02
    colour: Colour = (1.0, 1.0, 1.0)
    shape: Literal["disc", "cell"] = "disc"
    response_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    backlight_hz: Annotated[float, Field(ge=0, le=1e5)] = 0.0
    backlight_duty: Annotated[float, Field(ge=0.01, le=1)] = 1.0
    scan_s: Annotated[float, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> "EmitterSettings":
        if self.diameter_m > self.pitch_m:
            raise ValueError(f"diameter_m is at most pitch_m = {self.pitch_m:g}, not {self.diameter_m:g}")
        if self.shape == "disc" and (self.response_s or self.backlight_hz or self.scan_s):
            raise ValueError('response_s, backlight_hz and scan_s apply to a screen: set shape to "cell", or them to 0')
        return self

    @property
    def lobe_order(self) -> float:
        """Lambertian order m = -ln 2 / ln cos(half angle) for an intensity of cos^m(a) at angle a."""
        return -math.log(2) / math.log(math.cos(math.radians(self.half_angle_deg)))


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SensorSettings:
    """Image sensor according to EMVA 1288.

    Attributes
    ----------
    full_well_e
        Electrons at full scale, 10 to 1e7. A larger value reduces shot noise.
    dark_noise_e
        Rms dark noise in electrons, 0 to 1e5. A larger value hides dim and distant arrays.
    bits
        Bits of a gray level, 8 to 12.
    offset_dn
        Black level in gray levels, 0 to 4095; at 0, dark noise is clipped, as in the reference link.
    gamma
        Exponent of light by gray level, 0.2 to 5: 1 for a linear camera, about 2.2 for a phone. A larger exponent
        brightens dark levels.
    """

    full_well_e: Annotated[float, Field(ge=10, le=1e7)] = 15000.0
    dark_noise_e: Annotated[float, Field(ge=0, le=1e5)] = 40.0
    bits: Annotated[int, Field(ge=8, le=12)] = 8
    offset_dn: Annotated[float, Field(ge=0, le=4095)] = 0.0
    gamma: Annotated[float, Field(ge=0.2, le=5)] = 1.0

    @property
    def full_scale(self) -> int:
        """Largest gray level, 2^bits - 1."""
        return (1 << self.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """System gain K in gray levels per electron."""
        return self.full_scale / self.full_well_e


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class WeatherSettings:
    """Weather between arrays and camera, clear by default.

    Attributes
    ----------
    visibility_m
        Meteorological optical range of fog in m, 10 to 1e6, over which light falls to 5 %; left out for clear air.
    airlight
        Light of the horizon in full scales, 0 to 4: fog at an infinite distance, and drops on the windscreen.
    background_m
        Distance of the background in m, 1 to 1e6, for the airlight; constant over the film.
    droplet_m
        Diameter of fog droplets in m, 1e-6 to 1e-4. Smaller droplets widen the halo of an array.
    glare
        Veil of a low sun at the centre of the picture in full scales, 0 to 4. A larger value adds shot noise.
    sun_deg
        Direction of the sun in degrees to the right of the optical axis and above, -90 to 90 each. The veil falls with
        the square of the angle to the sun.
    rain_mm_h
        Rain rate in mm/h, 0 to 200. Rain dims distant arrays and wets the windscreen.
    windscreen_m
        Distance from lens to windscreen in m, 0 to 2; 0 for no windscreen. Drops appear as discs out of focus.
    rake_deg
        Angle of the windscreen from the horizontal in degrees, above 0 to 90.
    wiper_s
        Time from wipe to wipe in s, 0.1 to 10. A wipe removes all drops at once.
    aperture_m
        Diameter of the lens aperture in m, 1e-4 to 0.5: focal length over f-number, 0.0032 for 35 mm and f/11. A wider
        aperture dilutes the drops on the windscreen.
    """

    visibility_m: Annotated[float, Field(ge=10, le=1e6)] | None = None
    airlight: LightLevel = 0.1
    background_m: Annotated[float, Field(ge=1, le=1e6)] = 300.0
    droplet_m: Annotated[float, Field(ge=1e-6, le=1e-4)] = 1e-5
    glare: LightLevel = 0.0
    sun_deg: tuple[SunDeg, SunDeg] = (0.0, 10.0)
    rain_mm_h: Annotated[float, Field(ge=0, le=200)] = 0.0
    windscreen_m: Annotated[float, Field(ge=0, le=2)] = 0.2
    rake_deg: Annotated[float, Field(gt=0, le=90)] = 30.0
    wiper_s: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    aperture_m: Annotated[float, Field(ge=1e-4, le=0.5)] = 0.0032


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ChannelSettings:
    """Channel from LED patterns to camera frames; the defaults are the reference link.

    Attributes
    ----------
    distance_m
        Distance in m from the camera at time 0 to the plane of arrays with ``z_offset_m`` = 0, 0.1 to 10,000.
    stop_m
        Distance in m to the plane at the end of the film, above 0 and below ``distance_m``. Unused if ``duration_s`` is
        set or the vehicle is at rest.
    speed_m_s
        Speed of the vehicle in m/s, 0 to 100; 0 for a vehicle at rest. A higher speed increases the shake.
    duration_s
        Length of the film in s, above 0 and at most an hour; by default, to the first end of a trajectory, or the drive
        to ``stop_m``, or 1 s for a vehicle at rest.
    speed_profile
        Points (time in s, speed in m/s, 0 to 100) at rising times for linear interpolation, in place of ``speed_m_s``.
    trajectory
        CSV file with the columns time_s, x_m, y_m and optionally z_m and yaw_deg, or points (time in s, x, y, z in m,
        yaw in degrees): path of the camera in place of a speed. x, y and z point forward, left and up, yaw turns left
        (ISO 8855). Camera and vehicles of arrays have common axes; without a trajectory the camera starts at the origin
        along x. The shake is added.
    shake
        Motion of the camera: "none", "road" (half-car model on a random road), "imu" (a recorded trace) or "hand" (a
        handheld camera); programs may register others.
    hand_deg
        Rms angle of slow hand motion in degrees, 0 to 10, for ``shake`` = "hand"; the tremor is a tenth.
    road_class
        Road class of ISO 8608, "A" (smooth) to "D" (rough); the amplitude doubles with each class.
    imu_start_s
        Time in the trace in s at the start of the film, 0 to 1e6.
    arrays
        Arrays in the scene.
    camera
        Camera, lens and clock.
    emitter
        LEDs and panel, equal for all arrays.
    sensor
        Noise and gray levels of the image sensor.
    background
        Background of the arrays.
    weather
        Weather between arrays and camera.
    custom
        Settings of registered motions, backgrounds and point-spread functions, by name.
    """

    distance_m: Annotated[float, Field(ge=0.1, le=1e4)] = 80.0
    stop_m: Annotated[float, Field(gt=0, le=1e4)] = 25.0
    speed_m_s: Annotated[float, Field(ge=0, le=100)] = 30 / 3.6
    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    speed_profile: tuple[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], Annotated[float, Field(le=100)]], ...] = ()
    trajectory: Points = ()
    shake: Annotated[str, AfterValidator(MOTIONS.check)] = "road"
    hand_deg: Annotated[float, Field(ge=0, le=10)] = 0.3
    road_class: Literal["A", "B", "C", "D"] = "B"
    imu_start_s: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    arrays: tuple[Placement, ...] = (Placement(),)
    camera: CameraSettings = CameraSettings()
    emitter: EmitterSettings = EmitterSettings()
    sensor: SensorSettings = SensorSettings()
    background: BackgroundSettings = BackgroundSettings()
    weather: WeatherSettings = WeatherSettings()
    custom: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelSettings":
        times = [time for time, _ in self.speed_profile]
        if any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"the times of speed_profile rise, not {times}")
        if any(speed < 0 for _, speed in self.speed_profile):
            raise ValueError(f"speeds are at least 0, not {min(speed for _, speed in self.speed_profile):g}")
        begin_s, end_s = min(0.0, self.camera.start_s), self.duration_s or 0.0
        for key, points in self.trajectories.items():
            first_s, last_s = points[0][0], points[-1][0]
            if first_s > begin_s or last_s < end_s or last_s <= 0:
                spans = f"from {first_s:g} s to {last_s:g} s, the film from {begin_s:g} s to {end_s:g} s"
                raise ValueError(f"{key} lasts {spans}; extend it, shift its times, or change channel.duration_s")
        to_stop = self.moves and self.duration_s is None and not self.trajectories
        if to_stop and self.stop_m >= self.distance_m:
            raise ValueError(f"stop_m is below distance_m = {self.distance_m:g}, not {self.stop_m:g}; set duration_s")
        for k, place in enumerate(self.arrays):
            ahead_m = self.distance_m + place.z_offset_m
            if ahead_m <= 0 and place.vz_m_s <= 0 and not self.trajectories:
                cure = f"raise channel.arrays.{k}.z_offset_m above -{self.distance_m:g}"
                raise ValueError(f"array {k} lies {-ahead_m:g} m behind the camera during the film; {cure}")
            # the renderer checks later motion and shake
            motion_px = math.hypot(place.vx_m_s, place.vy_m_s) * self.camera.exposure_s * self.camera.focal_px
            motion_px /= max(ahead_m, MIN_DISTANCE_M)
            if ahead_m > 0 and motion_px > MAX_MOTION_PX:
                cure = f"lower channel.arrays.{k}.vx_m_s or vy_m_s, channel.camera.exposure_s or focal_m"
                limit = f"in the image within an exposure, at most {MAX_MOTION_PX:g}"
                raise ValueError(f"array {k} moves {motion_px:g} px {limit}; {cure}, or raise channel.distance_m")
        parts = ((MOTIONS, self.shake), (BACKGROUNDS, self.background.kind), (POINT_SPREADS, self.camera.psf))
        if self.custom and all(name in registry.built_in for registry, name in parts):
            keys = ", ".join(f"channel.custom.{key}" for key in self.custom)
            raise ValueError(f"{keys} has no effect, as shake, background.kind and camera.psf are built in; remove it")
        return self

    @property
    def trajectories(self) -> dict[str, Points]:
        """Trajectories of camera and arrays by key."""
        arrays = {f"channel.arrays.{k}.trajectory": place.trajectory for k, place in enumerate(self.arrays)}
        return {key: points for key, points in {"channel.trajectory": self.trajectory, **arrays}.items() if points}

    @property
    def moves(self) -> bool:
        """True if a vehicle has a trajectory, or a speed above 0."""
        if self.trajectories:
            return True
        return any(speed > 0 for _, speed in self.speed_profile) if self.speed_profile else self.speed_m_s > 0
