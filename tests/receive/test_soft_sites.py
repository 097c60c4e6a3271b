"""Expectation propagation, beside the exact probabilities of a few cells."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.receive.soft.equalise import equalise
from heliograph.receive.soft.look import Look
from heliograph.receive.soft.sites import Sites

Floats = NDArray[np.float64]
ROUNDS = 12


def look_at(b: Floats, d: Floats) -> Look:
    """A look d at cells through b, gain and noise 1."""
    zeros = np.zeros(b.shape[1])
    return Look((b.T @ b).astype(np.float32), b.T @ d, zeros, 0.0, 0.0)


def exact(b: Floats, d: Floats, mean: Floats) -> Floats:
    """E c of cells +-1 with the given means beforehand, by all that they can be."""
    cells = np.array(list(product((-1.0, 1.0), repeat=b.shape[1])))
    chance = np.prod(0.5 * (1 + cells * mean), axis=1) * np.exp(-0.5 * ((d - cells @ b.T) ** 2).sum(1))
    return np.asarray(chance @ cells / chance.sum())


def propagated(b: Floats, d: Floats, mean: Floats, rounds: int) -> Floats:
    """E c by so many rounds."""
    look, sites, llr = look_at(b, d), Sites.begun((1, b.shape[1])), np.zeros_like(mean)
    for _ in range(rounds):
        priors = sites.priors(mean[None], 1 - mean[None] ** 2)
        llr = sites.take(0, equalise(look, 1.0, 1.0, priors[0][0], priors[1][0]))
    return np.tanh(np.arctanh(mean) + 0.5 * llr)


def test_of_cells_apart_it_is_exact() -> None:
    rng = np.random.default_rng(0)
    b, mean = np.diag(rng.uniform(0.2, 2, 6)), rng.uniform(-0.9, 0.9, 6)
    d = b @ rng.choice([-1.0, 1.0], 6) + rng.normal(size=6)
    assert propagated(b, d, mean, ROUNDS) == pytest.approx(exact(b, d, mean), abs=2e-3)


def test_it_comes_nearer_to_what_is_true_of_cells_that_shine_into_each_other() -> None:
    rng, gaussian, sites = np.random.default_rng(1), list[float](), list[float]()
    for _ in range(60):
        b, mean = rng.normal(0, 0.8, (7, 9)), np.zeros(9)
        d = b @ rng.choice([-1.0, 1.0], 9) + rng.normal(size=7)
        truth = exact(b, d, mean)
        estimate = equalise(look_at(b, d), 1.0, 1.0, mean, np.ones(9))
        linear = np.tanh(estimate.added[1])
        gaussian.append(float(((linear - truth) ** 2).mean()))
        sites.append(float(((propagated(b, d, mean, ROUNDS) - truth) ** 2).mean()))
    assert np.mean(sites) < 0.5 * np.mean(gaussian)


def test_decoded_cells_are_their_own() -> None:
    sites = Sites.begun((1, 3))
    mean, variance = np.array([[1.0, -1.0, 0.2]]), np.array([[0.0, 0.0, 0.96]])
    at, spread = sites.priors(mean, variance)
    assert at[0, :2].tolist() == [1, -1]
    assert spread[0, :2].tolist() == [0, 0]
    assert at[0, 2] == pytest.approx(0.2)
    assert spread[0, 2] == pytest.approx(0.96)


def test_what_was_forgotten_leaves_no_trace() -> None:
    rng = np.random.default_rng(2)
    b, mean, even = rng.normal(size=(6, 4)), np.zeros((1, 4)), np.ones((1, 4))
    sites = Sites.begun((1, 4))
    sites.take(0, equalise(look_at(b, rng.normal(size=6)), 1.0, 1.0, mean[0], even[0]))
    assert not np.allclose(sites.priors(mean, even)[0], 0)
    sites.forget()
    at, spread = sites.priors(mean, even)
    assert np.allclose(at, 0)
    assert np.allclose(spread, 1)
