"""Settings of the receiver: what it knows of the light and the camera, and what a user may tune."""

from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, FocalM, Fraction, PitchM, PixelM, clear_errors, from_mapping
from heliograph.receive.registry import GROUPS, RECEIVERS, part_of

Equaliser = Literal["none", "inverse"]
"""How the plain receiver reads the LEDs of a pair; see `PlainSettings`."""

Feedback = Literal["none", "decoded", "soft", "propagation"]
"""What the soft receiver's equaliser gets back from the decoder; see `SoftSettings`."""

PlaceInPx = Annotated[float, Field(ge=-1e5, le=1e5)]
"""A coordinate in px, no farther off than any sensor is wide."""

Corners = tuple[PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx, PlaceInPx]
"""x and y in px of four corners in turn."""

Start = Annotated[int, Field(ge=-(10**5), le=10**5)]
"""First column or row of a region, no farther off than any sensor is wide."""

Length = Annotated[int, Field(ge=8, le=10**5)]
"""Columns or rows of a region: a search needs some."""

Region = tuple[Start, Start, Length, Length]
"""x, y, columns and rows in px."""

SMALLEST_SIDE_PX = {"plain": 8.0, "soft": 4.0}
"""Smallest array looked for by default. One half a step of sizes smaller is found too (`acquire.coarse.size_limits`):
123 m and 247 m away in the reference link."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CalibrationSettings:
    """What is known of lens and array beforehand; it turns the pitch in the image into a distance.

    Attributes
    ----------
    focal_m
        Focal length of the lens in m, 1e-4 to 10.
    pixel_m
        Pitch of the camera's pixels in m, 1e-7 to 1e-3.
    pitch_m
        Pitch of the LEDs in m, 1e-4 to 10.
    blur_px
        First guess of the blur's standard deviation in px, 0.2 to 5; it is estimated from then on.
    exposure_s
        Exposure of the camera in s, 1e-9 to 10, for the receiver "soft". If it is left out the receiver estimates it,
        and takes the frame period where headers and brightness do not decide.
    """

    focal_m: FocalM = 0.035
    pixel_m: PixelM = 12e-6
    pitch_m: PitchM = 0.02
    blur_px: Annotated[float, Field(ge=0.2, le=5)] = 0.55
    exposure_s: Annotated[float, Field(ge=1e-9, le=10)] | None = None


LIVE_BUSY_PART = 0.3
"""Part of a core that searching for arrays takes at most, of a live camera: following one takes half of it."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DetectSettings:
    """When something is taken for an array.

    Attributes
    ----------
    min_side_px
        Smallest array looked for in px, at least 3; arrays down to 0.945 of it are found too. If it is left out, 8 for
        "plain" and 4 for "soft". Smaller reads farther, takes longer and finds more clutter.
    max_side_px
        Largest array looked for in px, 6 to 4096; what is larger than 64 px is looked for in reduced frames.
    min_contrast
        Least luminance of a lit cell of the header, as a fraction of full scale. Lower finds dimmer arrays and more
        clutter.
    score
        Least correlation with the header's image of a detection. Lower lets clutter through.
    candidates
        Most candidates examined per search, 1 to 64. More finds arrays among more clutter, and more of many arrays that
        come into sight at once, and takes longer.
    cpu_share
        Share of one core, in the camera's time, that the search for arrays takes on average where much alternates, 0.01
        to 1000. If it is left out, 2 for films and 0.3 for live cameras. The search counts work, not time, so every
        machine reads a film alike. Skipped work is reported. Where corners or a region say where an array is, the
        search has no bound.
    corners
        Where somebody sees an array in the film: x and y in px of the four corners of its LED area, one after the other
        around it, in the frames as they are read; empty for none. Arrays are then looked for about it alone, turned and
        tilted as it is, down to a tenth of min_contrast.
    region
        Part of the frames in which arrays are looked for alone, down to a tenth of min_contrast: x, y, columns and rows
        in px; empty for all of it, or for what lies about the corners. An array that is found is followed beyond it.
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
    """How an array is followed.

    Attributes
    ----------
    acceleration_px
        Standard deviation of the image's acceleration by shake, in px per pattern squared, 1e-6 to 1000. Larger follows
        rougher roads, smaller smooths more.
    coast_patterns
        Patterns without the array in sight after which it is given up and looked for again, above 0 and at most 1e6.
    """

    acceleration_px: Annotated[float, Field(ge=1e-6, le=1000)] = 0.1
    coast_patterns: Annotated[float, Field(gt=0, le=1e6)] = 50.0


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DecodeSettings:
    """The decoder of the channel code.

    Attributes
    ----------
    algorithm
        Algorithm of the turbo code: "max-log" with scaled extrinsic values, or "log-map", which loses fewer blocks and
        takes longer. If it is left out, "max-log" for "plain" and "log-map" for "soft".
    iterations
        Most iterations, 1 to 64; a codeword is finished as soon as its CRC is right.
    in_background
        Whether packets are decoded in a process of their own, while the next frames are searched and followed on
        another core. The packets are the same; a receiver hands each out with the first frame after it is decoded. If
        it is left out, the command ``receive`` does so for live cameras and long films, and nothing else does.
    """

    algorithm: Literal["max-log", "log-map"] | None = None
    iterations: Annotated[int, Field(ge=1, le=64)] = 8
    in_background: bool | None = None


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PlainSettings:
    """Settings of the receiver "plain" alone.

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
    """Settings of the receiver "soft" alone.

    Attributes
    ----------
    feedback
        What the equaliser gets back from the decoder: "none"; the "decoded" codewords, whose light is subtracted;
        "soft" values of the others too; or these with expectation "propagation", which reads farthest.
    combining
        Whether codewords of a carousel that are sent again are added to what was seen of them.
    led_by_led
        Whether a packet is first read by the light at each LED's position, as "plain" does, and then square by square,
        out of step too: what that decodes is not equalised. It saves time. False compares equalisers alone, as the
        feedback "none" does.
    """

    feedback: Feedback = "propagation"
    combining: bool = True
    led_by_led: bool = True


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ScreenSettings:
    """Settings of the receiver "screen" alone.

    Attributes
    ----------
    gamma
        Exponent of light by gray level that is undone, 0.2 to 5: 1 for a linear camera, about 2.2 for a phone's films.
    row_time_s
        Time from the exposure of a row of pixels to that of the next in s, at least 0; left out: it is found from the
        film.
    find_rate
        Whether other pattern rates than that of ``signal.pattern_period_s`` are tried where it does not fit.
    """

    gamma: Annotated[float, Field(ge=0.2, le=5)] = 2.2
    row_time_s: Annotated[float, Field(ge=0, le=1)] | None = None
    find_rate: bool = True


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReceiveSettings:
    """The receiver.

    Attributes
    ----------
    receiver
        Receiver: "plain" is the paper's own, "soft" reads as far as the channel allows, "screen" reads a screen that a
        phone films; others may be registered.
    calibration
        What is known of lens and array.
    detect
        When something is taken for an array.
    track
        How an array is followed.
    decode
        The decoder of the channel code.
    plain
        Settings of the receiver "plain" alone.
    soft
        Settings of the receiver "soft" alone.
    screen
        Settings of the receiver "screen" alone.
    own
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
    own: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def smallest_side_px(self) -> float:
        """Smallest array looked for, in px."""
        if self.detect.min_side_px is not None:
            return self.detect.min_side_px
        return SMALLEST_SIDE_PX.get(self.receiver, min(SMALLEST_SIDE_PX.values()))

    def with_live_limits(self) -> "ReceiveSettings":
        """The same for a live camera, which does not wait: with the bound of a live search."""
        if self.detect.cpu_share is not None or not RECEIVERS.is_built_in(self.receiver):
            return self
        return replace(self, detect=replace(self.detect, cpu_share=LIVE_BUSY_PART))

    @model_validator(mode="after")
    def _consistent(self) -> "ReceiveSettings":
        smallest, largest = self.smallest_side_px, self.detect.max_side_px
        if smallest >= largest:
            raise ValueError(f"detect.min_side_px must be below detect.max_side_px, not {smallest:g} and {largest:g}")
        for key in _without_effect(self):
            raise ValueError(
                f"receive.{key} has no effect with receive.receiver = '{self.receiver}'; leave it out, or choose "
                f"{_reader_of(key, self.receiver)}"
            )
        if self.own and (kind := part_of(self.receiver).settings) is not None:
            from_mapping(kind, self.own)
        return self


def _is_around(corners: Corners) -> bool:
    """Whether four corners go around an area one after the other, without a dent."""
    x, y = corners[0::2], corners[1::2]
    sides = [(x[(k + 1) % 4] - x[k], y[(k + 1) % 4] - y[k]) for k in range(4)]
    turns = [a * d - b * c for (a, b), (c, d) in zip(sides, sides[1:] + sides[:1], strict=True)]
    return all(turn > 0 for turn in turns) or all(turn < 0 for turn in turns)


def _without_effect(settings: ReceiveSettings) -> list[str]:
    """Dotted keys that were set although the receiver does not ask for them."""
    name, found = settings.receiver, []
    rooms = (("plain", PlainSettings()), ("soft", SoftSettings()), ("screen", ScreenSettings()))
    for room, default in rooms:
        if room != name:
            found += _changed(getattr(settings, room), default, f"{room}.")
    if name != "soft" and RECEIVERS.is_built_in(name) and settings.calibration.exposure_s is not None:
        found.append("calibration.exposure_s")
    if RECEIVERS.is_built_in(name):
        return found + [f"own.{key}" for key in settings.own]
    part = part_of(name) if (changed := _changed_groups(settings)) or settings.own else None
    if part is None:  # nothing is asked of it, so it need not be loaded yet
        return found
    found += [key for key in changed if key.partition(".")[0] not in part.reads]
    return found + [f"own.{key}" for key in settings.own if part.settings is None]


def _reader_of(key: str, name: str) -> str:
    """Who a setting without effect is for."""
    group = key.partition(".")[0]
    if group in GROUPS and not RECEIVERS.is_built_in(name):
        return f"a receiver that reads it (this one is registered without reads=['{group}'])"
    return "the receiver it belongs to"


def _changed_groups(settings: ReceiveSettings) -> list[str]:
    """Dotted keys of the groups that are not one receiver's alone, as far as they were changed."""
    rooms = [(group, getattr(settings, group)) for group in GROUPS]
    return [key for group, room in rooms for key in _changed(room, type(room)(), f"{group}.")]


def _changed(settings: Any, default: Any, prefix: str) -> list[str]:
    assert is_dataclass(settings)
    names = [one.name for one in fields(settings)]
    return [f"{prefix}{name}" for name in names if getattr(settings, name) != getattr(default, name)]
