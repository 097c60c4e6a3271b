"""Reproducible property tests and shared strategies."""

from hypothesis import settings
from hypothesis import strategies as st

from heliograph.receive.geometry.pose import Pose


def examples(count: int) -> settings:
    """Use the same examples in each run, with no deadline."""
    return settings(max_examples=count, derandomize=True, deadline=None, database=None)


def poses() -> st.SearchStrategy[Pose]:
    """Draw poses within 60 px of the sensor corner, with a pitch of 0.3 to 4 px, in the order of the fields."""
    place, tilt = st.floats(-60.0, 60.0), st.floats(-0.15, 0.15)
    pitch, roll, blur = st.floats(0.3, 4.0), st.floats(-3.1, 3.1), st.floats(0.2, 3.0)
    return st.builds(Pose, place, place, pitch, roll, blur, tilt, tilt)
