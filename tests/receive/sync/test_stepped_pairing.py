"""Pairing for synchronous cameras: increasing, unique pair numbers despite dropped frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, SynchronousPairing
from heliograph.signal.settings import SignalSettings

SIGNAL = SignalSettings(data_pairs=3)
"""Packets with five pairs, two of which are headers."""

POSE = Pose(4.0, 4.0, 0.5)


def frame(number: int, start_s: float = 0.0) -> Frame:
    return Frame(number, start_s + number * 1e-3, np.zeros((4, 4), np.uint8))


def paired(pairing: SynchronousPairing, frames: list[Frame]) -> list[tuple[int, FramePair | None]]:
    """Return pair numbers and frames, frame by frame, as a receiver does."""
    got: list[tuple[int, FramePair | None]] = []
    for one in [*frames, None]:
        if one is None:
            pairing.flush()
        else:
            pairing.push(one, lambda _: POSE, False)
        while (due := pairing.next_pair(lambda _: POSE, np.ones((8, 8)), False)) is not None:
            number, pair = due
            assert not isinstance(pair, MeasuredHeader)
            got.append((number, pair))
    return got


@examples(150)
@given(
    dropped=st.sets(st.integers(0, 59)),
    before=st.integers(0, 5),
    start_s=st.sampled_from([0.0, 0.0371, 2.0]),
    jitter=st.floats(0, 0.4),
)
@pytest.mark.slow
def test_each_pair_comes_once_in_order_with_its_frames(
    dropped: set[int], before: int, start_s: float, jitter: float
) -> None:
    frames = [
        Frame(k + before, start_s + 1e-3 * (k + jitter * np.sin(k)), np.zeros((4, 4), np.uint8))
        for k in range(-before, 60)
        if k not in dropped
    ]
    got = paired(SynchronousPairing(start_s, start_s + 1.5e-3, 0, SIGNAL), frames)
    kept = sorted(set(range(60)) - dropped)
    # a pair is complete as soon as its last or a later frame arrives
    assert [number for number, _ in got] == list(range((max(kept, default=-1) + 1) // 2))
    for number, pair in got:
        there = {2 * number, 2 * number + 1} - dropped
        if len(there) < 2:
            assert pair is None
        else:
            assert isinstance(pair, FramePair)
            assert (pair.pattern.index, pair.inverted.index) == (2 * number + before, 2 * number + 1 + before)
            assert pair.combination is None


def test_the_light_of_data_comes_early_that_of_headers_does_not() -> None:
    got = paired(SynchronousPairing(0.0, 1.5e-3, 0, SIGNAL), [frame(k) for k in range(20)])
    late = [pair.late_s for _, pair in got if pair is not None]
    # (15 1/2 + 11 3/2 + 5 5/2 + 1 7/2) / 32 slots, each 0.25 ms, minus half a pattern
    data = (15 * 0.5 + 11 * 1.5 + 5 * 2.5 + 3.5) / 32 * 0.25e-3 - 0.5e-3
    assert late == pytest.approx([0, 0, data, data, data] * 2)


def test_times_of_the_pairing() -> None:
    pairing = SynchronousPairing(0.1, 0.1015, 0, SIGNAL)
    assert (pairing.origin_s, pairing.now_s) == (0.1, 0.1015)
    paired(pairing, [frame(0, 0.1)])
    assert pairing.now_s == 0.1015
    assert len(paired(pairing, [frame(7, 0.1)])) == 4
    assert pairing.now_s == pytest.approx(0.107)
    assert (pairing.lost, pairing.first_gain) == (False, None)
    pairing.flush()
    assert pairing.next_pair(lambda _: POSE, np.ones((8, 8)), False) is None
