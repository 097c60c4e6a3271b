"""Hot loops of the soft receiver, compiled by Numba; `reference.py` says the same with whole matrices.

Everything is counted in data cells, the order in which `PacketFormat.split` hands them out: the quarters D11, D12, D21
and D22 of the data matrix, row by row. The four cells of equal place in their quarters are the Haar transform of one
square of 2 x 2 LEDs, so that the transform of a matrix of LEDs goes square by square.
"""

import math

import numpy as np
from numba import njit

from heliograph.receive.kernels import normal

FEW, MANY = 2, 6
"""Cells that are drawn from -1 and +1 as those that disturb another most, at first and on a closer look."""

DOUBTFUL, SURE = 3.0, 10.0
"""LLRs in magnitude, 5 % and 5e-5 wrong, between which it is worth the time."""

REACH = 3.7
"""Standard deviations after which an LED's light is taken for nothing (2e-4 of it)."""


def support(sigma: float) -> int:
    """Pixels across which an LED of a blur is counted."""
    return 2 * math.ceil(REACH * sigma + 0.5) + 1


@njit(cache=True, nogil=True)
def place(pose, rows, cols, across, down, first):
    """Light of each LED on the columns and rows of a window's pixels about it.

    pose (9,): x, y in the window; from one LED to the next dx by column and by row, dy by column and by row; the pitch;
    sigma along x, sigma along y. LEDs in the order of the cells: square by square, in each (0, 0), (0, 1), (1, 0),
    (1, 1). across, down (n n, width) and first (n n, 2) int64, the first column and row, are overwritten. A wide array
    with all LEDs on has the image 1.
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
        _shares(x, pose[7], first[k, 0], cols, pitch, across[k])
        _shares(y, pose[8], first[k, 1], rows, pitch, down[k])


@njit(cache=True, nogil=True, inline="always")
def _shares(centre, sigma, first, count, scale, out):
    """Share of a Gaussian in each pixel from `first` on, times a scale; 0 beyond the window's `count` pixels."""
    # g_j = Phi((j + 1/2 - c) / sigma) - Phi((j - 1/2 - c) / sigma)
    cdf, _ = normal((first - 0.5 - centre) / sigma)
    for j in range(out.shape[0]):
        after, _ = normal((first + j + 0.5 - centre) / sigma)
        out[j] = scale * (after - cdf) if 0 <= first + j < count else 0.0
        cdf = after


@njit(cache=True, nogil=True)
def roots(shares, first, lit, dark, ring, out):
    """Roots of the weights of a window's columns or rows, out (pixels,): W = lit / s^2, 0 in the outer `ring` pixels.

    s^2 = dark + (lit - dark) f, f what all LEDs together give, 0 to 1; shares (n n, width) and first (n n,).
    """
    out[:] = 0.0
    for k in range(shares.shape[0]):
        for i in range(max(0, -first[k]), min(shares.shape[1], out.shape[0] - first[k])):
            out[first[k] + i] += shares[k, i]
    side = math.sqrt(shares.shape[0])
    for j in range(out.shape[0]):
        f = min(out[j] / side, 1.0)
        inside = ring <= j < out.shape[0] - ring
        out[j] = math.sqrt(lit / (dark + (lit - dark) * f)) if inside else 0.0


@njit(cache=True, nogil=True)
def weighted(shares, first, root, out):
    """Shares with each pixel's weight on them, out (n n, width), root (pixels,)."""
    for k in range(shares.shape[0]):
        for i in range(shares.shape[1]):
            j = first[k] + i
            out[k, i] = shares[k, i] * root[j] if 0 <= j < root.shape[0] else 0.0


@njit(cache=True, nogil=True, inline="always")
def _haar(a, b, c, d):
    """A square of LEDs (0, 0), (0, 1), (1, 0), (1, 1) to its four cells: 1/4 H t H^T."""
    q = np.float32(0.25)  # which leaves the sums in their own precision
    return q * (a + b + c + d), q * (a - b + c - d), q * (a + b - c - d), q * (a - b - c + d)


@njit(cache=True, nogil=True)
def seen_by_cells(image, across, down, first, out):
    """B^T image: the image's correlation with that of each cell; image (rows, columns), out (n n,)."""
    squares, width = across.shape[0] // 4, across.shape[1]
    rows, cols = image.shape
    led = np.empty(4)
    for q in range(squares):
        for k in range(4):
            n = 4 * q + k
            x, y, total = first[n, 0], first[n, 1], 0.0
            for i in range(max(0, -y), min(width, rows - y)):
                line = 0.0
                for j in range(max(0, -x), min(width, cols - x)):
                    line += image[y + i, x + j] * across[n, j]
                total += line * down[n, i]
            led[k] = total
        out[q], out[squares + q], out[2 * squares + q], out[3 * squares + q] = _haar(led[0], led[1], led[2], led[3])


@njit(cache=True, nogil=True)
def all_seen_by_cells(images, across, down, first, out):
    """`seen_by_cells` of many images at once, images (rows, columns, k) and out (n n, k)."""
    squares, width = across.shape[0] // 4, across.shape[1]
    rows, cols, count = images.shape
    led, line = np.empty((4, count)), np.empty(count)
    for q in range(squares):
        for k in range(4):
            n = 4 * q + k
            x, y = first[n, 0], first[n, 1]
            led[k] = 0.0
            for i in range(max(0, -y), min(width, rows - y)):
                line[:] = 0.0
                for j in range(max(0, -x), min(width, cols - x)):
                    for m in range(count):
                        line[m] += images[y + i, x + j, m] * across[n, j]
                for m in range(count):
                    led[k, m] += line[m] * down[n, i]
        for m in range(count):
            a, b, c, d = _haar(led[0, m], led[1, m], led[2, m], led[3, m])
            out[q, m], out[squares + q, m], out[2 * squares + q, m], out[3 * squares + q, m] = a, b, c, d


@njit(cache=True, nogil=True)
def leds(cells):
    """Levels about their mean of LEDs in the order of `place`, t = 1/4 H^T D H, of cells (n n,)."""
    squares = cells.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = cells[q], cells[squares + q], cells[2 * squares + q], cells[3 * squares + q]
        out[4 * q], out[4 * q + 1], out[4 * q + 2], out[4 * q + 3] = _haar(a, b, c, d)
    return out


@njit(cache=True, nogil=True)
def cells(leds):
    """The inverse of `leds`: D = H t H^T."""
    squares = leds.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = _haar(leds[4 * q], leds[4 * q + 1], leds[4 * q + 2], leds[4 * q + 3])
        out[q], out[squares + q], out[2 * squares + q], out[3 * squares + q] = 4.0 * a, 4.0 * b, 4.0 * c, 4.0 * d
    return out


@njit(cache=True, nogil=True)
def shine(leds, across, down, first, out):
    """Add the image of LEDs of given weights (n n,), in the order of `place`, to out (rows, columns)."""
    width = across.shape[1]
    rows, cols = out.shape
    for n in range(leds.shape[0]):
        x, y = first[n, 0], first[n, 1]
        for i in range(max(0, -y), min(width, rows - y)):
            w = leds[n] * down[n, i]
            for j in range(max(0, -x), min(width, cols - x)):
                out[y + i, x + j] += w * across[n, j]


@njit(cache=True, nogil=True)
def spread(shares, first, out):
    """Shares (n n, width) in their places, out (n n, pixels) float32, 0 elsewhere.

    LEDs there in the order of the cells: those of equal place in their squares together.
    """
    squares = shares.shape[0] // 4
    out[:] = 0.0
    for k in range(shares.shape[0]):
        row = out[k % 4 * squares + k // 4]
        for i in range(max(0, -first[k]), min(shares.shape[1], out.shape[1] - first[k])):
            row[first[k] + i] = shares[k, i]


@njit(cache=True, nogil=True)
def gram(across, down, out):
    """B^T B of the cells, out (n n, n n) float32.

    across, down (n n, n n): products of the LEDs' light by column and by row, in the order of `spread`. <led_i, led_j>
    = <across_i, across_j> <down_i, down_j>, then the Haar transform on both sides.
    """
    squares = across.shape[0] // 4
    for i in range(across.shape[0]):
        x, y, row = across[i], down[i], out[i]
        for p in range(squares):
            a, b, c, d = p, p + squares, p + 2 * squares, p + 3 * squares
            row[a], row[b], row[c], row[d] = _haar(x[a] * y[a], x[b] * y[b], x[c] * y[c], x[d] * y[d])
    for q in range(squares):
        a, b, c, d = out[q], out[q + squares], out[q + 2 * squares], out[q + 3 * squares]
        for j in range(across.shape[0]):
            a[j], b[j], c[j], d[j] = _haar(a[j], b[j], c[j], d[j])


@njit(cache=True, nogil=True)
def light(across, down, first, out):
    """B, the light of each cell on each pixel, added to out (rows, columns, n n) float32."""
    rows, cols, count = out.shape
    squares, width = count // 4, across.shape[1]
    for n in range(count):
        x, y, q, k = first[n, 0], first[n, 1], n // 4, n % 4
        a, b, c, d = _haar(1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2), 1.0 * (k == 3))
        for i in range(max(0, -y), min(width, rows - y)):
            for j in range(max(0, -x), min(width, cols - x)):
                value = down[n, i] * across[n, j]
                pixel = out[y + i, x + j]
                pixel[q] += a * value
                pixel[squares + q] += b * value
                pixel[2 * squares + q] += c * value
                pixel[3 * squares + q] += d * value


@njit(cache=True, nogil=True)
def steadied(change, total, lit, share, x, y, out):
    """The change less what moves by (x, y) behind it, 1/2 of the total and of -share lit; (rows, columns) each."""
    rows, cols = out.shape
    for i in range(rows):
        up, low = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(cols):
            left, right = max(j - 1, 0), min(j + 1, cols - 1)
            across = (total[i, right] - share * lit[i, right]) - (total[i, left] - share * lit[i, left])
            down = (total[low, j] - share * lit[low, j]) - (total[up, j] - share * lit[up, j])
            out[i, j] = change[i, j] - 0.5 * (x * across / (right - left) + y * down / (low - up))


@njit(cache=True, nogil=True, inline="always")
def _overlap(a, b, shift, width):
    """Sum of a[i + shift] b[i]."""
    total = 0.0
    for i in range(max(0, -shift), min(width, width - shift)):
        total += a[i + shift] * b[i]
    return total


@njit(cache=True, nogil=True)
def difference(across_1, down_1, first_1, across_2, down_2, first_2):
    """|A_1 - A_2|^2, the sum of squares over all LEDs and pixels; both of the same width."""
    width, total = across_1.shape[1], 0.0
    for k in range(across_1.shape[0]):
        dx, dy = first_2[k, 0] - first_1[k, 0], first_2[k, 1] - first_1[k, 1]
        total += _overlap(across_1[k], across_1[k], 0, width) * _overlap(down_1[k], down_1[k], 0, width)
        total += _overlap(across_2[k], across_2[k], 0, width) * _overlap(down_2[k], down_2[k], 0, width)
        total -= 2 * _overlap(across_1[k], across_2[k], dx, width) * _overlap(down_1[k], down_2[k], dy, width)
    return total


@njit(cache=True, nogil=True)
def precision(gram, unknown, scale, inverse, floor, size):
    """Scale G + V^-1 of the unknown cells, V^-1 = diag of inverse; a unit matrix beside it up to `size` rows.

    Only the upper triangle is filled.
    """
    count, first = unknown.shape[0], unknown[0]
    together = unknown[count - 1] - first == count - 1
    out = np.empty((size, size), np.float32)
    for i in range(count):
        row = gram[unknown[i]]
        if together:  # without looking numbers up it takes a third of the time
            for j in range(i, count):
                out[i, j] = scale * row[first + j] + floor
        else:
            for j in range(i, count):
                out[i, j] = scale * row[unknown[j]] + floor
        out[i, i] += inverse[i]
        out[i, count:] = 0.0
    for i in range(count, size):
        out[i, i:] = 0.0
        out[i, i] = 1.0
    return out


@njit(cache=True, nogil=True)
def mirror(upper, out):
    """The symmetric matrix of which the upper triangle is given, its first rows and columns into out."""
    for i in range(out.shape[0]):
        for j in range(i):
            out[i, j] = upper[j, i]
        out[i, i:] = upper[i, i : out.shape[0]]


@njit(cache=True, nogil=True)
def extrinsic(covariance, posterior, mean, variance, out):
    """Extrinsic LLR of each cell, out (n,), of a linear MMSE estimate: S (n, n), m, prior c_0 and v (n,).

    m is linear in the cells: m_i - c_0i = sum_j R_ij (c_j - c_0j) + noise with R = 1 - S V^-1. Of the statistic

        u_i = m_i - c_0i S_ii / v_i = k c_i - sum_j S_ij / v_j (c_j - c_0j) + noise,   k = 1 - S_ii / v_i,

    whose variance is k S_ii, the terms that weigh most are drawn from +-1 and the rest from a Gaussian: were all taken
    as Gaussian, the LLR would be 2 u_i / S_ii, too small where few neighbours shine in and all speak for the bit. At
    first `FEW` are drawn; where that leaves the bit neither in doubt nor beyond it, `MANY`.
    """
    inverse = (1.0 / variance).astype(np.float32)
    ways, which = np.empty((2, 1 << MANY)), np.empty(MANY, np.int64)
    for i in range(covariance.shape[0]):
        row = covariance[i]
        k = 1.0 - row[i] / variance[i]
        u = posterior[i] - mean[i] * row[i] / variance[i]
        for most in (FEW, MANY):
            count = _heaviest(row, inverse, i, which[:most])
            out[i] = _mixture(u, k, k * row[i], row, which[:count], mean, variance, ways)
            if not DOUBTFUL < abs(out[i]) < SURE:
                break


@njit(cache=True, nogil=True)
def _heaviest(row, inverse, i, which):
    """Numbers of the cells but i that disturb it most, the most first; how many there are."""
    most = np.zeros(which.shape[0], np.float32)
    last = which.shape[0] - 1
    for j in range(row.shape[0]):
        weight = row[j] * row[j] * inverse[j]
        if weight > most[last] and j != i:
            place = last
            while place > 0 and most[place - 1] < weight:
                most[place], which[place] = most[place - 1], which[place - 1]
                place -= 1
            most[place], which[place] = weight, j
    return np.count_nonzero(most)


@njit(cache=True, nogil=True)
def _mixture(u, k, power, row, drawn, mean, variance, ways):
    """Ln p(u|c=+1) / p(u|c=-1), u = k c - sum S_ij / v_j (c_j - c_0j) + the rest, of a variance `power` beside k c.

    row is S_i, drawn the numbers of the cells to be drawn; ways (2, 2^drawn or more) is overwritten.
    """
    # each way that they may be: the statistic without them, and the log of its chance
    rest, chance = ways
    rest[0], chance[0], noise, number = u, 0.0, power, 1
    for j in drawn:
        share = row[j] / variance[j]
        noise -= share * share * variance[j]
        likely, unlikely = math.log(max(1.0 + mean[j], 1e-12)), math.log(max(1.0 - mean[j], 1e-12))
        for w in range(number):
            rest[number + w], chance[number + w] = rest[w] + share * (1.0 - mean[j]), chance[w] + likely
            rest[w], chance[w] = rest[w] - share * (1.0 + mean[j]), chance[w] + unlikely
        number *= 2
    noise = max(noise, 0.02 * power, 1e-12)
    # ln sum P exp(-(x -+ k)^2 / 2 r), less k^2 that both share, by their largest exponents
    top, below = -np.inf, -np.inf
    for w in range(number):
        x = rest[w]
        chance[w] -= 0.5 * x * x / noise
        rest[w] = k * x / noise
        top, below = max(top, chance[w] + rest[w]), max(below, chance[w] - rest[w])
    plus, minus = 0.0, 0.0
    for w in range(number):
        plus += math.exp(chance[w] + rest[w] - top)
        minus += math.exp(chance[w] - rest[w] - below)
    return top - below + math.log(plus / minus)
