"""Unsynchronised pairs: predicted moments for observed symbols, against slot-by-slot light."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from slot_light import light_about_mean, observed, symbols_of

from heliograph.receive.sync import combine as partial_exposure
from heliograph.receive.sync.combine import Combination, UnsynchronisedPacket, combine_pair
from heliograph.signal import haar

Floats = NDArray[np.float64]
SIDE, PAIRS = 8, 5
PHASES = (0.1, 0.37, 0.5, 0.6)


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


@pytest.mark.parametrize("phase", PHASES)
def test_of_known_symbols_what_is_observed_is_known(phase: float) -> None:
    _, pairs, symbols, shown = packet(phase)
    own, leak = pairs.expected(symbols)
    assert own[0] + leak[0] == pytest.approx(shown, abs=1e-9)
    assert own[1] == pytest.approx(0, abs=1e-9)
    assert leak[1] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("phase", PHASES)
def test_of_unknown_symbols_mean_and_variance_are_those_of_random_data(phase: float) -> None:
    found = np.stack([packet(phase, seed)[3] for seed in range(400)])
    own, leak = packet(phase)[1].expected(np.zeros((PAIRS, SIDE**2)))
    # headers next to the packet are known
    inside = slice(1, PAIRS - 1)
    mean, variance = (own[0] + leak[0])[inside], (own[1] + leak[1])[inside]
    kinds = found[:, inside].reshape(-1, 4, SIDE**2 // 4)
    assert kinds.mean((0, 2)) == pytest.approx(mean.reshape(-1, 4, SIDE**2 // 4).mean((0, 2)), abs=0.03)
    assert kinds.var((0, 2)) == pytest.approx(variance.reshape(-1, 4, SIDE**2 // 4).mean((0, 2)), rel=0.1)


@pytest.mark.parametrize("phase", PHASES)
def test_symbols_follow_from_exact_estimates(phase: float) -> None:
    _, pairs, symbols, shown = packet(phase)
    # one unknown symbol per square; all other symbols are known
    kind, square = np.divmod(np.arange(SIDE**2), SIDE**2 // 4)
    mean = np.where(kind == square % 4, 0.0, symbols)
    _, leak = pairs.expected(symbols)
    llrs = pairs.llrs(shown, np.full_like(shown, 1e-3), leak, mean)
    assert (np.sign(llrs) == symbols)[mean == 0].all()


def test_a_pair_in_step_shows_its_own_symbols_alone() -> None:
    combination, _, symbols, _ = packet(0.5)
    pairs = UnsynchronisedPacket.of([combination, None, combination], np.ones((SIDE, SIDE), bool))
    own, leak = pairs.expected(symbols[:3])
    assert own[0][1] == pytest.approx(symbols[1])
    assert not leak[0][1].any()
    assert not leak[1][1].any()


def test_of_pairs_in_step_the_short_way_gives_what_the_table_of_all_values_gives() -> None:
    rng = np.random.default_rng(3)
    symbols = SIDE**2
    pairs = UnsynchronisedPacket.of([None] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    mean, found = rng.uniform(-0.9, 0.9, (PAIRS, symbols)), rng.normal(0, 1.2, (PAIRS, symbols))
    mean[:, : symbols // 2] = np.sign(mean[:, : symbols // 2])
    variance = rng.uniform(0.1, 2.0, symbols)
    assert pairs.is_synchronous
    assert not packet(0.37)[1].is_synchronous
    own, leak = pairs.expected(mean)
    assert np.stack(own) == pytest.approx(np.stack(partial_exposure.moments(pairs.response, mean)), abs=1e-12)
    assert not leak[0].any()
    assert not leak[1].any()
    assert pairs.llrs(found, variance, leak, mean) == pytest.approx(
        partial_exposure.symbol_llrs(pairs.response, found, variance, mean), abs=1e-6
    )
    asked = np.array([1, 3])
    short = pairs.posterior_moments(asked, found[asked], variance, mean[asked])
    table = partial_exposure.posterior_moments(pairs.response[asked], found[asked], variance, mean[asked])
    assert np.stack(short) == pytest.approx(np.stack(table), abs=1e-9)


def test_a_packet_partly_in_step_or_with_light_of_others_is_not_in_step() -> None:
    combination, whole = combination_at(0.37), UnsynchronisedPacket.of([None] * PAIRS, np.ones((SIDE, SIDE), bool))
    assert whole.is_synchronous
    assert not UnsynchronisedPacket.of([combination, None], np.ones((SIDE, SIDE), bool)).is_synchronous
    for side in ("before", "after"):
        leak = getattr(whole, side).copy()
        leak[1] = 0.2 * partial_exposure.VALUES
        assert not replace(whole, **{side: leak}).is_synchronous


def test_light_of_headers_counts_in_step_too() -> None:
    rng = np.random.default_rng(4)
    pairs = UnsynchronisedPacket.of([None] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    pairs = replace(pairs, headers=rng.normal(0, 0.2, pairs.headers.shape))
    mean, found, variance = np.zeros((PAIRS, SIDE**2)), rng.normal(0, 1, (PAIRS, SIDE**2)), np.ones(SIDE**2)
    _, leak = pairs.expected(mean)
    assert leak[0] == pytest.approx(pairs.headers)
    assert pairs.llrs(found, variance, leak, mean) == pytest.approx(2 * (found - pairs.headers))
