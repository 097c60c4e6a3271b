"""Fit of a header's frames to a fraction of a pixel: of a whole array, or of one that something hides in part."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.acquire.candidate import (
    HIDDEN_CELL,
    HIDING_BLUR,
    LEVEL_SPREAD,
    PARTLY_LIT_CELL,
    UPRIGHT_SPREAD,
    cell_weights,
    fit_near,
    lit_cells,
)
from heliograph.receive.acquire.coarse import ALTERNATION, DIFFERENCE, alternation_of
from heliograph.receive.image.fit import Fit
from heliograph.receive.image.pose import Pose
from heliograph.signal.header import CELLS

CLEAR = 0.95
"""Score from which on a candidate is not tried as a tilted one too: it then explains 90 % of the pixels' power."""

HIDDEN = 0.32
"""Largest hidden fraction of an array that is found all the same: 5 of 16 cells."""

HIDDEN_TRIED = 0.7
"""Least score of a candidate that is fitted again without its hidden cells.

With the fraction `HIDDEN` missing the whole header still correlates by sqrt(1 - 0.32) = 0.82; the rest is for noise.
"""

FIRST_AMPLITUDE, FIRST_SCORE = 0.7, 0.9
"""Least gain and score of a header's first pair, as fractions of the whole header's, for the pose to be its.

Out of step a header may begin amid a frame. Where the first frame shows the fraction f of it and the others all, the
gains have the ratio (1 + f) / (1.75 + 0.25 f): 0.7 for f = 0.27. Two frames have more noise than four: 2 to 1.25 in
power, for the same amplitude. Noise alone then brings the score below 0.9 of the whole's only where that is below 0.78.
With 0.85 and 0.95, and with 0.4 and 0.8, none of 192 codewords is lost.
"""


SMEARED_PX = 0.1
"""Motion in px per pattern from which on a header is fitted as moving: it then smears four frames by 0.09 px.

A blur of 0.5 px grows by 0.008 px from that, less than the error of a fit.
"""


def fit_header(
    header: Sequence[Frame], pose: Pose, weights: NDArray[np.float64], tilt: float, score: float, even: bool
) -> tuple[Fit | None, NDArray[np.float64], bool]:
    """Fit a header's frames."""
    change, origin, side = alternation_of(header), header[0].origin, len(weights)
    fit, sound = fit_near(change, origin, pose, weights, tilt), np.ones(weights.shape)
    if fit is None or not HIDDEN_TRIED <= fit.score < CLEAR or not even or tilt > UPRIGHT_SPREAD:
        return fit, sound, False
    best, lit, led_gains = fit, np.ones(CELLS * CELLS), sound
    for least in (HIDDEN_CELL, PARTLY_LIT_CELL):
        # a hidden side looks like a tilt
        pose = replace(best.pose, stretch=0.0, shear=0.0)
        lit = lit * lit_cells(change, origin, pose, led_gains * weights, least).ravel()
        led_gains = cell_weights(lit, side)
        rest = fit_near(change, origin, pose, led_gains * weights, LEVEL_SPREAD)
        if rest is None or lit.mean() < 1 - HIDDEN:
            break
        best = rest
    else:
        if best.score > max(fit.score, score):
            return best, led_gains, True
    if fit.score >= score:
        return fit, sound, False
    # a thin post hides parts of cells
    pose = replace(fit.pose, stretch=0.0, shear=0.0)
    return fit_near(change, origin, pose, weights, LEVEL_SPREAD), sound, True


def fit_moving(
    header: list[Frame], fit: Fit, weights: NDArray[np.float64], tilt: float, moved: tuple[float, float]
) -> Fit:
    """Fit a header that moves."""
    if max(np.abs(moved)) < SMEARED_PX:
        return fit
    weight = np.abs(ALTERNATION if len(header) == 4 else DIFFERENCE[:2])
    # the variance of the frames' times, each counted as its weight, and of an exposure
    late = np.arange(len(header)) - 0.5 * (len(header) - 1)
    patterns = float(np.sqrt(weight @ late**2 / weight.sum() + 1 / 12))
    smear = patterns * abs(moved[0]), patterns * abs(moved[1])
    change, origin = alternation_of(header), header[0].origin
    # the smear was taken for a stretch, by which single LEDs were taken for their neighbours
    rough = fit_near(change, origin, fit.pose, weights, tilt, HIDING_BLUR, smear)
    if rough is None:
        return fit
    start = replace(rough.pose, blur=fit.pose.blur)
    again = fit_near(change, origin, start, weights, tilt, smear=smear)
    return fit if again is None or again.score < fit.score else again


def fit_first_pair(header: list[Frame], fit: Fit, weights: NDArray[np.float64], tilt: float) -> tuple[Fit, list[Frame]]:
    """Fit a header's first pair, as the later pairs may be dimmed unevenly by a format."""
    first = fit_near(alternation_of(header[:2]), header[0].origin, fit.pose, weights, tilt)
    if first is None or first.score <= FIRST_SCORE * fit.score or first.gain <= FIRST_AMPLITUDE * fit.gain:
        return fit, header
    return replace(first, score=fit.score), header[:2]
