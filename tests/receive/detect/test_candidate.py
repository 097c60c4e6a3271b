"""Coarse candidates: hidden cells, refined fits and motion."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, Floats, draw, frame_of, pitch_at

from heliograph.receive.detect.alternation import DETECT
from heliograph.receive.detect.candidate import cell_weights, estimate_drift, find_lit_cells, fit_header, fit_near
from heliograph.receive.geometry.pose import Pose
from heliograph.signal.header import header_cells, header_levels

HEADER = header_levels(11) / 2.0 - 1.0
POSE = Pose(40.4, 31.3, pitch_at(60.0), 0.02, 0.55)
CORNER, SHAPE = (12, 7), (50, 56)


def alternating(gains: Floats, noise: float = 2.0) -> NDArray[np.float32]:
    rng = np.random.default_rng(0)
    return (150 * draw(POSE, gains * HEADER, CORNER, SHAPE) + rng.normal(0, noise, SHAPE)).astype(np.float32)


def test_weights_of_leds_are_those_of_their_cells() -> None:
    assert np.array_equal(cell_weights(header_cells(11).ravel().astype(float), SIDE), HEADER)
    assert cell_weights(np.arange(16.0), 8)[:3, :3].tolist() == [[0, 0, 1], [0, 0, 1], [4, 4, 5]]


def test_dark_cells_are_hidden_and_dim_cells_are_not() -> None:
    cells = np.ones((4, 4))
    cells[0, :2], cells[3, 1], cells[2, 3] = 0.0, 0.6, 0.2
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


@pytest.mark.parametrize(
    ("columns", "hidden", "is_level"), [(slice(0, 0), 0, False), (slice(0, 4), 4, True), (slice(6, 10), 0, True)]
)
def test_a_partly_hidden_header_is_fitted_without_tilt(columns: slice, hidden: int, is_level: bool) -> None:
    """Hidden cells are left out of the fit; a thin post hides only parts of cells."""
    visible, rng = np.ones((SIDE, SIDE)), np.random.default_rng(0)
    visible[:, columns] = 0
    lit = [0.1 + 0.6 * draw(POSE, visible * (1 + sign * HEADER) / 2, (0, 0), (70, 80)) for sign in (1, -1, 1, -1)]
    header = [frame_of(light, k, rng) for k, light in enumerate(lit)]
    fit, led_gains, was_level = fit_header(header, POSE, HEADER, DETECT.upright_sigma, 0.9, True)
    assert fit is not None
    assert np.count_nonzero(led_gains == 0) == hidden * SIDE
    assert was_level == is_level
    assert fit.vector[:2] == pytest.approx([POSE.x, POSE.y], abs=0.05)


@pytest.mark.parametrize("pose", [Pose(22.0, 31.0, 1.0), Pose(40.0, 52.0, 1.0), Pose(60.0, 31.0, 1.0)])
def test_a_candidate_at_the_rim_is_not_fitted(pose: Pose) -> None:
    assert fit_near(alternating(np.ones((SIDE, SIDE))), CORNER, pose, HEADER, 0.01) is None


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("distance_m", "within"), [(18.0, 0.05), (30.0, 0.05), (60.0, 0.06), (95.0, 0.1)])
def test_any_motion_of_a_header_is_found(distance_m: float, within: float, seed: int) -> None:
    rng = np.random.default_rng([seed, round(distance_m)])
    speed, angle = rng.uniform(0, 2 if distance_m < 50 else 0.9), rng.uniform(0, 2 * np.pi)
    # px per pattern, and the share of the next pattern in each frame
    drift, late = speed * np.array([np.cos(angle), np.sin(angle)]), rng.uniform(0, 0.3)
    rng, header, frames = np.random.default_rng(seed), header_levels(seed, SIDE) / 2.0 - 1.0, []
    x, y = rng.uniform(58, 62, 2).tolist()
    pose = Pose(x, y, pitch_at(distance_m), float(rng.normal(0, 0.02)), 0.51)
    for k in range(4):
        light = 0.5 + 0.5 * (1 - 2 * late) * (-1) ** k * header
        image = draw(pose.moved(*((k - 0.5) * drift)), light, (0, 0), (120, 120))
        frames.append(frame_of(0.1 + 0.7 * image, k, rng))
    found = np.array(estimate_drift(frames, pose, 0.5e-3, header, 1e-3)) * 1e-3
    assert found == pytest.approx(drift, abs=within)
