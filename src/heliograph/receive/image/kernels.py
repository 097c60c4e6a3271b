"""Hot loops of images: the light of LEDs on pixels.

`reference.py` holds the same in plain NumPy; a test holds the two together.
"""

import math

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.receive.image.normal import normal

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
