"""Compiled kernels: images of LEDs, small linear systems, medians, and the Gauss-Newton fit of a pose.

Loops replace array expressions and assignments of slices, which take ten times as long to compile.
`tests/oracles/render_oracle.py` and `fit_oracle.py` state the same in plain NumPy.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled


class FitParameters(NamedTuple):
    """Tuning of images and fits; Numba compiles a named tuple into the kernels as constants."""

    # Standard deviations beyond which an LED gives no light
    light_reach: float = 4.0
    # Rims in pitches of two squares around the LEDs, which together stand for a panel of unknown width and gray
    panel_margins: tuple[float, float] = (0.75, 2.0)
    # Longest step of the centre in px, or half a pitch if that is more
    max_step_px: float = 0.8
    # Longest steps of ln pitch, roll, ln blur, stretch and shear: about half a pitch at the rim of 16 LEDs
    max_steps: tuple[float, float, float, float, float] = (0.1, 0.05, 0.2, 0.05, 0.05)


FIT = FitParameters()
LEAST_VARIANCE = 0.08  # variance of rounding to gray levels, 1/12


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
    reach_x, reach_y = FIT.light_reach * sigma_x, FIT.light_reach * sigma_y
    span = int(2 * max(reach_x, reach_y)) + 3
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
            left, right = max(0, math.ceil(px - reach_x - 0.5)), min(cols - 1, math.floor(px + reach_x + 0.5))
            top, bottom = max(0, math.ceil(py - reach_y - 0.5)), min(rows - 1, math.floor(py + reach_y + 0.5))
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
    if z > FIT.light_reach:
        return 1.0, 0.0
    if z < -FIT.light_reach:
        return 0.0, 0.0
    cdf, pdf = normal(z)
    return cdf, pdf / sigma


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
    reach = FIT.light_reach * max(wide, high)
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
    reach = FIT.light_reach * sigma + 1.0
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
def solve(matrix, rhs):
    """Solve M x = b in place of b, by Cholesky."""
    lower = np.empty(matrix.shape)
    _factor(matrix, lower)
    _substitute(lower, rhs)


@compiled()
def invert(matrix, out):
    """Compute the first rows and columns of an inverse, to fill `out`."""
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
    """Factor M = L L^T by Cholesky; L is not finite if M is not positive definite."""
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
def rows_for_products(count, cols):
    """Allocate rows of pixels for `add_products`, padded by zeros to a multiple of four."""
    return np.zeros((-(-count // 4) * 4, cols))


@compiled(fastmath={"reassoc", "contract"})
def add_products(left, right, cols, out):
    """Add the lower half of left right^T to `out`; four sums at a time do not wait for each other."""
    for k in range(out.shape[0]):
        for n in range(0, k + 1, 4):
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
def split_products(products, matrix, rhs):
    """Split sums of products into normal equations; the last row holds the products with the target."""
    size = matrix.shape[0]
    for k in range(size):
        rhs[k] = products[size, k]
        for n in range(k + 1):
            matrix[k, n] = matrix[n, k] = products[k, n]


@compiled()
def median(values: NDArray[np.float64]) -> float:
    """Compute the median; `numpy.median` takes ten times as long to compile."""
    middle = values.shape[0] // 2
    upper = smallest(values, middle)
    if values.shape[0] % 2:
        return upper
    # all values before the middle are smaller or equal
    return 0.5 * (smallest(values[:middle], middle - 1) + upper)


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
def near(vector, anchor, side):
    """True if images at an anchor pose, moved by their slopes, stand for a pose."""
    step = np.empty(vector.size)
    for k in range(vector.size):
        step[k] = vector[k] - anchor[k]
    # both are False for a pose that is not a number
    return _rim_px(step, step.size, vector, side) < 0.1 and abs(step[4]) < 0.02


@compiled()
def shift(vector, shapes, drawn):
    """Move images to another pose by the slopes."""
    for n in range(shapes.shape[0]):
        for k in range(1, shapes.shape[1]):
            step = vector[k - 1] - drawn[k - 1]
            for i in range(shapes.shape[2]):
                for j in range(shapes.shape[3]):
                    shapes[n, 0, i, j] += step * shapes[n, k, i, j]
    for k in range(vector.size):
        drawn[k] = vector[k]


@compiled()
def draw(vector, open_pixels, scene, images):
    """Draw the array and squares around it at a pose, the new anchor."""
    (corner, weights, margins, resolved, smear), (shapes, anchor, drawn) = scene, images
    for k in range(vector.size):
        anchor[k] = drawn[k] = vector[k]
    half = 0.5 * weights.shape[0]
    if resolved:
        render(vector, weights, corner[0], corner[1], shapes[0], smear[0], smear[1])
    else:
        render_box(vector, half, corner[0], corner[1], shapes[0], smear[0], smear[1])
    for k in range(margins.shape[0]):
        render_box(vector, half + margins[k], corner[0], corner[1], shapes[k + 1], smear[0], smear[1])
    for n in range(shapes.shape[0]):
        for k in range(shapes.shape[1]):
            for i in range(open_pixels.shape[0]):
                for j in range(open_pixels.shape[1]):
                    shapes[n, k, i, j] *= open_pixels[i, j]


@compiled()
def fit(image, plane, open_pixels, scene, expected, steps, vector, images):
    """Fit the most probable pose by Gauss-Newton with robust weights.

    `scene` is as in `draw`, `expected` vector, covariance and gain before the fit, and `images` of any pose.
    """
    (_, weights, margins, _, _), (prior, covariance, gain), (shapes, anchor, drawn) = scene, expected, images
    free = covariance.shape[0]
    precision = np.empty((free, free))
    invert(covariance, precision)
    size = free + shapes.shape[0] + 3
    matrix, rhs = np.empty((size, size)), np.empty(size)
    residual = np.empty(image.shape)
    if near(vector, anchor, len(weights)):
        shift(vector, shapes, drawn)
    else:
        draw(vector, open_pixels, scene, images)
    linear = _coefficients(image, shapes, plane, gain)
    for _ in range(steps):
        residuals(image, shapes, plane, linear, residual)
        noise, count = _noise_of(residual, open_pixels)
        # Tukey's biweight of 95 % efficiency
        mass, loss = normal_equations(residual, shapes, plane, linear, 4.685 * noise, matrix, rhs)
        noise = max(loss / max(mass - (residual.size - count) - size, 1.0), LEAST_VARIANCE)
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
            # a bright sky adds half to a dark panel's rim
            weight = (0.5 * gain) ** -2
            matrix[free, free] += weight
            rhs[free] += weight * (gain - linear[0])
        _load(matrix, 1e-9)
        step = rhs.copy()
        solve(matrix, step)
        for k in range(free, size):
            linear[k - free] += step[k]
        pitch = math.exp(vector[2])
        for k in range(free):
            limit = max(FIT.max_step_px, 0.5 * pitch) if k < 2 else FIT.max_steps[k - 2]
            vector[k] += min(max(step[k], -limit), limit)
        close = _rim_px(step, free, vector, len(weights)) < 0.02 and abs(step[4]) < 0.02
        # headers give the distance: pitch and blur need all steps
        if len(margins) and close and abs(step[free]) < 0.1 * abs(linear[0]):
            break
        draw(vector, open_pixels, scene, images)
    residuals(image, shapes, plane, linear, residual)
    posterior = np.empty((free, free))
    invert(matrix, posterior)
    return posterior, linear, _correlation(image, residual, open_pixels)


@compiled()
def _coefficients(image, shapes, plane, gain):
    """Fit the coefficients of the images by least squares, near an expected gain unless that is 0."""
    m, cols = shapes.shape[0], image.shape[1]
    size = m + 3
    products, values = np.zeros((size + 1, size + 1)), rows_for_products(size + 1, cols)
    for i in range(image.shape[0]):
        _copy_images(shapes, plane, i, values, np.int64(0))  # a plain 0 would compile a second version
        for j in range(cols):
            values[size, j] = image[i, j]
        add_products(values, values, cols, products)
    matrix, rhs = np.empty((size, size)), np.empty(size)
    split_products(products, matrix, rhs)
    if gain != 0.0:
        weight = 1e3 * matrix[0, 0]
        matrix[0, 0] += weight
        rhs[0] += weight * gain
    # array and plane may be alike
    _load(matrix, 1e-6)
    solve(matrix, rhs)
    return rhs


@compiled()
def _copy_images(shapes, plane, row, out, first):
    """Copy a row of pixels of the images to rows of `out`."""
    for n in range(shapes.shape[0]):
        for j in range(out.shape[1]):
            out[first + n, j] = shapes[n, 0, row, j]
    for n in range(3):
        for j in range(out.shape[1]):
            out[first + shapes.shape[0] + n, j] = plane[n, row, j]


@compiled(fastmath={"reassoc", "contract"})
def normal_equations(residual, shapes, plane, linear, rough, matrix, vector):
    """Build the normal equations of image = linear . (shapes(pose), plane), weighted by Tukey's biweight."""
    rows, cols = residual.shape
    m = shapes.shape[0]
    p = shapes.shape[1] - 1
    size = p + m + 3
    # row by row of pixels; the residual follows the slopes
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
        _copy_images(shapes, plane, i, slopes, p)
        for k in range(size + 1):
            for j in range(cols):
                weighed[k, j] = w[j] * slopes[k, j]
        add_products(weighed, slopes, cols, products)
    split_products(products, matrix, vector)
    return mass, products[size, size]


@compiled()
def residuals(image, shapes, plane, linear, out):
    """Compute the residuals image - linear . (shapes(pose), plane)."""
    m = shapes.shape[0]
    # image by image: consecutive pixels are fast
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
    """Estimate the standard deviation of residuals in open pixels from the median magnitude; also count the pixels."""
    sizes, count = np.empty(residual.size), 0
    for i in range(residual.shape[0]):
        for j in range(residual.shape[1]):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                sizes[count] = abs(residual[i, j])
                count += 1
    # median |x| / Phi^-1(3/4), and the largest error of rounding at least
    return max(1.4826 * median(sizes[:count]), 0.5) if count else 0.5, count


@compiled()
def _load(matrix, loading):
    """Load a diagonal in place: M + lambda (diag M + epsilon 1)."""
    for k in range(matrix.shape[0]):
        # images without light have no information
        matrix[k, k] += loading * (matrix[k, k] + 1e-3)


@compiled()
def _correlation(image, residual, open_pixels):
    """Correlate an image and the fitted image over open pixels."""
    rows, cols = image.shape
    mean, rest, count = 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                mean += image[i, j]
                rest += residual[i, j]
                count += 1.0
    mean, rest = mean / max(count, 1.0), rest / max(count, 1.0)
    cross, power_x, power_y = 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            if open_pixels.size == 0 or open_pixels[i, j] > 0.0:
                x = image[i, j] - mean
                y = x - residual[i, j] + rest
                cross += x * y
                power_x += x * x
                power_y += y * y
    return cross / math.sqrt(max(power_x * power_y, TINY))


@compiled()
def _rim_px(step, free, vector, side):
    """Distance in px by which a step of `free` pose parameters moves the rim of an array."""
    turn = max(abs(step[2]), abs(step[3]))
    for k in range(5, free):
        turn = max(turn, abs(step[k]))
    return max(abs(step[0]), abs(step[1])) + 0.5 * side * math.exp(vector[2]) * turn


@compiled()
def sample_cubic(image, points, out):
    """Image between its pixels by cubic convolution (Keys 1981, a = -1/2); the border repeats."""
    wx, wy = np.empty(4), np.empty(4)
    for p in range(points.shape[0]):
        out[p] = _cubic(image, points[p, 0], points[p, 1], wx, wy)


@compiled()
def cubic_at_leds(image, x, y, axes, out):
    """Image at the LEDs by cubic convolution, as in `sample_cubic`."""
    side = out.shape[0]
    wx, wy = np.empty(4), np.empty(4)
    for u in range(side):
        for v in range(side):
            along, down = v - 0.5 * (side - 1), u - 0.5 * (side - 1)
            px = along * axes[0, 0] + down * axes[0, 1] + x
            out[u, v] = _cubic(image, px, along * axes[1, 0] + down * axes[1, 1] + y, wx, wy)


@compiled()
def _cubic(image, x, y, wx, wy):
    """Image at a point, with scratch for the weights along x and y."""
    rows, cols = image.shape
    j, i = math.floor(x), math.floor(y)
    for axis in range(2):
        t, w = (x - j, wx) if axis == 0 else (y - i, wy)
        w[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
        w[1] = (1.5 * t - 2.5) * t * t + 1.0
        w[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
        w[3] = (0.5 * t - 0.5) * t * t
    value = 0.0
    for a in range(4):
        r = min(max(i + a - 1, 0), rows - 1)
        for b in range(4):
            value += wy[a] * wx[b] * image[r, min(max(j + b - 1, 0), cols - 1)]
    return value
