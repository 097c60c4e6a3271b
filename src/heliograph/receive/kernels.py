"""Hot loops of the receiver, compiled by Numba. `reference.py` says the same slowly; a test holds them together."""

import math

import numpy as np
from numba import njit
from scipy.special import ndtr

REACH = 4.0
"""Standard deviations after which an LED's light is taken for nothing (6e-5 of it)."""

_FARTHEST, _NODES = 8, 64
_Z = np.arange(-_FARTHEST * _NODES, _FARTHEST * _NODES + 1) / _NODES
_CDF, _PDF = ndtr(_Z), np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)


@njit(cache=True, nogil=True, inline="always")
def normal(z):
    """Phi(z) within 3e-10 and its derivative within 2e-7, in a fifth of the time of erf and exp.

    Kernels of other modules hold a copy of it in Numba's cache, which their own file's change alone renews.
    """
    z = min(max(z, -_FARTHEST), _FARTHEST)
    k = int((z + _FARTHEST) * _NODES + 0.5)
    h, at, pdf = z - _Z[k], _Z[k], _PDF[k]
    # Taylor's series about the nearest node: phi' = -z phi, phi'' = (z^2 - 1) phi
    curve = at * at - 1.0
    return _CDF[k] + pdf * h * (1.0 - h * (at / 2.0 - h * curve / 6.0)), pdf * (1.0 - h * (at - h * curve / 2.0))


@njit(cache=True, nogil=True)
def _axis(centre, sigma, first, count, g, dg, ds):
    """Share of a Gaussian on `count` pixels from `first` on, and its derivatives by centre and by ln sigma."""
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


@njit(cache=True, nogil=True, inline="always")
def _tilt(pose):
    """Stretch and shear of a pose vector (5,) or (7,)."""
    if pose.shape[0] == 7:
        return pose[5], pose[6]
    return 0.0, 0.0


@njit(cache=True, nogil=True)
def render(pose, weights, x0, y0, out):
    """Image of LEDs of given weights and its derivatives by (x, y, ln pitch, roll, ln blur, stretch, shear).

    pose (5,) or (7,) float64, weights (n, n) float64, window corner (x0, y0); out (6 or 8, rows, columns) float64 is
    overwritten: with 6 the derivatives by the tilt are left out. An array of weights 1 that is not resolved and not
    tilted has the image 1.
    """
    side = weights.shape[0]
    rows, cols = out.shape[1], out.shape[2]
    out[:] = 0.0
    pitch, sigma = math.exp(pose[2]), math.exp(pose[4])
    c, s = math.cos(pose[3]), math.sin(pose[3])
    half = (side - 1) / 2.0
    span = int(2 * REACH * sigma) + 3
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
                max(0, math.ceil(px - REACH * sigma - 0.5)),
                min(cols - 1, math.floor(px + REACH * sigma + 0.5)),
            )
            top, bottom = (
                max(0, math.ceil(py - REACH * sigma - 0.5)),
                min(rows - 1, math.floor(py + REACH * sigma + 0.5)),
            )
            nx, ny = right - left + 1, bottom - top + 1
            if nx <= 0 or ny <= 0:
                continue
            _axis(px, sigma, left, nx, gx, dgx, sgx)
            _axis(py, sigma, top, ny, gy, dgy, sgy)
            for i in range(ny):
                wg, wd, wsig = w * gy[i], w * dgy[i], w * sgy[i]
                for j in range(nx):
                    value, by_x, by_y = wg * gx[j], wg * dgx[j], wd * gx[j]
                    out[0, top + i, left + j] += value
                    out[1, top + i, left + j] += by_x
                    out[2, top + i, left + j] += by_y
                    # the LED's flux grows with pitch^2, hence 2 value
                    out[3, top + i, left + j] += by_x * rx + by_y * ry + 2.0 * value
                    out[4, top + i, left + j] += by_y * rx - by_x * ry
                    out[5, top + i, left + j] += wsig * gx[j] + wg * sgx[j]
                    if tilts:
                        out[6, top + i, left + j] += by_x * tx + by_y * ty
                        out[7, top + i, left + j] += by_x * hx + by_y * hy


@njit(cache=True, nogil=True)
def _edge(t, sigma):
    """Phi(t / sigma) and its derivative by t."""
    z = t / sigma
    if z > REACH:
        return 1.0, 0.0
    if z < -REACH:
        return 0.0, 0.0
    cdf, pdf = normal(z)
    return cdf, pdf / sigma


@njit(cache=True, nogil=True)
def render_box(pose, half_leds, x0, y0, out):
    """Blurred square of half width `half_leds` pitches about the array's centre, and its derivatives by the pose.

    out (6 or 8, rows, columns) as in `render`; a pixel's box is taken as its variance, 1/12; the derivatives by blur
    and tilt are 0.
    """
    rows, cols = out.shape[1], out.shape[2]
    half = half_leds * math.exp(pose[2])
    sigma = math.sqrt(math.exp(2.0 * pose[4]) + 1.0 / 12.0)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    stretch, shear = _tilt(pose)
    # (x, y) = [[xx, xy], [xy, yy]] R^T (dx, dy), the inverse of the tilt: the array's own directions, in which a
    # blur is as wide as the row of the inverse is long
    det = 1.0 - stretch * stretch - shear * shear
    xx, xy, yy = (1.0 - stretch) / det, -shear / det, (1.0 + stretch) / det
    wide, high = sigma * math.hypot(xx, xy), sigma * math.hypot(xy, yy)
    reach = REACH * max(wide, high)
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


@njit(cache=True, nogil=True)
def normal_equations(image, shapes, plane, linear, rough, matrix, vector):
    """Gauss-Newton normal equations of image = linear . (shapes(pose), plane), weights by Tukey's biweight.

    shapes (m, 1 + p, rows, columns): images and their derivatives by p parameters of the pose; plane (3, rows,
    columns); coefficients linear (m + 3,); `rough` is the biweight's scale. matrix (p + m + 3, p + m + 3) and vector
    (p + m + 3,) are overwritten. Returns the sum of weights and that of the weighted squared residuals.
    """
    rows, cols = image.shape
    m = shapes.shape[0]
    p = shapes.shape[1] - 1
    size = p + m + 3
    matrix[:] = 0.0
    vector[:] = 0.0
    row = np.empty(size)
    mass, loss = 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            r = _residual(image, shapes, plane, linear, i, j)
            q = r / rough
            if abs(q) >= 1.0:
                continue
            w = (1.0 - q * q) ** 2
            for k in range(p):
                slope = 0.0
                for n in range(m):
                    slope += linear[n] * shapes[n, k + 1, i, j]
                row[k] = slope
            for n in range(m):
                row[p + n] = shapes[n, 0, i, j]
            for n in range(3):
                row[p + m + n] = plane[n, i, j]
            mass += w
            loss += w * r * r
            for k in range(size):
                wk = w * row[k]
                vector[k] += wk * r
                for n in range(k + 1):
                    matrix[k, n] += wk * row[n]
    for k in range(size):
        for n in range(k):
            matrix[n, k] = matrix[k, n]
    return mass, loss


@njit(cache=True, nogil=True)
def residuals(image, shapes, plane, linear, out):
    """Image - linear . (shapes(pose), plane), as for `normal_equations`; out (rows, columns) is overwritten."""
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            out[i, j] = _residual(image, shapes, plane, linear, i, j)


@njit(cache=True, nogil=True, inline="always")
def _residual(image, shapes, plane, linear, i, j):
    m = shapes.shape[0]
    r = image[i, j]
    for n in range(m):
        r -= linear[n] * shapes[n, 0, i, j]
    for n in range(3):
        r -= linear[m + n] * plane[n, i, j]
    return r


@njit(cache=True, nogil=True)
def alternation(f0, f1, f2, f3, out):
    """(f0 - 3 f1 + 3 f2 - f3) / 4: a header stays, what moves evenly or accelerates evenly cancels."""
    rows, cols = out.shape
    for i in range(rows):
        a, b, c, d, o = f0[i], f1[i], f2[i], f3[i], out[i]
        for j in range(cols):
            o[j] = np.float32(0.25) * np.float32(
                np.int32(a[j]) - np.int32(d[j]) + 3 * (np.int32(c[j]) - np.int32(b[j]))
            )


@njit(cache=True, nogil=True, fastmath=True)
def block_means(image, size, out):
    """Mean magnitude over blocks of size x size pixels."""
    columns = np.empty(out.shape[1] * size, np.float32)
    for bi in range(out.shape[0]):
        columns[:] = 0.0
        for i in range(bi * size, bi * size + size):
            row = image[i]
            for j in range(columns.shape[0]):
                columns[j] += abs(row[j])
        for bj in range(out.shape[1]):
            total = np.float32(0.0)
            for j in range(bj * size, bj * size + size):
                total += columns[j]
            out[bi, bj] = total / np.float32(size * size)


@njit(cache=True, nogil=True)
def _corner(integral, y, x):
    """Integral image between its grid points."""
    i, j = int(y), int(x)
    fy, fx = y - i, x - j
    top = integral[i, j] + fx * (integral[i, j + 1] - integral[i, j])
    low = integral[i + 1, j] + fx * (integral[i + 1, j + 1] - integral[i + 1, j])
    return top + fy * (low - top)


@njit(cache=True, nogil=True)
def _box(integral, y, x, height, width):
    return (
        _corner(integral, y + height, x + width)
        - _corner(integral, y, x + width)
        - _corner(integral, y + height, x)
        + _corner(integral, y, x)
    )


@njit(cache=True, nogil=True)
def _to_grid(start, step):
    """How far the next multiple of a step is from a start."""
    return math.ceil(start / step - 1e-9) * step - start


@njit(cache=True, nogil=True)
def search(total, square, busy, block, cells, sides, contrast, threshold, corner, best):
    """Correlate the alternation with all headers over scale and position.

    total, square: integral images (rows + 1, columns + 1) of the alternation and of its square; busy: coarse map of
    blocks in which something alternates; cells (identities, 16) of +-1; corner (2,): x, y on the sensor of the first
    pixel, for the places looked at are the same on the sensor whatever its window. Writes into best (count, 5) the best
    rows (score, x, y, side, identity), score signed, sorted from the best; overlapping ones are merged. Returns how
    many.
    """
    rows, cols = total.shape[0] - 1, total.shape[1] - 1
    sums = np.empty(16)
    found = 0
    for k in range(sides.shape[0]):
        side = sides[k]
        step = max(1.0, side / 10.0)
        ring = 0.12 * side
        cell = side / 4.0
        y = ring + _to_grid(corner[1], step)
        while y + side + ring < rows - 1:
            x = ring + _to_grid(corner[0], step)
            while x + side + ring < cols - 1:
                if not busy[int((y + 0.5 * side) / block), int((x + 0.5 * side) / block)]:
                    x += step
                    continue
                energy = _box(square, y - ring, x - ring, side + 2 * ring, side + 2 * ring)
                if energy < contrast * contrast * side * side:
                    x += step
                    continue
                power = 0.0
                for i in range(4):
                    for j in range(4):
                        value = _box(total, y + i * cell, x + j * cell, cell, cell)
                        sums[4 * i + j] = value
                        power += value * value
                # |<D, T>| <= |sums| 4 and |T| |D| = side sqrt(energy)
                bound = threshold * side * math.sqrt(energy)
                if 16.0 * power >= bound * bound:
                    for t in range(cells.shape[0]):
                        dot = 0.0
                        for i in range(16):
                            dot += cells[t, i] * sums[i]
                        if abs(dot) >= bound:
                            score = dot / (side * math.sqrt(energy))
                            found = _keep(best, found, score, x + 0.5 * side, y + 0.5 * side, side, t)
                x += step
            y += step
    return found


@njit(cache=True, nogil=True)
def _keep(best, found, score, x, y, side, identity):
    """Insert a candidate unless a better one lies on the same place; drop worse ones there."""
    i = 0
    while i < found:
        reach = 0.5 * max(side, best[i, 3])
        if abs(best[i, 1] - x) < reach and abs(best[i, 2] - y) < reach:
            if abs(best[i, 0]) >= abs(score):
                return found
            for m in range(i, found - 1):
                best[m] = best[m + 1]
            found -= 1
        else:
            i += 1
    place = found
    while place > 0 and abs(best[place - 1, 0]) < abs(score):
        place -= 1
    if place >= best.shape[0]:
        return found
    last = min(found, best.shape[0] - 1)
    for m in range(last, place, -1):
        best[m] = best[m - 1]
    best[place, 0], best[place, 1], best[place, 2], best[place, 3], best[place, 4] = score, x, y, side, identity
    return min(found + 1, best.shape[0])


@njit(cache=True, nogil=True)
def sample_cubic(image, points, out):
    """Image at points (n, 2) of (x, y) by cubic convolution (Keys 1981, a = -1/2); the border repeats."""
    rows, cols = image.shape
    wx, wy = np.empty(4), np.empty(4)
    for p in range(points.shape[0]):
        x, y = points[p, 0], points[p, 1]
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
        out[p] = value
