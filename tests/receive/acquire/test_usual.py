"""What surges over what usually alternates."""

import numpy as np

from heliograph.receive.acquire.usual import SURGE, UsualAlternation


def test_a_header_surges_over_its_data_and_flicker_of_even_strength_does_not() -> None:
    usual, change = UsualAlternation(), np.ones((6, 8), np.float32)
    assert usual.surges(change, (0, 0)).all()
    for _ in range(5):
        assert not usual.surges(change, (0, 0)).any()
    change[:3, :4] = 2.5
    header = usual.surges(change, (0, 0))
    assert header[:3, :4].any()
    assert not header[5].any()
    # what stays is usual soon
    for _ in range(20):
        usual.surges(change, (0, 0))
    assert not usual.surges(change, (0, 0)).any()
    assert usual.surges(np.float32(1.01 * SURGE) * change, (0, 0)).all()


def test_what_is_seen_first_may_be_a_header() -> None:
    usual, change = UsualAlternation(), np.ones((6, 8), np.float32)
    usual.surges(change, (0, 0))
    assert not usual.surges(change, (0, 0)).any()
    assert usual.surges(change, (8, 0)).all()
    assert usual.surges(change[:5], (8, 0)).all()
