"""Settings of the receivers: calibration of camera and array, and tuning."""

from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, FocalM, Fraction, PitchM, PixelM, clear_errors, from_mapping
from heliograph.base.errors import SettingsError
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.registry import GROUPS, RECEIVERS, part_of
from heliograph.signal.settings import SignalSettings

Equaliser = Literal["none", "inverse"]  # how the plain receiver reads the LEDs of a pair; see `PlainSettings`

# feedback from the soft receiver's decoder to the equaliser; see `SoftSettings`
Feedback = Literal["none", "decoded", "soft", "propagation"]

PlaceInPx = Annotated[float, Field(ge=-1e5, le=1e5)]  # coordinate in px, within the width of any sensor

# x and y in px of four corners in turn
Corners = tuple[PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx]

Start = Annotated[int, Field(ge=-(10**5), le=10**5)]  # first column or row of a region, within the width of any sensor

Length = Annotated[int, Field(ge=8, le=10**5)]  # columns or rows of a region

# x, y, columns and rows in px
Region = tuple[Start, Start, Length, Length]

# default minimum size of an array: 123 m and 247 m away in the reference link
SMALLEST_SIDE_PX = dict.fromkeys(RECEIVERS.built_in, 8.0) | {"soft": 4.0, "screen": 4.0}


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CalibrationSettings:
    """Calibration of lens and array, by which the pitch in the image gives a distance.

    Attributes
    ----------
    focal_m
        Focal length of the lens in m, 1e-4 to 10.
    pixel_m
        Pitch of the camera's pixels in m, 1e-7 to 1e-3.
    pitch_m
        Pitch of the LEDs in m, 1e-4 to 10.
    centre_px
        Image (x, y) of the optical axis in px. If left out, the centre of the reference sensor of 1024 x 512 pixels.
    blur_px
        First guess of the blur's standard deviation in px, 0.2 to 5; the receiver refines it.
    exposure_s
        Exposure of the camera in s, 1e-9 to 10, for the receiver "soft". If left out, the receiver estimates the
        exposure, or assumes the frame period if headers and brightness do not decide.
    """

    focal_m: FocalM = 0.035
    pixel_m: PixelM = 12e-6
    pitch_m: PitchM = 0.02
    centre_px: tuple[PlaceInPx, PlaceInPx] = (511.5, 255.5)
    blur_px: Annotated[float, Field(ge=0.2, le=5)] = 0.55
    exposure_s: Annotated[float, Field(ge=1e-9, le=10)] | None = None

    def distance_m(self, pose: Pose) -> float:
        """Distance of an array in metres by the pitch in the image.

        Parameters
        ----------
        pose
            Pose of the array on the sensor.
        """
        # pinhole: pitch_px = f p / (Z pixel)
        return self.focal_m * self.pitch_m / (pose.frontal_pitch * self.pixel_m)


LIVE_CPU_SHARE = 0.3  # share of a core for the search with a live camera: tracking an array takes half a core


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DetectSettings:
    """Detection of arrays.

    Attributes
    ----------
    min_side_px
        Minimum side of an array in px, at least 3; arrays down to 0.945 of the minimum are detected too. If left out, 8
        for "plain" and published receivers, 4 for others. A smaller value reads farther, takes longer and detects more
        clutter.
    max_side_px
        Maximum side of an array in px, 6 to 4096; arrays above 64 px are searched in reduced frames.
    min_contrast
        Minimum luminance of a lit cell of the header, as a fraction of full scale. A lower value detects dimmer arrays
        and more clutter.
    score
        Minimum correlation of a detection with the header's image. A lower value lets clutter through.
    candidates
        Maximum number of candidates per search, 1 to 64. A larger number detects arrays among more clutter, and more
        arrays that appear at once, and takes longer.
    cpu_share
        Average share of a CPU core for detection, in the camera's time, 0.01 to 1000. If left out, 2 for films and 0.3
        for live cameras. The search counts work, not time, so every machine reads a film alike. Skipped work is
        reported. With corners or a region the search has no bound.
    corners
        Corners of an array in the film: x and y in px of the four corners of the LED area, in order around the area, in
        the frames as read; empty for none. The search is then restricted to this area, turned and tilted like the
        corners, down to a tenth of min_contrast.
    region
        Region of the frames to which the search is restricted, down to a tenth of min_contrast: x, y, columns and rows
        in px; empty for the complete frame, or the surroundings of the corners. Detected arrays are tracked beyond the
        region.
    """

    min_side_px: Annotated[float, Field(ge=3)] | None = None
    max_side_px: Annotated[float, Field(ge=6, le=4096)] = 512.0
    min_contrast: Fraction = 0.03
    score: Fraction = 0.9
    candidates: Annotated[int, Field(ge=1, le=64)] = 6
    cpu_share: Annotated[float, Field(ge=0.01, le=1000)] | None = None
    corners: Corners | tuple[()] = ()
    region: Region | tuple[()] = ()

    @model_validator(mode="after")
    def _consistent(self) -> "DetectSettings":
        if self.corners and not _is_around(self.corners):
            raise ValueError(
                f"corners are x and y of four corners one after the other around an area, not "
                f"{','.join(f'{n:g}' for n in self.corners)}"
            )
        return self


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class TrackSettings:
    """Tracking of arrays.

    Attributes
    ----------
    acceleration_px
        Standard deviation of the image's acceleration by shake, in px per pattern squared, 1e-6 to 1000. A larger value
        follows rougher roads, a smaller value smooths more.
    coast_patterns
        Patterns without a visible array after which the track is lost and the search resumes, above 0 and at most 1e6.
    """

    acceleration_px: Annotated[float, Field(ge=1e-6, le=1000)] = 0.1
    coast_patterns: Annotated[float, Field(gt=0, le=1e6)] = 50.0


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DecodeSettings:
    """Decoder of the channel code.

    Attributes
    ----------
    algorithm
        Algorithm of the turbo code: "max-log" with scaled extrinsic values, or "log-map", which loses fewer blocks and
        takes longer. If left out, "log-map" for "soft" and "screen", else "max-log".
    iterations
        Maximum number of iterations, 1 to 64; decoding of a codeword stops as soon as the CRC is right.
    in_background
        True to decode packets in a second process, while the next frames are searched and tracked on another core. The
        packets are the same; a receiver returns each with the first frame after decoding. If left out, true for live
        cameras and long films in the command ``receive``, else false.
    """

    algorithm: Literal["max-log", "log-map"] | None = None
    iterations: Annotated[int, Field(ge=1, le=64)] = 8
    in_background: bool | None = None


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PlainSettings:
    """Settings of the receiver "plain".

    Attributes
    ----------
    equaliser
        "none" reads the luminance at each LED's position, as the paper does; "inverse" estimates all LEDs by least
        squares with the blur known (Kasashima et al., 2013).
    """

    equaliser: Equaliser = "none"


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SoftSettings:
    """Settings of the receiver "soft".

    Attributes
    ----------
    feedback
        Feedback from the decoder to the equaliser: "none"; the "decoded" codewords, to subtract the light;
        "soft" values of the others too; or soft values with expectation "propagation", which reads farthest.
    combining
        True to combine repeated codewords of a carousel with earlier receptions.
    led_by_led
        True to decode samples at each LED first, as "plain" does, and then by squares of 2 x 2 LEDs, out of step too;
        codewords decoded by samples are not equalised, which saves time. False to compare equalisers, as with the
        feedback "none".
    """

    feedback: Feedback = "propagation"
    combining: bool = True
    led_by_led: bool = True


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ScreenSettings:
    """Settings of the receiver "screen".

    Attributes
    ----------
    gamma
        Exponent of light by gray level, 0.2 to 5: 1 for a linear camera, about 2.2 for films of a phone.
    row_time_s
        Time between the exposures of successive rows of pixels in s, at least 0. If left out, estimated from the film.
    find_rate
        True to try other pattern rates if that of ``signal.pattern_period_s`` does not fit.
    """

    gamma: Annotated[float, Field(ge=0.2, le=5)] = 2.2
    row_time_s: Annotated[float, Field(ge=0, le=1)] | None = None
    find_rate: bool = True


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReceiveSettings:
    """Receiver and settings of reception.

    Attributes
    ----------
    receiver
        Receiver: "plain" is the paper's, "soft" reads as far as the channel allows, "screen" reads a screen filmed by a
        phone; `heliograph.list_receivers` also names published ones, and others may be registered.
    calibration
        Calibration of lens and array.
    detect
        Detection of arrays.
    track
        Tracking of arrays.
    decode
        Decoder of the channel code.
    plain
        Settings of the receiver "plain".
    soft
        Settings of the receiver "soft".
    screen
        Settings of the receiver "screen".
    custom
        Settings of a registered receiver, by name.
    """

    receiver: Annotated[str, AfterValidator(RECEIVERS.check)] = "plain"
    calibration: CalibrationSettings = CalibrationSettings()
    detect: DetectSettings = DetectSettings()
    track: TrackSettings = TrackSettings()
    decode: DecodeSettings = DecodeSettings()
    plain: PlainSettings = PlainSettings()
    soft: SoftSettings = SoftSettings()
    screen: ScreenSettings = ScreenSettings()
    custom: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def smallest_side_px(self) -> float:
        """Minimum side of an array in px, by the settings or the receiver."""
        return self.detect.min_side_px or SMALLEST_SIDE_PX.get(self.receiver, SMALLEST_SIDE_PX["soft"])

    def with_live_limits(self) -> "ReceiveSettings":
        """Return the settings with the CPU share of a live camera, which does not wait."""
        if self.detect.cpu_share is not None or self.receiver not in RECEIVERS.built_in:
            return self
        return replace(self, detect=replace(self.detect, cpu_share=LIVE_CPU_SHARE))

    @model_validator(mode="after")
    def _consistent(self) -> "ReceiveSettings":
        smallest, largest = self.smallest_side_px, self.detect.max_side_px
        if smallest >= largest:
            raise ValueError(f"detect.min_side_px must be below detect.max_side_px, not {smallest:g} and {largest:g}")
        _check_effects(self)
        if self.custom and (kind := part_of(self.receiver).settings) is not None:
            from_mapping(kind, self.custom)
        return self


def check_pairs(signal: SignalSettings, name: str) -> None:
    """Raise a SettingsError unless the light sends pairs of patterns as all receivers but "plain" read them."""
    for key, value, wanted in (("modulation", signal.modulation, "haar"), ("header", signal.header, "m_sequence")):
        if value != wanted:
            raise SettingsError(
                f'the {name} receiver reads signal.{key} = "{wanted}", not "{value}"; set receive.receiver = "plain"'
            )


def _is_around(corners: Corners) -> bool:
    """Return True if four corners are in order around a convex area."""
    x, y = corners[0::2], corners[1::2]
    sides = [(x[k] - x[k - 1], y[k] - y[k - 1]) for k in range(4)]
    turns = [sides[k - 1][0] * sides[k][1] - sides[k - 1][1] * sides[k][0] for k in range(4)]
    return min(turns) > 0 or max(turns) < 0


def _check_effects(settings: ReceiveSettings) -> None:
    """Raise a ValueError if a setting was changed that the receiver does not read."""
    name, changed = settings.receiver, [("custom", key) for key in settings.custom]
    for entry in fields(settings):
        if is_dataclass(group := getattr(settings, entry.name)):
            changed += [(entry.name, key.name) for key in fields(group) if getattr(group, key.name) != key.default]
    if not changed:  # a registered receiver is not loaded yet
        return
    part = None if name in RECEIVERS.built_in else part_of(name)
    reads = (*GROUPS, name) if part is None else (*part.reads, *(["custom"] if part.settings else []))
    for group, key in changed:
        if group in reads and (key != "exposure_s" or name == "soft" or part is not None):
            continue
        reader = "the receiver it belongs to"
        if group in GROUPS and part is not None:
            reader = f"a receiver that reads it (this one is registered without reads=['{group}'])"
        raise ValueError(
            f"receive.{group}.{key} has no effect with receive.receiver = '{name}'; leave it out, or choose {reader}"
        )
