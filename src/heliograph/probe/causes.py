"""Causes of a failed reception, by film and by region, with remedies."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from heliograph.base.words import counted
from heliograph.probe.arrays import SLACK, ArraySeen, Asked, Clock
from heliograph.probe.frames import FrameTimes
from heliograph.probe.headers import HeaderSeen
from heliograph.probe.levels import Levels
from heliograph.probe.light import LightRate
from heliograph.probe.reach import Reach
from heliograph.probe.regions import Region
from heliograph.probe.trials import LEAST_TURN_DEG, SURE_HEADER, Found, is_blurred, options
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE

Kind = Literal[
    "array", "other rate", "other side", "other packets", "too small", "too large", "too dim", "saturated",
    "out of focus", "moving", "cut", "hidden", "out of step", "search", "elsewhere",
    "turned", "lamp", "no header", "unread", "moves",
    "slow camera", "lost frames", "repeated frames", "overexposed", "dark", "other bits", "short", "still",
    "other settings", "screen", "sight", "angle", "motion", "exposure", "glare", "resolution", "focus", "cells", "rate",
]  # fmt: skip
"""What is the matter, in a word or two; "array" where nothing is. Those of the last line are told of screens."""

LOST, REPEATED = 0.005, 0.02
"""Parts of the frames that are lost, or come twice, from which on it is told."""

OVEREXPOSED, DARK = 0.15, 0.15
"""Part of a film's pixels at full scale, and brightest level over full scale, that are told."""


WHATEVER_SENT = ("lost frames", "repeated frames", "overexposed", "dark", "other bits")
"""Kinds of causes that do not follow from the settings of the signal."""


@dataclass(frozen=True, slots=True)
class Cause:
    """What is the matter with a region or with a film.

    Attributes
    ----------
    kind
        The matter in a word or two.
    why
        A sentence with the figures that show it.
    advice
        What to change, each on a line; it names the option, or the thing on the camera.
    proven
        Whether codewords were read once that was changed.
    """

    kind: Kind
    why: str
    advice: tuple[str, ...] = ()
    proven: bool = False


@dataclass(frozen=True, slots=True)
class ArrayLike:
    """A region as the array that it would be."""

    # Pixels from LED to LED
    pitch_px: float
    # Blur of an LED, as a standard deviation in px
    blur_px: float
    # Light with all LEDs on, over full scale
    contrast: float
    # The light's clock in the camera's; None where no packet was read
    clock: Clock | None
    # How far layers are expected to be read, by receiver; none where levels are lost, or the model holds no more
    reach: tuple[Reach, ...]


@dataclass(frozen=True)
class RegionSeen:
    """A region, and all that is known of it.

    Attributes
    ----------
    region
        Place, size, speed and brightness.
    rate
        Frames that a pattern lasts as its light shows it; None where it does not.
    lamp_frames
        Frames from one flash to the next if all of it goes on and off as one; None if not, or not regularly.
    pattern_part
        How much of what its pixels do they do apart from each other, 0 to 1.
    header
        What of a header it shows; None for nothing.
    found
        Settings with which it is read, other than those asked for; None where there are none.
    array
        The array, where it is one that is read.
    causes
        What is the matter, the first of them first.
    would_be
        The array that it would be; None where it is read as one, or shows too little of a header.
    """

    region: Region
    rate: LightRate | None
    lamp_frames: float | None
    pattern_part: float
    header: HeaderSeen | None
    found: Found | None
    array: ArraySeen | None
    causes: tuple[Cause, ...] = ()
    would_be: ArrayLike | None = None

    @property
    def header_like(self) -> HeaderSeen | None:
        """Its header, where it shows enough of one that size and blur are those of an array."""
        # correlation from which on size, contrast and blur of the header's fit are told in place of the region's
        return self.header if self.header is not None and self.header.score >= 0.75 else None

    @property
    def like_array(self) -> bool:
        """Whether its light is that of an array: patterns with their inverses, or header and inverse twice in a row."""
        clear = self.header is not None and self.header.score >= SURE_HEADER and self.header.pairs >= 2
        return self.rate is not None or clear

    @property
    def size_px(self) -> float:
        """Side in px of the array it would be."""
        if self.array is not None and self.header is None:
            return self.region.side
        return self.header_like.size_px if self.header_like else self.region.side


def film_causes(
    times: FrameTimes, levels: Levels, asked: Asked, error: str, rate: LightRate | None
) -> tuple[Cause, ...]:
    """What is the matter with a film as a whole."""
    out = list[Cause]()
    light_hz, most = 1 / asked.signal.pattern_period_s, max(times.count + times.lost, 1)
    # stamps are wrong where frames show each pattern
    stepped = rate is not None and rate.frames > 1 - STEP_TOLERANCE
    if times.rate_hz < light_hz * (1 - STEP_TOLERANCE) and not stepped:
        out.append(Cause(
            "slow camera",
            f"{times.rate_hz:.4g} frames a second as stamped, and the light shows {light_hz:.4g} patterns: no receiver "
            "reads less than a frame a pattern",
            (f"film with {light_hz:.4g} frames a second or more",
             f"or, where the camera did and the file misstates it, say so: --fps {light_hz:g}",
             "or, where the light is slower, say how long a pattern lasts: --set signal.pattern_period_s=..."),
        ))  # fmt: skip
    if times.lost > LOST * most:
        out.append(Cause(
            "lost frames", f"{times.lost} of {most} frames are missing at {counted(times.gaps, 'place')}",
            ("look for what drops them: the disk, the cable, the computer's load; receivers read on, but less",),
        ))  # fmt: skip
    # part of the frames that show what the one before did from which on nothing moves or blinks at all
    if times.repeated > 0.9 * times.count:
        out.append(Cause(
            "still", f"all {times.count} frames but {times.count - times.repeated} show what the one before did",
            ("film the array while it blinks: one picture over and over, as of a camera that stopped, holds no data",),
        ))  # fmt: skip
    elif times.repeated > REPEATED * times.count:
        out.append(Cause(
            "repeated frames",
            f"{times.repeated} of {times.count} frames show what the one before did, to the last pixel",
            ("a file of another rate than the camera's repeats frames: export it again without, and say --fps",),
        ))  # fmt: skip
    if levels.ceiling < levels.full_scale:
        contrast = asked.settings.detect.min_contrast * levels.ceiling / levels.full_scale
        out.append(Cause(
            "other bits",
            f"levels end at {levels.ceiling} of {levels.full_scale}: the film has more bits than its camera",
            ("save it with the camera's own bits, or lower the least contrast: "
             f"--set receive.detect.min_contrast={contrast:.1g}",),
        ))  # fmt: skip
    if levels.at_full_scale > OVEREXPOSED:
        out.append(Cause(
            "overexposed", f"{100 * levels.at_full_scale:.0f} % of the pixels are at full scale",
            ("expose shorter, lower the gain, or close the lens",),
        ))  # fmt: skip
    if levels.brightest < DARK * levels.ceiling:
        out.append(Cause(
            "dark", f"nothing is brighter than {levels.brightest} of {levels.full_scale}",
            ("expose longer, open the lens, or raise the gain",),
        ))  # fmt: skip
    packet = asked.signal.packet_patterns * asked.frames_a_pattern
    if times.count + times.lost < packet and not error:
        out.append(Cause(
            "short", f"{counted(times.count, 'frame')}; a packet takes {packet:.0f}",
            (f"record longer, {3 * asked.signal.packet_s:.2g} s at least: a packet has to be whole",),
        ))  # fmt: skip
    return tuple(out)


def still(asked: Asked) -> Cause:
    """That nothing blinks in a film."""
    light_hz = 1 / asked.signal.pattern_period_s
    return Cause(
        "still", "nothing blinks: no part of the frames changes more than noise does",
        ("look whether the array is switched on and in the picture",
         f"expose no longer than a pattern of {1e3 / light_hz:.3g} ms: a pattern and its inverse are even light"),
    )  # fmt: skip


def other_settings(differing: Sequence[tuple[str, Any, Any]]) -> Cause:
    """Return the cause that a film notes another signal than the one it is read with."""
    why = ", ".join(f"{key} is {ours}, and the film's note says {noted}" for key, ours, noted in differing)
    advice = tuple(f"leave {key} out, or write --set '{key}={json.dumps(noted)}'" for key, _, noted in differing)
    return Cause("other settings", why, advice)


SATURATED = 0.3
"""Overexposed part of a region's pixels above which levels are lost. LEDs that are resolved take a fifth of it."""

FAST_PX = 0.5
"""Motion in px a frame from which on detection fails at times: headers of four frames are smeared by 0.7 px."""

NO_CHANGE = "nothing to change, if it is no array"
"""What is advised where a region need not be an array."""


def region_causes(seen: RegionSeen, asked: Asked, full_scale: int) -> tuple[Cause, ...]:
    """What is the matter with a region, the first of the causes first."""
    if seen.array is not None:
        return (Cause("array", f"array {seen.array.identity}, {seen.array.orientation}", proven=True),)
    if seen.found is not None:
        return tuple(_proven(seen, seen.found, asked, full_scale))
    header = seen.header.score if seen.header else 0.0
    # pattern part below which a region goes on and off as one, unless it shows a header: arrays have 0.06 and more
    if seen.pattern_part < 0.05 and not (seen.like_array and header >= SURE_HEADER):
        return (_lamp(seen, asked),)
    # least ratio of what alternates to what changes of a region that blinks; of an edge that passes it is about 0.2
    if seen.region.blinks < 0.45 and not seen.like_array:
        return (Cause("moves", "it moves or changes slowly, and does not blink", (NO_CHANGE,)),)
    # size and contrast are no fault of what does not look like an array
    causes = tuple(_measured(seen, asked, full_scale)) if seen.like_array else ()
    if not causes and _is_saturated(seen, asked):  # nor does it show a header then
        causes = (_saturated(seen),)
    return causes or (_header(seen, asked),)


def _proven(seen: RegionSeen, found: Found, asked: Asked, full_scale: int) -> Sequence[Cause]:
    """Causes by the settings with which it is read."""
    signal, receive = found.changes.get("signal", {}), found.changes.get("receive", {})
    detect, out = receive.get("detect", {}), list[Cause]()
    all_options = " ".join(options(found.changes))
    with_all = f"read once {all_options} is given" if all_options else "read then"
    if found.retimed and seen.rate is not None:
        out.append(_other_rate(seen.rate, asked, proven=True))
    if "side" in signal:
        side = signal["side"]
        why = f"a header is found, and codewords are right with {side} LEDs in a row, not with {asked.signal.side}"
        out.append(Cause("other side", why, (f"say so: --set signal.side={side}",), True))
    if "data_pairs" in signal:
        mine = f"{asked.signal.header_pairs} and {asked.signal.data_pairs}"
        pairs = f"{signal['header_pairs']} pairs of header and {signal['data_pairs']} of data"
        say = f"--set signal.header_pairs={signal['header_pairs']} --set signal.data_pairs={signal['data_pairs']}"
        out.append(Cause("other packets", f"packets have {pairs}, not {mine}", (f"say so: {say}",), True))
    if detect.get("corners"):
        out.append(_turned(detect["corners"], found, asked))
    elif "region" in detect:
        out.append(_elsewhere(detect["region"], asked))
    if "min_side_px" in detect:
        out.append(_too_small(seen, asked, found))
    if "max_side_px" in detect:
        out.append(_too_large(seen, asked, detect["max_side_px"]))
    if "min_contrast" in detect:
        out.append(_too_dim(seen, asked, full_scale, detect["min_contrast"]))
    if "calibration" in receive:
        out.append(_out_of_focus(seen, receive["calibration"]["blur_px"]))
    if not out and receive.get("receiver") == "soft":
        out.append(_soft_alone(seen, found, asked))
    if not out:
        out.append(Cause(
            "search", "the array is read where it is looked for about its size alone",
            ("cut the film to its surroundings: --crop " + ",".join(map(str, seen.region.window)),), True,
        ))  # fmt: skip
    first, *rest = out
    # what one cause takes does not read the region alone
    if all_options and not any(all_options in line for line in first.advice):
        first = Cause(first.kind, first.why, (*first.advice, f"all together: {with_all}"), True)
    return [first, *rest]


def _measured(seen: RegionSeen, asked: Asked, full_scale: int) -> Sequence[Cause]:
    """Causes by what a region shows, the gravest first."""
    region, header, detect = seen.region, seen.header_like, asked.settings.detect
    smallest, out = asked.settings.smallest_side_px, list[Cause]()
    if _is_saturated(seen, asked):
        out.append(_saturated(seen))
    if seen.rate is not None and abs(seen.rate.frames / asked.frames_a_pattern - 1) > STEP_TOLERANCE:
        out.append(_other_rate(seen.rate, asked))
    elif asked.frames_a_pattern < 1 - STEP_TOLERANCE:
        why = f"a pattern lasts {_frames(asked.frames_a_pattern)}: a frame shows more than one, in which pairs cancel"
        out.append(Cause("slow camera", why))
    if _hidden(seen) and max(region.width, region.height) >= smallest:
        # a part of it is too small for whole arrays
        out.append(_partly_hidden(seen))
    elif seen.size_px < smallest:
        out.append(_too_small(seen, asked, None))
    elif seen.size_px > detect.max_side_px:
        out.append(_too_large(seen, asked, None))
    gain = header.fit.gain / full_scale if header else region.contrast
    if gain < detect.min_contrast:
        out.append(_too_dim(seen, asked, full_scale, None))
    if region.at_border:
        out.append(Cause(
            "cut", "it reaches the frame's border, and a part of it is not in the picture",
            ("turn the camera so that all of the array and a rim about it are seen; mind --crop",),
        ))  # fmt: skip
    if region.speed_px > FAST_PX:
        out.append(Cause(
            "moving", f"it moves by {region.speed_px:.1f} px a frame, and is smeared by as much",
            ("expose shorter, film faster, follow it with the camera, or take a wider lens",),
        ))  # fmt: skip
    if header and not _hidden(seen) and is_blurred(header.fit.pose):
        out.append(_out_of_focus(seen, None))
    return out


def _is_saturated(seen: RegionSeen, asked: Asked) -> bool:
    # on-off light has half of its LEDs at the highest level
    return seen.region.saturated > (SATURATED if asked.signal.modulation == "haar" else 2 * SATURATED)


def _saturated(seen: RegionSeen) -> Cause:
    part = f"{100 * seen.region.saturated:.0f} % of its pixels are at full scale or at one highest level"
    return Cause(
        "saturated", f"it is overexposed: {part}, so that its levels are lost",
        ("expose shorter, lower the gain, or close the lens, until LEDs stay below full scale",),
    )  # fmt: skip


def _hidden(seen: RegionSeen) -> bool:
    """Whether a region is no square, though nothing else explains it."""
    region = seen.region
    oblong = max(region.width, region.height) / max(min(region.width, region.height), 1.0)
    # ratio of width and height from which on something hides a part: that of an array turned by 42 degrees
    return oblong > 1.35 and not region.at_border and region.speed_px <= FAST_PX


def _partly_hidden(seen: RegionSeen) -> Cause:
    size = f"{seen.region.width:.0f} px wide and {seen.region.height:.0f} px high"
    return Cause(
        "hidden", f"it is {size}, and arrays are square: something hides a part, or it is seen from a side",
        ("see that the whole array is in view; --receiver soft reads arrays of which up to a third is hidden",),
    )  # fmt: skip


def _header(seen: RegionSeen, asked: Asked) -> Cause:
    """What is told where nothing else is wrong, or no header was found."""
    score = seen.header.score if seen.header else 0.0
    if score >= SURE_HEADER and seen.like_array:
        noted = f"a header is found (correlation {score:.2f}), but no codeword is right"
        return Cause(
            "unread", noted,
            ("see that the settings of the signal are the transmitter's: signal.rate, signal.code, signal.slot_order, "
             "signal.modulation",
             "come nearer, or expose longer, where the light is weak beside the noise"),
        )  # fmt: skip
    if seen.rate is not None:
        return Cause(
            "no header",
            f"patterns and their inverses are seen, but no header: correlation {score:.2f} at best, "
            f"{asked.settings.detect.score:g} is asked for",
            ("see that the transmitter sends headers (signal.header), and film longer than a packet",),
        )  # fmt: skip
    return Cause(
        "no header",
        "it changes from frame to frame, but shows neither patterns with their inverses, nor two pairs of a header in "
        f"a row: correlation {score:.2f} at best",
        (NO_CHANGE,),
    )  # fmt: skip


def _lamp(seen: RegionSeen, asked: Asked) -> Cause:
    how = "all of it goes on and off as one"
    if seen.lamp_frames is not None:
        how += (
            f", every {seen.lamp_frames:.1f} frames ({asked.rate_hz / seen.lamp_frames:.4g} times a second as stamped)"
        )
    return Cause("lamp", f"{how}: it has no header", ("nothing to change, if it is a lamp; an array sends headers",))


def _other_rate(rate: LightRate, asked: Asked, proven: bool = False) -> Cause:
    said = asked.frames_a_pattern
    period_s, rate_hz = rate.frames / asked.rate_hz, rate.frames / asked.signal.pattern_period_s
    why = f"a pattern lasts {_frames(rate.frames)}; by stamps and settings it would be {_frames(said)}"
    advice = [
        f"where the stamps are wrong, say how many frames a second the camera took: --fps {_nice(rate_hz)}",
        f"where they are right, say how long a pattern lasts: --set signal.pattern_period_s={_nice(period_s)}",
    ]
    if rate.frames < 1 - STEP_TOLERANCE:
        faster = f"film {1 / rate.frames:.2g} times as fast at least: no receiver reads less than a frame a pattern"
        advice = [faster, *advice]
    elif abs(rate.frames - 1) > STEP_TOLERANCE and asked.settings.receiver == "plain":
        advice.append("and read it by --receiver soft: plain takes one frame a pattern")
    return Cause("other rate", why, tuple(advice), proven)


def _frames(count: float) -> str:
    return f"{count:.2f} frames"


def _nice(value: float) -> str:
    """A number as a user would write it: the nearest of three digits where the light's rate is as near to it."""
    three = float(f"{value:.3g}")
    rough = float(f"{value:.2g}")
    return f"{rough if abs(rough / value - 1) < 0.004 else three:g}"


def _too_small(seen: RegionSeen, asked: Asked, found: Found | None) -> Cause:
    smallest = asked.settings.smallest_side_px
    pitch = seen.size_px / asked.signal.side
    why = f"{seen.size_px:.1f} px a side, {pitch:.2g} px from LED to LED; {smallest:g} px are looked for"
    if found is not None:
        return Cause("too small", why, (f"look for smaller ones: {' '.join(options(found.changes))}",), True)
    advice = [f"come nearer or take a longer lens: {smallest / seen.size_px:.1f} times as large at least"]
    soft = SMALLEST_SIDE_PX["soft"]
    if asked.settings.receiver == "plain" and seen.size_px >= soft:
        advice.append("or read it by --receiver soft, which looks for smaller ones and reads farther")
    return Cause("too small", why, tuple(advice))


def _too_large(seen: RegionSeen, asked: Asked, most_px: float | None) -> Cause:
    largest = asked.settings.detect.max_side_px
    wanted = most_px or min(16 * np.ceil(seen.size_px / SLACK / 16), 4096)
    why = f"{seen.size_px:.0f} px a side; up to {largest:g} px are looked for"
    advice = f"look for larger ones, --set receive.detect.max_side_px={wanted:g}; or go farther, or take --bin 2"
    return Cause("too large", why, (advice,), most_px is not None)


def _too_dim(seen: RegionSeen, asked: Asked, full_scale: int, least: float | None) -> Cause:
    header = seen.header_like
    gain = header.fit.gain / full_scale if header else seen.region.contrast
    asked_for = asked.settings.detect.min_contrast
    why = f"its light is {100 * gain:.2g} % of full scale, {100 * asked_for:.2g} % are asked for"
    wanted = least or float(f"{SLACK * gain:.1g}")
    advice = ("expose longer, open the lens, or raise the gain",
              f"or ask for less: --set receive.detect.min_contrast={wanted:g}")  # fmt: skip
    return Cause("too dim", why, advice, least is not None)


def _out_of_focus(seen: RegionSeen, blur_px: float | None) -> Cause:
    header = seen.header
    assert header is not None
    pose = header.fit.pose
    why = (
        f"an LED is blurred to {pose.blur:.1f} px, {pose.blur / pose.pitch:.1f} times the pitch of {pose.pitch:.2f} px"
    )
    advice = ["focus the lens on the array; see that the windscreen or a filter does not blur"]
    if blur_px is not None:
        advice.append(f"or begin with that blur: --set receive.calibration.blur_px={blur_px:g}")
    return Cause("out of focus", why, tuple(advice), blur_px is not None)


def _turned(corners: Sequence[float], found: Found, asked: Asked) -> Cause:
    """That an array is turned or seen from a side, beyond what is looked for without its corners."""
    turn = np.degrees(np.mean([one.fit.pose.roll for one in found.reading.detections] or [0.0]))
    how = f"it is turned by {abs(turn):.0f} degrees" if abs(turn) >= LEAST_TURN_DEG else "it is seen from a side"
    say = ",".join(f"{n:g}" for n in corners) + (", without --region" if asked.settings.detect.region else "")
    return Cause(
        "turned", f"{how}, and arrays are looked for upright or in quarter turns unless their corners are given",
        (f"say where its corners are: --corners {say}", "or turn the camera, or the array, until it is upright"), True,
    )  # fmt: skip


def _elsewhere(region: Sequence[int], asked: Asked) -> Cause:
    """That an array lies beside the place that was given."""
    detect = asked.settings.detect
    given, name = (detect.region, "region") if detect.region else (detect.corners, "corners")
    return Cause(
        "elsewhere", f"it is not where it was to be looked for, --{name} {','.join(f'{n:g}' for n in given)}",
        (f"leave out --{name}, or say where it is: --region {','.join(map(str, region))}",), True,
    )  # fmt: skip


def _soft_alone(seen: RegionSeen, found: Found, asked: Asked) -> Cause:
    """Why the soft receiver alone reads a region."""
    advice = ("read it by --receiver soft",)
    detections, phase = found.reading.detections, found.clock.phase
    hidden = any(bool((one.led_gains == 0).any()) for one in detections)
    if abs(seen.rate.frames - 1 if seen.rate else 0.0) > STEP_TOLERANCE and seen.rate is not None:
        why = f"a pattern lasts {_frames(seen.rate.frames)}; the receiver plain takes one frame a pattern"
        return Cause("out of step", why, advice, True)
    if not found.clock.in_step:
        when = "after" if phase > 0 else "before"
        why = f"patterns begin {abs(phase):.2f} of a pattern {when} the frames: each shows two"
        return Cause("out of step", why, advice, True)
    if hidden:
        return Cause("hidden", "a part of it is hidden, and the receiver plain looks for whole arrays", advice, True)
    if seen.size_px < SMALLEST_SIDE_PX["plain"]:
        return _too_small(seen, asked, found)
    tilt = max((float(np.hypot(one.fit.pose.stretch, one.fit.pose.shear)) for one in detections), default=0.0)
    if tilt > 0.05:
        return Cause(
            "hidden", "it is seen from a side, and the receiver plain looks for arrays that face it", advice, True
        )
    return Cause("search", "the receiver soft reads it, plain does not find it", advice, True)
