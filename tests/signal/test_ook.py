"""On-off keying."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.signal import ook


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_round_trip(seed: int, n: int) -> None:
    d = np.random.default_rng(seed).choice([-1, 1], (2, n, n))
    levels = ook.encode(d)
    assert levels.dtype == np.uint8
    assert np.array_equal(levels, np.where(d == 1, 4, 0))
    assert np.array_equal(ook.decode(levels.astype(float) - 2), d)
    assert np.array_equal(ook.encode(-d), 4 - levels)


def test_data_are_signs() -> None:
    with pytest.raises(ValueError, match=r"-1 and \+1 only"):
        ook.encode([[0, 1], [1, 1]])
