"""Gauss-Newton steps of a fit, as machine code: between two steps there is too little work to go back to Python.

`fit_reference.py` holds the same in plain NumPy; a test holds the two together.
"""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled
from heliograph.receive.image.cholesky import invert, solve
from heliograph.receive.image.median import median
from heliograph.receive.image.products import add_products, rows_for_products, take_apart
from heliograph.receive.image.redraw import copy_pose, draw, near, shift

BIWEIGHT = 4.685
"""Standard deviations from which on a residual has no weight: Tukey's biweight of 95 % efficiency."""

FIT_LOADING = 1e-9
"""Relative loading of the normal equations' diagonal: keeps a parameter that no pixel shows solvable."""

FIRST_LOADING = 1e-6
"""The same of the first coefficients, where images of the array and of a plane may be alike."""

LEAST_INFORMATION = 1e-3
"""Added to the diagonal before it is loaded: of images that are 0 all over something must be left to solve for."""

LEAST_RESIDUAL = 0.5
"""Least standard deviation of residuals in gray levels by which they are weighed: the largest error of rounding."""

LEAST_VARIANCE = 0.08
"""Least variance of a pixel in squared gray levels: that of rounding to whole levels, 1/12."""

HELD_GAIN = 1e3
"""Weight of an expected gain in the first coefficients, over that of the pixels: it all but holds the gain.

The pixels can move it by a thousandth of the way to what they say.
"""

CLOSE_PX, CLOSE_BLUR, CLOSE_GAIN = 0.02, 0.02, 0.1
"""Steps of the array's rim in px, of ln blur, and of the gain as a fraction of it, below which a fit ends.

The next steps are a tenth of these, so what is left is below the error that noise gives a sum at 80 m (0.004 px rms).
While the gain is wrong all steps are too short or too long, so a fit goes on until it is right.
"""

LONGEST_PX = 0.8
"""Longest step of the centre in px, half a pitch where that is more: the width of an edge of the array."""

LONGEST = (0.1, 0.05, 0.2, 0.05, 0.05)
"""Longest steps of ln pitch, roll, ln blur, stretch and shear: they move the rim of 16 LEDs by half a pitch or so."""

EXPECTED_GAIN_SPREAD = 0.5
"""Standard deviation of an expected gain, as a fraction of it: before a bright sky the rim of a dark panel adds half.

With 0.15 the gain was held below what the pixels showed. The sum's blur grew in its place, until the array was lost: 4
of 40 packets of the high layer in the strongest bumps of a recorded drive, none with 0.5.
"""


@compiled()
def fit(
    image,
    plane,
    open_pixels,
    corner,
    weights,
    margins,
    resolved,
    smear,
    prior,
    covariance,
    gain,
    steps,
    vector,
    shapes,
    anchor,
    drawn,
):
    """Most probable pose of LEDs in pixels, by Gauss-Newton with robust weights."""
    free = covariance.shape[0]
    precision = np.empty((free, free))
    invert(covariance, precision)
    size = free + shapes.shape[0] + 3
    matrix, rhs = np.empty((size, size)), np.empty(size)
    residual = np.empty(image.shape)
    if near(vector, anchor, len(weights)):
        shift(vector, drawn, shapes)
    else:
        draw(vector, open_pixels, corner, weights, margins, resolved, smear, shapes)
        copy_pose(vector, anchor)
    copy_pose(vector, drawn)
    linear = _coefficients(image, shapes, plane, gain)
    for _ in range(steps):
        residuals(image, shapes, plane, linear, residual)
        rough = BIWEIGHT * _noise_of(residual, open_pixels)
        mass, loss = normal_equations(residual, shapes, plane, linear, rough, matrix, rhs)
        mass -= _hidden(open_pixels)
        noise = max(loss / max(mass - size, 1.0), LEAST_VARIANCE)
        for k in range(size):
            rhs[k] /= noise
            for n in range(size):
                matrix[k, n] /= noise
        # (J^T W J + P^-1) step = J^T W r + P^-1 (theta_0 - theta), and the same for the gain
        for k in range(free):
            for n in range(free):
                matrix[k, n] += precision[k, n]
                rhs[k] += precision[k, n] * (prior[n] - vector[n])
        if gain != 0.0:
            weight = (EXPECTED_GAIN_SPREAD * gain) ** -2
            matrix[free, free] += weight
            rhs[free] += weight * (gain - linear[0])
        _load(matrix, FIT_LOADING)
        step = rhs.copy()
        solve(matrix, step)
        for k in range(linear.shape[0]):
            linear[k] += step[free + k]
        pitch = math.exp(vector[2])
        for k in range(free):
            limit = max(LONGEST_PX, 0.5 * pitch) if k < 2 else LONGEST[k - 2]
            vector[k] += min(max(step[k], -limit), limit)
        close = _rim_px(step, free, vector, len(weights)) < CLOSE_PX and abs(step[4]) < CLOSE_BLUR
        # pitch and blur of a header, from which distances are measured, go on in small steps
        if len(margins) and close and abs(step[free]) < CLOSE_GAIN * abs(linear[0]):
            break
        draw(vector, open_pixels, corner, weights, margins, resolved, smear, shapes)
        copy_pose(vector, anchor)
        copy_pose(vector, drawn)
    residuals(image, shapes, plane, linear, residual)
    found = np.empty((free, free))
    invert(matrix, found)
    return found, linear, _correlation(image, residual, open_pixels)


@compiled()
def _coefficients(image, shapes, plane, gain):
    """Least squares coefficients of the images, near an expected gain if there is one."""
    m, cols = shapes.shape[0], image.shape[1]
    size = m + 3
    products, values = np.zeros((size + 1, size + 1)), rows_for_products(size + 1, cols)
    for i in range(image.shape[0]):
        for n in range(m):
            for j in range(cols):
                values[n, j] = shapes[n, 0, i, j]
        for n in range(3):
            for j in range(cols):
                values[m + n, j] = plane[n, i, j]
        for j in range(cols):
            values[size, j] = image[i, j]
        add_products(values, values, cols, products)
    matrix, rhs = np.empty((size, size)), np.empty(size)
    take_apart(products, matrix, rhs)
    if gain != 0.0:
        weight = HELD_GAIN * matrix[0, 0]
        matrix[0, 0] += weight
        rhs[0] += weight * gain
    _load(matrix, FIRST_LOADING)
    solve(matrix, rhs)
    return rhs


@compiled(fastmath={"reassoc", "contract"})
def normal_equations(residual, shapes, plane, linear, rough, matrix, vector):
    """Gauss-Newton normal equations of image = linear . (shapes(pose), plane), weighted by Tukey's biweight."""
    rows, cols = residual.shape
    m = shapes.shape[0]
    p = shapes.shape[1] - 1
    size = p + m + 3
    # row by row of pixels; the residual is one row more beside the slopes
    products = np.zeros((size + 1, size + 1))
    slopes, weighed = rows_for_products(size + 1, cols), rows_for_products(size + 1, cols)
    w = np.empty(cols)
    mass = 0.0
    for i in range(rows):
        for j in range(cols):
            r = residual[i, j]
            q = r / rough
            w[j] = 0.0 if abs(q) >= 1.0 else (1.0 - q * q) ** 2
            mass += w[j]
            slopes[size, j] = r
        for k in range(p):
            for j in range(cols):
                slopes[k, j] = linear[0] * shapes[0, k + 1, i, j]
            for n in range(1, m):
                for j in range(cols):
                    slopes[k, j] += linear[n] * shapes[n, k + 1, i, j]
        # number by number: to assign whole rows takes long to compile, for the words of its errors
        for n in range(m):
            for j in range(cols):
                slopes[p + n, j] = shapes[n, 0, i, j]
        for n in range(3):
            for j in range(cols):
                slopes[p + m + n, j] = plane[n, i, j]
        for k in range(size + 1):
            for j in range(cols):
                weighed[k, j] = w[j] * slopes[k, j]
        add_products(weighed, slopes, cols, products)
    take_apart(products, matrix, vector)
    return mass, products[size, size]


@compiled()
def residuals(image, shapes, plane, linear, out):
    """Residuals of a fit, image - linear . (shapes(pose), plane)."""
    m = shapes.shape[0]
    # image by image: a row of one is fast
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            out[i, j] = image[i, j]
        for n in range(m):
            for j in range(image.shape[1]):
                out[i, j] -= linear[n] * shapes[n, 0, i, j]
        for n in range(3):
            for j in range(image.shape[1]):
                out[i, j] -= linear[m + n] * plane[n, i, j]


@compiled()
def _noise_of(residual, open_pixels):
    """Standard deviation of the residuals that count, by their median magnitude; at least `LEAST_RESIDUAL`."""
    sizes, count = np.empty(residual.size), 0
    for i in range(residual.shape[0]):
        for j in range(residual.shape[1]):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                sizes[count] = abs(residual[i, j])
                count += 1
    # median |x| / Phi^-1(3/4)
    return max(1.4826 * median(sizes[:count]), LEAST_RESIDUAL) if count else LEAST_RESIDUAL


@compiled()
def _hidden(open_pixels):
    """How many pixels do not count."""
    found = 0.0
    for i in range(open_pixels.shape[0]):
        for j in range(open_pixels.shape[1]):
            found += 1.0 - open_pixels[i, j]
    return found


@compiled()
def _load(matrix, loading):
    """M + lambda (diag M + epsilon 1), in place."""
    for k in range(matrix.shape[0]):
        matrix[k, k] += loading * (matrix[k, k] + LEAST_INFORMATION)


@compiled()
def _correlation(image, residual, open_pixels):
    """Correlation of an image and what a fit makes of it, over the pixels that count; see `robust.correlation`."""
    rows, cols = image.shape
    mean, rest, count = 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                mean += image[i, j]
                rest += residual[i, j]
                count += 1.0
    mean, rest = mean / max(count, 1.0), rest / max(count, 1.0)
    both, one, other = 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                x = image[i, j] - mean
                y = x - residual[i, j] + rest
                both += x * y
                one += x * x
                other += y * y
    return both / math.sqrt(max(one * other, TINY))


@compiled()
def _rim_px(step, free, vector, side):
    """How far a step of the pose's `free` parameters moves the rim of an array, in px."""
    turn = max(abs(step[2]), abs(step[3]))
    for k in range(5, free):
        turn = max(turn, abs(step[k]))
    return max(abs(step[0]), abs(step[1])) + 0.5 * side * math.exp(vector[2]) * turn
