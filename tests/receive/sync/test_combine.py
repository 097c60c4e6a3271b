"""Frame combination for arbitrary timing and square symbol estimates, against slot-by-slot PWM light."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from slot_light import COVARIANCE, MEAN_LIT, SLOPES, VALUES, light_about_mean, observed, symbols_of, values_of

from heliograph.base.arrays import Floats
from heliograph.receive.sync import combine
from heliograph.receive.sync.combine import Combination, UnsynchronisedPacket, combine_pair, moments, response
from heliograph.signal import haar, pwm

SIDE, PAIRS, ORDER = 8, 5, (0, 1, 2, 3)
ORDERS = pytest.mark.parametrize("order", [ORDER, (2, 0, 3, 1)])
FINE = 400  # simulation steps per T_b
ALL_ON = np.ones((SIDE, SIDE), bool)


def random_data(seed: int, count: int) -> NDArray[np.int8]:
    return np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), (count, SIDE, SIDE))


def light_of(pairs: NDArray[np.int8], order: tuple[int, ...]) -> Floats:
    """Return light (FINE steps per pattern, n, n) for consecutive pattern and inverse pairs; LEDs are on or off."""
    levels = haar.encode(pairs)
    patterns = np.stack([levels, pwm.invert(levels)], 1).reshape(-1, SIDE, SIDE)
    return pwm.lit_slots(patterns, order).reshape(-1, SIDE, SIDE).repeat(FINE // 4, 0).astype(float)


def combined(starts: Floats, exposure: float = 1.0, order: tuple[int, ...] = ORDER) -> Combination:
    found = combine_pair(starts, exposure, order)
    assert found is not None
    return found


@ORDERS
@pytest.mark.parametrize("exposure", [0.13, 0.5, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.37, 0.6])
@pytest.mark.parametrize("rate", [1.0, 2.7])
def test_combination_shows_stated_symbols(order: tuple[int, ...], exposure: float, phase: float, rate: float) -> None:
    exposure = round(min(exposure, 1 / rate) * FINE) / FINE
    pairs = random_data(5, 3)
    light = light_of(pairs, order)
    starts = phase + np.arange(-10, 10) / rate
    starts = np.round(starts[(starts >= -1) & (starts + exposure <= 4)] * FINE) / FINE
    combination = combined(starts, exposure, order)
    first = np.round((starts[combination.frames] + 2) * FINE).astype(int)
    exposures = np.stack([light[k : k + round(exposure * FINE)].mean(0) for k in first])
    difference = np.tensordot(combination.difference, exposures, 1)
    tables = [response(slots) for slots in combination.slots]
    kind = np.arange(SIDE * SIDE) // (SIDE * SIDE // 4)
    shown = sum(table[values_of(symbols_of(d)), kind] for table, d in zip(tables, pairs, strict=True))
    # subtract the mean, which the levels include
    mean = combination.levels[0] - combination.levels[1]
    assert observed(difference - mean) == pytest.approx(shown, abs=1e-9)
    assert combination.difference.sum() == pytest.approx(0, abs=1e-9)
    assert np.abs(combination.difference).sum() == pytest.approx(2)
    assert np.array_equal(combination.response, tables[1])
    for leak, slots, table in zip(combination.leaks, combination.slots[[0, 2]], tables[::2], strict=True):
        # weights up to 1e-3 are negligible
        assert (leak is None) == (np.abs(slots).max() <= 1e-3)
        assert leak is None or np.array_equal(leak, table)


@examples(150)
@given(rate=st.floats(1.0, 3.0), part=st.floats(0.2, 1.0), phase=st.floats(0, 1))
def test_combination_is_close_to_the_optimum(rate: float, part: float, phase: float) -> None:
    """With noise and interference from other pairs; low-weight frames may be dropped."""
    exposure, starts = part / rate, (phase + np.arange(-8.0, 16.0)) / rate
    starts = starts[(starts > -1) & (starts < 2)]
    combination = combine_pair(starts, exposure, ORDER)
    # slot overlaps for three pairs; the first begins at -2
    slots = np.arange(-8, 16) / 4
    ends = np.minimum(starts[:, None] + exposure, slots + 0.25)
    overlap = np.maximum(ends - np.maximum(starts[:, None], slots), 0) / exposure
    shown = np.einsum("fj,jqr->fqr", overlap, combine.slot_light(ORDER)[0])
    slope = shown[:, 1] @ SLOPES
    # noise variance 0.05 per frame, plus random data in each slot
    spread = 0.05 * np.eye(len(starts)) - np.outer(slope, slope)
    spread += np.einsum("fqr,rs,gqs->fg", shown, COVARIANCE, shown)
    near = overlap[:, 8:16].sum(1) > 1e-9
    spread, slope = spread[np.ix_(near, near)], slope[near]
    # optimum with zero sum: M^-1 (h - mu 1)
    h, ones = np.linalg.solve(spread, np.stack([slope, np.ones(len(slope))], axis=1)).T

    def merit(weights: Floats) -> float:
        """Return squared slope over the variance of nonlinear terms."""
        return float((weights @ slope) ** 2 / (weights @ spread @ weights))

    best = merit(h - ones * h.sum() / ones.sum())
    weights = np.zeros(len(starts))
    if combination is not None:
        weights[combination.frames] = combination.difference
    assert best < 0.1 if combination is None else merit(weights[near]) > 0.994 * best


@ORDERS
@pytest.mark.parametrize("phase", [0.0, 0.1, 0.37, 0.6])
def test_sum_shows_all_leds_on_at_the_mean_time(order: tuple[int, ...], phase: float) -> None:
    """Averaged over data, the sum equals an all-on array with mean time `sum_time`."""
    starts = np.round((phase + np.arange(-2, 6) / 1.5) * FINE) / FINE
    starts = starts[(starts >= -1) & (starts + 0.5 <= 4)]
    combination, sums = combined(starts, 0.5, order), []
    first = np.round((starts[combination.frames] + 2) * FINE).astype(int)
    middle = starts[combination.frames][:, None] + (np.arange(FINE // 2) + 0.5) / FINE
    for seed in range(60):
        light = light_of(random_data(seed, 3), order)
        parts = np.stack([light[k : k + FINE // 2].mean((1, 2)) for k in first])
        sums.append([combination.total @ (parts * middle).mean(1), combination.total @ parts.mean(1)])
    moment, mass = np.mean(sums, axis=0)
    assert (mass, moment / mass) == pytest.approx((1, combination.sum_time), abs=0.02)
    assert (combination.total >= 0).all()


def test_synchronous_combination_has_two_frames() -> None:
    combination = combined(np.arange(-1.0, 4.0))
    assert (list(combination.frames), combination.leaks) == ([1, 2], (None, None))
    assert list(combination.difference) == pytest.approx([1, -1])
    assert list(combination.total) == pytest.approx([1, 1])
    assert (combination.noise, *combination.levels) == pytest.approx((1, 0.5, 0.5))
    # mean light is early in a pattern, data-dependent light later
    mean, data = pwm.light_centroids()
    assert (combination.sum_time, *combination.data_times) == pytest.approx((mean + 0.5, data, 1 + data))


@pytest.mark.parametrize("late", [0.0, 0.02, 0.1, -0.25])
def test_departure_is_half_of_the_misplaced_light(late: float) -> None:
    """Late frames miss the pattern's start and include the inverse's start, which the second frame then misses."""
    combination = combined(late + np.arange(-1.0, 4.0))
    departure = 1.5 * abs(late) if len(combination.difference) == 2 else np.inf
    assert combination.departure == pytest.approx(departure, abs=1e-9)


def test_half_a_pattern_late_only_the_outer_frames_differ() -> None:
    combination = combined(np.arange(-1.5, 4.0))
    assert combination.departure > 0.035
    # the middle frame is half lit for all data and only contributes to the sum
    within = list(combination.frames).index(2)
    assert combination.difference[within] == 0
    assert combination.total[within] == pytest.approx(2, rel=0.1)
    # half the synchronous slope, with equal leakage from the previous and next pair
    assert combination.slots[1] @ SLOPES == pytest.approx(0.5 * 0.5)
    assert combination.slots[[0, 2]] == pytest.approx(np.tile([-0.25, -0.25, 0, 0], (2, 1)))


# the last has two frames in the pattern, none in the inverse
@pytest.mark.parametrize(("starts", "exposure"), [([], 1.0), ([0.0], 1.0), ([0.0, 0.5], 0.5)])
def test_pair_without_frames_gives_no_combination(starts: list[float], exposure: float) -> None:
    assert combine_pair(np.array(starts), exposure, ORDER) is None


def test_sum_of_a_header_cancels_its_cells() -> None:
    shown = np.array([0.4, -0.4, 0.7, 0.1])
    half = 0.5 * shown, np.array([0.5, 0.5, 0.6, 0.5])
    combination = combine.combine_header(np.arange(4.0), 1.0, shown, half)
    assert combination is not None
    # half-contrast cells; frame weights determine the visible uneven light
    assert combination.dimmed == pytest.approx((0.5, 0.1 * combination.difference[2]))
    assert (combination.total @ shown, combination.total.sum()) == pytest.approx((0, 2))
    assert (combination.difference @ shown, combination.difference.sum()) == pytest.approx((2, 0))
    # header light is uniform: mean of exposure centres
    assert combination.sum_time == pytest.approx(combination.total @ (np.arange(4.0) + 0.5) / 2)
    assert combine.combine_header(np.arange(4.0), 1.0, np.array([0.0, 0.01, 0.0, 0.0]), half) is None
    assert combine.combine_header(np.zeros(0), 1.0, np.zeros(0), (np.zeros(0), np.zeros(0))) is None


@ORDERS
@pytest.mark.slow
def test_slot_light_is_the_mean_of_lit_slots(order: tuple[int, ...]) -> None:
    _, mean = combine.slot_light(order)
    # dimmed cells use levels 3 and 1
    high, low = (pwm.lit_slots(np.full((1, 1), level), order)[:, 0, 0].astype(float) for level in (3, 1))
    assert np.array_equal(combine.dimmed_light(order), [high - low, (high + low) / 2])
    drawn = light_of(random_data(1, 400), order).reshape(400, 2 * FINE, -1).mean((0, 2))
    assert mean[:8] == pytest.approx(drawn[FINE // 8 :: FINE // 4], abs=0.02)
    assert mean.tolist() == np.tile(mean[:8], 3).tolist()


def packet(phase: float, seed: int = 0) -> tuple[Combination, UnsynchronisedPacket, Floats, Floats]:
    """Return combination, packet, symbols and noiseless observations, simulated slot by slot."""
    rng, combination = np.random.default_rng(seed), combined(np.arange(-3.0, 5.0) + phase)
    header, data = rng.random((SIDE, SIDE)) > 0.5, rng.choice(np.array([-1, 1], np.int8), (PAIRS, SIDE, SIDE))
    lit = np.where(header, 4, 0).astype(np.uint8)
    around, slots = [lit, *haar.encode(data), lit], combination.slots
    shown = [
        sum(observed(light_about_mean(around[k + q], slots[q])) for q in range(3) if np.abs(slots[q]).max() > 1e-3)
        for k in range(PAIRS)
    ]
    pairs = UnsynchronisedPacket.of([combination] * PAIRS, header)
    return combination, pairs, np.stack([*map(symbols_of, data)]), np.stack(shown)


@pytest.mark.slow
def test_unknown_symbols_have_the_moments_of_random_data() -> None:
    own, leak = packet(0.37)[1].expected(np.zeros((PAIRS, SIDE**2)))
    # headers next to the packet are known
    found = np.stack([packet(0.37, seed)[3][1:-1] for seed in range(400)]).reshape(-1, 4, SIDE**2 // 4)
    mean, variance = ((own[k] + leak[k])[1:-1].reshape(-1, 4, SIDE**2 // 4).mean((0, 2)) for k in (0, 1))
    assert found.mean((0, 2)) == pytest.approx(mean, abs=0.03)
    assert found.var((0, 2)) == pytest.approx(variance, rel=0.1)


@pytest.mark.parametrize("phase", [0.1, 0.37, 0.5, 0.6])
def test_known_symbols_predict_the_observation_and_unknown_ones_follow(phase: float) -> None:
    _, pairs, symbols, shown = packet(phase)
    own, leak = pairs.expected(symbols)
    assert own[0] + leak[0] == pytest.approx(shown, abs=1e-9)
    assert np.stack([own[1], leak[1]]) == pytest.approx(0, abs=1e-9)
    # one unknown symbol per square; all other symbols are known
    kind, square = np.divmod(np.arange(SIDE**2), SIDE**2 // 4)
    mean = np.where(kind == square % 4, 0.0, symbols)
    llrs = pairs.llrs(shown, np.full_like(shown, 1e-3), leak, mean)
    assert (np.sign(llrs) == symbols)[mean == 0].all()


def test_synchronous_pair_shows_only_its_own_symbols() -> None:
    combination, _, symbols, _ = packet(0.5)
    own, leak = UnsynchronisedPacket.of([combination, None, combination], ALL_ON).expected(symbols[:3])
    assert own[0][1] == pytest.approx(symbols[1])
    assert not np.any([leak[0][1], leak[1][1]])


def test_synchronous_shortcut_equals_enumeration() -> None:
    rng, symbols = np.random.default_rng(3), SIDE**2
    pairs = UnsynchronisedPacket.of([None] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    mean, found = rng.uniform(-0.9, 0.9, (PAIRS, symbols)), rng.normal(0, 1.2, (PAIRS, symbols))
    mean[:, : symbols // 2] = np.sign(mean[:, : symbols // 2])
    variance = rng.uniform(0.1, 2.0, symbols)
    own, leak = pairs.expected(mean)
    assert np.stack(own) == pytest.approx(np.stack(moments(pairs.response, mean)), abs=1e-12)
    assert not np.any(leak)
    llrs = combine.symbol_llrs(pairs.response, found, variance, mean)
    assert pairs.llrs(found, variance, leak, mean) == pytest.approx(llrs, abs=1e-6)
    chosen = np.array([1, 3])
    short = pairs.posterior_moments(chosen, found[chosen], variance, mean[chosen])
    table = combine.posterior_moments(pairs.response[chosen], found[chosen], variance, mean[chosen])
    assert np.stack(short) == pytest.approx(np.stack(table), abs=1e-9)


def test_partly_combined_packet_or_leakage_is_not_synchronous() -> None:
    whole = UnsynchronisedPacket.of([None] * PAIRS, ALL_ON)
    assert whole.is_synchronous
    assert not UnsynchronisedPacket.of([combined(np.arange(-3.0, 5.0) + 0.37), None], ALL_ON).is_synchronous
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
    levels = haar.encode(random_data(0, 4000))
    lit = pwm.lit_slots(levels).transpose(1, 0, 2, 3).reshape(4, -1)
    joint = np.cov(lit, levels.ravel())[:, :4]
    assert lit.mean(1) == pytest.approx(MEAN_LIT, abs=0.01)
    assert joint == pytest.approx(np.vstack([COVARIANCE, SLOPES]), abs=0.01)
    for stated, derived in (("MEAN_LIT", MEAN_LIT), ("COVARIANCE", COVARIANCE), ("SLOPES", SLOPES), ("VALUES", VALUES)):
        assert getattr(combine, stated) == pytest.approx(derived), stated


TABLE = response(np.array([0.1, 0.6, 0.3, 0.0]))


def test_moments_equal_enumeration() -> None:
    rng = np.random.default_rng(5)
    mean, observed, variance = rng.uniform(-0.9, 0.9, 4), rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    chance = np.prod((1 + VALUES * mean) / 2, 1)
    first = chance @ TABLE
    assert np.stack(moments(TABLE, mean)) == pytest.approx(np.stack([first, chance @ TABLE**2 - first**2]))
    chance = chance * np.exp(-((TABLE - observed) ** 2 / variance / 2).sum(1))
    expected = np.stack([chance @ TABLE, chance @ TABLE**2]) / chance.sum()
    assert np.stack(combine.posterior_moments(TABLE, observed, variance, mean)) == pytest.approx(expected)


@pytest.mark.parametrize("known", [0.0, 0.6, 1.0])
def test_known_symbols_of_a_square_add_information_to_an_llr_without_the_prior(known: float) -> None:
    rng = np.random.default_rng(3)
    observed, variance = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    # power ratio between symbol products and symbols
    products = np.mean(TABLE**2) / np.mean(TABLE * VALUES) ** 2 - 1
    assert 0.05 < products < 0.5
    # trust in the other three symbols: product of squared means
    trust, fit = products + (1 - products) * known**6, (TABLE - observed) ** 2 / variance / 2
    for i, up in enumerate(VALUES.T > 0):
        mean = known * np.array([1.0, -1.0, -1.0, 1.0])
        mean[i] = 0.0
        chance = np.prod((1 + VALUES * mean) / 2, 1)
        likelihoods = (chance * np.exp(-part) for part in (fit[:, i], fit.sum(1)))
        own, joint = (np.log(part[up].sum() / part[~up].sum()) for part in likelihoods)
        for prior in (0.0, -0.3, 0.8):
            mean[i] = prior
            llr = combine.symbol_llrs(TABLE, observed, variance, mean)[i]
            assert llr == pytest.approx(own + trust * (joint - own), abs=1e-6)


@pytest.mark.parametrize("far", [30.0, 3000.0])
def test_outliers_leave_moments_and_llrs_finite(far: float) -> None:
    mean = np.array([1.0, -1.0, 1.0, 1.0])
    observed, variance = far * np.array([-1.0, 1.0, 1.0, -1.0]), np.full(4, 1e-4)
    first, second = combine.posterior_moments(TABLE, observed, variance, mean)
    assert (np.abs(first) <= np.abs(TABLE).max()).all()
    assert (second <= (TABLE**2).max()).all()
    assert np.isfinite(combine.symbol_llrs(TABLE, observed, variance, mean)).all()
