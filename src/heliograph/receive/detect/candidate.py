"""Fit of a candidate's header to a fraction of a pixel, with hidden cells and motion.

Frame k of a header shows a_k A (2 Y - 1) + a'_k A 1 and an even background, at any phase of the camera: Y is the
header, A the blur matrix. About an even motion the image is linear in small errors of position and motion, and all
frames together give both by Gauss-Newton with a_k and a'_k eliminated.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import RCOND, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import ALTERNATION, DETECT, DIFFERENCE, Change, alternation_of
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.geometry.footprint import images_of, render_with_slopes, to_quarters
from heliograph.receive.geometry.kernels import LEAST_VARIANCE
from heliograph.receive.geometry.pose import Corner, Pose, Shape
from heliograph.receive.geometry.window import Window, cut_out, window_around
from heliograph.signal.header import CELLS


def fit_header(
    header: Sequence[Frame], pose: Pose, weights: Floats, tilt: float, score: float, even: bool
) -> tuple[Fit | None, Floats, bool]:
    """Fit a header's frames; return the fit, the LED gains and True if the fit was held level."""
    change, origin, side = alternation_of(header), header[0].origin, len(weights)
    fit, sound = fit_near(change, origin, pose, weights, tilt), np.ones(weights.shape)
    if fit is None or not 0.7 <= fit.score < DETECT.clear_score or not even or tilt > DETECT.upright_sigma:
        return fit, sound, False
    best, lit, led_gains = fit, np.ones(CELLS * CELLS), sound
    # least alternation of visible cells over the median cell, before and after the first fit to visible cells
    for min_light in (0.4, 0.75):
        # a hidden side looks like a tilt
        pose = replace(best.pose, stretch=0.0, shear=0.0)
        lit = lit * find_lit_cells(change, origin, pose, led_gains * weights, min_light).ravel()
        led_gains = cell_weights(lit, side)
        visible = fit_near(change, origin, pose, led_gains * weights, DETECT.level_sigma)
        # at most a third may be hidden
        if visible is None or lit.mean() < 0.68:
            break
        best = visible
    else:
        if best.score > max(fit.score, score):
            return best, led_gains, True
    if fit.score >= score:
        return fit, sound, False
    # a thin post hides parts of cells
    pose = replace(fit.pose, stretch=0.0, shear=0.0)
    return fit_near(change, origin, pose, weights, DETECT.level_sigma), sound, True


def fit_moving(header: list[Frame], fit: Fit, weights: Floats, tilt: float, motion: tuple[float, float]) -> Fit:
    """Fit a header with the smear of a motion in px per pattern."""
    if max(np.abs(motion)) < 0.1:
        return fit
    frame_weights = np.abs(ALTERNATION if len(header) == 4 else DIFFERENCE[:2])
    # the variance of the frames' times, by weight, and of an exposure
    times = np.arange(len(header)) - 0.5 * (len(header) - 1)
    patterns = float(np.sqrt(frame_weights @ times**2 / frame_weights.sum() + 1 / 12))
    smear = patterns * abs(motion[0]), patterns * abs(motion[1])
    change, origin = alternation_of(header), header[0].origin
    # unsmeared, the fit has a stretch, and single LEDs match the neighbours
    rough = fit_near(change, origin, fit.pose, weights, tilt, DETECT.hiding_blur, smear)
    if rough is None:
        return fit
    start = replace(rough.pose, blur=fit.pose.blur)
    smeared = fit_near(change, origin, start, weights, tilt, smear=smear)
    return fit if smeared is None or smeared.score < fit.score else smeared


def fit_first_pair(header: list[Frame], fit: Fit, weights: Floats, tilt: float) -> tuple[Fit, list[Frame]]:
    """Fit a header's first pair, as a format may dim the later pairs unevenly."""
    first = fit_near(alternation_of(header[:2]), header[0].origin, fit.pose, weights, tilt)
    if first is None or first.score <= 0.9 * fit.score or first.gain <= 0.7 * fit.gain:
        return fit, header
    return replace(first, score=fit.score), header[:2]


def fit_near(
    change: Change,
    origin: Corner,
    start: Pose,
    weights: Floats,
    tilt: float,
    smooth: float = 0.0,
    smear: tuple[float, float] = (0.0, 0.0),
) -> Fit | None:
    """Fit a header to the alternation near a pose."""
    side = len(weights)
    if (window := find_window(change, origin, start, side)) is None:
        return None
    x0, y0, width, height = window
    i, j = y0 - origin[1], x0 - origin[0]
    image = change[i : i + height, j : j + width].astype(np.float64)
    sigma = smooth * start.pitch
    if sigma:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float64)
        start = replace(start, blur=float(np.hypot(start.blur, sigma)))
    reach = 0.08 * side * start.pitch
    # of x, y, ln pitch, roll, ln blur, stretch and shear
    spread = np.diag(np.array([reach, reach, 0.1, 0.05, 0.2, tilt, tilt]) ** 2)
    try:
        return fit_array(image, (x0, y0), Fit(start.full_vector(), spread), weights, DETECT.max_steps, smear=smear)
    except np.linalg.LinAlgError:
        # no pose, no array
        return None


def find_window(change: Change, origin: Corner, pose: Pose, side: int) -> Window | None:
    """Return the window of an array and the ring around; None if an image does not show all of it."""
    window = window_around(pose, side, DETECT.ring * side * pose.pitch + DETECT.margin_px)
    left, top = window[0] - origin[0], window[1] - origin[1]
    is_within = left >= 0 and top >= 0 and left + window[2] <= change.shape[1] and top + window[3] <= change.shape[0]
    return window if is_within else None


def cell_weights(cells: Floats, side: int) -> Floats:
    """Return luminances of LEDs, (n, n), by the cells of a header."""
    return np.asarray(np.kron(cells.reshape(CELLS, CELLS), np.ones((side // CELLS, side // CELLS))), np.float64)


def cell_images(led_gains: Floats, pose: Pose, corner: Corner, shape: Shape) -> Floats:
    """Render each cell of a header with all LEDs on, (16, pixels)."""
    return images_of(led_gains, _leds_of_cells(len(led_gains)), pose, corner, shape).reshape(CELLS * CELLS, -1)


@lru_cache
def _leds_of_cells(side: int) -> NDArray[np.intp]:
    """Return the places in quarters of the LEDs of each cell, (16, LEDs)."""
    numbers = to_quarters(cell_weights(np.arange(CELLS * CELLS, dtype=np.float64), side))
    return np.argsort(numbers, kind="stable").reshape(CELLS * CELLS, -1)


def find_lit_cells(change: Change, origin: Corner, pose: Pose, weights: Floats, min_light: float) -> Floats:
    """Find the visible cells of a header, which alternate alike."""
    light = measure_cells(change, origin, pose, weights)
    return np.asarray((light > min_light * np.median(light[light > 0])).astype(float).reshape(CELLS, CELLS))


def measure_cells(change: Change, origin: Corner, pose: Pose, weights: Floats) -> Floats:
    """Measure the light of each cell of an array, by least squares."""
    side = len(weights)
    x0, y0, width, height = window_around(pose, side, DETECT.margin_px)
    i, j = max(0, y0 - origin[1]), max(0, x0 - origin[0])
    image = change[i : y0 - origin[1] + height, j : x0 - origin[0] + width].astype(np.float64)
    columns = cell_images(weights, pose, (origin[0] + j, origin[1] + i), image.shape).T
    return np.asarray(np.linalg.lstsq(columns, image.ravel(), rcond=None)[0], np.float64)


def is_tracked(start: Pose, tracked: Sequence[Pose], side: int) -> bool:
    """Return True if a candidate is a tracked array."""
    return any(np.hypot(start.x - p.x, start.y - p.y) < DETECT.min_distance * side * p.pitch for p in tracked)


def are_disjoint(a: Pose, b: Pose, side: int) -> bool:
    """Return True if two arrays do not overlap; parts of a header look like smaller arrays."""
    # |a - b| > (n p_a + n p_b) / 2, less a tenth for the errors of the poses
    return bool(np.hypot(a.x - b.x, a.y - b.y) > 0.45 * side * (a.pitch + b.pitch))


def estimate_drift(
    frames: Sequence[Frame], pose: Pose, time_s: float, weights: Floats, period_s: float
) -> tuple[float, float]:
    """Estimate the motion of a header in px per second."""
    # (x, y) of the error of the pose, 1 px, and of the motion in px per pattern, 0.9 px by hard shake
    state, prior = np.zeros(4), np.diag(np.repeat([1.0, 0.9], 2) ** -2.0)
    times = (np.array([frame.time_s for frame in frames]) - time_s) / period_s
    for _ in range(DETECT.max_steps):
        errors = [
            _position_error(frame, pose.moved(*(state[:2] + t * state[2:])), weights)
            for t, frame in zip(times, frames, strict=True)
        ]
        noise = max(sum(residual for *_, residual in errors) / len(errors), LEAST_VARIANCE)
        matrix, vector = prior.copy(), -prior @ state
        for t, (power, match, _) in zip(times, errors, strict=True):
            matrix += np.kron(np.array([[1.0, t], [t, t * t]]), power) / noise
            vector += np.kron([1.0, t], match) / noise
        step = np.linalg.solve(matrix, vector)
        state = state + step
        if np.abs(step).max() < 0.02:
            break
    x, y = (state[2:] / period_s).tolist()
    return x, y


def _position_error(frame: Frame, pose: Pose, weights: Floats) -> tuple[Floats, Floats, float]:
    """Compare a frame with a pose: J^T J and J^T r of the error of x and y, and the mean square of r."""
    window = window_around(pose, len(weights), 3.0)
    x0, y0, width, height = window
    sigma = DETECT.hiding_blur * pose.pitch
    pixels = np.asarray(cv2.GaussianBlur(cut_out(frame, window), (0, 0), sigma), np.float64).ravel()
    pose = replace(pose, blur=float(np.hypot(pose.blur, sigma)))
    images = [render_with_slopes(pose, levels, (x0, y0), (height, width)) for levels in (weights, np.abs(weights))]
    flat = np.reshape(images, (2, 6, -1))
    columns = np.column_stack([flat[0, 0], flat[1, 0], np.ones(pixels.size)])
    slopes = flat[:, 1:3]
    amounts = np.linalg.lstsq(columns, pixels, rcond=RCOND)[0]
    residual = pixels - columns @ amounts
    jacobian = (amounts[0] * slopes[0] + amounts[1] * slopes[1]).T
    jacobian = jacobian - columns @ np.linalg.lstsq(columns, jacobian, rcond=RCOND)[0]
    return jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual) / pixels.size
