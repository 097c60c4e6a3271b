"""Images of an array for a fit, as hot loops: drawn at a pose, or moved to it from a pose nearby."""

import math

from heliograph.base.compiled import compiled
from heliograph.receive.image.kernels import draw_box, draw_leds

NEAR_PX, NEAR_BLUR = 0.1, 0.02
"""Distance of an array's rim in px, and difference of ln blur, from a pose at which its images were drawn, up to which
these stand for it with their slopes.

What they leave out is half of the curvature times 0.1^2: 0.3 gray levels at the edge of an array of 120 levels and of a
blur of 0.6 px. It looks like a blur that is 1 % wider, and moves no pose.
"""


@compiled()
def near(vector, anchor, side):
    """Whether a pose is so near another, at which images were drawn, that their slopes give it."""
    turn = max(abs(vector[2] - anchor[2]), abs(vector[3] - anchor[3]))
    for k in range(5, vector.shape[0]):
        turn = max(turn, abs(vector[k] - anchor[k]))
    away = max(abs(vector[0] - anchor[0]), abs(vector[1] - anchor[1])) + 0.5 * side * math.exp(vector[2]) * turn
    # of a pose that is not a number neither holds
    return away < NEAR_PX and abs(vector[4] - anchor[4]) < NEAR_BLUR


@compiled()
def shift(vector, drawn, shapes):
    """Move images from the pose at which they were drawn to another by their slopes."""
    for n in range(shapes.shape[0]):
        for k in range(1, shapes.shape[1]):
            step = vector[k - 1] - drawn[k - 1]
            for i in range(shapes.shape[2]):
                for j in range(shapes.shape[3]):
                    shapes[n, 0, i, j] += step * shapes[n, k, i, j]


@compiled(inline="always")
def copy_pose(vector, out):
    """Copy a pose vector, number by number."""
    for k in range(vector.shape[0]):
        out[k] = vector[k]


@compiled()
def draw(vector, open_pixels, corner, weights, margins, resolved, smear, shapes):
    """Draw the array and squares around it at a pose."""
    half = 0.5 * weights.shape[0]
    if resolved:
        draw_leds(vector, weights, corner[0], corner[1], shapes[0], smear[0], smear[1])
    else:
        draw_box(vector, half, corner[0], corner[1], shapes[0], smear[0], smear[1])
    for k in range(margins.shape[0]):
        draw_box(vector, half + margins[k], corner[0], corner[1], shapes[k + 1], smear[0], smear[1])
    if open_pixels.size == 0:
        return
    for k in range(shapes.shape[0]):
        for n in range(shapes.shape[1]):
            for i in range(shapes.shape[2]):
                for j in range(shapes.shape[3]):
                    shapes[k, n, i, j] *= open_pixels[i, j]
