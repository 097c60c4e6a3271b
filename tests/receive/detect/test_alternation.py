"""Detection of alternating blocks."""

import detect_oracle as reference
import numpy as np
import pytest
from scenes import SIDE

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.detect.alternation import DETECT, busy_blocks

FRAME = Frame(0, 0.0, np.zeros((160, 320), np.uint8))
BLOCKS = (20, 40)
LARGE = Pose(100.0, 80.0, 12.0, 0.0, 0.6)
"""An array spanning the frame height, with more than half the blocks."""


def busy(means: np.ndarray, taken: list[Pose]) -> np.ndarray:
    return busy_blocks(means.astype(np.float32), FRAME, taken, SIDE, 0.03)


def test_what_a_large_array_lights_all_over_is_not_searched() -> None:
    # bright region seen through the windscreen
    means = np.full(BLOCKS, 12.0)
    means[:, :25] = 60.0
    assert not busy(means, [LARGE]).any()


def test_another_array_beside_a_large_one_is() -> None:
    means = np.full(BLOCKS, 1.0)
    means[:, :25] = 60.0
    means[10, 35] = 30.0
    found = np.argwhere(busy(means, [LARGE]))
    assert len(found) == 9
    assert found.mean(0).tolist() == [10, 35]


def test_a_frame_full_of_followed_arrays_has_no_busy_blocks() -> None:
    assert not busy(np.full(BLOCKS, 60.0), [LARGE, Pose(260.0, 80.0, 12.0, 0.0, 0.6)]).any()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("taken", "followed"),
    [
        ([], []),
        ([Pose(60.0, 60.0, 1.0)], [(slice(5, 10), slice(5, 10))]),
        # overlapping arrays; the second extends beyond the frame
        ([LARGE, Pose(4.0, 80.0, 3.0)], [(slice(0, 20), slice(0, 26)), (slice(5, 15), slice(0, 5))]),
    ],
)
def test_busy_blocks_are_those_of_the_reference(
    taken: list[Pose], followed: list[tuple[slice, slice]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    means = rng.gamma(4.0, 0.6, BLOCKS).astype(np.float32)
    free = np.ones(BLOCKS, bool)
    for blocks in followed:
        free[blocks] = False
    want = reference.busy(means.astype(float), free, DETECT.busy_contrast * 0.03 * 255, DETECT.busy_ratio)
    assert want.any()
    assert np.array_equal(busy(means, taken), want)
