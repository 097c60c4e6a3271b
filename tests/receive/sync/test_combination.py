"""Frame combination for arbitrary timing, against slot-by-slot PWM light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from slot_light import COVARIANCE, SLOPES, observed, symbols_of, values_of

from heliograph.receive.sync import combine as partial_exposure
from heliograph.receive.sync.combine import combine_header, combine_pair, dimmed_light, slot_light
from heliograph.signal import haar, pwm

Floats = NDArray[np.float64]
SIDE = 8
FINE = 400
"""Simulation steps per T_b."""

EXACT = 0.035
"""Frames within this offset, in T_b, count as synchronous."""

LEAK = 1e-3
"""Negligible weight for a foreign slot."""


def random_data(seed: int, count: int) -> NDArray[np.int8]:
    return np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), (count, SIDE, SIDE))


def light_of(pairs: NDArray[np.int8], order: tuple[int, ...]) -> Floats:
    """Return light (FINE steps per pattern, n, n) for consecutive pattern and inverse pairs; LEDs are on or off."""
    levels = haar.encode(pairs)
    patterns = np.stack([levels, pwm.invert(levels)], 1).reshape(-1, SIDE, SIDE)
    return pwm.lit_slots(patterns, order).reshape(-1, SIDE, SIDE).repeat(FINE // 4, 0).astype(float)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1)])
@pytest.mark.parametrize("exposure", [0.13, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.1, 0.37, 0.6])
@pytest.mark.parametrize("rate", [1.0, 1.5, 2.7])
def test_a_combination_holds_what_it_says(order: tuple[int, ...], exposure: float, phase: float, rate: float) -> None:
    exposure = min(exposure, 1 / rate)
    pairs = random_data(5, 3)
    light = light_of(pairs, order)
    starts = phase + np.arange(-10, 10) / rate
    starts = starts[(starts >= -1) & (starts + exposure <= 4)]
    starts, exposure = np.round(starts * FINE) / FINE, round(exposure * FINE) / FINE
    combination = combine_pair(starts, exposure, order)
    assert combination is not None
    first = np.round((starts[combination.frames] + 2) * FINE).astype(int)
    exposures = np.stack([light[k : k + round(exposure * FINE)].mean(0) for k in first])
    difference = np.tensordot(combination.difference, exposures, 1)
    tables = [partial_exposure.response(slots) for slots in combination.slots]
    expected = sum(
        table[values_of(symbols_of(d)), np.arange(SIDE * SIDE) // (SIDE * SIDE // 4)]
        for table, d in zip(tables, pairs, strict=True)
    )
    # subtract the mean, which the levels include
    mean = combination.levels[0] - combination.levels[1]
    assert observed(difference - mean) == pytest.approx(expected, abs=1e-9)
    assert combination.difference.sum() == pytest.approx(0, abs=1e-9)
    assert np.abs(combination.difference).sum() == pytest.approx(2)
    assert np.array_equal(combination.response, tables[1])
    for leak, slots, table in zip(combination.leaks, combination.slots[[0, 2]], (tables[0], tables[2]), strict=True):
        assert (leak is None) == (np.abs(slots).max() <= LEAK)
        assert leak is None or np.array_equal(leak, table)


def merit(weights: Floats, slope: Floats, spread: Floats) -> float:
    """Return squared slope over the variance of nonlinear terms."""
    return float((weights @ slope) ** 2 / (weights @ spread @ weights))


@examples(150)
@given(rate=st.floats(1.0, 3.0), part=st.floats(0.2, 1.0), phase=st.floats(0, 1))
def test_no_difference_shows_the_levels_better(rate: float, part: float, phase: float) -> None:
    """With noise and interference from other pairs; low-weight frames may be dropped."""
    order, exposure = (0, 1, 2, 3), part / rate
    starts = (phase + np.arange(-8.0, 16.0)) / rate
    starts = starts[(starts > -1) & (starts < 2)]
    combination = combine_pair(starts, exposure, order)
    # slot overlaps for three pairs; the first begins at -2
    slots = np.arange(-8, 16) / 4
    ends = np.minimum(starts[:, None] + exposure, slots + 0.25)
    overlap = np.maximum(ends - np.maximum(starts[:, None], slots), 0) / exposure
    shown = np.einsum("fj,jqr->fqr", overlap, slot_light(order)[0])
    slope = shown[:, 1] @ SLOPES
    # noise variance 0.05 per frame, plus random data in each slot
    spread = 0.05 * np.eye(len(starts)) - np.outer(slope, slope)
    spread += np.einsum("fqr,rs,gqs->fg", shown, COVARIANCE, shown)
    near = overlap[:, 8:16].sum(1) > 1e-9
    spread, slope = spread[np.ix_(near, near)], slope[near]
    # optimum with zero sum: M^-1 (h - mu 1)
    h, ones = np.linalg.solve(spread, np.stack([slope, np.ones(len(slope))], axis=1)).T
    best = h - ones * h.sum() / ones.sum()
    if combination is None:
        assert merit(best, slope, spread) < 0.1
        return
    weights = np.zeros(len(starts))
    weights[combination.frames] = combination.difference
    assert merit(weights[near], slope, spread) > 0.994 * merit(best, slope, spread)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1)])
@pytest.mark.parametrize("phase", [0.0, 0.1, 0.37, 0.6])
def test_the_sum_is_the_array_all_on_at_its_mean_time(order: tuple[int, ...], phase: float) -> None:
    """Averaged over data, the sum equals an all-on array with mean time `sum_time`."""
    starts = np.round((phase + np.arange(-2, 6) / 1.5) * FINE) / FINE
    starts, exposure = starts[(starts >= -1) & (starts + 0.5 <= 4)], 0.5
    combination = combine_pair(starts, exposure, order)
    assert combination is not None
    sums, times = [], []
    for seed in range(60):
        light = light_of(random_data(seed, 3), order)
        first = np.round((starts[combination.frames] + 2) * FINE).astype(int)
        parts = np.stack([light[k : k + FINE // 2].mean((1, 2)) for k in first])
        sums.append(combination.total @ parts.mean(1))
        middle = starts[combination.frames][:, None] + (np.arange(FINE // 2) + 0.5) / FINE
        times.append([combination.total @ (parts * middle).mean(1), combination.total @ parts.mean(1)])
    assert np.mean(sums) == pytest.approx(1, abs=0.02)
    moment, mass = np.sum(times, axis=0)
    assert moment / mass == pytest.approx(combination.sum_time, abs=0.02)
    assert (combination.total >= 0).all()


def test_in_step_a_combination_is_two_frames() -> None:
    combination = combine_pair(np.arange(-1.0, 4.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    assert combination.departure < EXACT
    assert list(combination.frames) == [1, 2]
    assert list(combination.difference) == pytest.approx([1, -1])
    assert list(combination.total) == pytest.approx([1, 1])
    assert (combination.noise, combination.sum_noise) == pytest.approx((1, 1))
    assert combination.levels == pytest.approx((0.5, 0.5))
    assert combination.leaks == (None, None)
    # mean light is early in a pattern, data-dependent light later
    mean, data = pwm.light_centroids()
    assert combination.sum_time == pytest.approx(mean + 0.5)
    assert combination.data_times == pytest.approx((data, 1 + data))


@pytest.mark.parametrize("late", [0.0, 0.02, 0.1, -0.25])
def test_the_departure_is_half_of_the_light_that_is_misplaced(late: float) -> None:
    """Late frames miss the pattern's start and include the inverse's start, which the second frame then misses."""
    combination = combine_pair(late + np.arange(-1.0, 4.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    if len(combination.difference) == 2:
        assert combination.departure == pytest.approx(1.5 * abs(late), abs=1e-9)
    else:
        assert combination.departure == np.inf


def test_half_a_pattern_late_only_neighbours_differ() -> None:
    combination = combine_pair(np.arange(-1.5, 4.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    assert combination.departure > EXACT
    # the middle frame is half lit for all data and only contributes to the sum
    within = list(combination.frames).index(2)
    assert combination.difference[within] == 0
    assert combination.total[within] == pytest.approx(2, rel=0.1)
    # half the synchronous slope, with equal leakage from the previous and next pair
    assert combination.slots[1] @ SLOPES == pytest.approx(0.5 * 0.5)
    assert combination.slots[0] == pytest.approx([-0.25, -0.25, 0, 0])
    assert combination.slots[2] == pytest.approx([-0.25, -0.25, 0, 0])


def test_a_pair_that_is_not_filmed_gives_no_combination() -> None:
    order = (0, 1, 2, 3)
    assert combine_pair(np.array([]), 1.0, order) is None
    assert combine_pair(np.array([0.0]), 1.0, order) is None
    # two frames in the pattern, none in the inverse
    assert combine_pair(np.array([0.0, 0.5]), 0.5, order) is None


def test_the_sum_of_a_header_is_free_of_it() -> None:
    shown = np.array([0.4, -0.4, 0.7, 0.1])
    half = 0.5 * shown, np.array([0.5, 0.5, 0.6, 0.5])
    combination = combine_header(np.arange(4.0), 1.0, shown, half)
    assert combination is not None
    # half-contrast cells; frame weights determine the visible uneven light
    assert combination.dimmed == pytest.approx((0.5, 0.1 * combination.difference[2]))
    assert combination.total @ shown == pytest.approx(0)
    assert combination.total.sum() == pytest.approx(2)
    assert combination.difference @ shown == pytest.approx(2)
    assert combination.difference.sum() == pytest.approx(0)
    # header light is uniform: mean of exposure centres
    assert combination.sum_time == pytest.approx(combination.total @ (np.arange(4.0) + 0.5) / 2)
    assert combine_header(np.arange(4.0), 1.0, np.array([0.0, 0.01, 0.0, 0.0]), half) is None
    assert combine_header(np.zeros(0), 1.0, np.zeros(0), (np.zeros(0), np.zeros(0))) is None


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1)])
@pytest.mark.slow
def test_slots_show_the_light_that_is_lit_in_them(order: tuple[int, ...]) -> None:
    _, mean = slot_light(order)
    # dimmed cells use levels 3 and 1
    high, low = (pwm.lit_slots(np.full((1, 1), level), order)[:, 0, 0] for level in (3, 1))
    assert [part.tolist() for part in dimmed_light(order)] == [
        (high.astype(float) - low).tolist(),
        ((high.astype(float) + low) / 2).tolist(),
    ]
    drawn = light_of(random_data(1, 400), order).reshape(400, 2 * FINE, -1).mean((0, 2))
    assert mean[:8] == pytest.approx(drawn[FINE // 8 :: FINE // 4], abs=0.02)
    assert mean.tolist() == np.tile(mean[:8], 3).tolist()
