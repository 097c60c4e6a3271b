"""The receiver's kernels written for reading: plain NumPy, no bounds on the light's reach, no tricks.

Nothing runs on these but the tests that hold `kernels.py` to them.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Floats = NDArray[np.float64]

Corner = tuple[float, float]
"""(x, y) on the sensor of a window's first pixel."""

STEP = 1e-5
"""Step of the central differences, in px, rad or as a logarithm."""

Candidate = tuple[float, float, float, float, int]
"""Score, x, y, side, identity."""


def render(vector: Floats, weights: Floats, corner: Corner, shape: tuple[int, int]) -> Floats:
    """Image of LEDs and its derivatives by the parameters of a pose vector (5,) or (7,), (6 or 8, rows, columns)."""
    return _with_derivatives(lambda v: array_image(v, weights, corner, shape), vector)


def array_image(vector: Floats, weights: Floats, corner: Corner, shape: tuple[int, int]) -> Floats:
    """Image of LEDs of (n, n) weights at a pose vector, (rows, columns)."""
    x, y, log_pitch, roll, log_blur = vector[:5]
    stretch, shear = vector[5:] if len(vector) == 7 else (0.0, 0.0)
    pitch, blur = np.exp(log_pitch), np.exp(log_blur)
    grid = (np.arange(len(weights)) - (len(weights) - 1) / 2) * pitch
    v, u = np.meshgrid(grid, grid)
    # (x, y)_uv = (x, y) + pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]] (v, u)
    v, u = (1 + stretch) * v + shear * u, shear * v + (1 - stretch) * u
    led_x = x + np.cos(roll) * v - np.sin(roll) * u
    led_y = y + np.sin(roll) * v + np.cos(roll) * u
    # image = pitch^2 sum_uv w_uv g(column - x_uv) g(row - y_uv)
    across = _pixel_shares(np.arange(shape[1]) + corner[0], led_x.ravel(), float(blur))
    down = _pixel_shares(np.arange(shape[0]) + corner[1], led_y.ravel(), float(blur))
    return np.asarray(pitch**2 * np.einsum("k,ki,kj->ij", weights.ravel(), down, across))


def render_box(vector: Floats, half_leds: float, corner: Corner, shape: tuple[int, int]) -> Floats:
    """Image of a blurred square and its derivatives, (6 or 8, rows, columns); those by blur and tilt are left 0."""
    out = _with_derivatives(lambda v: box_image(v, half_leds, corner, shape), vector)
    out[5:] = 0.0
    return out


def box_image(vector: Floats, half_leds: float, corner: Corner, shape: tuple[int, int]) -> Floats:
    """Blurred square of half width `half_leds` pitches about the array's centre."""
    half, roll = half_leds * np.exp(vector[2]), vector[3]
    # a pixel's box has the variance 1/12
    sigma = np.sqrt(np.exp(vector[4]) ** 2 + 1 / 12)
    dy, dx = np.mgrid[: shape[0], : shape[1]] + np.reshape([corner[1] - vector[1], corner[0] - vector[0]], (2, 1, 1))
    stretch, shear = vector[5:] if len(vector) == 7 else (0.0, 0.0)
    back = np.linalg.inv([[1 + stretch, shear], [shear, 1 - stretch]])
    turned = np.stack([np.cos(roll) * dx + np.sin(roll) * dy, np.cos(roll) * dy - np.sin(roll) * dx])
    along, across = np.tensordot(back, turned, 1)
    widths = sigma * np.linalg.norm(back, axis=1)
    # strip(t) = Phi((half - t) / sigma) - Phi((-half - t) / sigma); square = strip(along) strip(across)
    strips = [ndtr((half - t) / w) - ndtr((-half - t) / w) for t, w in zip((along, across), widths, strict=True)]
    return np.asarray(strips[0] * strips[1])


def alternation(f0: Floats, f1: Floats, f2: Floats, f3: Floats) -> Floats:
    """What alternates in four frames."""
    # (f0 - 3 f1 + 3 f2 - f3) / 4
    return (f0 - 3 * f1 + 3 * f2 - f3) / 4


def block_means(image: Floats, size: int) -> Floats:
    """Mean magnitude of blocks of size x size pixels."""
    rows, cols = image.shape
    return np.asarray(np.abs(image).reshape(rows // size, size, cols // size, size).mean(axis=(1, 3)))


def search(
    image: Floats,
    busy: NDArray[np.bool_],
    block: int,
    cells: Floats,
    sides: Floats,
    contrast: float,
    threshold: float,
    count: int,
) -> list[Candidate]:
    """Best candidates of the headers `cells` (identities, 16) over scale and position, best first."""
    kept: list[Candidate] = []
    for side in sides:
        for x, y in _places(image.shape, busy, block, float(side)):
            for number, score in _scores(image, cells, x, y, float(side), contrast):
                if abs(score) >= threshold:
                    kept = _merge(kept, (score, x + side / 2, y + side / 2, float(side), number), count)
    return kept


def sample_cubic(image: Floats, points: Floats) -> Floats:
    """Image at points (n, 2) of (x, y) by Keys' cubic convolution; the border repeats."""
    out = np.empty(len(points))
    for k, (x, y) in enumerate(points):
        j, i = int(np.floor(x)), int(np.floor(y))
        rows, cols = np.arange(i - 1, i + 3), np.arange(j - 1, j + 3)
        values = image[np.ix_(np.clip(rows, 0, image.shape[0] - 1), np.clip(cols, 0, image.shape[1] - 1))]
        # f(x, y) = sum_ij h(y - i) h(x - j) f_ij
        out[k] = _keys(y - rows) @ values @ _keys(x - cols)
    return out


def _with_derivatives(image: Callable[[Floats], Floats], vector: Floats) -> Floats:
    """An image and its central differences (f(v + h) - f(v - h)) / 2 h by each parameter."""
    steps = STEP * np.eye(len(vector))
    return np.stack([image(vector), *((image(vector + h) - image(vector - h)) / (2 * STEP) for h in steps)])


def _pixel_shares(pixels: NDArray[Any], centres: Floats, sigma: float) -> Floats:
    """Share of a Gaussian about each centre in each pixel, (centres, pixels)."""
    # g(t) = Phi((t + 1/2) / sigma) - Phi((t - 1/2) / sigma)
    t = pixels - centres[:, None]
    return np.asarray(ndtr((t + 0.5) / sigma) - ndtr((t - 0.5) / sigma))


def _keys(t: Floats) -> Floats:
    """Keys' kernel with a = -1/2."""
    # 3/2 |t|^3 - 5/2 |t|^2 + 1 to 1, then -1/2 |t|^3 + 5/2 |t|^2 - 4 |t| + 2 to 2
    a = np.abs(t)
    inner, outer = 1.5 * a**3 - 2.5 * a**2 + 1, -0.5 * a**3 + 2.5 * a**2 - 4 * a + 2
    return np.where(a <= 1, inner, np.where(a <= 2, outer, 0.0))


def _places(shape: tuple[int, ...], busy: NDArray[np.bool_], block: int, side: float) -> Iterator[tuple[float, float]]:
    """Upper left corners looked at: a tenth of the side apart, the ring around inside, the centre in a busy block."""
    step, ring = max(1.0, side / 10), 0.12 * side
    for y in np.arange(ring, shape[0] - 1 - side - ring, step):
        for x in np.arange(ring, shape[1] - 1 - side - ring, step):
            if busy[int((y + side / 2) / block), int((x + side / 2) / block)]:
                yield float(x), float(y)


def _scores(image: Floats, cells: Floats, x: float, y: float, side: float, contrast: float) -> list[tuple[int, float]]:
    """Correlation with each header of what lies in a square, its ring counted as light that should not be there."""
    cell, ring = side / 4, 0.12 * side
    energy = _box(image**2, x - ring, y - ring, side + 2 * ring)
    if energy < contrast**2 * side**2:
        return []
    sums = np.array([_box(image, x + j * cell, y + i * cell, cell) for i in range(4) for j in range(4)])
    # <D, T> / (|D| |T|) with |T| = side
    return [(k, float(row @ sums / (side * np.sqrt(energy)))) for k, row in enumerate(cells)]


def _box(image: Floats, x: float, y: float, size: float) -> float:
    """Sum over a square whose borders cut pixels, which then count by their share; pixel (0, 0) begins at 0."""
    return float(_overlap(y, size, image.shape[0]) @ image @ _overlap(x, size, image.shape[1]))


def _overlap(start: float, size: float, count: int) -> Floats:
    """Share of each of `count` pixels within [start, start + size]."""
    first = np.arange(count)
    return np.clip(np.minimum(start + size, first + 1) - np.maximum(start, first), 0, 1)


def _merge(kept: list[Candidate], new: Candidate, count: int) -> list[Candidate]:
    """Take a candidate in unless a better one overlaps it; it replaces worse ones that do."""
    near = [old for old in kept if max(abs(old[1] - new[1]), abs(old[2] - new[2])) < 0.5 * max(new[3], old[3])]
    if any(abs(old[0]) >= abs(new[0]) for old in near):
        return kept
    rest = [old for old in kept if old not in near]
    return sorted([*rest, new], key=lambda c: -abs(c[0]))[:count]
