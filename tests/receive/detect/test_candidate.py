"""Coarse candidates: hidden cells and refined fits."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, pitch_at

from heliograph.receive import Pose
from heliograph.receive.detect.candidate import cell_weights, find_lit_cells, fit_near
from heliograph.signal.header import header_cells, header_levels

Floats = NDArray[np.float64]

HEADER = header_levels(11) / 2.0 - 1.0
POSE = Pose(40.4, 31.3, pitch_at(60.0), 0.02, 0.55)
CORNER, SHAPE = (12, 7), (50, 56)


def alternating(gains: Floats, noise: float = 2.0) -> NDArray[np.float32]:
    """Render the alternation for an array with given LED gains."""
    rng = np.random.default_rng(0)
    return (150 * draw(POSE, gains * HEADER, CORNER, SHAPE) + rng.normal(0, noise, SHAPE)).astype(np.float32)


def test_weights_of_leds_are_those_of_their_cells() -> None:
    assert np.array_equal(cell_weights(header_cells(11).ravel().astype(float), SIDE), HEADER)
    assert cell_weights(np.arange(16.0), 8)[:3, :3].tolist() == [[0, 0, 1], [0, 0, 1], [4, 4, 5]]


def test_cells_that_do_not_alternate_are_hidden_and_dim_ones_are_not() -> None:
    cells = np.ones((4, 4))
    cells[0, :2] = 0.0
    cells[3, 1], cells[2, 3] = 0.6, 0.2
    found = find_lit_cells(alternating(cell_weights(cells.ravel(), SIDE)), CORNER, POSE, HEADER, 0.4)
    # a cell is hidden below 0.4 of the median
    assert np.array_equal(found, cells > 0.4)


def test_a_fit_near_a_candidate_finds_it() -> None:
    found = fit_near(alternating(np.ones((SIDE, SIDE))), CORNER, POSE.moved(0.8, -0.6), HEADER, 0.01, 0.5)
    assert found is not None
    # blurred so that LEDs merge
    assert found.vector[:2] == pytest.approx([POSE.x, POSE.y], abs=0.05)
    assert found.pose.blur == pytest.approx(np.hypot(POSE.blur, 0.5 * POSE.pitch), rel=0.1)
    assert found.gain == pytest.approx(150, rel=0.05)
    assert found.score > 0.97


@pytest.mark.parametrize("pose", [Pose(22.0, 31.0, 1.0), Pose(40.0, 52.0, 1.0), Pose(60.0, 31.0, 1.0)])
def test_a_candidate_at_the_rim_is_not_fitted(pose: Pose) -> None:
    assert fit_near(alternating(np.ones((SIDE, SIDE))), CORNER, pose, HEADER, 0.01) is None
