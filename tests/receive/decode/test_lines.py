"""Pairs out of step of whose squares at most one symbol is open."""

import numpy as np
import pytest
from known_packets import by_matrices
from numpy.typing import NDArray

from heliograph.receive.decode.turbo_equaliser import GainAndNoise, Lines
from heliograph.receive.sync.combine import UnsynchronisedPacket, combine_pair

Floats = NDArray[np.float64]
SIDE, PAIRS = 8, 4
SQUARES = SIDE**2 // 4
PHASES = (0.1, 0.37, 0.5, 0.6)


def packet(phase: float) -> tuple[UnsynchronisedPacket, Floats, NDArray[np.intp]]:
    """Pairs so far out of step, in T_b; their symbols; and an open one of each square, (pairs, squares)."""
    rng = np.random.default_rng(3)
    combination = combine_pair(np.arange(-3.0, 5.0) + phase, 1.0, (0, 1, 2, 3))
    pairs = UnsynchronisedPacket.of([combination] * PAIRS, rng.random((SIDE, SIDE)) > 0.5)
    open_ = rng.integers(0, 4, (PAIRS, SQUARES)) * SQUARES + np.arange(SQUARES)
    return pairs, rng.choice([-1.0, 1.0], (PAIRS, SIDE**2)), open_


def priors(symbols: Floats, open_: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Mean and variance of symbols of which some are open."""
    mean, variance = symbols.copy(), np.zeros_like(symbols)
    np.put_along_axis(mean, open_, 0.0, 1)
    np.put_along_axis(variance, open_, 1.0, 1)
    return mean, variance


def test_two_open_symbols_of_a_square_lie_on_no_line() -> None:
    pairs, symbols, open_ = packet(0.37)
    mean, variance = priors(symbols, open_)
    assert Lines.of(pairs, mean, variance) is not None
    variance[2, (open_[2, 5] + SQUARES) % SIDE**2] = 1.0
    assert Lines.of(pairs, mean, variance) is None


@pytest.mark.parametrize("guess", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("phase", PHASES)
def test_what_is_expected_lies_on_them(phase: float, guess: float) -> None:
    pairs, symbols, open_ = packet(phase)
    mean, variance = priors(symbols, open_)
    # some are known, of the others there is a guess
    np.put_along_axis(mean, open_, guess * np.take_along_axis(symbols, open_, 1), 1)
    np.put_along_axis(variance, open_, 1 - guess**2, 1)
    mean[::2], variance[::2] = symbols[::2], 0.0
    lines, expected = Lines.of(pairs, mean, variance), pairs.expected(mean)
    assert lines is not None
    along = lines.start + lines.slope * np.tile(lines.mean + lines.leak, 4)
    assert along == pytest.approx(expected.mean + expected.leak, abs=1e-9)
    # along a line there is no more variance than in all of the light around
    power = (lines.slope**2).reshape(PAIRS, 4, -1).sum(1)
    assert (lines.leak_variance * power <= expected.leak_variance.reshape(PAIRS, 4, -1).sum(1) + 1e-9).all()


@pytest.mark.parametrize("phase", PHASES)
def test_open_symbols_follow_from_the_light_of_leds(phase: float) -> None:
    pairs, symbols, open_ = packet(phase)
    mean, variance = priors(symbols, open_)
    lines = Lines.of(pairs, mean, variance)
    assert lines is not None
    rng, gain, noise = np.random.default_rng(4), 50.0, 1.0
    b, shown = rng.normal(size=(200, SIDE**2)) / 8, pairs.expected(symbols)
    for k in range(PAIRS):
        d = gain * b @ (shown.mean[k] + shown.leak[k]) + rng.normal(0, noise**0.5, 200)
        llr, moments = lines.equalise(k, by_matrices(b, d, np.zeros(200), np.ones(200)), GainAndNoise(gain, noise))
        there = np.zeros(SIDE**2, bool)
        there[open_[k]] = True
        assert not llr[~there].any()
        assert (np.sign(llr[there]) == symbols[k][there]).mean() > 0.95
        assert moments[0] / moments[1] == pytest.approx(gain, rel=0.2)


def test_known_neighbours_leave_nothing_open() -> None:
    pairs, symbols, _ = packet(0.5)
    lines = Lines.of(pairs, symbols, np.zeros_like(symbols))
    assert lines is not None
    assert not lines.variance.any()
    assert not lines.leak_variance.any()
