"""Headers of all identities and orientations, and an array detected by the header.

A turned or mirrored header may equal the header of another identity. The blocks of a packet name the identity and have
a CRC, so the data resolve the ambiguity.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import DETECT
from heliograph.receive.detect.candidate import are_disjoint
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import UPRIGHT, Orientation
from heliograph.receive.geometry.view import View
from heliograph.receive.geometry.window import cut_out, window_around
from heliograph.signal.header import IDENTITIES, header_cells
from heliograph.signal.settings import SignalSettings

Hypothesis = tuple[int, Orientation]  # identity of an array, and the orientation in the camera's image


@dataclass(frozen=True, slots=True)
class Headers:
    """Set of different headers."""

    # (headers, 16) of +-1, as the camera sees them
    cells: Floats
    # Identities and orientations of each header, the most plausible first
    hypotheses: tuple[tuple[Hypothesis, ...], ...]
    # Least distance of two candidates as a fraction of the side
    min_distance: float = DETECT.min_distance


ALL_ON = Headers(np.ones((1, 16)), (((0, UPRIGHT),),))  # blinking square with no identity


@lru_cache
def headers(orientations: Sequence[Orientation], other: Sequence[Orientation] = ()) -> Headers:
    """Return the headers of all identities in some orientations; `other` orientations add hypotheses alone."""
    hypotheses: dict[bytes, list[Hypothesis]] = defaultdict(list)
    for orientation in (*orientations, *other):
        for number in range(IDENTITIES):
            hypotheses[orientation.turned(header_cells(number)).tobytes()].append((number, orientation))
    kept = {cells: meanings for cells, meanings in hypotheses.items() if meanings[0][1] in orientations}
    cells = np.array([np.frombuffer(header, np.int8) for header in kept], np.float64)
    min_distance = DETECT.min_distance if len(orientations) == 1 else DETECT.min_distance_turned
    return Headers(cells, tuple(map(tuple, kept.values())), min_distance)


@dataclass(frozen=True, slots=True)
class Detection:
    """An array detected by the header."""

    # Number of the array, 0 to 29
    identity: int
    # Start of the header's first pattern in seconds
    start_time_s: float
    # Pose and gain at `time_s`
    fit: Fit
    # Middle of the fitted frames, in seconds
    time_s: float
    # Correlation with the header's image, 0 to 1
    score: float
    # Weakest over mean alternation of the header's frames, at most 1
    regularity: float
    # (n, n), 1, or 0 in hidden cells of the header
    led_gains: Floats
    # Orientation of the array in the camera's image
    orientation: Orientation = UPRIGHT
    # Other identities and orientations with the same header, the most plausible first
    alternatives: tuple[Hypothesis, ...] = ()
    # Motion of the image along x and y, in px per second
    drift: tuple[float, float] = (0.0, 0.0)
    # True if the array was sending before the header, in the first two packets of the film
    misses_start: bool = False

    @property
    def hypotheses(self) -> "list[Detection]":
        """Copies for each identity and orientation of the header, the most plausible first."""
        best = self.identity, self.orientation
        return [self, *(replace(self, identity=i, orientation=o, alternatives=(best,)) for i, o in self.alternatives)]

    @property
    def is_clear(self) -> bool:
        """True if the header is beyond doubt."""
        return self.score >= DETECT.clear_score and self.regularity >= DETECT.min_hidden_regularity

    @property
    def is_certain(self) -> bool:
        """True if the header is clear, no cell is hidden or dark, and one upright array has this header."""
        # a hidden cell leaves at most 0.968, and turned arrays are rare
        return self.is_clear and self.score >= 0.985 and not self.alternatives and self.orientation == UPRIGHT

    def in_view(self, view: View) -> "Detection":
        """Return the detection in the coordinates of a view."""
        gains, drift = view.orientation.upright(self.led_gains), view.map_motion(self.drift)
        return replace(self, fit=view.map_fit(self.fit), led_gains=gains, drift=drift)


def distinct(detections: list[Detection], side: int) -> list[Detection]:
    """Keep the best of overlapping detections."""
    kept: list[Detection] = []
    for detection in sorted(detections, key=lambda d: -d.score):
        if all(are_disjoint(detection.fit.pose, other.fit.pose, side) for other in kept):
            kept.append(detection)
    return kept


def is_sending_before(detection: Detection, frames: Sequence[Frame], signal: SignalSettings) -> bool:
    """Return True if the last frame before a header shows the array with a pattern as well."""
    start_s, period_s = detection.start_time_s, signal.pattern_period_s
    end_s = start_s + 2 * signal.header_pairs * period_s
    before = [frame for frame in frames if frame.time_s < start_s - period_s / 2]
    header = [frame for frame in frames if start_s - period_s / 4 <= frame.time_s < end_s - period_s]
    if not before or not header:
        return False
    window = window_around(detection.fit.pose, signal.side, 0.0)
    contrasts = [float(cut_out(frame, window).std()) for frame in header]
    # data have 0.4 to 0.6 of the header's contrast, a dark array at most 0.15
    return float(cut_out(before[-1], window).std()) > 0.25 * float(np.median(contrasts))
