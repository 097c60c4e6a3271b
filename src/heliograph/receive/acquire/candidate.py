"""A candidate of the coarse search fitted: its pose, and cells of its header that are hidden."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.acquire.coarse import APART_SIDES, RING, SearchParameters, size_limits
from heliograph.receive.image.fit import Fit, Prior, fit_array
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import window_around
from heliograph.signal.header import CELLS

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
    from heliograph.receive.image import kernels

    x0, y0, width, height = window_around(pose, len(weights), CANDIDATE_MARGIN_PX)
    i, j = max(0, y0 - origin[1]), max(0, x0 - origin[0])
    image = change[i : y0 - origin[1] + height, j : x0 - origin[0] + width].astype(np.float64)
    shapes, out = [], np.empty((6, *image.shape))
    for cell in np.eye(CELLS * CELLS):
        lit = weights * cell_weights(cell, len(weights))
        kernels.render(pose.full_vector(), lit, float(origin[0] + j), float(origin[1] + i), out)
        shapes.append(out[0].ravel().copy())
    return np.asarray(np.linalg.lstsq(np.stack(shapes, 1), image.ravel(), rcond=None)[0], np.float64)


def plausible(fit: Fit, parameters: SearchParameters, full_scale: int) -> bool:
    """Whether brightness and tilt of a fit are those of an array looked for."""
    bright = parameters.min_contrast <= fit.gain / full_scale <= MOST_GAIN
    # a tilt that was given is that of an array
    given = (parameters.start.stretch, parameters.start.shear) if parameters.start is not None else (0.0, 0.0)
    turned = np.hypot(fit.pose.stretch - given[0], fit.pose.shear - given[1]) <= MOST_TILT
    return bool(bright and turned)


def of_size(fit: Fit, parameters: SearchParameters, side: int) -> bool:
    """Whether the size of a fit is that of an array looked for."""
    smallest, largest = size_limits(parameters.min_side_px, parameters.max_side_px)
    return smallest <= side * fit.pose.pitch <= largest


def apart(a: Pose, b: Pose, side: int) -> bool:
    """Whether two arrays do not overlap; parts of a header look like smaller ones."""
    # |a - b| > (n p_a + n p_b) / 2, less what the poses may err by
    reach = (1 - OVERLAP) / 2 * side * (a.pitch + b.pitch)
    return bool(np.hypot(a.x - b.x, a.y - b.y) > reach)
