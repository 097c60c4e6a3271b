"""Queue between camera and receiver."""

import itertools
import threading
import time

import numpy as np
import pytest
from waiting import HANG_S

from heliograph.base.frames import Frame
from heliograph.media.live.grabber import FrameQueue


def frame(index: int) -> Frame:
    return Frame(index, index / 100, np.zeros((2, 2), np.uint8))


def test_frames_come_in_their_order() -> None:
    queue = FrameQueue(8)
    for index in range(5):
        queue.put(frame(index))
    queue.end()
    got = [queue.get(0) for _ in range(5)]
    assert [one and one.index for one in got] == [0, 1, 2, 3, 4]
    assert len(queue) == 0
    assert queue.get(0) is None
    assert queue.over
    assert queue.dropped == 0


def test_a_full_queue_drops_a_run_of_frames_until_half_empty() -> None:
    queue = FrameQueue(8)
    kept: list[int] = []
    for index in range(60):
        queue.put(frame(index))
        if index % 2 and (one := queue.get(0)):  # the receiver takes two frame periods per frame
            kept.append(one.index)
    kept += [one.index for one in iter(lambda: queue.get(0), None)]
    assert len(kept) + queue.dropped == 60
    gaps = [(one, other) for one, other in itertools.pairwise(kept) if other != one + 1]
    assert queue.dropped > 10
    # a full queue drops half of its frames at once, not single frames
    assert len(gaps) <= queue.dropped // 4


def test_waiting_is_bounded_and_ends_with_the_queue() -> None:
    queue = FrameQueue(2)
    began = time.monotonic()
    assert queue.get(0.05) is None
    assert time.monotonic() - began > 0.04
    threading.Timer(0.05, queue.end).start()
    assert queue.get(HANG_S) is None
    assert queue.over


@pytest.mark.parametrize("most", [1, 2, 3])
def test_a_small_queue_accepts_frames_after_it_was_full(most: int) -> None:
    queue = FrameQueue(most)
    for index in range(10):
        queue.put(frame(index))
    assert len(queue) == most
    for _ in range(most):
        queue.get(0)
    queue.put(frame(99))
    last = queue.get(0)
    assert last is not None
    assert last.index == 99
