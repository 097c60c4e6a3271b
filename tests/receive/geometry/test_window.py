"""Windows around an array, and frame cut-outs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples, poses

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.geometry.window import common, covered, cut_out, plane, window_around

SENSOR = np.random.default_rng(0).integers(0, 256, (60, 70)).astype(np.uint8)  # frames are windows


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Draw a sensor window with at least 3 x 3 pixels."""
    left, top = draw(st.integers(0, 40)), draw(st.integers(0, 40))
    right, low = draw(st.integers(left + 3, 70)), draw(st.integers(top + 3, 60))
    return Frame(0, 0.0, SENSOR[top:low, left:right], 8, (left, top))


WINDOWS = st.tuples(st.integers(-20, 80), st.integers(-20, 70), st.integers(1, 30), st.integers(1, 30))


@examples(100)
@given(pose=poses(), side=st.sampled_from([4, 8, 16]), margin=st.floats(0, 9))
def test_a_window_holds_the_leds_and_the_margin_only(pose: Pose, side: int, margin: float) -> None:
    x, y, cols, rows = window_around(pose, side, margin)
    # outer LED cells extend half a step beyond the LED centres
    corners = pose.leds(side)[[0, 0, -1, -1], [0, -1, 0, -1]] - (pose.x, pose.y)
    corners = corners * side / (side - 1) + (pose.x, pose.y)
    first, last = np.array([x, y]), np.array([x + cols - 1, y + rows - 1])
    # of less than a pixel beyond the margin
    for beyond in (corners.min(0) - margin - first, last - corners.max(0) - margin):
        assert (beyond > -1e-9).all()
        assert (beyond < 1 + 1e-9).all()


@examples(100)
@given(frame=frames(), window=WINDOWS)
def test_a_cut_out_is_a_copied_slice_with_a_repeated_border(frame: Frame, window: tuple[int, int, int, int]) -> None:
    x, y, cols, rows = window
    got = cut_out(frame, window)
    assert got.shape == (rows, cols)
    assert got.dtype == np.float64
    (left, top), (height, width) = frame.origin, frame.pixels.shape
    right, low = left + width - 1, top + height - 1
    for i, j in ((0, 0), (rows - 1, cols - 1), (rows // 2, cols // 3), (0, cols - 1)):
        assert got[i, j] == SENSOR[min(max(y + i, top), low), min(max(x + j, left), right)]
    if x >= left and y >= top and x + cols <= left + width and y + rows <= top + height:
        assert np.array_equal(got, SENSOR[y : y + rows, x : x + cols])
        # a copy: receivers may write to cut-outs
        assert not np.shares_memory(got, frame.pixels)


@pytest.mark.slow
@examples(100)
@given(several=st.lists(frames(), min_size=1, max_size=3), window=WINDOWS)
def test_covered_pixels_are_inside_all_frames(several: list[Frame], window: tuple[int, int, int, int]) -> None:
    x, y, cols, rows = window
    there = np.ones((rows, cols), bool)
    for frame in several:
        (left, top), (height, width) = frame.origin, frame.pixels.shape
        v, u = np.arange(x, x + cols), np.arange(y, y + rows)
        there &= ((u >= top) & (u < top + height))[:, None] & ((v >= left) & (v < left + width))
    found = covered(several, (x, y), (rows, cols))
    if found is None:
        assert there.all()
    else:
        assert not there.all()
        assert np.array_equal(np.outer(found[1], found[0]) > 0, there)


@examples(100)
@given(several=st.lists(frames(), min_size=1, max_size=4))
def test_common_parts_show_the_same_part_of_the_sensor(several: list[Frame]) -> None:
    left, top = np.max([f.origin for f in several], axis=0)
    right, low = np.min([np.add(f.origin, f.pixels.shape[::-1]) for f in several], axis=0)
    for one in common(several):
        assert one.origin == (left, top)
        assert one.pixels.shape == (max(low - top, 0), max(right - left, 0))
        assert not one.pixels.size or np.array_equal(one.pixels, SENSOR[top:low, left:right])


@pytest.mark.parametrize("shape", [(1, 1), (5, 8), (30, 26)])
def test_the_plane_is_a_constant_and_two_slopes(shape: tuple[int, int]) -> None:
    constant, x, y = plane(*shape)
    assert (constant == 1).all()
    for slope, axis in ((x, 1), (y, 0)):
        assert slope.mean() == pytest.approx(0)
        assert np.allclose(np.diff(slope, axis=axis), 1 / shape[axis])
        assert np.ptp(slope, axis=1 - axis) == pytest.approx(0)
    with pytest.raises(ValueError, match="read-only"):
        constant[0, 0] = 2.0
