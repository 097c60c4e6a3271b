"""Reproducible property tests and shared strategies."""

from hypothesis import settings
from hypothesis import strategies as st

from heliograph.receive import Pose


def examples(count: int) -> settings:
    """Use the same examples in each run, with no deadline."""
    return settings(max_examples=count, derandomize=True, deadline=None, database=None)


def poses(reach_px: float = 60.0, smallest: float = 0.3, largest: float = 4.0) -> st.SearchStrategy[Pose]:
    """Draw poses within `reach_px` of the sensor corner, with a pitch from `smallest` to `largest` px."""
    place, tilt = st.floats(-reach_px, reach_px), st.floats(-0.15, 0.15)
    return st.builds(
        Pose,
        x=place,
        y=place,
        pitch=st.floats(smallest, largest),
        roll=st.floats(-3.1, 3.1),
        blur=st.floats(0.2, 3.0),
        stretch=tilt,
        shear=tilt,
    )
