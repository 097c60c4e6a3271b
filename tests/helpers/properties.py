"""Property tests that take the same examples on each run, and what several of them draw."""

from hypothesis import settings
from hypothesis import strategies as st

from heliograph.receive import Pose


def examples(count: int) -> settings:
    """The same examples on each run, however long one takes."""
    return settings(max_examples=count, derandomize=True, deadline=None, database=None)


def poses(reach_px: float = 60.0, smallest: float = 0.3, largest: float = 4.0) -> st.SearchStrategy[Pose]:
    """Poses within `reach_px` of the sensor's corner, their pitch from `smallest` to `largest` px."""
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
