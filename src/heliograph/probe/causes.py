"""What may be the matter with a region or with a film, and what is told of the film as a whole."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from heliograph.base.words import counted
from heliograph.probe.arrays import ArraySeen
from heliograph.probe.clock import Clock
from heliograph.probe.frames import FrameTimes
from heliograph.probe.headers import HeaderSeen
from heliograph.probe.levels import Levels
from heliograph.probe.light import LightRate
from heliograph.probe.reach import Reach
from heliograph.probe.reading import Asked
from heliograph.probe.regions import Region
from heliograph.probe.trials import SURE_HEADER, Found
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE

Kind = Literal[
    "array", "other rate", "other side", "other packets", "too small", "too large", "too dim", "saturated",
    "out of focus", "moving", "cut", "hidden", "out of step", "search", "elsewhere",
    "turned", "lamp", "no header", "unread", "moves",
    "slow camera", "lost frames", "repeated frames", "overexposed", "dark", "other bits", "short", "still",
    "other settings", "screen", "sight", "angle", "motion", "exposure", "glare", "resolution", "focus", "cells", "rate",
]  # fmt: skip
"""What is the matter, in a word or two; "array" where nothing is. Those of the last line are told of screens."""

LIKE_HEADER = 0.75
"""Correlation from which on size, contrast and blur of the header's fit are told in place of the region's."""

LOST, REPEATED = 0.005, 0.02
"""Parts of the frames that are lost, or come twice, from which on it is told."""

STANDS_STILL = 0.9
"""Part of the frames that show what the one before did from which on nothing moves or blinks at all."""

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
        return self.header if self.header is not None and self.header.score >= LIKE_HEADER else None

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
    if times.repeated > STANDS_STILL * times.count:
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
