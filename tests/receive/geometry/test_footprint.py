"""Separable LED footprints against the dense blur matrix."""

import numpy as np
import pytest
import render_oracle as reference
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples, poses
from scenes import SIDE, draw, pitch_at

from heliograph.receive import Pose
from heliograph.receive.geometry.footprint import footprints, image_of, images_of, sum_of_leds, to_grid, to_quarters

Floats = NDArray[np.float64]

SHAPE = (40, 44)
CUT = 5e-4
"""Light fraction beyond 4 standard deviations in x and y."""

POSES = [
    Pose(21.3, 19.6, pitch_at(100), 0.0, 0.51),
    Pose(20.8, 20.2, pitch_at(60), 0.03, 0.53),
    Pose(21.0, 18.9, 1.9, -0.4, 0.9),
    Pose(3.0, 38.0, 1.1, 0.1, 0.6),
]
"""The last pose lies partly outside the window."""


@pytest.mark.parametrize("roll", [0.0, 0.05])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (-0.1, 0.05)])
def test_blur_matrix_is_the_image_of_each_led(roll: float, tilt: tuple[float, float]) -> None:
    x, pose = np.random.default_rng(1).random((SIDE, SIDE)), Pose(20.3, 21.6, pitch_at(60), roll, 0.52, *tilt)
    a = reference.blur_matrix(pose, SIDE, (3, 2), SHAPE)
    assert np.allclose(a @ x.ravel(), draw(pose, x, (3, 2), SHAPE).ravel(), atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_footprints_are_the_blur_matrix(pose: Pose) -> None:
    across, down = footprints(pose, (3, 2), SHAPE, SIDE)
    got = np.einsum("ki,kj->kij", down, across).reshape(SIDE * SIDE, -1)
    want = reference.blur_matrix(pose, SIDE, (3, 2), SHAPE).T
    order = to_quarters(np.arange(SIDE * SIDE, dtype=float).reshape(SIDE, SIDE)).astype(int)
    assert np.abs(got - want[order]).max() < CUT * pose.pitch**2


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.3, 0.0), (0.1, 0.6)])
@pytest.mark.parametrize("pose", POSES)
def test_images_of_leds_in_motion(pose: Pose, motion: tuple[float, float]) -> None:
    """Motion along x and y widens the blur."""
    levels = np.random.default_rng(2).random((SIDE, SIDE))
    light = footprints(pose, (3, 2), SHAPE, SIDE, motion)
    want = (reference.blur_matrix(pose, SIDE, (3, 2), SHAPE, motion) @ levels.ravel()).reshape(SHAPE)
    assert sum_of_leds(to_quarters(levels), light) == pytest.approx(want, abs=4 * CUT)
    if motion == (0.0, 0.0):
        assert image_of(levels, pose, (3, 2), SHAPE) == pytest.approx(want, abs=4 * CUT)


@examples(60)
@given(pose=poses(), corner=st.tuples(st.integers(-50, 50), st.integers(-50, 50)))
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
    assert ordered[:2].tolist() == [0, 2]
    assert ordered[side * side // 4 :][:2].tolist() == [1, 3]


def test_footprints_are_shared_and_so_not_writeable() -> None:
    first = footprints(POSES[0], (0, 0), SHAPE, SIDE)
    assert footprints(POSES[0], (0, 0), SHAPE, SIDE) is first
    for part in first:
        with pytest.raises(ValueError, match="read-only"):
            part[0, 0] = 0


def test_images_of_parts_are_those_of_an_array_with_the_others_off() -> None:
    rng, pose = np.random.default_rng(5), Pose(9.3, 8.1, 1.1, 0.03, 0.6)
    levels, parts = rng.random((16, 16)), rng.integers(0, 3, (16, 16))
    got = images_of(levels, parts, 3, pose, (2, 1), (17, 16))
    for number, image in enumerate(got):
        assert image == pytest.approx(image_of(levels * (parts == number), pose, (2, 1), (17, 16)), abs=1e-12)
