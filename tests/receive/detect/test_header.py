"""Header correlation in a frame pair."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, pitch_at

from heliograph.base.arrays import Floats
from heliograph.receive import Pose
from heliograph.receive.detect.header_bank import header_score, header_weights
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.sync.combine import combine_header
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.formats import words
from heliograph.signal.header import header_levels

SIGNS = header_levels(7) / 2.0 - 1.0
FORM = 0o765
DIMMED = np.kron(words()[FORM].reshape(4, 4), np.ones((4, 4))) > 0


def test_dimmed_cells_have_half_of_their_contrast() -> None:
    assert np.array_equal(header_weights(7, 0, SIDE), SIGNS)
    assert np.array_equal(header_weights(7, FORM, SIDE), np.where(DIMMED, 0.5 * SIGNS, SIGNS))


def test_combined_frames_show_dimmed_cells_by_contrast_and_light() -> None:
    shown = np.array([0.4, -0.4, 0.7, 0.1])
    combination = combine_header(np.arange(4.0), 1.0, shown, (0.6 * shown, np.array([0.5, 0.5, 0.7, 0.5])))
    assert combination is not None
    contrast, light = combination.dimmed
    assert contrast == pytest.approx(0.6)
    assert light > 0.1
    weights = header_weights(7, FORM, SIDE, combination)
    assert np.array_equal(weights[~DIMMED], SIGNS[~DIMMED])
    # light adds to lit cells and reduces dark cells
    assert weights[DIMMED & (SIGNS > 0)] == pytest.approx(0.6 + light)
    assert weights[DIMMED & (SIGNS < 0)] == pytest.approx(-0.6 + light)


@pytest.mark.parametrize("part", [1.0, 0.5, 0.0, -1.0])
def test_the_score_is_the_amplitude_over_the_arrays_light(part: float) -> None:
    pose = Pose(30.2, 29.7, pitch_at(60.0), 0.01, 0.55)

    def light(levels: Floats) -> NDArray[np.float32]:
        return (20 + 100 * draw(pose, levels, (0, 0), (60, 60))).astype(np.float32)

    up, down = (
        CombinedFrame(k, k * 1e-3, light(1 + sign * part * SIGNS), (0, 0), 255) for k, sign in enumerate((1, -1))
    )
    assert header_score(FramePair(up, down), pose, SIGNS, 200.0) == pytest.approx(part, abs=0.01)
