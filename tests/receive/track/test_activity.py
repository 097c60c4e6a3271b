"""Plausibility of tracked arrays."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.receive.geometry.pose import Pose
from heliograph.receive.track.track import check_pose

ARRAY = Pose(40.0, 40.0, 1.5, 0.0, 0.6)


@pytest.mark.parametrize("pose", [ARRAY, replace(ARRAY, blur=8.0), replace(ARRAY, pitch=15.0)])
def test_blurred_and_near_arrays_are_arrays(pose: Pose) -> None:
    check_pose(pose, 16, (96, 128))


@pytest.mark.parametrize(
    "pose",
    [replace(ARRAY, blur=170_000.0), replace(ARRAY, blur=12.5), replace(ARRAY, pitch=20.0)]
    + [replace(ARRAY, **{name: np.nan}) for name in ("blur", "pitch")],
)
def test_what_is_too_blurred_or_too_large_is_given_up(pose: Pose) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="none of an array"):
        check_pose(pose, 16, (96, 128))
