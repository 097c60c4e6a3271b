"""Expectation propagation against exact posteriors for few symbols."""

from itertools import product

import numpy as np
import pytest
from known_packets import by_matrices
from numpy.typing import NDArray

from heliograph.receive.equalise.ep import ExpectationPropagation
from heliograph.receive.equalise.lmmse import Estimate, equalise
from heliograph.receive.observe.statistics import PairStatistics

Floats = NDArray[np.float64]
ITERATIONS = 12


def pair_of(b: Floats, d: Floats) -> PairStatistics:
    """Return statistics for d = B c + n with unit gain and noise."""
    return by_matrices(b, d, np.zeros(len(d)))


def exact(b: Floats, d: Floats, mean: Floats) -> Floats:
    """Return E c for symbols +-1 with prior means, by enumeration."""
    symbols = np.array(list(product((-1.0, 1.0), repeat=b.shape[1])))
    chance = np.prod(0.5 * (1 + symbols * mean), axis=1) * np.exp(-0.5 * ((d - symbols @ b.T) ** 2).sum(1))
    return np.asarray(chance @ symbols / chance.sum())


def propagated(b: Floats, d: Floats, mean: Floats, iterations: int) -> Floats:
    """Return E c after `iterations` iterations."""
    pair, propagation, llr = pair_of(b, d), ExpectationPropagation((1, b.shape[1])), np.zeros_like(mean)
    for _ in range(iterations):
        priors = propagation.priors(mean[None], 1 - mean[None] ** 2)
        llr = propagation.take(0, equalise(pair, 1.0, 1.0, priors[0][0], priors[1][0]))
    return np.tanh(np.arctanh(mean) + 0.5 * llr)


def test_propagation_is_exact_without_overlap() -> None:
    rng = np.random.default_rng(0)
    b, mean = np.diag(rng.uniform(0.2, 2, 6)), rng.uniform(-0.9, 0.9, 6)
    d = b @ rng.choice([-1.0, 1.0], 6) + rng.normal(size=6)
    assert propagated(b, d, mean, ITERATIONS) == pytest.approx(exact(b, d, mean), abs=2e-3)


def test_propagation_beats_linear_mmse_with_overlap() -> None:
    rng, gaussian, two_valued = np.random.default_rng(1), list[float](), list[float]()
    for _ in range(60):
        b, mean = rng.normal(0, 0.8, (7, 9)), np.zeros(9)
        d = b @ rng.choice([-1.0, 1.0], 9) + rng.normal(size=7)
        truth = exact(b, d, mean)
        estimate = equalise(pair_of(b, d), 1.0, 1.0, mean, np.ones(9))
        linear = np.tanh(estimate.extrinsic[1])
        gaussian.append(float(((linear - truth) ** 2).mean()))
        two_valued.append(float(((propagated(b, d, mean, ITERATIONS) - truth) ** 2).mean()))
    assert np.mean(two_valued) < 0.5 * np.mean(gaussian)


def test_decoded_symbols_keep_their_values() -> None:
    propagation = ExpectationPropagation((1, 3))
    mean, variance = np.array([[1.0, -1.0, 0.2]]), np.array([[0.0, 0.0, 0.96]])
    at, spread = propagation.priors(mean, variance)
    assert at[0, :2].tolist() == [1, -1]
    assert spread[0, :2].tolist() == [0, 0]
    assert at[0, 2] == pytest.approx(0.2)
    assert spread[0, 2] == pytest.approx(0.96)


def test_dropped_cavities_have_no_effect() -> None:
    rng = np.random.default_rng(2)
    b, mean, even = rng.normal(size=(6, 4)), np.zeros((1, 4)), np.ones((1, 4))
    propagation = ExpectationPropagation((1, 4))
    propagation.take(0, equalise(pair_of(b, rng.normal(size=6)), 1.0, 1.0, mean[0], even[0]))
    assert not np.allclose(propagation.priors(mean, even)[0], 0)
    propagation.forget()
    at, spread = propagation.priors(mean, even)
    assert np.allclose(at, 0)
    assert np.allclose(spread, 1)


def test_site_moves_by_the_damping() -> None:
    """Cavity with precision 2 and mean 1/2; site and cavity together must match the moments of +-1."""
    propagation = ExpectationPropagation((1, 1))
    # L L^T: posterior precision, 2 from the cavity plus 1 from the prior
    factor = np.full((1, 1), np.sqrt(3), np.float32)
    cavity = Estimate(np.zeros(1), np.ones(1), np.array([1 / 3]), np.arange(1), factor, 0.0)
    propagation.take(0, cavity)
    both = np.tanh(0.5 * 2 * 1.0)
    # G = mean / variance - G_cavity; the site starts at precision 1 and G = 0
    precision, weighted = 1 / (1 - both**2) - 2, both / (1 - both**2) - 1
    at, spread = propagation.priors(np.zeros((1, 1)), np.ones((1, 1)))
    assert 1 / spread[0, 0] == pytest.approx(1 + 0.7 * (precision - 1))
    assert at[0, 0] / spread[0, 0] == pytest.approx(0.7 * weighted)
