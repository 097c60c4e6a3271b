"""Images of arrays: rendering kernels and separable footprints against the NumPy reference."""

import numpy as np
import pytest
import render_oracle as reference
from hypothesis import given
from hypothesis import strategies as st
from properties import examples, poses
from scenes import ALL_ON, SIDE, draw, pitch_at
from scipy.special import ndtr

from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.footprint import footprints, image_of, images_of, sum_of_leds, to_grid, to_quarters
from heliograph.receive.geometry.kernels import median, normal, smallest
from heliograph.receive.geometry.pose import Pose

SHAPE = (40, 44)
CUT = 5e-4  # light fraction beyond 4 standard deviations in x and y


def some_pose(rng: np.random.Generator) -> Pose:
    """Draw a pose inside, partly outside or beyond a 40 x 50 px window."""
    x, y, log_pitch, roll, blur = rng.uniform([-20, -20, np.log(0.3), -np.pi, 0.3], [70, 60, np.log(4), np.pi, 2])
    return Pose(x, y, float(np.exp(log_pitch)), roll, blur)


@pytest.mark.parametrize("seed", range(8))
def test_images_of_leds_and_squares_equal_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, weights, corner = some_pose(rng), rng.uniform(-1, 1, (16, 16)), (3.0, -5.0)
    got, want = np.empty((6, 40, 50)), reference.render(pose.vector(), weights, corner, (40, 50))
    kernels.render(pose.vector(), weights, *corner, got, 0.0, 0.0)
    # the kernel truncates LED images at 4 standard deviations
    around = (np.floor(pose.x) - 80, np.floor(pose.y) - 80)
    scale = np.abs(reference.render(pose.vector(), weights, around, (160, 160))).max(axis=(1, 2))
    error = np.abs(got - want).max(axis=(1, 2)) / scale
    assert error[0] < 1e-3
    assert error[1:].max() < 1e-2
    # and edges
    slope = 2e-4 / np.hypot(pose.blur, np.sqrt(1 / 12))
    for half in (8.75, 10.0):
        kernels.render_box(pose.vector(), half, *corner, got, 0.0, 0.0)
        error = np.abs(got - reference.render_box(pose.vector(), half, corner, (40, 50))).max(axis=(1, 2))
        assert (error < [1e-4, 2 * slope, 2 * slope, 3 * slope * half * pose.pitch, 300 * slope, 1e-300]).all()


@pytest.mark.parametrize("smear", [(0.0, 0.0), (1.1, 0.0), (0.2, 0.7)])
@pytest.mark.parametrize("seed", range(4))
def test_tilted_arrays_and_their_derivatives(seed: int, smear: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(-0.15, 0.15, 2)
    pose = Pose(24.3, 19.8, float(rng.uniform(0.6, 1.2)), float(rng.uniform(-1, 1)), 0.6, *map(float, tilt))
    vector, weights = pose.full_vector(), rng.uniform(-1, 1, (16, 16))
    got, want = np.empty((8, 40, 50)), reference.render(vector, weights, (0.0, 0.0), (40, 50), smear)
    kernels.render(vector, weights, 0.0, 0.0, got, *smear)
    if smear == (0.0, 0.0):
        assert got[0] == pytest.approx(draw(pose, weights, (0, 0), (40, 50)), abs=2e-3)
    error = np.abs(got - want).max(axis=(1, 2)) / np.abs(want).max(axis=(1, 2))
    assert error[0] < 1e-3
    assert error[1:].max() < 1e-2
    box, square = np.empty((6, 40, 50)), reference.render_box(vector, 9.0, (0.0, 0.0), (40, 50), smear)
    kernels.render_box(vector, 9.0, 0.0, 0.0, box, *smear)
    assert np.abs(box[0] - square[0]).max() < 2e-4
    # the kernel neglects how roll changes a smeared edge
    known = [1, 2, 3, 4] if smear == (0.0, 0.0) else [1, 2, 3]
    assert np.abs(box[known] - square[known]).max() < 1e-2


def test_normal_distribution() -> None:
    at = np.concatenate([np.linspace(-9, 9, 500), [-np.inf, np.inf]])
    got, density = np.array([normal(z) for z in at]).T
    assert got == pytest.approx(ndtr(at), abs=3e-10)
    assert density == pytest.approx(np.exp(-0.5 * at**2) / np.sqrt(2 * np.pi), abs=2e-7)


def test_render_of_odd_and_empty_windows_and_of_unresolved_leds() -> None:
    pose, far, got = Pose(2.3, 1.1, 0.8, 0.3, 0.5), np.empty((6, 1, 7)), np.empty((6, 60, 60))
    kernels.render(pose.vector(), ALL_ON, 0.0, 0.0, far, 0.0, 0.0)
    assert far[0] == pytest.approx(draw(pose, ALL_ON, (0, 0), (1, 7)), abs=1e-3)
    kernels.render(pose.vector(), ALL_ON, 500.0, 0.0, far, 0.0, 0.0)
    assert not far.any()
    kernels.render(Pose(30.2, 29.7, 2.0, 0.4, 2.0).vector(), ALL_ON, 0.0, 0.0, got, 0.0, 0.0)
    assert got[0, 25:35, 25:35] == pytest.approx(1.0, abs=1e-3)
    # no light outside the array
    assert np.abs(got[0, :2]).max() < 1e-3


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 16, 99, 1000])
def test_the_median_is_numpy_s(count: int) -> None:
    """Bit-exact for few, equal, sorted and infinite values, and finite time for NaN."""
    rng = np.random.default_rng(count)
    normals, equal, place = rng.normal(size=count), rng.integers(0, 3, count).astype(float), int(0.8 * (count - 1))
    for values in (normals, equal, -np.arange(count, dtype=float), np.where(rng.random(count) < 0.2, np.inf, normals)):
        assert median(values.copy()) == np.median(values)
        assert smallest(values.copy(), place) == np.sort(values)[place]
    median(np.where(equal > 1, np.nan, normals))
    median(np.full(count, np.nan))


POSES = [
    Pose(21.3, 19.6, pitch_at(100), 0.0, 0.51),
    Pose(20.8, 20.2, pitch_at(60), 0.03, 0.53),
    Pose(21.0, 18.9, 1.9, -0.4, 0.9),
    Pose(3.0, 38.0, 1.1, 0.1, 0.6),  # partly outside the window
]


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.3, 0.0), (0.1, 0.6)])
@pytest.mark.parametrize("pose", POSES)
def test_footprints_equal_the_blur_matrix(pose: Pose, motion: tuple[float, float]) -> None:
    across, down = light = footprints(pose, (3, 2), SHAPE, SIDE, motion)
    got = np.einsum("ki,kj->kij", down, across).reshape(SIDE * SIDE, -1)
    want = reference.blur_matrix(pose, SIDE, (3, 2), SHAPE, motion)
    order = to_quarters(np.arange(SIDE * SIDE, dtype=float).reshape(SIDE, SIDE)).astype(int)
    assert np.abs(got - want.T[order]).max() < CUT * pose.pitch**2
    levels = np.random.default_rng(2).random((SIDE, SIDE))
    image = (want @ levels.ravel()).reshape(SHAPE)
    assert sum_of_leds(to_quarters(levels), light) == pytest.approx(image, abs=4 * CUT)


@examples(60)
@given(pose=poses(), corner=st.tuples(st.integers(-50, 50), st.integers(-50, 50)))
@pytest.mark.slow
def test_any_array_in_any_window(pose: Pose, corner: tuple[int, int]) -> None:
    levels = np.random.default_rng(3).random((4, 4))
    got = image_of(levels, pose, corner, (12, 15))
    assert got == pytest.approx(draw(pose, levels, corner, (12, 15)), abs=CUT * max(pose.pitch**2, 1))


@pytest.mark.parametrize("side", [4, 8, 16])
def test_quarters_of_leds_and_back(side: int) -> None:
    grid = np.arange(side * side, dtype=float).reshape(side, side)
    ordered = to_quarters(grid)
    assert np.array_equal(to_grid(ordered), grid)
    # first the upper left LED in each 2 x 2 square, then the upper right LED
    assert ordered.reshape(4, -1)[:2, :2].tolist() == [[0, 2], [1, 3]]


def test_footprints_are_shared_and_read_only() -> None:
    first = footprints(POSES[0], (0, 0), SHAPE, SIDE)
    assert footprints(POSES[0], (0, 0), SHAPE, SIDE) is first
    for part in first:
        with pytest.raises(ValueError, match="read-only"):
            part[0, 0] = 0


def test_the_image_of_a_part_has_the_other_parts_off() -> None:
    rng, pose = np.random.default_rng(5), Pose(9.3, 8.1, 1.1, 0.03, 0.6)
    levels, leds = rng.random((16, 16)), rng.permutation(256).reshape(4, 64)
    for places, image in zip(leds, images_of(levels, leds, pose, (2, 1), (17, 16)), strict=True):
        part = np.zeros(256)
        part[places] = to_quarters(levels)[places]
        assert image == pytest.approx(image_of(to_grid(part), pose, (2, 1), (17, 16)), abs=1e-12)
