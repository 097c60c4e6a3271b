"""Novelty of blocks over the running baseline of their alternation."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.receive.detect.budget import NoveltyFilter, NoveltyParameters

Bools = NDArray[np.bool_]
HAAR, OOK = NoveltyParameters(), NoveltyParameters(min_ratio=1.1, max_ratio=1.1)
LEAST, MOST, STRONG = HAAR.min_ratio, HAAR.max_ratio, HAAR.strong_ratio


def novel_blocks(
    baseline: NoveltyFilter, change: NDArray[np.float32], origin: tuple[int, int], depletion: float
) -> Bools:
    return baseline.novel_blocks(change, origin, depletion)[0]


def novel_and_strong(baseline: NoveltyFilter, change: NDArray[np.float32], depletion: float) -> tuple[Bools, Bools]:
    novel, novelty, _ = baseline.novel_blocks(change, (0, 0), depletion)
    return novel, novelty > STRONG


def test_a_header_is_novel_over_data_and_even_flicker_is_not() -> None:
    baseline, change = NoveltyFilter(HAAR), np.ones((10, 12), np.float32)
    for _ in range(HAAR.warmup_searches):
        assert novel_blocks(baseline, change, (0, 0), 1.0).all()
    for _ in range(5):
        assert not novel_blocks(baseline, change, (0, 0), 1.0).any()
    change[:4, :4] = 2.5
    header = novel_blocks(baseline, change, (0, 0), 1.0)
    assert header[:3, :3].all()
    assert not header[7:].any()
    # what stays is baseline soon
    for _ in range(20):
        novel_blocks(baseline, change, (0, 0), 1.0)
    assert not novel_blocks(baseline, change, (0, 0), 1.0).any()
    # the scarcer time is, the more is asked
    assert novel_blocks(baseline, np.float32(1.01 * MOST) * change, (0, 0), 1.0).all()
    novel_blocks(baseline, change, (0, 0), 1.0)
    assert not novel_blocks(baseline, np.float32(1.1 * LEAST) * change, (0, 0), 1.0).any()
    assert novel_blocks(baseline, np.float32(1.1 * LEAST) * change, (0, 0), 0.0).all()


@pytest.mark.parametrize(
    ("parameters", "factor", "is_strong", "repeats"),
    [
        (HAAR, 0.5 * (LEAST + MOST), False, False),
        (HAAR, 1.1 * STRONG, True, True),
        (OOK, 0.5 * (OOK.min_ratio + STRONG), False, True),
        (OOK, 1.1 * STRONG, True, True),
    ],
)
def test_a_novel_block_stays_novel_for_a_second_search(
    parameters: NoveltyParameters, factor: float, is_strong: bool, repeats: bool
) -> None:
    """A search too late for a header leaves it to the next search, in which the block is no longer novel."""
    baseline, change = NoveltyFilter(parameters), np.ones((6, 8), np.float32)
    for _ in range(5):
        novel, strong = novel_and_strong(baseline, change, 0.0)
        assert not strong.any()
    assert not novel.any()
    novel, strong = novel_and_strong(baseline, np.float32(factor) * change, 0.0)
    assert novel.all()
    assert strong.all() == strong.any() == is_strong
    novel, strong = novel_and_strong(baseline, change, 1.0)
    assert novel.all() == novel.any() == repeats
    assert strong.all() == strong.any() == is_strong
    novel, strong = novel_and_strong(baseline, change, 1.0)
    assert not novel.any()
    assert not strong.any()


def test_the_baseline_follows_a_new_array_at_once() -> None:
    """An array that comes into sight is strongly novel in two searches, as the second may see the header."""
    baseline, change = NoveltyFilter(HAAR), np.full((6, 8), 0.1, np.float32)
    for _ in range(5):
        baseline.novel_blocks(change, (0, 0), 0.0)
    change *= np.float32(10)
    updates = [novel_and_strong(baseline, change, 0.0) for _ in range(3)]
    assert [bool(one.all()) for update in updates for one in update] == [True, True, True, True, False, False]


@pytest.mark.parametrize("before", [0, 20])
def test_all_blocks_are_strongly_novel_after_quiet_searches(before: int) -> None:
    baseline, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(before):
        novel, strong = novel_and_strong(baseline, change, 1.0)
    for _ in range(20):
        baseline.record_quiet()
    novel, strong = novel_and_strong(baseline, change, 1.0)
    assert novel.all()
    assert strong.all()
    # it was a place seen first, or one that was calm
    assert novel_and_strong(baseline, change, 1.0)[1].all()
    assert not baseline.novel_blocks(change, (0, 0), 1.0)[0].any()


def test_a_quiet_search_makes_no_block_novel() -> None:
    baseline, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(20):
        baseline.novel_blocks(change, (0, 0), 1.0)
    baseline.record_quiet()
    assert not baseline.novel_blocks(change, (0, 0), 0.0)[0].any()


def test_all_blocks_of_a_new_place_are_novel() -> None:
    baseline, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(HAAR.warmup_searches):
        novel_blocks(baseline, change, (0, 0), 1.0)
    assert not novel_blocks(baseline, change, (0, 0), 1.0).any()
    for _ in range(HAAR.warmup_searches):
        assert novel_blocks(baseline, change, (8, 0), 1.0).all()
    assert not novel_blocks(baseline, change, (8, 0), 1.0).any()
    assert novel_blocks(baseline, change[:5], (8, 0), 1.0).all()


@pytest.mark.parametrize("levels", [(0, 0.25, 0.5, 0.75, 1), (0, 1)], ids=["haar", "ook"])
@pytest.mark.parametrize("first", [0, 1], ids=["pattern", "inverse"])
@pytest.mark.parametrize("phase", [0.0, 0.2])
def test_headers_are_novel_over_data_for_either_first_frame(levels: Sequence[float], first: int, phase: float) -> None:
    baseline, rng = NoveltyFilter(HAAR if len(levels) > 2 else OOK), np.random.default_rng(2)
    header, found = rng.integers(0, 2, (6, 6, 16)).astype(float), list[bool]()
    before = False
    patterns = [
        one
        for _ in range(12)
        for pattern in [header, header, *(rng.choice(levels, header.shape) for _ in range(48))]
        for one in (pattern, 1 - pattern)
    ]
    frames = [(1 - phase) * one + phase * two for one, two in pairwise(patterns)]
    for k in range(first, len(frames) - 3, 2):
        a, b, c, d = frames[k : k + 4]
        # each block the mean size of its LEDs' change
        seen = novel_blocks(baseline, np.abs(a - 3 * b + 3 * c - d).mean(axis=2).astype(np.float32), (0, 0), 1.0)
        surging = bool(seen[1:-1, 1:-1].all())
        if k > 200 and k % 100 == first:
            # amid a header that begins with its inverse, two searches see most of it
            found.append(surging or (before and first == 1))
        before = surging
    assert len(found) > 8
    assert all(found)


def test_blocks_wait_from_their_second_search_on() -> None:
    """The first search may see a part of a header alone."""
    baseline, waits = NoveltyFilter(NoveltyParameters(window=3), packet_searches=10), list[float]()
    change, first = np.ones((2, 3), np.float32), np.zeros((2, 3), bool)
    first[0, 0] = True
    for k in range(6):
        _, _, now = baseline.novel_blocks(change, (0, 0), 0.0)
        waits.append(float(now[0, 0]))
        assert np.isinf(now[1]).all()
        baseline.record_searched(first if k < 2 else ~first & False)
    assert waits == pytest.approx([np.inf, np.inf, 0.1, 0.1, 0.2, 0.3])
    for _ in range(5):
        baseline.record_quiet()
    assert baseline.novel_blocks(change, (0, 0), 0.0)[2][0, 0] == pytest.approx(0.9)
    # another part of the sensor is new
    assert np.isinf(baseline.novel_blocks(change, (8, 0), 0.0)[2]).all()
