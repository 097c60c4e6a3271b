"""Settings of the receiver: what it is told of the light and the camera, and its tunables."""

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]

Equaliser = Literal["none", "inverse"]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CalibrationSettings:
    """What is known of lens and array beforehand; it turns the pitch in the image into a distance.

    Attributes
    ----------
    focal_m
        Focal length of the lens.
    pixel_m
        Pitch of the camera's pixels.
    pitch_m
        Pitch of the LEDs.
    blur_px
        First guess of the blur's standard deviation; it is estimated from then on.
    exposure_s
        Exposure of the camera where it is known; None leaves it to the receiver "soft" to find, which takes it for the
        frame period unless headers or brightness tell otherwise.
    """

    focal_m: Positive = 0.035
    pixel_m: Positive = 12e-6
    pitch_m: Positive = 0.02
    blur_px: Annotated[float, Field(ge=0.2, le=5)] = 0.55
    exposure_s: Positive | None = None


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DetectSettings:
    """When something is taken for an array.

    Attributes
    ----------
    detector
        "m_sequence", by the header, or "all_on", by the shape of the lit array (the comparison of the paper).
    min_side_px, max_side_px
        Smallest and largest array looked for; a narrow range is faster and gives fewer false candidates.
    min_contrast
        Least luminance of a lit cell, as a share of full scale. Lower finds dimmer arrays and more clutter.
    coarse_score
        Correlation with a header that makes a candidate, before its pose is fitted.
    score
        Correlation with the fitted header that makes a detection. Lower lets clutter through.
    regularity
        Least ratio of the weakest to the mean alternation of the header's frames; clutter does not alternate.
    impaired
        Whether arrays are found that are tilted or partly hidden; more clutter is taken for one of them. The receiver
        "soft" always looks for them.
    hidden_score, hidden_regularity
        As above for an array a part of which is hidden: it correlates less, but alternates as evenly as any.
    candidates
        Most candidates fitted a search.
    """

    detector: Literal["m_sequence", "all_on"] = "m_sequence"
    min_side_px: Annotated[float, Field(ge=3)] = 8.0
    max_side_px: Annotated[float, Field(ge=6, le=400)] = 64.0
    min_contrast: Share = 0.03
    coarse_score: Share = 0.5
    score: Share = 0.9
    regularity: Share = 0.5
    impaired: bool = False
    hidden_score: Share = 0.8
    hidden_regularity: Share = 0.85
    candidates: Annotated[int, Field(ge=1, le=64)] = 6

    @model_validator(mode="after")
    def _ordered(self) -> "DetectSettings":
        if self.min_side_px >= self.max_side_px:
            raise ValueError(f"min_side_px must be below max_side_px, not {self.min_side_px} and {self.max_side_px}")
        return self


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class TrackSettings:
    """How the array is followed.

    Attributes
    ----------
    acceleration_px_s2
        Standard deviation of the image's acceleration by shake; larger follows rougher roads, smaller smooths more.
    acceleration_s
        Time over which that acceleration keeps its sign.
    expansion_s2
        The same for the second derivative of the logarithm of the pitch.
    activity
        Least rms difference of pattern and inverse with which it is seen, as a share of the array's luminance less
        what blur takes of the contrast of 2 x 2 LEDs.
    score
        Least correlation with which a header sharpens pitch and blur.
    coast_s
        Time without the array in sight after which it is lost.
    iterations
        Most Gauss-Newton steps a pair.
    """

    acceleration_px_s2: Positive = 1e5
    acceleration_s: Positive = 4e-3
    expansion_s2: Positive = 0.5
    activity: Share = 0.06
    score: Share = 0.6
    coast_s: Positive = 0.05
    iterations: Annotated[int, Field(ge=1, le=20)] = 3


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DecodeSettings:
    """The turbo decoder.

    Attributes
    ----------
    algorithm
        "max-log" with scaled extrinsic values, or "log-map".
    iterations
        Most iterations; decoding stops as soon as the CRC is right.
    """

    algorithm: Literal["max-log", "log-map"] = "max-log"
    iterations: Annotated[int, Field(ge=1, le=64)] = 8


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SoftSettings:
    """What the receiver "soft" has beside.

    Attributes
    ----------
    min_side_px
        Smallest array looked for, in place of ``detect.min_side_px``: it reads farther.
    regularity
        Least ratio of the weakest to the mean alternation, in place of ``detect.regularity``: a camera out of step
        sees a header alternate unevenly. What the header's clock cannot explain is sorted out after.
    rounds
        Most rounds between equaliser and turbo decoder.
    algorithm
        Of the turbo decoder, in place of ``decode.algorithm``: what is fed back softly should be no guess.
    feedback
        What the equaliser gets back from the turbo decoder: "none", the "decoded" codewords, whose light is
        subtracted, or "soft" values of the others too.
    propagate
        Whether cells that are not decoded count as -1 or +1 to the others, by expectation propagation, not as Gaussian.
    sharpen
        Whether poses are sharpened by what is decoded.
    looks
        Whether codewords of a carousel that come again are added to what was seen of them.
    """

    min_side_px: Annotated[float, Field(ge=3)] = 4.0
    regularity: Share = 0.15
    rounds: Annotated[int, Field(ge=1, le=100)] = 24
    algorithm: Literal["max-log", "log-map"] = "log-map"
    feedback: Literal["none", "decoded", "soft"] = "soft"
    propagate: bool = True
    sharpen: bool = True
    looks: bool = True


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReceiveSettings:
    """The receiver.

    Attributes
    ----------
    receiver
        Its name: "plain" is the paper's own, "soft" reads as far as the channel allows.
    equaliser
        How "plain" reads the LEDs: "none", the luminance at each one's position, as in the paper, or "inverse", all by
        least squares with the blur known, as Kasashima et al. 2013 did.
    """

    receiver: Literal["plain", "soft"] = "plain"
    equaliser: Equaliser = "none"
    calibration: CalibrationSettings = CalibrationSettings()
    detect: DetectSettings = DetectSettings()
    track: TrackSettings = TrackSettings()
    decode: DecodeSettings = DecodeSettings()
    soft: SoftSettings = SoftSettings()

    @model_validator(mode="after")
    def _ordered(self) -> "ReceiveSettings":
        smallest, largest = self.soft.min_side_px, self.detect.max_side_px
        if smallest >= largest:
            raise ValueError(f"soft.min_side_px must be below detect.max_side_px, not {smallest} and {largest}")
        return self
