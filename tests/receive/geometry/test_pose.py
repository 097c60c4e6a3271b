"""Pose: vector form, axes and LED positions are consistent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples, poses

from heliograph.receive import Pose

SIDES = st.sampled_from([4, 8, 16, 32])


def values(pose: Pose) -> list[float]:
    return [pose.x, pose.y, pose.pitch, pose.roll, pose.blur, pose.stretch, pose.shear]


@examples(200)
@given(pose=poses())
def test_a_vector_and_back(pose: Pose) -> None:
    assert values(Pose.from_vector(pose.full_vector())) == pytest.approx(values(pose), rel=1e-12, abs=1e-12)
    assert np.array_equal(pose.vector(), pose.full_vector()[:5])
    flat = Pose.from_vector(pose.vector())
    assert values(flat) == pytest.approx([*values(pose)[:5], 0.0, 0.0], rel=1e-12, abs=1e-12)
    assert pose.full_vector()[[0, 1, 3, 5, 6]].tolist() == [pose.x, pose.y, pose.roll, pose.stretch, pose.shear]
    assert pose.full_vector()[[2, 4]] == pytest.approx([np.log(pose.pitch), np.log(pose.blur)])


@examples(100)
@given(pose=poses(), side=SIDES)
def test_leds_are_an_axis_apart_about_the_centre(pose: Pose, side: int) -> None:
    leds = pose.leds(side)
    assert leds.shape == (side, side, 2)
    assert leds.mean((0, 1)) == pytest.approx([pose.x, pose.y], abs=1e-9)
    # v increases along rows, u along columns
    assert np.allclose(np.diff(leds, axis=1), pose.axes[:, 0])
    assert np.allclose(np.diff(leds, axis=0), pose.axes[:, 1])


@examples(200)
@given(pose=poses())
def test_axes_are_a_rotated_symmetric_map(pose: Pose) -> None:
    # pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]], R clockwise with y down
    c, s = np.cos(pose.roll), np.sin(pose.roll)
    form = np.array([[c, s], [-s, c]]) @ pose.axes / pose.pitch
    assert form == pytest.approx(np.array([[1 + pose.stretch, pose.shear], [pose.shear, 1 - pose.stretch]]), abs=1e-12)
    # pitch is the mean of the extreme singular values
    longest, shortest = np.linalg.svd(pose.axes, compute_uv=False)
    assert 0.5 * (longest + shortest) == pytest.approx(pose.pitch)


@examples(200)
@given(pose=poses())
def test_the_frontal_pitch_is_the_longest_step_less_what_noise_makes_of_it(pose: Pose) -> None:
    longest = np.linalg.svd(pose.axes, compute_uv=False)[0]
    # header fits have a tilt bias of 0.004
    assert pose.pitch <= pose.frontal_pitch <= longest + 1e-12
    assert longest - pose.frontal_pitch <= 0.0041 * pose.pitch
    assert Pose(0, 0, 2.0, stretch=0.003, shear=0.002).frontal_pitch == 2.0


@examples(100)
@given(a=poses(), b=poses(), dx=st.floats(-9, 9), dy=st.floats(-9, 9))
def test_moved_and_midway(a: Pose, b: Pose, dx: float, dy: float) -> None:
    assert a.moved(dx, dy).leds(4) == pytest.approx(a.leds(4) + np.array([dx, dy]), abs=1e-9)
    assert a.moved(dx, dy).pitch == a.pitch
    middle = Pose.midway(a, b)
    assert values(middle) == pytest.approx(values(Pose.midway(b, a)), rel=1e-12, abs=1e-12)
    assert (middle.x, middle.y) == pytest.approx(((a.x + b.x) / 2, (a.y + b.y) / 2), abs=1e-9)
    # geometric means
    assert middle.pitch**2 == pytest.approx(a.pitch * b.pitch)
    assert middle.blur**2 == pytest.approx(a.blur * b.blur)
    assert values(Pose.midway(a, a)) == pytest.approx(values(a), rel=1e-12, abs=1e-12)
