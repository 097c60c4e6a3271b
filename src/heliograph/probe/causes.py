"""Causes of a failed reception: tables of conditions on measured quantities, with messages and remedies."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from heliograph.base.errors import counted
from heliograph.link.budget import Reach
from heliograph.probe.arrays import SLACK, ArrayReport, Clock, Setup
from heliograph.probe.frames import FrameTimes
from heliograph.probe.headers import HeaderMatch
from heliograph.probe.levels import Levels
from heliograph.probe.light import LightRate
from heliograph.probe.regions import Region
from heliograph.probe.trials import MIN_TURN_DEG, SURE_HEADER, Remedy, is_blurred, options
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE


@dataclass(frozen=True, slots=True)
class Cause:
    """Cause of a failed reception.

    Attributes
    ----------
    kind
        Short name; "array" for a decoded array.
    why
        A sentence with the measured values.
    advice
        Remedies, one per line; each names the option, or the part of the camera.
    proven
        True if codewords were decoded with the remedy.
    """

    kind: str
    why: str
    advice: tuple[str, ...] = ()
    proven: bool = False


M = TypeVar("M")


class Rule(Generic[M]):
    """Row of a table of causes: a condition on the measured values m, and texts with fields {m.name}.

    A remedy is a text, or a condition and a text.
    """

    def __init__(
        self, kind: str, applies: Callable[[M], object], why: str, *advice: str | tuple[Callable[[M], object], str]
    ):
        self.kind, self.applies, self.why = kind, applies, why
        self.advice = [(lambda _: True, remedy) if isinstance(remedy, str) else remedy for remedy in advice]


def diagnose(rules: Sequence[Rule[M]], measured: M, proven: bool = False) -> tuple[Cause, ...]:
    """Return the causes of all matching rules, in table order."""
    causes = list[Cause]()
    for rule in rules:
        if rule.applies(measured):
            advice = tuple(text.format(m=measured) for applies, text in rule.advice if applies(measured))
            causes.append(Cause(rule.kind, rule.why.format(m=measured), advice, proven))
    return tuple(causes)


@dataclass(frozen=True, slots=True)
class ArrayLike:
    """A region, described as an array."""

    # Pose, with the pitch of the LEDs and the blur of an LED in px
    pose: Pose
    # Light with all LEDs on, over full scale
    contrast: float
    # Clock of the light; None if no packet was decoded
    clock: Clock | None
    # Estimated reach by receiver; empty for overexposed regions, and beyond the limits of the model
    reach: Reach = field(default_factory=dict)


@dataclass(frozen=True)
class RegionReport:
    """Region of a film with measurements and causes.

    Attributes
    ----------
    region
        Position, size, speed and brightness.
    rate
        Duration of a pattern from the light; None if the region shows no patterns.
    lamp_frames
        Period in frames if the region flashes as a whole; None if it does not, or has no period.
    pattern_part
        Part of the power outside the strongest image, 0 to 1; 0 for a lamp.
    header
        Best header match; None for no match.
    remedy
        Other settings for decoding the region; None if none were found.
    array
        The decoded array; None if the region is not decoded.
    causes
        Causes of the failure, the most important first.
    would_be
        The region described as an array; None if it is decoded, or has no clear header.
    """

    region: Region
    rate: LightRate | None = None
    lamp_frames: float | None = None
    pattern_part: float = 1.0
    header: HeaderMatch | None = None
    remedy: Remedy | None = None
    array: ArrayReport | None = None
    causes: tuple[Cause, ...] = ()
    would_be: ArrayLike | None = None

    @property
    def clear_header(self) -> HeaderMatch | None:
        """Header with a fit that gives size and blur of an array."""
        return self.header if self.header is not None and self.header.score >= 0.75 else None

    @property
    def has_header(self) -> bool:
        """True if the correlation with a header is higher than that of clutter."""
        return self.header is not None and self.header.score >= SURE_HEADER

    @property
    def like_array(self) -> bool:
        """True if the region shows patterns with inverses, or two header pairs."""
        return self.rate is not None or (self.header is not None and self.has_header and self.header.pairs >= 2)

    @property
    def size_px(self) -> float:
        """Side in px of the region as an array."""
        return self.clear_header.size_px if self.clear_header else self.region.side


@dataclass(frozen=True)
class FilmMeasures:
    """Measured values of a film."""

    times: FrameTimes
    levels: Levels
    setup: Setup
    error: str
    rate: LightRate | None
    # True if no region blinks
    is_still: bool

    light_hz = property(lambda self: 1 / self.setup.signal.pattern_period_s)
    period_ms = property(lambda self: 1e3 * self.setup.signal.pattern_period_s)
    total = property(lambda self: max(self.times.count + self.times.lost, 1))
    packet = property(lambda self: self.setup.signal.packet_patterns * self.setup.frames_a_pattern)
    at_full_scale = property(lambda self: 100 * self.levels.at_full_scale)
    different = property(lambda self: self.times.count - self.times.repeated)
    gaps = property(lambda self: counted(self.times.gaps, "place"))
    count = property(lambda self: counted(self.times.count, "frame"))
    three_packets_s = property(lambda self: 3 * self.setup.signal.packet_s)

    @property
    def is_slow(self) -> bool:
        """True if the camera is slower than the light by its stamps; wrong if frames show each pattern."""
        is_stepped = self.rate is not None and self.rate.frames > 1 - STEP_TOLERANCE
        return self.times.rate_hz < self.light_hz * (1 - STEP_TOLERANCE) and not is_stepped

    @property
    def min_contrast(self) -> float:
        """Minimum contrast for the sensor's number of bits."""
        return float(self.setup.settings.detect.min_contrast * self.levels.ceiling / self.levels.full_scale)


FILM: tuple[Rule[FilmMeasures], ...] = (
    Rule("still", lambda m: m.is_still, "no region blinks: all changes are within the noise",
         "check that the array is switched on and in the image",
         "expose no longer than a pattern of {m.period_ms:.3g} ms: the sum of a pattern and the inverse is uniform"),
    Rule("slow camera", lambda m: m.is_slow,
         "{m.times.rate_hz:.4g} frames a second as stamped, but the light shows {m.light_hz:.4g} patterns; receivers "
         "need a frame per pattern at least",
         "film with {m.light_hz:.4g} frames a second or more",
         "or pass the camera's true rate with --fps {m.light_hz:g}",
         "or, if the light is slower, give the duration of a pattern: --set signal.pattern_period_s=..."),
    Rule("lost frames", lambda m: m.times.lost > 0.005 * m.total,
         "{m.times.lost} of {m.total} frames are missing at {m.gaps}",
         "check disk, cable and load of the computer for the cause; receivers continue, but decode less"),
    Rule("still", lambda m: m.times.repeated > 0.9 * m.times.count,
         "all {m.times.count} frames except {m.different} repeat the previous frame",
         "film the array while it blinks: a repeated image, as from a camera that stopped, holds no data"),
    Rule("repeated frames", lambda m: 0.9 * m.times.count >= m.times.repeated > 0.02 * m.times.count,
         "{m.times.repeated} of {m.times.count} frames repeat the previous frame exactly",
         "a file with another rate than the camera repeats frames: export it at the camera's rate, and give --fps"),
    Rule("other bits", lambda m: m.levels.ceiling < m.levels.full_scale,
         "levels end at {m.levels.ceiling} of {m.levels.full_scale}: the film has more bits than the camera",
         "save it with the camera's number of bits, or lower the minimum contrast: "
         "--set receive.detect.min_contrast={m.min_contrast:.1g}"),
    Rule("overexposed", lambda m: m.levels.at_full_scale > 0.15,
         "{m.at_full_scale:.0f} % of the pixels are at full scale",
         "expose shorter, lower the gain, or close the lens"),
    Rule("dark", lambda m: m.levels.brightest < 0.15 * m.levels.ceiling,
         "the brightest level is {m.levels.brightest} of {m.levels.full_scale}",
         "expose longer, open the lens, or raise the gain"),
    Rule("short", lambda m: m.times.count + m.times.lost < m.packet and not m.error,
         "{m.count}; a packet has {m.packet:.0f}",
         "record longer, {m.three_packets_s:.2g} s at least: a packet must be complete"),
)  # fmt: skip
"""Causes of a film."""


def other_settings(differing: Sequence[tuple[str, Any, Any]], causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Return the cause for settings other than in the film's note, and causes independent of the settings."""
    why = ", ".join(f"{key} is {ours}, and the film's note says {noted}" for key, ours, noted in differing)
    advice = tuple(f"leave {key} out, or write --set '{key}={json.dumps(noted)}'" for key, _, noted in differing)
    independent = ("lost frames", "repeated frames", "overexposed", "dark", "other bits")
    return (Cause("other settings", why, advice), *(cause for cause in causes if cause.kind in independent))


SATURATED = 0.3  # maximum overexposed part of a region's pixels; resolved LEDs cover a fifth


@dataclass(frozen=True, kw_only=True)
class RegionMeasures(RegionReport):
    """Measured values of a region, and the settings of the reception and of the remedy."""

    setup: Setup
    full_scale: int

    duration = property(lambda self: self.rate.frames if self.rate else None)
    pitch_px = property(lambda self: self.size_px / self.setup.signal.side)
    score = property(lambda self: self.header.score if self.header else 0.0)
    pose = property(lambda self: self.header.fit.pose)
    blur = property(lambda self: self.pose.blur / self.pose.pitch)
    percent = property(lambda self: 100 * self.gain)
    saturated = property(lambda self: 100 * self.region.saturated)
    # on-off light has half of the LEDs at the highest level
    max_saturated = property(lambda self: SATURATED * (1 if self.setup.signal.modulation == "haar" else 2))
    # motion blur of a header, which lasts four frames, makes detection unreliable
    is_fast = property(lambda self: self.region.speed_px > 0.5)
    has_other_rate = property(lambda self: self.duration and abs(self.duration / self.expected - 1) > STEP_TOLERANCE)
    window = property(lambda self: ",".join(map(str, self.region.window)))
    # settings and texts
    expected = property(lambda self: self.setup.frames_a_pattern)
    detect = property(lambda self: self.setup.settings.detect)
    smallest = property(lambda self: self.setup.settings.smallest_side_px)
    speed_up = property(lambda self: 1 / self.duration)
    enlarge = property(lambda self: self.smallest / self.size_px)
    min_percent = property(lambda self: 100 * self.detect.min_contrast)
    is_plain = property(lambda self: self.setup.settings.receiver == "plain")
    given_name = property(lambda self: "region" if self.detect.region else "corners")
    given = property(lambda self: ",".join(f"{n:g}" for n in self.detect.region or self.detect.corners))
    # remedy: changed settings, clock and detections
    signal = property(lambda self: self.remedy.changes.get("signal", {}))
    receive = property(lambda self: self.remedy.changes.get("receive", {}) if self.remedy else {})
    new = property(lambda self: self.receive.get("detect", {}))
    options = property(lambda self: " ".join(options(self.remedy.changes)))
    new_region = property(lambda self: ",".join(map(str, self.new["region"])))
    only_soft = property(lambda self: self.receive.get("receiver") == "soft")
    is_retimed = property(lambda self: self.remedy.retimed)
    clock = property(lambda self: self.remedy.clock)
    phase = property(lambda self: self.clock.phase_patterns)
    delay = property(lambda self: f"{abs(self.phase):.2f} of a pattern {'after' if self.phase > 0 else 'before'}")
    poses = property(lambda self: [found.fit.pose for found in self.remedy.trial.detections])
    is_tilted = property(lambda self: any(np.hypot(pose.stretch, pose.shear) > 0.05 for pose in self.poses))
    has_dark_leds = property(lambda self: any((found.led_gains == 0).any() for found in self.remedy.trial.detections))
    # settings for the size and light of the region
    max_side_px = property(lambda self: self.new.get("max_side_px", min(16 * np.ceil(self.size_px / SLACK / 16), 4096)))
    min_contrast = property(lambda self: self.new.get("min_contrast", float(f"{SLACK * self.gain:.1g}")))
    # frame rate for a pattern as long as in the settings, and duration of a pattern for the frame rate of the stamps
    camera_hz = property(lambda self: _rounded(self.duration / self.setup.signal.pattern_period_s))
    period_s = property(lambda self: _rounded(self.duration / self.setup.rate_hz))

    @property
    def gain(self) -> float:
        """Light over full scale."""
        return self.clear_header.fit.gain / self.full_scale if self.clear_header else self.region.contrast

    # neither cut nor fast
    is_oblong = property(lambda self: self.region.is_oblong and not self.region.at_border and not self.is_fast)
    # a part of an array of sufficient size
    is_part = property(lambda self: self.is_oblong and max(self.region.width, self.region.height) >= self.smallest)

    @property
    def view(self) -> str:
        """Turn of an array that needs corners."""
        turn = abs(np.degrees(np.mean([pose.roll for pose in self.poses] or [0.0])))
        return f"it is turned by {turn:.0f} degrees" if turn >= MIN_TURN_DEG else "the view is oblique"

    @property
    def new_corners(self) -> str:
        """Corners of the remedy."""
        return ",".join(f"{n:g}" for n in self.new["corners"]) + (", without --region" if self.detect.region else "")

    @property
    def flashes(self) -> str:
        """Period of a lamp."""
        if not self.lamp_frames:
            return ""
        rate_hz = self.setup.rate_hz / self.lamp_frames
        return f", every {self.lamp_frames:.1f} frames ({rate_hz:.4g} times a second as stamped)"


def _rounded(value: float) -> str:
    """Round to two digits if the error is below 0.4 %, or to three."""
    two, three = float(f"{value:.2g}"), float(f"{value:.3g}")
    return f"{two if abs(two / value - 1) < 0.004 else three:g}"


OTHER_RATE = (
    "a pattern lasts {m.duration:.2f} frames, but {m.expected:.2f} frames by stamps and settings",
    (lambda m: m.duration < 1 - STEP_TOLERANCE,
     "film {m.speed_up:.2g} times as fast at least: receivers need a frame per pattern at least"),
    "if the time stamps are wrong, give the frame rate of the camera: --fps {m.camera_hz}",
    "if they are right, give the duration of a pattern: --set signal.pattern_period_s={m.period_s}",
    (lambda m: m.is_plain and m.duration > 1 + STEP_TOLERANCE,
     "and read it by --receiver soft: plain needs one frame per pattern"),
)  # fmt: skip
TOO_SMALL = "{m.size_px:.1f} px a side, {m.pitch_px:.2g} px from LED to LED; the minimum is {m.smallest:g} px"
TOO_LARGE = (
    "{m.size_px:.0f} px a side; up to {m.detect.max_side_px:g} px are searched",
    "search for larger arrays, --set receive.detect.max_side_px={m.max_side_px:g}; or go farther, or use --bin 2",
)
TOO_DIM = (
    "its light is {m.percent:.2g} % of full scale; the minimum is {m.min_percent:.2g} %",
    "expose longer, open the lens, or raise the gain",
    "or lower the minimum: --set receive.detect.min_contrast={m.min_contrast:g}",
)
OUT_OF_FOCUS = (
    "an LED is blurred to {m.pose.blur:.1f} px, {m.blur:.1f} times the pitch of {m.pose.pitch:.2f} px",
    "focus the lens on the array; check windscreen and filters for blur",
)
BY_SOFT = "read it by --receiver soft"
OVEREXPOSED: Rule[RegionMeasures] = Rule(
    "saturated", lambda m: m.region.saturated > m.max_saturated,
    "it is overexposed: {m.saturated:.0f} % of the pixels are at full scale or at one highest level: levels are lost",
    "expose shorter, lower the gain, or close the lens, until LEDs stay below full scale",
)  # fmt: skip

NO_ARRAY: tuple[Rule[RegionMeasures], ...] = (
    # arrays have a pattern part of 0.06 and more
    Rule("lamp", lambda m: m.pattern_part < 0.05 and not (m.like_array and m.has_header),
         "all of it goes on and off together{m.flashes}: a header is missing",
         "no change is needed if it is a lamp; an array sends headers"),
    # a passing edge has about 0.2
    Rule("moves", lambda m: m.region.blinks < 0.45 and not m.like_array,
         "it moves or changes slowly, and does not blink", "no change is needed if it is no array"),
)  # fmt: skip
"""Regions that are no array; the first rule that applies counts."""

MEASURED: tuple[Rule[RegionMeasures], ...] = (
    OVEREXPOSED,
    Rule("other rate", lambda m: m.has_other_rate, *OTHER_RATE),
    Rule("slow camera", lambda m: not m.has_other_rate and m.expected < 1 - STEP_TOLERANCE,
         "a pattern lasts {m.expected:.2f} frames: a frame shows several, and pairs cancel"),
    Rule("hidden", lambda m: m.is_part,
         "it is {m.region.width:.0f} px wide and {m.region.height:.0f} px high, but arrays are square: something hides "
         "a part, or the view is oblique",
         "see that the complete array is in view; --receiver soft reads arrays hidden by a third at most"),
    Rule("too small", lambda m: not m.is_part and m.size_px < m.smallest, TOO_SMALL,
         "come nearer or use a longer lens: {m.enlarge:.1f} times as large at least",
         (lambda m: m.is_plain and m.size_px >= SMALLEST_SIDE_PX["soft"],
          "or read it by --receiver soft, which finds smaller arrays and reads farther")),
    Rule("too large", lambda m: not m.is_part and m.size_px > m.detect.max_side_px, *TOO_LARGE),
    Rule("too dim", lambda m: m.gain < m.detect.min_contrast, *TOO_DIM),
    Rule("cut", lambda m: m.region.at_border, "it reaches the frame's border, and a part of it is outside the image",
         "turn the camera so that the array and a margin around it are visible; check --crop"),
    Rule("moving", lambda m: m.is_fast, "it moves by {m.region.speed_px:.1f} px a frame, and is blurred by as much",
         "expose shorter, film faster, follow it with the camera, or use a wider lens"),
    Rule("out of focus", lambda m: m.clear_header and not m.is_oblong and is_blurred(m.pose),
         *OUT_OF_FOCUS),
)  # fmt: skip
"""Regions like an array, the most important cause first."""

UNCLEAR: tuple[Rule[RegionMeasures], ...] = (
    OVEREXPOSED,
    Rule("unread", lambda m: m.has_header and m.like_array,
         "a header is found (correlation {m.score:.2f}), but no codeword is decoded",
         "check that the settings of the signal match the transmitter: signal.rate, signal.code, signal.slot_order, "
         "signal.modulation", "come nearer or expose longer if the light is weak compared with the noise"),
    Rule("no header", lambda m: m.rate,
         "patterns and inverses are visible, but no header: the best correlation is {m.score:.2f}, the threshold "
         "{m.detect.score:g}",
         "check that the transmitter sends headers (signal.header), and film longer than a packet"),
    Rule("no header", lambda _: True,
         "it changes from frame to frame, but shows neither patterns with inverses nor two header pairs: "
         "the best correlation is {m.score:.2f}",
         "no change is needed if it is no array"),
)  # fmt: skip
"""Other regions; the first rule that applies counts."""

PROVEN: tuple[Rule[RegionMeasures], ...] = (
    Rule("other rate", lambda m: m.is_retimed and m.rate, *OTHER_RATE),
    Rule("other side", lambda m: "side" in m.signal,
         "a header is found, and codewords are decoded with {m.signal[side]} LEDs in a row, not with "
         "{m.setup.signal.side}",
         "change the setting: --set signal.side={m.signal[side]}"),
    Rule("other packets", lambda m: "data_pairs" in m.signal,
         "packets have {m.signal[header_pairs]} pairs of header and {m.signal[data_pairs]} of data, not "
         "{m.setup.signal.header_pairs} and {m.setup.signal.data_pairs}",
         "change the settings: --set signal.header_pairs={m.signal[header_pairs]} "
         "--set signal.data_pairs={m.signal[data_pairs]}"),
    Rule("turned", lambda m: m.new.get("corners"),
         "{m.view}, but arrays are found upright or in quarter turns unless corners are given",
         "give the corners: --corners {m.new_corners}", "or turn the camera, or the array, until it is upright"),
    Rule("elsewhere", lambda m: m.new.get("region"), "it is not at the given place, --{m.given_name} {m.given}",
         "leave out --{m.given_name}, or say where it is: --region {m.new_region}"),
    Rule("too small", lambda m: "min_side_px" in m.new, TOO_SMALL, "search for smaller arrays: {m.options}"),
    Rule("too large", lambda m: "max_side_px" in m.new, *TOO_LARGE),
    Rule("too dim", lambda m: "min_contrast" in m.new, *TOO_DIM),
    Rule("out of focus", lambda m: "calibration" in m.receive, *OUT_OF_FOCUS,
         "or start with this blur: --set receive.calibration.blur_px={m.receive[calibration][blur_px]:g}"),
)  # fmt: skip
"""Regions decoded with other settings."""

FOUND: tuple[Rule[RegionMeasures], ...] = (
    Rule("out of step", lambda m: m.only_soft and m.duration and abs(m.duration - 1) > STEP_TOLERANCE,
         "a pattern lasts {m.duration:.2f} frames, but the receiver plain needs a frame per pattern", BY_SOFT),
    Rule("out of step", lambda m: m.only_soft and not m.clock.in_step,
         "patterns begin {m.delay} the frames: each frame shows two", BY_SOFT),
    Rule("hidden", lambda m: m.only_soft and m.has_dark_leds,
         "a part of it is hidden, but the receiver plain needs complete arrays", BY_SOFT),
    Rule("too small", lambda m: m.only_soft and m.size_px < SMALLEST_SIDE_PX["plain"], TOO_SMALL,
         "search for smaller arrays: {m.options}"),
    Rule("hidden", lambda m: m.only_soft and m.is_tilted,
         "the view is oblique, but the receiver plain needs arrays that face the camera", BY_SOFT),
    Rule("search", lambda m: m.only_soft, "the receiver soft reads it, but plain does not find it", BY_SOFT),
    Rule("search", lambda _: True, "the array is decoded only by a search limited to this size",
         "crop the film around the array: --crop {m.window}"),
)  # fmt: skip
"""Regions decoded by another receiver, or by a limited search; the first rule that applies counts."""


def region_causes(report: RegionReport, setup: Setup, full_scale: int) -> tuple[Cause, ...]:
    """Return the causes of a region, the most important first."""
    if report.array is not None:
        packet = report.array.packet
        return (Cause("array", f"array {packet.identity}, {packet.orientation}", proven=True),)
    measured = RegionMeasures(setup=setup, full_scale=full_scale, **vars(report))
    if report.remedy is None:
        causes = diagnose(NO_ARRAY, measured)[:1]
        if not causes and report.like_array:
            causes = diagnose(MEASURED, measured)
        return causes or diagnose(UNCLEAR, measured)[:1]
    first, *rest = diagnose(PROVEN, measured, True) or diagnose(FOUND, measured, True)[:1]
    if measured.options and not any(measured.options in line for line in first.advice):
        together = f"all together: read once {measured.options} is given"
        first = replace(first, advice=(*first.advice, together))
    return (first, *rest)
