"""Frames of successive patterns as a search holds them: a frame that is missing leaves its slot empty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from heliograph.base.frames import Frame
from heliograph.receive.image.window import common

Slots = Sequence[Frame | None]
"""Frames of successive patterns, None for those that are missing."""

FAR_PAST_S = 1e9
"""Seconds by which each frame that fills up the slots before the film lies before the next one.

It is 30 years, so that no clock takes these for frames of the film.
"""

MISSING_FRAMES = 0.25
"""Largest fraction of a header's frames that may be missing: one of four.

Were two missing, frames of data before or after might pass for a header.
"""

Shown = TypeVar("Shown")


@dataclass(frozen=True, slots=True)
class Due:
    """Frames that are to be searched now.

    Attributes
    ----------
    slots
        Frames of successive patterns, of one size and place; None stands for those that are missing.
    turned
        Whether turned headers are due too, in every other search: a header that one search alone sees is found by the
        other ones a packet later.
    """

    slots: Slots
    turned: bool


def filled(header: Sequence[Shown | None]) -> list[Shown] | None:
    """What a header's frames show, a missing one as the nearest before or after that shows the same.

    Parameters
    ----------
    header
        What each frame shows, header and inverse in turn; None for those that are missing.

    Returns
    -------
    As many; None where more than `MISSING_FRAMES` are missing, or all of a kind.
    """
    missing = [k for k, one in enumerate(header) if one is None]
    if len(missing) > MISSING_FRAMES * len(header):
        return None
    out = [*header]
    for k in missing:
        alike = [header[j] for j in sorted(range(k % 2, len(header), 2), key=lambda j: abs(j - k))]
        out[k] = next((one for one in alike if one is not None), None)
    return None if None in out else [one for one in out if one is not None]


def in_common(slots: Slots) -> list[Frame | None]:
    """Cut the frames that are there to the part of the sensor that all of them show.

    Parameters
    ----------
    slots
        Frames of one sensor; one at least is there.
    """
    shown = iter(common([frame for frame in slots if frame is not None]))
    return [None if frame is None else next(shown) for frame in slots]


def before(frame: Frame, count: int) -> list[Frame]:
    """Copies of a frame with earlier, negative times and numbers.

    Parameters
    ----------
    frame
        First frame of a film.
    count
        How many copies, at least 0.
    """
    return [replace(frame, index=frame.index - k, time_s=frame.time_s - FAR_PAST_S * k) for k in range(count, 0, -1)]


def alike(last: Frame, frame: Frame) -> bool:
    """Whether two frames have the same kind of pixels.

    Parameters
    ----------
    last, frame
        Two frames of a film, in the order of time.
    """
    return last.pixels.dtype == frame.pixels.dtype and last.bits == frame.bits
