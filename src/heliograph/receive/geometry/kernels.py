"""Compiled kernels: images of LEDs, medians, and the Gauss-Newton fit of a pose.

`tests/oracles/render_oracle.py` and `fit_oracle.py` state the same in plain NumPy.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

LIGHT_REACH = 4.0  # standard deviations beyond which an LED gives no light
LEAST_VARIANCE = 0.08  # variance of rounding to gray levels, 1/12

PANEL_MARGINS = (0.75, 2.0)
"""Rims in pitches of two squares around the LEDs, which together represent a panel of unknown width and gray."""

MAX_STEPS = (0.8, 0.8, 0.1, 0.05, 0.2, 0.05, 0.05)
"""Longest steps of x and y in px, ln pitch, roll, ln blur, stretch and shear: half a pitch at the rim of 16 LEDs."""


@compiled()
def _axis(centre, sigma, first, count, g, dg, ds):
    """Integrate a Gaussian over `count` pixels from `first`; also the derivatives by centre and ln sigma."""
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
    """Stretch and shear of a pose vector, (5,) or (7,)."""
    if pose.shape[0] == 7:
        return pose[5], pose[6]
    return 0.0, 0.0


@compiled()
def render(pose, weights, x0, y0, out, smear_x, smear_y):
    """Render LEDs and the derivatives by the pose; an unresolved array of weights 1 has the image 1."""
    side = weights.shape[0]
    rows, cols = out.shape[1], out.shape[2]
    out[:] = 0.0
    pitch, blur = math.exp(pose[2]), math.exp(pose[4])
    # sigma^2 = blur^2 + smear^2, hence d ln sigma / d ln blur = blur^2 / sigma^2
    sigma_x, sigma_y = math.hypot(blur, smear_x), math.hypot(blur, smear_y)
    part_x, part_y = (blur / sigma_x) ** 2, (blur / sigma_y) ** 2
    c, s = math.cos(pose[3]), math.sin(pose[3])
    half = (side - 1) / 2.0
    span = int(2 * LIGHT_REACH * max(sigma_x, sigma_y)) + 3
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
            # derivatives by stretch (p, -q) and by shear (q, p), both rotated
            tx, ty, hx, hy = c * p + s * q, s * p - c * q, c * q - s * p, s * q + c * p
            px, py = pose[0] + rx - x0, pose[1] + ry - y0
            left, right = (
                max(0, math.ceil(px - LIGHT_REACH * sigma_x - 0.5)),
                min(cols - 1, math.floor(px + LIGHT_REACH * sigma_x + 0.5)),
            )
            top, bottom = (
                max(0, math.ceil(py - LIGHT_REACH * sigma_y - 0.5)),
                min(rows - 1, math.floor(py + LIGHT_REACH * sigma_y + 0.5)),
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
def render_box(pose, half_leds, x0, y0, out, smear_x, smear_y):
    """Render a blurred square of brightness 1 about the array's centre, and the derivatives by the pose.

    A pixel's box counts as the variance 1/12; the derivatives by blur and tilt are 0. If the smear along x and y
    differs, the change of an edge's width with the roll is neglected.
    """
    rows, cols = out.shape[1], out.shape[2]
    half = half_leds * math.exp(pose[2])
    narrow = math.exp(2.0 * pose[4]) + 1.0 / 12.0
    sigma_x, sigma_y = math.sqrt(narrow + smear_x**2), math.sqrt(narrow + smear_y**2)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    stretch, shear = _tilt(pose)
    # (x, y) = [[xx, xy], [xy, yy]] R^T (dx, dy), the inverse of the tilt; along the axes of the array a blur is
    # as wide as the row of the inverse is long
    det = 1.0 - stretch * stretch - shear * shear
    xx, xy, yy = (1.0 - stretch) / det, -shear / det, (1.0 + stretch) / det
    wide = math.hypot(sigma_x * (xx * c - xy * s), sigma_y * (xx * s + xy * c))
    high = math.hypot(sigma_x * (xy * c - yy * s), sigma_y * (xy * s + yy * c))
    reach = LIGHT_REACH * max(wide, high)
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
            right, right_slope = normal((half - x) / wide)
            left, left_slope = normal((half + x) / wide)
            low, low_slope = normal((half - y) / high)
            top, top_slope = normal((half + y) / high)
            bx, by = right + left - 1.0, low + top - 1.0
            by_x, by_y = (left_slope - right_slope) / wide * by, (top_slope - low_slope) / high * bx
            by_along, by_across = xx * by_x + xy * by_y, xy * by_x + yy * by_y
            out[0, i, j] = bx * by
            out[1, i, j] = -c * by_along + s * by_across
            out[2, i, j] = -s * by_along - c * by_across
            out[3, i, j] = half * ((left_slope + right_slope) / wide * by + (top_slope + low_slope) / high * bx)
            out[4, i, j] = across * by_along - along * by_across


@compiled()
def footprints(pose, across, down):
    """Compute the light of each LED by column and row; an unresolved array with all LEDs on has the image 1.

    LEDs come in quarters, as in `footprint.to_quarters`.
    """
    side = round(math.sqrt(across.shape[0]))
    half = side // 2
    for k in range(across.shape[0]):
        corner, square = divmod(k, half * half)
        a = 2 * (square % half) + corner % 2 - (side - 1) / 2.0
        b = 2 * (square // half) + corner // 2 - (side - 1) / 2.0
        _row_of_light(pose[0] + pose[2] * a + pose[3] * b, pose[7], pose[6], across[k])
        _row_of_light(pose[1] + pose[4] * a + pose[5] * b, pose[8], pose[6], down[k])


@compiled()
def _row_of_light(centre, sigma, scale, out):
    """Integrate a scaled Gaussian over each pixel."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    out[:] = 0.0
    reach = LIGHT_REACH * sigma + 1.0
    first, last = max(0, math.ceil(centre - reach)), min(out.shape[0] - 1, math.floor(centre + reach))
    cdf, _ = normal((first - 0.5 - centre) / sigma)
    for j in range(first, last + 1):
        after, _ = normal((j + 0.5 - centre) / sigma)
        out[j] = scale * (after - cdf)
        cdf = after


# Cumulative distribution and density of the normal distribution at 64 nodes a standard deviation, from -8 to 8
_NORMAL = np.stack([ndtr(_z := np.arange(-512, 513) / 64), np.exp(-0.5 * _z**2) / math.sqrt(2.0 * math.pi)])


@compiled(inline="always")
def normal(z):
    """Look up the normal distribution and density, in a fifth of the time of erf and exp; errors are below 1e-10."""
    z = min(max(z, -8.0), 8.0)
    k = int((z + 8.0) * 64.0 + 0.5)
    at, pdf = (k - 512) / 64.0, _NORMAL[1, k]
    h = z - at
    # Taylor series about the nearest node: phi' = -z phi, phi'' = (z^2 - 1) phi
    curve = at * at - 1.0
    return _NORMAL[0, k] + pdf * h * (1.0 - h * (at / 2.0 - h * curve / 6.0)), pdf * (1.0 - h * (at - h * curve / 2.0))


@compiled()
def median(values: NDArray[np.float64]) -> float:
    """Compute the median; `numpy.median` takes ten times as long to compile."""
    middle = values.shape[0] // 2
    upper = smallest(values, middle)
    if values.shape[0] % 2:
        return upper
    # all values before the middle are smaller or equal
    below = float(values[0])
    for k in range(1, middle):
        below = max(below, float(values[k]))
    return 0.5 * (below + upper)


@compiled()
def smallest(values: NDArray[np.float64], middle: int) -> float:
    """Select the number at an index of the sorted values, by Wirth's algorithm."""
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


@compiled()
def correlation(a, b):
    """Compute the correlation of two rows of pixels."""
    x, y = a - a.mean(), b - b.mean()
    return (x * y).sum() / math.sqrt(max((x * x).sum() * (y * y).sum(), TINY))


@compiled()
def fit(image, is_open, corner, weights, margins, resolved, smear, prior, covariance, gain, steps, vector, rows):
    """Fit the most probable pose to the open pixels by Gauss-Newton with robust weights.

    `vector` is the start and becomes the result. Rows are the derivatives by the pose, the images of the array and of
    squares around it, and the given images of the background.
    """
    pixels, free, images = image.ravel(), covariance.shape[0], 1 + margins.shape[0]
    size, columns = len(rows), rows[free:]
    shapes = np.empty((images, 1 + free, *image.shape))
    precision, half = np.linalg.inv(covariance), 0.5 * len(weights)
    matrix, linear, fitted = np.eye(size), np.empty(0), pixels
    for number in range(steps):
        if resolved:
            render(vector, weights, corner[0], corner[1], shapes[0], smear[0], smear[1])
        else:
            render_box(vector, half, corner[0], corner[1], shapes[0], smear[0], smear[1])
        for k in range(1, images):
            render_box(vector, half + margins[k - 1], corner[0], corner[1], shapes[k], smear[0], smear[1])
        for k in range(images):
            columns[k] = shapes[k, 0].ravel()
        if number == 0:
            linear = _coefficients(pixels, is_open, columns, gain)
        for k in range(free):
            rows[k] = linear[0] * shapes[0, k + 1].ravel()
            for n in range(1, images):
                rows[k] += linear[n] * shapes[n, k + 1].ravel()
        residual = pixels - linear @ columns
        # Tukey's biweight of 95 % efficiency: median |x| / Phi^-1(3/4), and the largest error of rounding at least
        rough = 4.685 * max(1.4826 * median(np.abs(residual[is_open])), 0.5)
        weight = is_open * np.maximum(1.0 - (residual / rough) ** 2, 0.0) ** 2
        noise = max((weight * residual**2).sum() / max(weight.sum() - size, 1.0), LEAST_VARIANCE)
        # (J^T W J + P^-1) step = J^T W r + P^-1 (theta_0 - theta), and the same for the gain
        weighed = rows * (weight / noise)
        matrix, rhs = weighed @ rows.T, weighed @ residual
        matrix[:free, :free] += precision
        rhs[:free] += precision @ (prior - vector[:free])
        if gain != 0.0:
            # a bright sky adds half to a dark panel's rim
            matrix[free, free] += (0.5 * gain) ** -2
            rhs[free] += (0.5 * gain) ** -2 * (gain - linear[0])
        _load(matrix, 1e-9)
        step = np.linalg.solve(matrix, rhs)
        pitch = math.exp(vector[2])
        for k in range(free):
            limit = max(MAX_STEPS[k], 0.5 * pitch) if k < 2 else MAX_STEPS[k]
            step[k] = min(max(step[k], -limit), limit)
        vector[:free] += step[:free]
        linear += step[free:]
        fitted = pixels - residual + step @ rows
        turn = max(abs(step[2]), abs(step[3]), np.abs(step[5:free]).max() if free > 5 else 0.0)
        rim_px = max(abs(step[0]), abs(step[1])) + half * pitch * turn
        # images are linear in so short a step; headers give the distance: pitch and blur need all steps
        if images > 1 and rim_px < 0.1 and abs(step[4]) < 0.02 and abs(step[free]) < 0.1 * abs(linear[0]):
            break
    posterior = np.linalg.inv(matrix)[:free, :free].copy()
    return posterior, linear, correlation(pixels[is_open], fitted[is_open])


@compiled()
def _coefficients(pixels, is_open, columns, gain):
    """Fit the coefficients of the images by least squares, near an expected gain unless that is 0."""
    weighed = columns * is_open
    matrix, rhs = weighed @ columns.T, weighed @ pixels
    if gain != 0.0:
        rhs[0] += 1e3 * matrix[0, 0] * gain
        matrix[0, 0] *= 1e3 + 1.0
    # array and plane may be alike
    _load(matrix, 1e-6)
    return np.linalg.solve(matrix, rhs)


@compiled()
def _load(matrix, loading):
    """Load a diagonal in place: M + lambda (diag M + epsilon 1)."""
    for k in range(len(matrix)):
        # images without light have no information
        matrix[k, k] += loading * (matrix[k, k] + 1e-3)
