"""How fast a header moves in the image: a camera that passes an array sideways sees it move by pixels a frame.

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
from heliograph.receive.acquire.candidate import HIDING_BLUR
from heliograph.receive.image.gauss_newton import LEAST_VARIANCE
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import cut_out, window_around

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
    from heliograph.receive.image import kernels  # Numba is slow to import

    window = window_around(pose, len(weights), DRIFT_MARGIN_PX)
    x0, y0, width, height = window
    hidden = HIDING_BLUR * pose.pitch
    shown = np.asarray(cv2.GaussianBlur(cut_out(frame, window), (0, 0), hidden), np.float64).ravel()
    pose = replace(pose, blur=float(np.hypot(pose.blur, hidden)))
    images = np.empty((2, 6, height, width))
    for levels, out in zip((weights, np.abs(weights)), images, strict=True):
        kernels.render(pose.full_vector(), levels, float(x0), float(y0), out)
    flat = images.reshape(2, 6, -1)
    columns = np.column_stack([flat[0, 0], flat[1, 0], np.ones(shown.size)])
    slopes = flat[:, 1:3]
    amounts = np.linalg.lstsq(columns, shown, rcond=RCOND)[0]
    residual = shown - columns @ amounts
    jacobian = (amounts[0] * slopes[0] + amounts[1] * slopes[1]).T
    jacobian = jacobian - columns @ np.linalg.lstsq(columns, jacobian, rcond=RCOND)[0]
    return jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual) / shown.size
