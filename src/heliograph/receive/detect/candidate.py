"""Fit of a header's frames to a fraction of a pixel: of a whole array, or of one that something hides in part.

A candidate of the coarse search fitted: its pose, and cells of its header that are hidden.

How fast a header moves in the image: a camera that passes an array sideways sees it move by pixels a frame.

Frame k of a header shows a_k A (2 Y - 1) + a'_k A 1 and an even background, whatever the camera's phase: Y is the
header, A the blur matrix. About an even motion the image is linear in small errors of place and motion; all frames
together give both (Gauss-Newton, a_k and a'_k eliminated).
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import RCOND, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    ALTERNATION,
    APART_SIDES,
    DIFFERENCE,
    RING,
    SearchParameters,
    alternation_of,
    size_limits,
)
from heliograph.receive.geometry.fit import Fit, Prior, fit_array
from heliograph.receive.geometry.kernels import LEAST_VARIANCE
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import cut_out, window_around
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


FIT_STEPS = 6
"""Most Gauss-Newton steps of a candidate, which starts up to half a grid step away.

Chosen: it bounds the time of candidates that do not converge. With 3 and 12 none of 192 codewords is lost.
"""

CANDIDATE_MARGIN_PX = 1.0
"""Pixels around a candidate and its ring that are fitted too."""

PLACE_SPREAD = 0.08
"""Standard deviation of a candidate's place, as a fraction of its side; the grid's step is 0.1."""

CANDIDATE_SPREADS = (0.1, 0.05, 0.2)
"""Standard deviations of a candidate's ln pitch (sizes are 0.11 apart), roll (3 degrees) and ln blur."""

LEVEL_SPREAD, UPRIGHT_SPREAD, TILTED_SPREAD = 1e-5, 0.01, 0.1
"""Standard deviations of stretch and shear of partly hidden candidates, whose hidden side looks like a tilt; of
candidates taken to face the camera; and of others.

10 degrees of yaw are a stretch of -0.008, 40 degrees of -0.13.
"""

HIDING_BLUR = 0.5
"""Pitches of blur that hide single LEDs while a candidate is centred: else it locks in a whole pitch beside them."""

HIDDEN_CELL, PARTLY_LIT_CELL = 0.4, 0.75
"""Least alternation of a cell that is not hidden, as a fraction of the median cell's; a hidden one has 0.

The second holds once the pose is found without the hidden cells: a cell of which a quarter is hidden would move it.
"""

MOST_TILT = 0.2
"""Largest tilt taken for an array's: that of 48 degrees, beyond which LEDs of 22.6 degrees half angle hardly shine."""

MOST_GAIN = 1.25
"""Largest light of an array with all LEDs on, in full scales: brighter pixels saturate. The rest is for errors of the
fit and for data beside a header."""

OVERLAP = 0.1
"""Fraction of their sides by which two arrays may seem to overlap: a candidate's place and size err by half of it."""


def cell_weights(cells: NDArray[np.float64], side: int) -> Floats:
    """Luminances of LEDs by the cells of a header. Returns (n, n)."""
    return np.asarray(np.kron(cells.reshape(CELLS, CELLS), np.ones((side // CELLS, side // CELLS))), np.float64)


def followed(start: Pose, taken: Sequence[Pose], side: int) -> bool:
    """Whether a candidate is one of the arrays that are followed, by `APART_SIDES`."""
    return any(np.hypot(start.x - p.x, start.y - p.y) < APART_SIDES * side * p.pitch for p in taken)


def fit_near(
    change: NDArray[np.float32],
    origin: tuple[int, int],
    start: Pose,
    weights: Floats,
    tilt: float,
    smooth: float = 0.0,
    smear: tuple[float, float] = (0.0, 0.0),
) -> Fit | None:
    """Fit a header to what alternates, near a pose."""
    side = len(weights)
    x0, y0, width, height = window_around(start, side, RING * side * start.pitch + CANDIDATE_MARGIN_PX)
    i, j = y0 - origin[1], x0 - origin[0]
    if i < 0 or j < 0 or i + height > change.shape[0] or j + width > change.shape[1]:
        return None
    image = change[i : i + height, j : j + width].astype(np.float64)
    sigma = smooth * start.pitch
    if sigma:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float64)
        start = replace(start, blur=float(np.hypot(start.blur, sigma)))
    reach = PLACE_SPREAD * side * start.pitch
    spread = np.diag(np.array([reach, reach, *CANDIDATE_SPREADS, tilt, tilt]) ** 2)
    try:
        return fit_array(image, (x0, y0), Prior(start.full_vector(), spread), weights, FIT_STEPS, smear=smear)
    except np.linalg.LinAlgError:
        # pixels that give no pose are no array
        return None


def lit_cells(
    change: NDArray[np.float32], origin: tuple[int, int], pose: Pose, weights: Floats, least: float
) -> Floats:
    """Find the cells of a header that alternate as the others do."""
    light = cell_light(change, origin, pose, weights)
    return np.asarray((light > least * np.median(light[light > 0])).astype(float).reshape(CELLS, CELLS))


def cell_light(change: NDArray[np.float32], origin: tuple[int, int], pose: Pose, weights: Floats) -> Floats:
    """How much each cell of an array alternates, by least squares."""
    from heliograph.receive.geometry import kernels

    x0, y0, width, height = window_around(pose, len(weights), CANDIDATE_MARGIN_PX)
    i, j = max(0, y0 - origin[1]), max(0, x0 - origin[0])
    image = change[i : y0 - origin[1] + height, j : x0 - origin[0] + width].astype(np.float64)
    shapes, out = [], np.empty((6, *image.shape))
    for cell in np.eye(CELLS * CELLS):
        lit = weights * cell_weights(cell, len(weights))
        kernels.render(pose.full_vector(), lit, float(origin[0] + j), float(origin[1] + i), out, 0.0, 0.0)
        shapes.append(out[0].ravel().copy())
    return np.asarray(np.linalg.lstsq(np.stack(shapes, 1), image.ravel(), rcond=None)[0], np.float64)


def plausible(fit: Fit, parameters: SearchParameters, full_scale: int) -> bool:
    """Whether brightness and tilt of a fit are those of an array looked for."""
    bright = parameters.min_contrast <= fit.gain / full_scale <= MOST_GAIN
    # a tilt that was given is that of an array
    given = (parameters.start.stretch, parameters.start.shear) if parameters.start is not None else (0.0, 0.0)
    turned = np.hypot(fit.pose.stretch - given[0], fit.pose.shear - given[1]) <= MOST_TILT
    return bool(bright and turned)


def is_in_size_range(fit: Fit, parameters: SearchParameters, side: int) -> bool:
    """Whether the size of a fit is that of an array looked for."""
    smallest, largest = size_limits(parameters.min_side_px, parameters.max_side_px)
    return smallest <= side * fit.pose.pitch <= largest


def apart(a: Pose, b: Pose, side: int) -> bool:
    """Whether two arrays do not overlap; parts of a header look like smaller ones."""
    # |a - b| > (n p_a + n p_b) / 2, less what the poses may err by
    reach = (1 - OVERLAP) / 2 * side * (a.pitch + b.pitch)
    return bool(np.hypot(a.x - b.x, a.y - b.y) > reach)


STEPS = 6
"""Gauss-Newton steps: each finds a motion of up to half a cell between a header's first and last frame."""

ENOUGH_PX = 0.02
"""Step in px, and in px per pattern, that ends the search.

A tolerance: an LED that is 0.02 px off changes a pixel by up to 2 % of its peak (`equalise.led_gains.MODEL`).
"""

DRIFT_PX = 0.9
"""Prior standard deviation of the motion in px per pattern: hard shake, as in the tracker's `START_RATES`."""

PLACE_PX = 1.0
"""Prior standard deviation of the pose's error in px.

Chosen: what a motion of `DRIFT_PX` does in about a pattern. The pose was fitted to all frames together, and errs by
less. The prior bounds the first step where the pixels say little.
"""

DRIFT_MARGIN_PX = 3.0
"""Pixels around the array that count too: five times the blur of the reference link."""


def drift_of(
    frames: Sequence[Frame], pose: Pose, time_s: float, weights: Floats, period_s: float
) -> tuple[float, float]:
    """Motion of a header in px per second."""
    # (x, y) of the error of the pose, and of the motion in px per pattern
    found, prior = np.zeros(4), np.diag(np.repeat([PLACE_PX, DRIFT_PX], 2) ** -2.0)
    times = (np.array([frame.time_s for frame in frames]) - time_s) / period_s
    for _ in range(STEPS):
        seen = [
            _error(frame, pose.moved(*(found[:2] + t * found[2:])), weights)
            for t, frame in zip(times, frames, strict=True)
        ]
        noise = max(sum(left for *_, left in seen) / len(seen), LEAST_VARIANCE)
        matrix, vector = prior.copy(), -prior @ found
        for t, (power, match, _) in zip(times, seen, strict=True):
            both = np.array([[1.0, t], [t, t * t]])
            matrix += np.kron(both, power) / noise
            vector += np.kron([1.0, t], match) / noise
        step = np.linalg.solve(matrix, vector)
        found = found + step
        if np.abs(step).max() < ENOUGH_PX:
            break
    x, y = (found[2:] / period_s).tolist()
    return x, y


def _error(frame: Frame, pose: Pose, weights: Floats) -> tuple[NDArray[np.float64], Floats, float]:
    """What a frame says of an error of x and y: J^T J, J^T r, and the mean square of r."""
    from heliograph.receive.geometry import kernels  # Numba is slow to import

    window = window_around(pose, len(weights), DRIFT_MARGIN_PX)
    x0, y0, width, height = window
    hidden = HIDING_BLUR * pose.pitch
    shown = np.asarray(cv2.GaussianBlur(cut_out(frame, window), (0, 0), hidden), np.float64).ravel()
    pose = replace(pose, blur=float(np.hypot(pose.blur, hidden)))
    images = np.empty((2, 6, height, width))
    for levels, out in zip((weights, np.abs(weights)), images, strict=True):
        kernels.render(pose.full_vector(), levels, float(x0), float(y0), out, 0.0, 0.0)
    flat = images.reshape(2, 6, -1)
    columns = np.column_stack([flat[0, 0], flat[1, 0], np.ones(shown.size)])
    slopes = flat[:, 1:3]
    amounts = np.linalg.lstsq(columns, shown, rcond=RCOND)[0]
    residual = shown - columns @ amounts
    jacobian = (amounts[0] * slopes[0] + amounts[1] * slopes[1]).T
    jacobian = jacobian - columns @ np.linalg.lstsq(columns, jacobian, rcond=RCOND)[0]
    return jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual) / shown.size
