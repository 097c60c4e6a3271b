"""Hot loops of images: the light of LEDs on pixels.

`reference.py` holds the same in plain NumPy; a test holds the two together.

The normal distribution by a table, for hot loops.

Positive definite systems of a few unknowns, for hot loops.

It is compiled in tenths of a second; SciPy's, called from machine code, in three seconds.

Products of rows of pixels, summed up along them, for hot loops: what normal equations are made of.

The median and other quantiles, for hot loops.

Images of an array for a fit, as hot loops: drawn at a pose, or moved to it from a pose nearby.

Gauss-Newton steps of a fit, as machine code: between two steps there is too little work to go back to Python.

`fit_reference.py` holds the same in plain NumPy; a test holds the two together.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

Floats = NDArray[np.float64]

RENDER_REACH = 4.0
"""Standard deviations beyond which `render` leaves an LED's light out: 6e-5 of it lies there."""

FOOTPRINT_REACH = 3.7
"""The same of `footprints`, whose arrays the equaliser multiplies: 2e-4 of the light lies beyond."""


@compiled()
def _axis(centre, sigma, first, count, g, dg, ds):
    """Part of a Gaussian on `count` pixels from `first` on, and its derivatives by centre and by ln sigma."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    z = (first - 0.5 - centre) / sigma
    cdf, pdf = normal(z)
    zpdf = z * pdf
    for j in range(count):
        z += 1.0 / sigma
        cdf_next, pdf_next = normal(z)
        g[j] = cdf_next - cdf
        dg[j] = (pdf - pdf_next) / sigma
        ds[j] = zpdf - z * pdf_next
        cdf, pdf, zpdf = cdf_next, pdf_next, z * pdf_next


@compiled(inline="always")
def _tilt(pose):
    """Stretch and shear of a pose vector (5,) or (7,)."""
    if pose.shape[0] == 7:
        return pose[5], pose[6]
    return 0.0, 0.0


def render(
    pose: Floats, weights: Floats, x0: float, y0: float, out: Floats, smear_x: float = 0.0, smear_y: float = 0.0
) -> None:
    """Image of LEDs and its derivatives by the pose; an unresolved array of weights 1 has the image 1."""
    draw_leds(pose, weights, x0, y0, out, smear_x, smear_y)


@compiled()
def draw_leds(pose, weights, x0, y0, out, smear_x, smear_y):
    """Do the work of `render`: with arguments left out it would be compiled a second time."""
    side = weights.shape[0]
    rows, cols = out.shape[1], out.shape[2]
    out[:] = 0.0
    pitch, blur = math.exp(pose[2]), math.exp(pose[4])
    # sigma^2 = blur^2 + smear^2, hence d ln sigma / d ln blur = blur^2 / sigma^2
    sigma_x, sigma_y = math.hypot(blur, smear_x), math.hypot(blur, smear_y)
    part_x, part_y = (blur / sigma_x) ** 2, (blur / sigma_y) ** 2
    c, s = math.cos(pose[3]), math.sin(pose[3])
    half = (side - 1) / 2.0
    span = int(2 * RENDER_REACH * max(sigma_x, sigma_y)) + 3
    gx, dgx, sgx = np.empty(span), np.empty(span), np.empty(span)
    gy, dgy, sgy = np.empty(span), np.empty(span), np.empty(span)
    area = pitch * pitch
    stretch, shear = _tilt(pose)
    tilts = out.shape[0] == 8
    for u in range(side):
        for v in range(side):
            w = weights[u, v] * area
            if w == 0.0:
                continue
            p, q = (v - half) * pitch, (u - half) * pitch
            a, b = (1.0 + stretch) * p + shear * q, shear * p + (1.0 - stretch) * q
            rx, ry = c * a - s * b, s * a + c * b
            # by stretch (p, -q) and by shear (q, p), both turned
            tx, ty, hx, hy = c * p + s * q, s * p - c * q, c * q - s * p, s * q + c * p
            px, py = pose[0] + rx - x0, pose[1] + ry - y0
            left, right = (
                max(0, math.ceil(px - RENDER_REACH * sigma_x - 0.5)),
                min(cols - 1, math.floor(px + RENDER_REACH * sigma_x + 0.5)),
            )
            top, bottom = (
                max(0, math.ceil(py - RENDER_REACH * sigma_y - 0.5)),
                min(rows - 1, math.floor(py + RENDER_REACH * sigma_y + 0.5)),
            )
            nx, ny = right - left + 1, bottom - top + 1
            if nx <= 0 or ny <= 0:
                continue
            _axis(px, sigma_x, left, nx, gx, dgx, sgx)
            _axis(py, sigma_y, top, ny, gy, dgy, sgy)
            for i in range(ny):
                wg, wd, wsig = w * gy[i], w * dgy[i], part_y * w * sgy[i]
                for j in range(nx):
                    value, by_x, by_y = wg * gx[j], wg * dgx[j], wd * gx[j]
                    out[0, top + i, left + j] += value
                    out[1, top + i, left + j] += by_x
                    out[2, top + i, left + j] += by_y
                    # the LED's flux grows with pitch^2, hence 2 value
                    out[3, top + i, left + j] += by_x * rx + by_y * ry + 2.0 * value
                    out[4, top + i, left + j] += by_y * rx - by_x * ry
                    out[5, top + i, left + j] += wsig * gx[j] + part_x * wg * sgx[j]
                    if tilts:
                        out[6, top + i, left + j] += by_x * tx + by_y * ty
                        out[7, top + i, left + j] += by_x * hx + by_y * hy


@compiled()
def _edge(t, sigma):
    """Phi(t / sigma) and its derivative by t."""
    z = t / sigma
    if z > RENDER_REACH:
        return 1.0, 0.0
    if z < -RENDER_REACH:
        return 0.0, 0.0
    cdf, pdf = normal(z)
    return cdf, pdf / sigma


def render_box(
    pose: Floats, half_leds: float, x0: float, y0: float, out: Floats, smear_x: float = 0.0, smear_y: float = 0.0
) -> None:
    """Image of a blurred square of brightness 1 about the array's centre, and its derivatives by the pose.

    A pixel's box counts as its variance, 1/12; the derivatives by blur and tilt are 0. Where the smear along x and y
    differs, an edge's width changes with the roll: that is left out.
    """
    draw_box(pose, half_leds, x0, y0, out, smear_x, smear_y)


@compiled()
def draw_box(pose, half_leds, x0, y0, out, smear_x, smear_y):
    """Do the work of `render_box`, as `draw_leds` does that of `render`."""
    rows, cols = out.shape[1], out.shape[2]
    half = half_leds * math.exp(pose[2])
    narrow = math.exp(2.0 * pose[4]) + 1.0 / 12.0
    sigma_x, sigma_y = math.sqrt(narrow + smear_x**2), math.sqrt(narrow + smear_y**2)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    stretch, shear = _tilt(pose)
    # (x, y) = [[xx, xy], [xy, yy]] R^T (dx, dy), the inverse of the tilt: the array's own directions, in which a
    # blur is as wide as the row of the inverse is long
    det = 1.0 - stretch * stretch - shear * shear
    xx, xy, yy = (1.0 - stretch) / det, -shear / det, (1.0 + stretch) / det
    wide = math.hypot(sigma_x * (xx * c - xy * s), sigma_y * (xx * s + xy * c))
    high = math.hypot(sigma_x * (xy * c - yy * s), sigma_y * (xy * s + yy * c))
    reach = RENDER_REACH * max(wide, high)
    out[:] = 0.0
    for i in range(rows):
        for j in range(cols):
            dx, dy = x0 + j - pose[0], y0 + i - pose[1]
            along, across = c * dx + s * dy, c * dy - s * dx
            x, y = xx * along + xy * across, xy * along + yy * across
            inside = half - max(abs(x), abs(y))
            if inside < -reach:  # no light, no slope
                continue
            if inside > reach:  # full light, no slope: most of a near array
                out[0, i, j] = 1.0
                continue
            right, right_slope = _edge(half - x, wide)
            left, left_slope = _edge(half + x, wide)
            low, low_slope = _edge(half - y, high)
            top, top_slope = _edge(half + y, high)
            bx, by = right + left - 1.0, low + top - 1.0
            by_x, by_y = (left_slope - right_slope) * by, (top_slope - low_slope) * bx
            by_along, by_across = xx * by_x + xy * by_y, xy * by_x + yy * by_y
            out[0, i, j] = bx * by
            out[1, i, j] = -c * by_along + s * by_across
            out[2, i, j] = -s * by_along - c * by_across
            out[3, i, j] = half * ((left_slope + right_slope) * by + (top_slope + low_slope) * bx)
            out[4, i, j] = across * by_along - along * by_across


def footprint_width(sigma: float) -> int:
    """Width of an LED's footprint in px, an odd number."""
    return 2 * math.ceil(FOOTPRINT_REACH * sigma + 0.5) + 1


@compiled()
def footprints(pose, rows, cols, across, down, first):
    """Light of each LED by column and by row of a window; an unresolved array with all LEDs on has the image 1.

    LEDs come square by square of 2 x 2, in each (0, 0), (0, 1), (1, 0), (1, 1).
    """
    count, width = across.shape
    side = round(math.sqrt(count))
    half = side // 2
    pitch = pose[6]
    reach = (width - 1) // 2
    for k in range(count):
        square, corner = k // 4, k % 4
        a = 2 * (square % half) + corner % 2 - (side - 1) / 2.0
        b = 2 * (square // half) + corner // 2 - (side - 1) / 2.0
        x, y = pose[0] + pose[2] * a + pose[3] * b, pose[1] + pose[4] * a + pose[5] * b
        first[k, 0], first[k, 1] = math.floor(x + 0.5) - reach, math.floor(y + 0.5) - reach
        _row_of_light(x, pose[7], first[k, 0], cols, pitch, across[k])
        _row_of_light(y, pose[8], first[k, 1], rows, pitch, down[k])


@compiled(inline="always")
def _row_of_light(centre, sigma, first, count, scale, out):
    """Part of a Gaussian on each pixel from `first` on, times a scale; 0 beyond the window's `count` pixels."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    cdf, _ = normal((first - 0.5 - centre) / sigma)
    for j in range(out.shape[0]):
        after, _ = normal((first + j + 0.5 - centre) / sigma)
        out[j] = scale * (after - cdf) if 0 <= first + j < count else 0.0
        cdf = after


@compiled()
def add_image(leds, across, down, first, out):
    """Add the image of LEDs to another."""
    width = across.shape[1]
    rows, cols = out.shape
    for n in range(leds.shape[0]):
        x, y = first[n, 0], first[n, 1]
        for i in range(max(0, -y), min(width, rows - y)):
            w = leds[n] * down[n, i]
            for j in range(max(0, -x), min(width, cols - x)):
                out[y + i, x + j] += w * across[n, j]


@compiled()
def add_parts(leds, parts, across, down, first, out):
    """Add each LED's light to the image of its part of an array."""
    width = across.shape[1]
    rows, cols = out.shape[1], out.shape[2]
    for n in range(leds.shape[0]):
        x, y, part = first[n, 0], first[n, 1], parts[n]
        for i in range(max(0, -y), min(width, rows - y)):
            w = leds[n] * down[n, i]
            for j in range(max(0, -x), min(width, cols - x)):
                out[part, y + i, x + j] += w * across[n, j]


@compiled(inline="always")
def _overlap(a, b, shift, width):
    """Sum of a[i + shift] b[i]."""
    total = 0.0
    for i in range(max(0, -shift), min(width, width - shift)):
        total += a[i + shift] * b[i]
    return total


@compiled()
def squared_difference(across_1, down_1, first_1, across_2, down_2, first_2):
    """Squared distance of two blur matrices, |A_1 - A_2|^2 over all LEDs and pixels."""
    width, total = across_1.shape[1], 0.0
    for k in range(across_1.shape[0]):
        dx, dy = first_2[k, 0] - first_1[k, 0], first_2[k, 1] - first_1[k, 1]
        total += _overlap(across_1[k], across_1[k], 0, width) * _overlap(down_1[k], down_1[k], 0, width)
        total += _overlap(across_2[k], across_2[k], 0, width) * _overlap(down_2[k], down_2[k], 0, width)
        total -= 2 * _overlap(across_1[k], across_2[k], dx, width) * _overlap(down_1[k], down_2[k], dy, width)
    return total


_FARTHEST, _NODES = 8, 64
"""Standard deviations to which the table of the normal distribution goes, where 6e-16 is left, and its nodes in each.

Three terms of the series err by h^4 / 24 times the fourth derivative, 0.55 at most: 9e-11 half a node away.
"""

_Z = np.arange(-_FARTHEST * _NODES, _FARTHEST * _NODES + 1) / _NODES
_CDF, _PDF = ndtr(_Z), np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)


@compiled(inline="always")
def normal(z):
    """Normal distribution by a table, in a fifth of the time of erf and exp."""
    z = min(max(z, -_FARTHEST), _FARTHEST)
    k = int((z + _FARTHEST) * _NODES + 0.5)
    h, at, pdf = z - _Z[k], _Z[k], _PDF[k]
    # Taylor series about the nearest node: phi' = -z phi, phi'' = (z^2 - 1) phi
    curve = at * at - 1.0
    return _CDF[k] + pdf * h * (1.0 - h * (at / 2.0 - h * curve / 6.0)), pdf * (1.0 - h * (at - h * curve / 2.0))


@compiled()
def solve(matrix, rhs):
    """Solve M x = b in place of b, by Cholesky."""
    lower = np.empty(matrix.shape)
    _factor(matrix, lower)
    _substitute(lower, rhs)


@compiled()
def invert(matrix, out):
    """First rows and columns of an inverse, as many as `out` has."""
    lower, column = np.empty(matrix.shape), np.empty(matrix.shape[0])
    _factor(matrix, lower)
    for k in range(out.shape[0]):
        column[:] = 0.0
        column[k] = 1.0
        _substitute(lower, column)
        for n in range(out.shape[0]):
            out[n, k] = column[n]


@compiled()
def _factor(matrix, lower):
    """Cholesky's L of M = L L^T; not finite where M is not positive definite."""
    for k in range(matrix.shape[0]):
        for n in range(k + 1):
            total = matrix[k, n]
            for i in range(n):
                total -= lower[k, i] * lower[n, i]
            lower[k, n] = math.sqrt(total) if k == n and total > 0.0 else np.nan if k == n else total / lower[n, n]


@compiled()
def _substitute(lower, rhs):
    """Solve L y = b, then L^T x = y, in place of b."""
    size = lower.shape[0]
    for k in range(size):
        for i in range(k):
            rhs[k] -= lower[k, i] * rhs[i]
        rhs[k] /= lower[k, k]
    for k in range(size - 1, -1, -1):
        for i in range(k + 1, size):
            rhs[k] -= lower[i, k] * rhs[i]
        rhs[k] /= lower[k, k]


@compiled()
def mirror(matrix):
    """Give a matrix the upper half that its lower one has."""
    for k in range(matrix.shape[0]):
        for n in range(k):
            matrix[n, k] = matrix[k, n]


TOGETHER = 4
"""Sums of products that `add_products` takes at a time: they are written out there."""


@compiled()
def rows_for_products(count, cols):
    """Rows of pixels for `add_products`, which takes four of them at a time: those beyond the count are 0."""
    return np.zeros((-(-count // TOGETHER) * TOGETHER, cols))


@compiled(fastmath={"reassoc", "contract"})
def add_products(left, right, cols, out):
    """Add left right^T to `out`: its lower half.

    A sum alone waits for its last addition, each time; four of them do not wait for each other.
    """
    for k in range(out.shape[0]):
        for n in range(0, k + 1, TOGETHER):
            a, b, c, d = 0.0, 0.0, 0.0, 0.0
            for j in range(cols):
                x = left[k, j]
                a += x * right[n, j]
                b += x * right[n + 1, j]
                c += x * right[n + 2, j]
                d += x * right[n + 3, j]
            out[k, n] += a
            if n + 1 <= k:
                out[k, n + 1] += b
            if n + 2 <= k:
                out[k, n + 2] += c
            if n + 3 <= k:
                out[k, n + 3] += d


@compiled()
def take_apart(products, matrix, rhs):
    """Normal equations from sums of products of images and, in the last row, of the target with them."""
    size = matrix.shape[0]
    for k in range(size):
        rhs[k] = products[size, k]
        for n in range(k + 1):
            matrix[k, n] = products[k, n]
    mirror(matrix)


@compiled()
def median(values: NDArray[np.float64]) -> float:
    """Median of numbers, as `numpy.median`, which takes ten times as long to compile."""
    middle = values.shape[0] // 2
    found = smallest(values, middle)
    if values.shape[0] % 2:
        return found
    # none before the middle is larger
    below = float(values[0])
    for k in range(1, middle):
        below = max(below, float(values[k]))
    return 0.5 * (below + found)


@compiled()
def smallest(values: NDArray[np.float64], middle: int) -> float:
    """The number that stands at a place once all are sorted, by Wirth's selection."""
    low, high = 0, values.shape[0] - 1
    while low < high:
        pivot = values[middle]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if middle < i:
            high = j
    return float(values[middle])


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
