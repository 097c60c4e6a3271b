"""What surges over what usually alternates."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.receive.detect.budget import NoveltyFilter, NoveltyParameters

Bools = NDArray[np.bool_]
HAAR, OOK = NoveltyParameters(), NoveltyParameters(min_ratio=1.1, max_ratio=1.1)
LEAST, MOST, STRONG = HAAR.min_ratio, HAAR.max_ratio, HAAR.strong_ratio


def novel_blocks(usual: NoveltyFilter, change: NDArray[np.float32], origin: tuple[int, int], depletion: float) -> Bools:
    return usual.novel_blocks(change, origin, depletion)[0]


def novel_and_strong(usual: NoveltyFilter, change: NDArray[np.float32], depletion: float) -> tuple[Bools, Bools]:
    novel, novelty, _ = usual.novel_blocks(change, (0, 0), depletion)
    return novel, novelty > STRONG


def test_a_header_surges_over_its_data_and_flicker_of_even_strength_does_not() -> None:
    usual, change = NoveltyFilter(HAAR), np.ones((10, 12), np.float32)
    for _ in range(HAAR.warmup_searches):
        assert novel_blocks(usual, change, (0, 0), 1.0).all()
    for _ in range(5):
        assert not novel_blocks(usual, change, (0, 0), 1.0).any()
    change[:4, :4] = 2.5
    header = novel_blocks(usual, change, (0, 0), 1.0)
    assert header[:3, :3].all()
    assert not header[7:].any()
    # what stays is usual soon
    for _ in range(20):
        novel_blocks(usual, change, (0, 0), 1.0)
    assert not novel_blocks(usual, change, (0, 0), 1.0).any()
    # the scarcer time is, the more is asked
    assert novel_blocks(usual, np.float32(1.01 * MOST) * change, (0, 0), 1.0).all()
    novel_blocks(usual, change, (0, 0), 1.0)
    assert not novel_blocks(usual, np.float32(1.1 * LEAST) * change, (0, 0), 1.0).any()
    assert novel_blocks(usual, np.float32(1.1 * LEAST) * change, (0, 0), 0.0).all()


@pytest.mark.parametrize(
    ("parameters", "factor", "strikes", "lasts"),
    [
        (HAAR, 0.5 * (LEAST + MOST), False, False),
        (HAAR, 1.1 * STRONG, True, True),
        (OOK, 0.5 * (OOK.min_ratio + STRONG), False, True),
        (OOK, 1.1 * STRONG, True, True),
    ],
)
def test_what_surges_does_so_for_one_more_search(
    parameters: NoveltyParameters, factor: float, strikes: bool, lasts: bool
) -> None:
    """A search that sees a header too late leaves it to the next, in which it surges no more."""
    usual, change = NoveltyFilter(parameters), np.ones((6, 8), np.float32)
    for _ in range(5):
        told, strong = novel_and_strong(usual, change, 0.0)
        assert not strong.any()
    assert not told.any()
    told, strong = novel_and_strong(usual, np.float32(factor) * change, 0.0)
    assert told.all()
    assert strong.all() == strong.any() == strikes
    told, strong = novel_and_strong(usual, change, 1.0)
    assert told.all() == told.any() == lasts
    assert strong.all() == strong.any() == strikes
    told, strong = novel_and_strong(usual, change, 1.0)
    assert not told.any()
    assert not strong.any()


def test_what_is_there_anew_is_usual_at_once() -> None:
    """Of an array that comes into sight two searches strike, the second as it may be its header."""
    usual, change = NoveltyFilter(HAAR), np.full((6, 8), 0.1, np.float32)
    for _ in range(5):
        usual.novel_blocks(change, (0, 0), 0.0)
    change *= np.float32(10)
    told = [novel_and_strong(usual, change, 0.0) for _ in range(3)]
    assert [bool(one.all()) for two in told for one in two] == [True, True, True, True, False, False]


@pytest.mark.parametrize("before", [0, 20])
def test_where_it_was_calm_all_strikes(before: int) -> None:
    usual, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(before):
        told, strong = novel_and_strong(usual, change, 1.0)
    for _ in range(20):
        usual.record_quiet()
    told, strong = novel_and_strong(usual, change, 1.0)
    assert told.all()
    assert strong.all()
    # it was a place seen first, or one that was calm
    assert novel_and_strong(usual, change, 1.0)[1].all()
    assert not usual.novel_blocks(change, (0, 0), 1.0)[0].any()


def test_one_calm_search_is_nothing_unusual() -> None:
    usual, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(20):
        usual.novel_blocks(change, (0, 0), 1.0)
    usual.record_quiet()
    assert not usual.novel_blocks(change, (0, 0), 0.0)[0].any()


def test_what_is_seen_first_may_be_a_header() -> None:
    usual, change = NoveltyFilter(HAAR), np.ones((6, 8), np.float32)
    for _ in range(HAAR.warmup_searches):
        novel_blocks(usual, change, (0, 0), 1.0)
    assert not novel_blocks(usual, change, (0, 0), 1.0).any()
    for _ in range(HAAR.warmup_searches):
        assert novel_blocks(usual, change, (8, 0), 1.0).all()
    assert not novel_blocks(usual, change, (8, 0), 1.0).any()
    assert novel_blocks(usual, change[:5], (8, 0), 1.0).all()


@pytest.mark.parametrize("levels", [(0, 0.25, 0.5, 0.75, 1), (0, 1)], ids=["haar", "ook"])
@pytest.mark.parametrize("first", [0, 1], ids=["pattern", "inverse"])
@pytest.mark.parametrize("phase", [0.0, 0.2])
def test_headers_surge_over_data_whatever_a_search_begins_with(
    levels: Sequence[float], first: int, phase: float
) -> None:
    usual, rng = NoveltyFilter(HAAR if len(levels) > 2 else OOK), np.random.default_rng(2)
    header, told = rng.integers(0, 2, (6, 6, 16)).astype(float), list[bool]()
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
        seen = novel_blocks(usual, np.abs(a - 3 * b + 3 * c - d).mean(axis=2).astype(np.float32), (0, 0), 1.0)
        surging = bool(seen[1:-1, 1:-1].all())
        if k > 200 and k % 100 == first:
            # amid a header that begins with its inverse, two searches see most of it
            told.append(surging or (before and first == 1))
        before = surging
    assert len(told) > 8
    assert all(told)


def test_blocks_wait_from_their_second_search_on() -> None:
    """The first search may see a part of a header alone."""
    usual, waits = NoveltyFilter(NoveltyParameters(window=3), packet_searches=10), list[float]()
    change, first = np.ones((2, 3), np.float32), np.zeros((2, 3), bool)
    first[0, 0] = True
    for k in range(6):
        _, _, now = usual.novel_blocks(change, (0, 0), 0.0)
        waits.append(float(now[0, 0]))
        assert np.isinf(now[1]).all()
        usual.record_searched(first if k < 2 else ~first & False)
    assert waits == pytest.approx([np.inf, np.inf, 0.1, 0.1, 0.2, 0.3])
    for _ in range(5):
        usual.record_quiet()
    assert usual.novel_blocks(change, (0, 0), 0.0)[2][0, 0] == pytest.approx(0.9)
    # another part of the sensor is new
    assert np.isinf(usual.novel_blocks(change, (8, 0), 0.0)[2]).all()
