"""Block novelty relative to a running baseline."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.receive.detect.budget import NoveltyFilter

Bools = NDArray[np.bool_]
HAAR, OOK = (1.2, 1.4), (1.1, 1.1)
(LEAST, MOST), STRONG, WARMUP_SEARCHES = HAAR, NoveltyFilter.STRONG, 3


def novel_blocks(
    baseline: NoveltyFilter, change: NDArray[np.float32], origin: tuple[int, int], is_scarce: bool
) -> Bools:
    return baseline.novel_blocks(change, origin, is_scarce)[0]


def novel_and_strong(baseline: NoveltyFilter, change: NDArray[np.float32], is_scarce: bool) -> tuple[Bools, Bools]:
    novel, novelty = baseline.novel_blocks(change, (0, 0), is_scarce)
    return novel, novelty > STRONG


def test_a_header_is_novel_over_data_and_even_flicker_is_not() -> None:
    baseline, change = NoveltyFilter(*HAAR), np.ones((10, 12), np.float32)
    for _ in range(WARMUP_SEARCHES):
        assert novel_blocks(baseline, change, (0, 0), True).all()
    for _ in range(5):
        assert not novel_blocks(baseline, change, (0, 0), True).any()
    change[:4, :4] = 2.5
    header = novel_blocks(baseline, change, (0, 0), True)
    assert header[:3, :3].all()
    assert not header[7:].any()
    # persistent change becomes baseline
    for _ in range(20):
        novel_blocks(baseline, change, (0, 0), True)
    assert not novel_blocks(baseline, change, (0, 0), True).any()
    # scarce budget raises the threshold
    assert novel_blocks(baseline, np.float32(1.01 * MOST) * change, (0, 0), True).all()
    novel_blocks(baseline, change, (0, 0), True)
    assert not novel_blocks(baseline, np.float32(1.1 * LEAST) * change, (0, 0), True).any()
    assert novel_blocks(baseline, np.float32(1.1 * LEAST) * change, (0, 0), False).all()


@pytest.mark.parametrize(
    ("parameters", "factor", "is_strong", "repeats"),
    [
        (HAAR, 0.5 * (LEAST + MOST), False, False),
        (HAAR, 1.1 * STRONG, True, True),
        (OOK, 0.5 * (OOK[0] + STRONG), False, True),
        (OOK, 1.1 * STRONG, True, True),
    ],
)
def test_a_novel_block_stays_novel_for_a_second_search(
    parameters: tuple[float, float], factor: float, is_strong: bool, repeats: bool
) -> None:
    """A novel block stays novel in the next search, which may catch a header missed by the first."""
    baseline, change = NoveltyFilter(*parameters), np.ones((6, 8), np.float32)
    for _ in range(5):
        novel, strong = novel_and_strong(baseline, change, False)
        assert not strong.any()
    assert not novel.any()
    novel, strong = novel_and_strong(baseline, np.float32(factor) * change, False)
    assert novel.all()
    assert strong.all() == strong.any() == is_strong
    novel, strong = novel_and_strong(baseline, change, True)
    assert novel.all() == novel.any() == repeats
    assert strong.all() == strong.any() == is_strong
    novel, strong = novel_and_strong(baseline, change, True)
    assert not novel.any()
    assert not strong.any()


def test_the_baseline_follows_a_new_array_at_once() -> None:
    """A new array is strongly novel in two searches, because the second may contain the header."""
    baseline, change = NoveltyFilter(*HAAR), np.full((6, 8), 0.1, np.float32)
    for _ in range(5):
        baseline.novel_blocks(change, (0, 0), False)
    change *= np.float32(10)
    updates = [novel_and_strong(baseline, change, False) for _ in range(3)]
    assert [bool(one.all()) for update in updates for one in update] == [True, True, True, True, False, False]


@pytest.mark.parametrize("before", [0, 20])
def test_all_blocks_are_strongly_novel_after_quiet_searches(before: int) -> None:
    baseline, change = NoveltyFilter(*HAAR), np.ones((6, 8), np.float32)
    for _ in range(before):
        novel, strong = novel_and_strong(baseline, change, True)
    for _ in range(20):
        baseline.record_quiet()
    novel, strong = novel_and_strong(baseline, change, True)
    assert novel.all()
    assert strong.all()
    # as for a new or quiet area, the second search is strongly novel too
    assert novel_and_strong(baseline, change, True)[1].all()
    assert not baseline.novel_blocks(change, (0, 0), True)[0].any()


def test_a_quiet_search_makes_no_block_novel() -> None:
    baseline, change = NoveltyFilter(*HAAR), np.ones((6, 8), np.float32)
    for _ in range(20):
        baseline.novel_blocks(change, (0, 0), True)
    baseline.record_quiet()
    assert not baseline.novel_blocks(change, (0, 0), False)[0].any()


def test_all_blocks_of_a_new_place_are_novel() -> None:
    baseline, change = NoveltyFilter(*HAAR), np.ones((6, 8), np.float32)
    for _ in range(WARMUP_SEARCHES):
        novel_blocks(baseline, change, (0, 0), True)
    assert not novel_blocks(baseline, change, (0, 0), True).any()
    for _ in range(WARMUP_SEARCHES):
        assert novel_blocks(baseline, change, (8, 0), True).all()
    assert not novel_blocks(baseline, change, (8, 0), True).any()
    assert novel_blocks(baseline, change[:5], (8, 0), True).all()


@pytest.mark.parametrize("levels", [(0, 0.25, 0.5, 0.75, 1), (0, 1)], ids=["haar", "ook"])
@pytest.mark.parametrize("first", [0, 1], ids=["pattern", "inverse"])
@pytest.mark.parametrize("phase", [0.0, 0.2])
def test_headers_are_novel_over_data_for_either_first_frame(levels: Sequence[float], first: int, phase: float) -> None:
    baseline, rng = NoveltyFilter(*(HAAR if len(levels) > 2 else OOK)), np.random.default_rng(2)
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
        # mean absolute change per block
        seen = novel_blocks(baseline, np.abs(a - 3 * b + 3 * c - d).mean(axis=2).astype(np.float32), (0, 0), True)
        surging = bool(seen[1:-1, 1:-1].all())
        if k > 200 and k % 100 == first:
            # headers starting with an inverse need two searches
            found.append(surging or (before and first == 1))
        before = surging
    assert len(found) > 8
    assert all(found)
