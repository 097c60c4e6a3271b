"""The compiled kernels against the same said slowly."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import ALL_ON, draw
from scipy.special import ndtr

from heliograph.receive import Pose, kernels, reference
from heliograph.signal.header import all_header_cells

Floats = NDArray[np.float64]


def some_pose(rng: np.random.Generator) -> Pose:
    """Inside, partly outside or beyond a window of 40 x 50 px."""
    return Pose(
        float(rng.uniform(-20, 70)),
        float(rng.uniform(-20, 60)),
        float(np.exp(rng.uniform(np.log(0.3), np.log(4)))),
        float(rng.uniform(-np.pi, np.pi)),
        float(rng.uniform(0.3, 2)),
    )


@pytest.mark.parametrize("seed", range(8))
def test_render_is_the_sum_of_gaussians(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, weights, corner = some_pose(rng), rng.uniform(-1, 1, (16, 16)), (3.0, -5.0)
    got, want = np.empty((6, 40, 50)), reference.render(pose.vector(), weights, corner, (40, 50))
    kernels.render(pose.vector(), weights, *corner, got)
    # an LED's light is cut at 4 standard deviations
    around = (np.floor(pose.x) - 80, np.floor(pose.y) - 80)
    scale = np.abs(reference.render(pose.vector(), weights, around, (160, 160))).max(axis=(1, 2))
    error = np.abs(got - want).max(axis=(1, 2)) / scale
    assert error[0] < 1e-3
    assert error[1:].max() < 1e-2


@pytest.mark.parametrize("seed", range(4))
def test_tilted_arrays_and_their_derivatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(-0.15, 0.15, 2)
    pose = Pose(24.3, 19.8, float(rng.uniform(0.6, 1.2)), float(rng.uniform(-1, 1)), 0.6, *map(float, tilt))
    vector, weights = pose.full_vector(), rng.uniform(-1, 1, (16, 16))
    got, want = np.empty((8, 40, 50)), reference.render(vector, weights, (0.0, 0.0), (40, 50))
    kernels.render(vector, weights, 0.0, 0.0, got)
    assert got[0] == pytest.approx(draw(pose, weights, (0, 0), (40, 50)), abs=2e-3)
    error = np.abs(got - want).max(axis=(1, 2)) / np.abs(want).max(axis=(1, 2))
    assert error[0] < 1e-3
    assert error[1:].max() < 1e-2
    box, square = np.empty((6, 40, 50)), reference.render_box(vector, 9.0, (0.0, 0.0), (40, 50))
    kernels.render_box(vector, 9.0, 0.0, 0.0, box)
    assert np.abs(box[0] - square[0]).max() < 2e-4
    assert np.abs(box[1:5] - square[1:5]).max() < 1e-2


def test_normal_distribution() -> None:
    at = np.concatenate([np.linspace(-9, 9, 5000), [-np.inf, np.inf]])
    got = np.array([kernels.normal(z) for z in at])
    assert got[:, 0] == pytest.approx(ndtr(at), abs=3e-10)
    assert got[:, 1] == pytest.approx(np.exp(-0.5 * at**2) / np.sqrt(2 * np.pi), abs=2e-7)


def test_render_of_odd_and_empty_windows() -> None:
    pose, far = Pose(2.3, 1.1, 0.8, 0.3, 0.5), np.empty((6, 1, 7))
    kernels.render(pose.vector(), ALL_ON, 0.0, 0.0, far)
    assert far[0] == pytest.approx(draw(pose, ALL_ON, (0, 0), (1, 7)), abs=1e-3)
    kernels.render(pose.vector(), ALL_ON, 500.0, 0.0, far)
    assert not far.any()


def test_all_on_and_not_resolved_is_one() -> None:
    got = np.empty((6, 60, 60))
    kernels.render(Pose(30.2, 29.7, 2.0, 0.4, 2.0).vector(), ALL_ON, 0.0, 0.0, got)
    assert got[0, 25:35, 25:35] == pytest.approx(1.0, abs=1e-3)
    # beyond the array's edge nothing shines
    assert np.abs(got[0, :2]).max() < 1e-3


@pytest.mark.parametrize(("pitch", "roll", "blur"), [(0.39, 0.0, 0.5), (1.17, 0.7, 0.6), (2.33, -2.0, 1.1)])
def test_light_in_all_is_that_of_the_leds(pitch: float, roll: float, blur: float) -> None:
    got = np.empty((6, 90, 90))
    kernels.render(Pose(44.3, 45.1, pitch, roll, blur).vector(), ALL_ON, 0.0, 0.0, got)
    assert got[0].sum() == pytest.approx(256 * pitch**2, rel=2e-4)
    # moving or turning the array keeps it; the pitch gives the square
    assert np.abs(got[[1, 2, 4, 5]].sum(axis=(1, 2))).max() < 1e-2 * 256 * pitch**2
    assert got[3].sum() == pytest.approx(2 * 256 * pitch**2, rel=1e-2)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("half", [8.75, 10.0])
def test_box_is_the_blurred_square(seed: int, half: float) -> None:
    rng = np.random.default_rng(seed)
    pose, corner = some_pose(rng), (3.0, -5.0)
    got, want = np.empty((6, 40, 50)), reference.render_box(pose.vector(), half, corner, (40, 50))
    kernels.render_box(pose.vector(), half, *corner, got)
    # an edge is cut at 4 standard deviations too
    slope = 2e-4 / np.hypot(pose.blur, np.sqrt(1 / 12))
    assert np.abs(got[0] - want[0]).max() < 1e-4
    assert np.abs(got[1:3] - want[1:3]).max() < 2 * slope
    assert np.abs(got[3] - want[3]).max() < 3 * slope * half * pose.pitch
    assert np.abs(got[4] - want[4]).max() < 3 * slope * 100
    assert not got[5].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_alternation(dtype: type) -> None:
    rng = np.random.default_rng(0)
    top = 256 if dtype is np.uint8 else 65536
    f0, f1, f2, f3 = rng.integers(0, top, (4, 13, 21)).astype(dtype)
    got = np.empty((13, 21), np.float32)
    kernels.alternation(f0, f1, f2, f3, got)
    want = reference.alternation(f0.astype(float), f1.astype(float), f2.astype(float), f3.astype(float))
    assert np.array_equal(got, want.astype(np.float32))


def test_alternation_cancels_even_acceleration() -> None:
    base, rate = np.random.default_rng(0).integers(0, 40, (2, 9, 11))
    got = np.empty((9, 11), np.float32)
    f0, f1, f2, f3 = (np.asarray(base + rate * t + 3 * t * t, np.uint8) for t in range(4))
    kernels.alternation(f0, f1, f2, f3, got)
    assert not got.any()


def test_block_means() -> None:
    image = np.random.default_rng(0).normal(0, 30, (32, 48)).astype(np.float32)
    got = np.empty((4, 6), np.float32)
    kernels.block_means(image, 8, got)
    assert got == pytest.approx(reference.block_means(image.astype(float), 8), rel=1e-5)


def headers(seed: int, pixels: int) -> NDArray[np.float32]:
    """Two headers, one of them inverted, in noise; the first of identity 7 seed + 2, its corner at (8, 10)."""
    image = np.random.default_rng(seed).normal(0, 4, (44, 52)).astype(np.float32)
    cells, size = all_header_cells(), 4 * pixels
    image[10 : 10 + size, 8 : 8 + size] += 30 * np.kron(cells[7 * seed + 2], np.ones((pixels, pixels)))
    image[24 : 24 + size, 31 : 31 + size] -= 22 * np.kron(cells[7 * seed + 4], np.ones((pixels, pixels)))
    return image


# a size whose half is no multiple of the step, else rounding decides which of two neighbours overlap
@pytest.mark.parametrize(("pixels", "sides", "count"), [(2, (8.3, 9.1), 5), (4, (11.3, 15.8), 1)])
@pytest.mark.parametrize("seed", range(3))
def test_search_finds_what_the_reference_finds(seed: int, pixels: int, sides: tuple[float, ...], count: int) -> None:
    image, cells = headers(seed, pixels), all_header_cells().reshape(-1, 16).astype(float)
    busy = np.ones((6, 7), dtype=bool)
    busy[0] = False
    total, square = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    best = np.zeros((count, 5))
    found = kernels.search(total, square, busy, 8.0, cells, np.array(sides), 3.0, 0.35, np.zeros(2), best)
    want = reference.search(image.astype(float), busy, 8, cells, np.array(sides), 3.0, 0.35, count)
    assert found == count
    assert best == pytest.approx(np.array(want), rel=1e-6)
    assert best[0, 4] == 7 * seed + 2
    assert abs(best[0, 1] - 8 - 2 * pixels) < 1
    assert abs(best[0, 2] - 10 - 2 * pixels) < 1


def test_search_keeps_out_of_quiet_blocks() -> None:
    image = np.random.default_rng(0).normal(0, 30, (40, 48)).astype(np.float32)
    total, square = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    cells, best = all_header_cells().reshape(-1, 16).astype(float), np.zeros((5, 5))
    for busy, dim in ((False, 1.0), (True, 200.0)):
        blocks = np.full((5, 6), busy)
        assert kernels.search(total, square, blocks, 8.0, cells, np.array([12.0]), dim, 0.0, np.zeros(2), best) == 0
    assert (
        kernels.search(total, square, np.full((5, 6), True), 8.0, cells, np.array([12.0]), 1.0, 0.0, np.zeros(2), best)
        == 5
    )


def test_cubic_samples() -> None:
    rng = np.random.default_rng(0)
    image, points = rng.normal(size=(9, 12)), rng.uniform(-2.5, 13, (200, 2))
    got = np.empty(200)
    kernels.sample_cubic(image, points, got)
    assert got == pytest.approx(reference.sample_cubic(image, points), abs=1e-12)


def test_cubic_samples_a_parabola_exactly() -> None:
    y, x = np.mgrid[:12, :14].astype(float)
    points = np.random.default_rng(0).uniform(2, 9, (50, 2))
    got = np.empty(50)
    kernels.sample_cubic(2 + x - 0.3 * y + 0.2 * x * y + 0.1 * x * x - 0.05 * y * y, points, got)
    px, py = points.T
    assert got == pytest.approx(2 + px - 0.3 * py + 0.2 * px * py + 0.1 * px * px - 0.05 * py * py)
