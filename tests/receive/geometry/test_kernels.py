"""Rendering kernels against the NumPy reference."""

import numpy as np
import pytest
import render_oracle as reference
from numpy.typing import NDArray
from scenes import ALL_ON, draw, pitch_at
from scipy.special import ndtr

from heliograph.receive import Pose
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.kernels import median, normal, smallest

Floats = NDArray[np.float64]

SHAPE = (40, 44)

POSES = [
    Pose(21.3, 19.6, pitch_at(100), 0.0, 0.51),
    Pose(20.8, 20.2, pitch_at(60), 0.03, 0.53),
    Pose(21.0, 18.9, 1.9, -0.4, 0.9),
]


def some_pose(rng: np.random.Generator) -> Pose:
    """Draw a pose inside, partly outside or beyond a 40 x 50 px window."""
    return Pose(
        float(rng.uniform(-20, 70)),
        float(rng.uniform(-20, 60)),
        float(np.exp(rng.uniform(np.log(0.3), np.log(4)))),
        float(rng.uniform(-np.pi, np.pi)),
        float(rng.uniform(0.3, 2)),
    )


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.slow
def test_render_is_the_sum_of_gaussians(seed: int) -> None:
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
    at = np.concatenate([np.linspace(-9, 9, 5000), [-np.inf, np.inf]])
    got = np.array([normal(z) for z in at])
    assert got[:, 0] == pytest.approx(ndtr(at), abs=3e-10)
    assert got[:, 1] == pytest.approx(np.exp(-0.5 * at**2) / np.sqrt(2 * np.pi), abs=2e-7)


def test_render_of_odd_and_empty_windows() -> None:
    pose, far = Pose(2.3, 1.1, 0.8, 0.3, 0.5), np.empty((6, 1, 7))
    kernels.render(pose.vector(), ALL_ON, 0.0, 0.0, far, 0.0, 0.0)
    assert far[0] == pytest.approx(draw(pose, ALL_ON, (0, 0), (1, 7)), abs=1e-3)
    kernels.render(pose.vector(), ALL_ON, 500.0, 0.0, far, 0.0, 0.0)
    assert not far.any()


def test_all_on_and_not_resolved_is_one() -> None:
    got = np.empty((6, 60, 60))
    kernels.render(Pose(30.2, 29.7, 2.0, 0.4, 2.0).vector(), ALL_ON, 0.0, 0.0, got, 0.0, 0.0)
    assert got[0, 25:35, 25:35] == pytest.approx(1.0, abs=1e-3)
    # no light outside the array
    assert np.abs(got[0, :2]).max() < 1e-3


@pytest.mark.parametrize(("pitch", "roll", "blur"), [(0.39, 0.0, 0.5), (1.17, 0.7, 0.6), (2.33, -2.0, 1.1)])
def test_the_total_light_is_that_of_the_leds(pitch: float, roll: float, blur: float) -> None:
    got = np.empty((6, 90, 90))
    kernels.render(Pose(44.3, 45.1, pitch, roll, blur).vector(), ALL_ON, 0.0, 0.0, got, 0.0, 0.0)
    assert got[0].sum() == pytest.approx(256 * pitch**2, rel=2e-4)
    # total light is invariant to motion and rotation, and grows with the squared pitch
    assert np.abs(got[[1, 2, 4, 5]].sum(axis=(1, 2))).max() < 1e-2 * 256 * pitch**2
    assert got[3].sum() == pytest.approx(2 * 256 * pitch**2, rel=1e-2)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("half", [8.75, 10.0])
def test_box_is_the_blurred_square(seed: int, half: float) -> None:
    rng = np.random.default_rng(seed)
    pose, corner = some_pose(rng), (3.0, -5.0)
    got, want = np.empty((6, 40, 50)), reference.render_box(pose.vector(), half, corner, (40, 50))
    kernels.render_box(pose.vector(), half, *corner, got, 0.0, 0.0)
    # edges are truncated at 4 standard deviations too
    slope = 2e-4 / np.hypot(pose.blur, np.sqrt(1 / 12))
    assert np.abs(got[0] - want[0]).max() < 1e-4
    assert np.abs(got[1:3] - want[1:3]).max() < 2 * slope
    assert np.abs(got[3] - want[3]).max() < 3 * slope * half * pose.pitch
    assert np.abs(got[4] - want[4]).max() < 3 * slope * 100
    assert not got[5].any()


@pytest.mark.parametrize("seed", range(4))
def test_the_median_is_numpy_s(seed: int) -> None:
    """Bit-exact for few, equal, sorted and infinite values."""
    rng = np.random.default_rng(seed)
    for count in (1, 2, 3, 4, 5, 16, 99, 1000):
        for values in (rng.normal(size=count), rng.integers(0, 3, count).astype(float), np.arange(count) * -1.0,
                       np.where(rng.uniform(size=count) < 0.2, np.inf, rng.normal(size=count))):  # fmt: skip
            assert median(values.copy()) == np.median(values)
            place = int(0.8 * (len(values) - 1))
            assert smallest(values.copy(), place) == np.sort(values)[place]


def test_median_of_nan_ends() -> None:
    median(np.array([np.nan, 1.0, np.nan, 0.0, 2.0]))
    median(np.full(6, np.nan))
