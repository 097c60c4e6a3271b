"""Why a screen is not read, in words for who holds the phone: sight, size, focus, glare, exposure, rate."""

from collections.abc import Iterator

from heliograph.probe import Findings
from heliograph.probe.causes import RegionSeen
from heliograph.probe.words import in_short

FEWEST_PX = 3.0
"""Pixels of a cell below which more would help. Chosen: at 2.9 px the receiver has read 16 x 16 cells in good light."""

BLURRED = 0.6
"""Blur in cells from which on focus would help: of sharp square cells it is 0.4, and reading ends about 1."""

WEAK = 0.2
"""Contrast over full scale below which it is glare, or a dim screen. Chosen: a screen in a lit room has 0.5."""

BURNT = 0.2
"""Part of the array's pixels at full scale from which on it is too bright. Chosen: whole cells are white then."""

FEWEST_FRAMES = 1.7
"""Frames to a pattern below which the rate is too high for the camera: rows see two patterns in nearly all frames."""

BRIGHT = 0.8
"""Median gray level over full scale of a picture that is nearly white. Chosen."""


def why_unread(found: Findings) -> list[str]:
    """Why a screen is not read, the most likely reason first; what the probe says where none of them is it.

    Parameters
    ----------
    found
        What its frames tell.
    """
    if not found.regions:
        return list(_nothing_seen(found))
    return list(_array_words(found.regions[0], found)) or list(in_short(found))


def _nothing_seen(found: Findings) -> Iterator[str]:
    yield "No patterns are seen: see that the screen is in the picture, not paused, and fills a third of it."
    if found.levels.percentiles.get(50, 0) > BRIGHT * found.levels.full_scale:
        yield "Exposure: the picture is nearly white. Touch the patterns on the phone, or take off glare."


def _array_words(seen: RegionSeen, found: Findings) -> Iterator[str]:
    header, side = seen.header_like, found.asked.signal.side
    cell_px = (seen.region.side if header is None else header.size_px) / side
    if seen.region.at_border:
        yield "Sight: the patterns reach the picture's border. Show all of them, with the dark margin."
    if seen.region.saturated > BURNT:
        yield "Exposure: cells are white blots. Lower the brightness on page Transmit, or touch them on the phone."
    elif header is not None and header.fit.gain < WEAK * found.levels.full_scale:
        yield "Glare: the patterns hardly stand out. Turn off lamps, turn the screen from windows, make it brighter."
    if cell_px < FEWEST_PX:
        yield f"Resolution: a cell has {cell_px:.1f} px. Come nearer, take fewer cells, or film in 1080p."
    elif header is not None and header.fit.pose.blur > BLURRED * header.fit.pose.pitch:
        yield "Focus: the cells are blurred. Touch the patterns in the camera's picture, and hold the phone still."
    if seen.rate is not None and seen.rate.frames < FEWEST_FRAMES:
        yield (
            f"Rate: a pattern lasts {seen.rate.frames:.1f} frames of the film. Choose fewer patterns a second, or film "
            "at more frames a second."
        )
