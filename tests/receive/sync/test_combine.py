"""Frame combination for arbitrary timing and square symbol estimates, against slot-by-slot PWM light."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from slot_light import COVARIANCE, MEAN_LIT, SLOPES, VALUES, light_about_mean, observed, symbols_of, values_of

from heliograph.receive.sync import combine
from heliograph.receive.sync.combine import (
    Combination,
    UnsynchronisedPacket,
    combine_header,
    combine_pair,
    dimmed_light,
    moments,
    posterior_moments,
    response,
    response_of_levels,
    slot_light,
    symbol_llrs,
)
from heliograph.signal import haar, pwm

Floats = NDArray[np.float64]
SIDE, PAIRS = 8, 5
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
@pytest.mark.parametrize("exposure", [0.13, 0.5, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.37, 0.6])
@pytest.mark.parametrize("rate", [1.0, 2.7])
def test_combination_shows_stated_symbols(order: tuple[int, ...], exposure: float, phase: float, rate: float) -> None:
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
    tables = [response(slots) for slots in combination.slots]
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
def test_combination_is_close_to_the_optimum(rate: float, part: float, phase: float) -> None:
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
def test_sum_shows_all_leds_on_at_the_mean_time(order: tuple[int, ...], phase: float) -> None:
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


def test_synchronous_combination_has_two_frames() -> None:
    combination = combine_pair(np.arange(-1.0, 4.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    assert combination.departure < EXACT
    assert list(combination.frames) == [1, 2]
    assert list(combination.difference) == pytest.approx([1, -1])
    assert list(combination.total) == pytest.approx([1, 1])
    assert combination.noise == pytest.approx(1)
    assert combination.levels == pytest.approx((0.5, 0.5))
    assert combination.leaks == (None, None)
    # mean light is early in a pattern, data-dependent light later
    mean, data = pwm.light_centroids()
    assert combination.sum_time == pytest.approx(mean + 0.5)
    assert combination.data_times == pytest.approx((data, 1 + data))


@pytest.mark.parametrize("late", [0.0, 0.02, 0.1, -0.25])
def test_departure_is_half_of_the_misplaced_light(late: float) -> None:
    """Late frames miss the pattern's start and include the inverse's start, which the second frame then misses."""
    combination = combine_pair(late + np.arange(-1.0, 4.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    if len(combination.difference) == 2:
        assert combination.departure == pytest.approx(1.5 * abs(late), abs=1e-9)
    else:
        assert combination.departure == np.inf


def test_half_a_pattern_late_only_the_outer_frames_differ() -> None:
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


def test_pair_without_frames_gives_no_combination() -> None:
    order = (0, 1, 2, 3)
    assert combine_pair(np.array([]), 1.0, order) is None
    assert combine_pair(np.array([0.0]), 1.0, order) is None
    # two frames in the pattern, none in the inverse
    assert combine_pair(np.array([0.0, 0.5]), 0.5, order) is None


def test_sum_of_a_header_cancels_its_cells() -> None:
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
def test_slot_light_is_the_mean_of_lit_slots(order: tuple[int, ...]) -> None:
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


def combination_at(phase: float) -> Combination:
    """Combine frames with full exposure at a phase in T_b."""
    found = combine_pair(np.arange(-3.0, 5.0) + phase, 1.0, (0, 1, 2, 3))
    assert found is not None
    return found


def packet(phase: float, seed: int = 0) -> tuple[Combination, UnsynchronisedPacket, Floats, Floats]:
    """Return combination, packet, symbols and noiseless observations, simulated slot by slot."""
    rng = np.random.default_rng(seed)
    combination, header = combination_at(phase), rng.random((SIDE, SIDE)) > 0.5
    data = rng.choice(np.array([-1, 1], np.int8), (PAIRS, SIDE, SIDE))
    levels = [haar.encode(d) for d in data]
    lit = np.where(header, 4, 0).astype(np.uint8)
    around = [lit, *levels, lit]
    shown = [
        sum(
            observed(light_about_mean(around[k + q], combination.slots[q]))
            for q in range(3)
            if np.abs(combination.slots[q]).max() > 1e-3
        )
        for k in range(PAIRS)
    ]
    return (
        combination,
        UnsynchronisedPacket.of([combination] * PAIRS, header),
        np.stack([*map(symbols_of, data)]),
        np.stack(shown),
    )


@pytest.mark.slow
def test_unknown_symbols_have_the_moments_of_random_data() -> None:
    found = np.stack([packet(0.37, seed)[3] for seed in range(400)])
    own, leak = packet(0.37)[1].expected(np.zeros((PAIRS, SIDE**2)))
    # headers next to the packet are known
    inside = slice(1, PAIRS - 1)
    mean, variance = (own[0] + leak[0])[inside], (own[1] + leak[1])[inside]
    kinds = found[:, inside].reshape(-1, 4, SIDE**2 // 4)
    assert kinds.mean((0, 2)) == pytest.approx(mean.reshape(-1, 4, SIDE**2 // 4).mean((0, 2)), abs=0.03)
    assert kinds.var((0, 2)) == pytest.approx(variance.reshape(-1, 4, SIDE**2 // 4).mean((0, 2)), rel=0.1)


@pytest.mark.parametrize("phase", [0.1, 0.37, 0.5, 0.6])
def test_known_symbols_predict_the_observation_and_unknown_ones_follow(phase: float) -> None:
    _, pairs, symbols, shown = packet(phase)
    own, leak = pairs.expected(symbols)
    assert own[0] + leak[0] == pytest.approx(shown, abs=1e-9)
    assert own[1] == pytest.approx(0, abs=1e-9)
    assert leak[1] == pytest.approx(0, abs=1e-9)
    # one unknown symbol per square; all other symbols are known
    kind, square = np.divmod(np.arange(SIDE**2), SIDE**2 // 4)
    mean = np.where(kind == square % 4, 0.0, symbols)
    llrs = pairs.llrs(shown, np.full_like(shown, 1e-3), leak, mean)
    assert (np.sign(llrs) == symbols)[mean == 0].all()


def test_synchronous_pair_shows_only_its_own_symbols() -> None:
    combination, _, symbols, _ = packet(0.5)
    pairs = UnsynchronisedPacket.of([combination, None, combination], np.ones((SIDE, SIDE), bool))
    own, leak = pairs.expected(symbols[:3])
    assert own[0][1] == pytest.approx(symbols[1])
    assert not leak[0][1].any()
    assert not leak[1][1].any()


def test_synchronous_shortcut_equals_enumeration() -> None:
    rng = np.random.default_rng(3)
    symbols = SIDE**2
    pairs = UnsynchronisedPacket.of([None] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    mean, found = rng.uniform(-0.9, 0.9, (PAIRS, symbols)), rng.normal(0, 1.2, (PAIRS, symbols))
    mean[:, : symbols // 2] = np.sign(mean[:, : symbols // 2])
    variance = rng.uniform(0.1, 2.0, symbols)
    assert pairs.is_synchronous
    assert not packet(0.37)[1].is_synchronous
    own, leak = pairs.expected(mean)
    assert np.stack(own) == pytest.approx(np.stack(moments(pairs.response, mean)), abs=1e-12)
    assert not leak[0].any()
    assert not leak[1].any()
    assert pairs.llrs(found, variance, leak, mean) == pytest.approx(
        symbol_llrs(pairs.response, found, variance, mean), abs=1e-6
    )
    chosen = np.array([1, 3])
    short = pairs.posterior_moments(chosen, found[chosen], variance, mean[chosen])
    table = posterior_moments(pairs.response[chosen], found[chosen], variance, mean[chosen])
    assert np.stack(short) == pytest.approx(np.stack(table), abs=1e-9)


def test_partly_combined_packet_or_leakage_is_not_synchronous() -> None:
    combination, whole = combination_at(0.37), UnsynchronisedPacket.of([None] * PAIRS, np.ones((SIDE, SIDE), bool))
    assert whole.is_synchronous
    assert not UnsynchronisedPacket.of([combination, None], np.ones((SIDE, SIDE), bool)).is_synchronous
    for side in ("before", "after"):
        leak = getattr(whole, side).copy()
        leak[1] = 0.2 * VALUES
        assert not replace(whole, **{side: leak}).is_synchronous


def test_header_light_counts_in_synchronous_packets() -> None:
    rng = np.random.default_rng(4)
    pairs = UnsynchronisedPacket.of([None] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    pairs = replace(pairs, headers=rng.normal(0, 0.2, pairs.headers.shape))
    mean, found, variance = np.zeros((PAIRS, SIDE**2)), rng.normal(0, 1, (PAIRS, SIDE**2)), np.ones(SIDE**2)
    _, leak = pairs.expected(mean)
    assert leak[0] == pytest.approx(pairs.headers)
    assert pairs.llrs(found, variance, leak, mean) == pytest.approx(2 * (found - pairs.headers))


def test_lit_slots_have_the_stated_moments() -> None:
    data = np.random.default_rng(0).choice(np.array([-1, 1], np.int8), (4000, SIDE, SIDE))
    levels = haar.encode(data)
    lit = pwm.lit_slots(levels).transpose(1, 0, 2, 3).reshape(4, -1)
    assert lit.mean(1) == pytest.approx(MEAN_LIT, abs=0.01)
    assert np.cov(lit) == pytest.approx(COVARIANCE, abs=0.01)
    assert np.cov(lit, levels.ravel())[4, :4] == pytest.approx(SLOPES, abs=0.01)
    stated = combine.MEAN_LIT, combine.COVARIANCE, combine.SLOPES
    for one, derived in zip(stated, (MEAN_LIT, COVARIANCE, SLOPES), strict=True):
        assert one == pytest.approx(derived)


def test_response_is_the_light_of_each_symbol_value() -> None:
    weights = np.array([0.1, 0.6, -0.3, 0.2])
    assert np.array_equal(combine.VALUES, VALUES)
    shown = [observed(light_about_mean(haar.encode(value.reshape(2, 2)), weights)) for value in VALUES]
    assert response(weights) == pytest.approx(np.stack(shown))


TABLE = response(np.array([0.1, 0.6, 0.3, 0.0]))


def test_moments_equal_enumeration() -> None:
    rng = np.random.default_rng(5)
    mean, observed, variance = rng.uniform(-0.9, 0.9, 4), rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    chance = np.prod((1 + VALUES * mean) / 2, 1)
    first, second = moments(TABLE, mean)
    assert first == pytest.approx(chance @ TABLE)
    assert second == pytest.approx(chance @ TABLE**2 - first**2)
    chance = chance * np.exp(-((TABLE - observed) ** 2 / variance / 2).sum(1))
    first, second = posterior_moments(TABLE, observed, variance, mean)
    assert first == pytest.approx(chance @ TABLE / chance.sum())
    assert second == pytest.approx(chance @ TABLE**2 / chance.sum())


@pytest.mark.parametrize("known", [0.0, 0.6, 1.0])
def test_known_symbols_of_a_square_add_information(known: float) -> None:
    rng = np.random.default_rng(3)
    observed, variance = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    for i in range(4):
        mean = known * np.array([1.0, -1.0, -1.0, 1.0])
        mean[i] = 0.0
        chance = np.prod((1 + VALUES * mean) / 2, 1)
        fit = (TABLE - observed) ** 2 / variance / 2
        up = VALUES[:, i] > 0
        own, joint = (
            np.log((chance * np.exp(-part))[up].sum() / (chance * np.exp(-part))[~up].sum())
            for part in (fit[:, i], fit.sum(1))
        )
        # power ratio between symbol products and symbols
        products = np.mean(TABLE**2) / np.mean(TABLE * VALUES) ** 2 - 1
        assert 0.05 < products < 0.5
        # trust in the other three symbols: product of squared means
        trust = products + (1 - products) * known**6
        llr = own + trust * (joint - own)
        assert symbol_llrs(TABLE, observed, variance, mean)[i] == pytest.approx(llr, abs=1e-6)


def test_llr_excludes_the_prior() -> None:
    rng = np.random.default_rng(4)
    observed, variance, mean = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4), rng.uniform(-0.9, 0.9, 4)
    for i in range(4):
        other = mean.copy()
        other[i] = -0.3
        llrs = [symbol_llrs(TABLE, observed, variance, m)[i] for m in (mean, other)]
        assert llrs[0] == pytest.approx(llrs[1])


@pytest.mark.parametrize("far", [30.0, 3000.0])
def test_outliers_leave_moments_and_llrs_finite(far: float) -> None:
    mean = np.array([1.0, -1.0, 1.0, 1.0])
    observed, variance = far * np.array([-1.0, 1.0, 1.0, -1.0]), np.full(4, 1e-4)
    first, second = posterior_moments(TABLE, observed, variance, mean)
    assert (np.abs(first) <= np.abs(TABLE).max()).all()
    assert (second <= (TABLE**2).max()).all()
    assert np.isfinite(symbol_llrs(TABLE, observed, variance, mean)).all()


def test_synchronous_llr_is_that_of_a_bit_in_gaussian_noise() -> None:
    observed, variance = np.array([0.3, -1.2, 0.8, 0.1] * 4), np.linspace(0.2, 3, 16)
    llr = symbol_llrs(VALUES, observed, variance, np.zeros(16))
    assert llr == pytest.approx(2 * observed / variance)


def test_response_of_known_levels() -> None:
    lit = np.zeros((SIDE, SIDE), bool)
    lit[:4, 4:] = True
    weights = np.array([0.2, 0.1, 0.0, 0.3])
    levels = np.where(lit, 4, 0).astype(np.uint8)
    assert response_of_levels(weights, lit) == pytest.approx(observed(light_about_mean(levels, weights)))
