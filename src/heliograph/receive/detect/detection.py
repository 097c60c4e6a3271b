"""An array found by its header, and what looks for one.

Light of an array before its header was found: a packet began earlier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.candidate import CLEAR, apart
from heliograph.receive.detect.header_bank import Hypothesis
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.view import View
from heliograph.receive.geometry.window import cut_out, window_around
from heliograph.signal.settings import SignalSettings

HIDDEN_REGULARITY = 0.85
"""Least regularity of an array of which a part may be hidden: it correlates less, but alternates evenly.

A format may dim half of the cells to a half in the second pair of a header. The four frames then have the amplitudes
1, -1, 0.75 and -0.75; the weakest change over the mean one is 1.5 / 1.75 = 0.86. Its cost was not measured.
"""

WHOLE = 0.985
"""Least score of a header none of whose cells is hidden or dark.

Of a header that lacks one of its 16 cells it is the root of 15 / 16, 0.968; this is the middle between that and 1.
Whole arrays have 0.9998 and more at 40 m to 150 m, with a cell hidden 0.970. With half and twice of its distance from 1
none of 155 codewords is lost.
"""


@dataclass(frozen=True, slots=True)
class Detection:
    """An array found by its header."""

    # Its number, 0 to 29
    identity: int
    # Start of the header's first pattern in seconds
    start_time_s: float
    # Pose and gain at `time_s`
    fit: Fit
    # Middle of the frames fitted, in seconds
    time_s: float
    # Correlation with the header's image, 0 to 1
    score: float
    # Weakest over mean alternation of the header's frames, at most 1
    regularity: float
    # (n, n), 1, or 0 in cells of the header that are hidden
    led_gains: NDArray[np.float64]
    # How the camera sees the array, as far as its header tells
    orientation: Orientation = UPRIGHT
    # Other identities and orientations that have the same header, the most plausible first
    others: tuple[Hypothesis, ...] = ()
    # Motion of its image along x and y, in px per second
    drift: tuple[float, float] = (0.0, 0.0)

    @property
    def hypotheses(self) -> "list[Detection]":
        """The same for all that its header may mean, the most plausible first."""
        own = self.identity, self.orientation
        others = [replace(self, identity=i, orientation=o, others=(own,)) for i, o in self.others]
        return [self, *others]

    @property
    def clear(self) -> bool:
        """Whether its header leaves no doubt that it is an array."""
        return self.score >= CLEAR and self.regularity >= HIDDEN_REGULARITY

    @property
    def whole(self) -> bool:
        """Whether its header leaves no doubt, and no cell of it is hidden or dark."""
        return self.clear and self.score >= WHOLE

    @property
    def ambiguous(self) -> bool:
        """Whether its header leaves open which array it is, or how the camera sees it: turned ones are rare."""
        return bool(self.others) or self.orientation != UPRIGHT

    def seen_in(self, view: View) -> "Detection":
        """The same in a view."""
        gains, drift = view.orientation.upright(self.led_gains), view.motion_in(self.drift)
        return replace(self, fit=view.fit_in(self.fit), led_gains=gains, drift=drift)


class HeaderSearch(Protocol):
    """Looks for headers in a stream of frames."""

    def start(self, period_s: float) -> None:
        """Begin to search frames; it comes before the first of them."""

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""

    def settle(self, orientation: Orientation) -> None:
        """Look for arrays of one orientation alone from now on: a camera sees all of them alike."""

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame."""


def distinct(detections: list[Detection], side: int) -> list[Detection]:
    """One detection a place, the best."""
    kept: list[Detection] = []
    for one in sorted(detections, key=lambda d: -d.score):
        if all(apart(one.fit.pose, other.fit.pose, side) for other in kept):
            kept.append(one)
    return kept


SHINES = 0.25
"""Least contrast of an array that sends data, as a fraction of the contrast of its header.

Chosen: data have 0.4 to 0.6 of it, a dark array 0.02 at 50 m and 0.15 at 100 m.
"""


def shone_before(detection: Detection, frames: Sequence[Frame], signal: SignalSettings) -> bool:
    """Return True if the last frame before a header shows the array with a pattern as well."""
    start_s, period_s = detection.start_time_s, signal.pattern_period_s
    end_s = start_s + 2 * signal.header_pairs * period_s
    before = [frame for frame in frames if frame.time_s < start_s - period_s / 2]
    header = [frame for frame in frames if start_s - period_s / 4 <= frame.time_s < end_s - period_s]
    if not before or not header:
        return False
    window = window_around(detection.fit.pose, signal.side, 0.0)
    contrasts = [float(cut_out(frame, window).std()) for frame in header]
    return float(cut_out(before[-1], window).std()) > SHINES * float(np.median(contrasts))
