"""Settings of the devices: the camera, the emitters of the arrays and the image sensor."""

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, FocalM, PitchM, PixelM, clear_errors
from heliograph.channel.parts import POINT_SPREADS


def _lit(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(colour):
        raise ValueError("a colour has red, green or blue above 0, not (0, 0, 0)")
    return colour


LightLevel = Annotated[float, Field(ge=0, le=4)]
"""Light in full scales. Chosen bound: four times saturation."""

Colour = Annotated[tuple[LightLevel, LightLevel, LightLevel], AfterValidator(_lit)]
"""Red, green and blue of a light, by those of what the camera shows as gray: (1, 1, 1) is gray."""

Probability = Annotated[float, Field(ge=0, lt=1)]
"""Probability of an accident of a frame."""

Ppm = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Error of a clock's period in millionths. Chosen bound: 1 %, a hundred times what the air interface allows."""

LengthM = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Place in the scene in m. Chosen bound: 10 km, from which no array is seen."""

SpeedMS = Annotated[float, Field(ge=-1000, le=1000)]
"""Velocity in m/s. Chosen bound: ten times that of a fast train."""

TimeS = Annotated[float, Field(ge=-60, le=3600)]
"""Start of a clock in s. What an array shows before the film is computed too, so that a minute is the most."""

TiltDeg = Annotated[float, Field(gt=-90, lt=90)]
"""Angle of an array's tilt in degrees: at 90 it is seen from its edge."""


MOST_FOCAL_PX = 1e6
"""Largest focal length in pixels: that of a lens of 1 m and pixels of 1 um. The motion of an array within an exposure
is drawn in steps of pixels, so that a frame would take the longer the larger it is."""

EXPOSURE_SLACK = 1e-9
"""Relative excess of the exposure over the frame period, or over T_b, that counts as a rounding error of double
precision."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CameraSettings:
    """Pinhole camera; its shutter is global unless a time from row to row is set.

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
    uneven_s
        Rms unevenness of the exposures themselves in s, 0 to 10, cut at 0.45 frame periods: a variable frame rate, of
        which the time stamps tell.
    row_time_s
        Time from the exposure of a row to that of the next in s, 0 for a global shutter; all rows take at most 1 /
        ``fps``. A rolling shutter's rows see a pattern at times of their own.
    gain_swing
        Amplitude by which automatic exposure changes the light of all pixels about 1, 0 to 0.9, as a sine in time.
    gain_period_s
        Period of that swing in s, 0.1 to 1000.
    white_balance_swing
        Amplitude by which automatic white balance changes the gain of red about 1, 0 to 0.9, as a sine in time, and
        that of blue the other way. Gray frames show it as brighter or darker light, the more the more coloured it is:
        see ``emitter.colour`` and ``background.colour``.
    white_balance_period_s
        Period of that swing in s, 0.1 to 1000.
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
        if self.row_time_s * self.height * self.fps > 1 + EXPOSURE_SLACK:
            raise ValueError(
                f"row_time_s times height is at most 1 / fps = {1 / self.fps:g} s, not "
                f"{self.row_time_s * self.height:g} s"
            )
        if self.focal_px > MOST_FOCAL_PX:
            raise ValueError(f"focal_m is at most {MOST_FOCAL_PX:g} pixels of pixel_m, not {self.focal_px:g}")
        if self.dropped + self.repeated >= 1:
            raise ValueError(f"dropped and repeated are below 1 together, not {self.dropped + self.repeated:g}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, ``focal_m`` / ``pixel_m``."""
        return self.focal_m / self.pixel_m

    def gain(self, time_s: float) -> float:
        """Return the factor by which automatic exposure changes the light, 1 without a swing.

        Parameters
        ----------
        time_s
            True time in s.
        """
        return 1 + self.gain_swing * math.sin(2 * math.pi * time_s / self.gain_period_s)

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
    colour
        Red, green and blue of the LEDs' light, 0 to 4 each, by those of what the camera shows as gray: (1, 1, 1) for
        white. Without a swing of white balance it changes nothing: ``all_on`` is what a gray frame shows.
    shape
        "disc", a round LED of ``diameter_m``, or "cell", a square of a screen that fills ``pitch_m`` and has no lobe.
        The next four are of a screen's cells alone.
    response_s
        Time constant in s, 0 to 1, with which a cell's light nears a new level; 0 for at once. A larger one leaves more
        of the pattern before.
    backlight_hz
        Rate in Hz at which the backlight is switched to dim it, 0 for a steady one, to 1e5. With a rolling shutter a
        low rate shows as bands.
    backlight_duty
        Part of that period for which the backlight is on, 0.01 to 1; its mean stays.
    scan_s
        Time in s, 0 to 1, by which the display's lowest row of cells takes a new pattern later than its top row.
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
            raise ValueError(
                'response_s, backlight_hz and scan_s are of a screen: set shape to "cell", or leave them 0'
            )
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
    gamma
        Exponent of light by gray level, 0.2 to 5: 1 for a linear camera, about 2.2 for a phone's films. A larger one
        makes dark levels brighter.
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
        """System gain K in gray levels an electron: the full well is full scale."""
        return self.full_scale / self.full_well_e
