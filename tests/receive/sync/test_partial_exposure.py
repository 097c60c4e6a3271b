"""Partial exposures: square symbol estimates against enumeration."""

import numpy as np
import pytest
from numpy.typing import NDArray
from slot_light import COVARIANCE, MEAN_LIT, SLOPES, VALUES, light_about_mean, observed

from heliograph.receive.sync import combine as partial_exposure
from heliograph.receive.sync.combine import (
    moments,
    posterior_moments,
    response,
    response_of_levels,
    symbol_llrs,
)
from heliograph.signal import haar, pwm

Floats = NDArray[np.float64]
SIDE = 8


def test_half_of_each_slot_shows_the_symbols_themselves() -> None:
    assert np.allclose(response(np.full(4, 0.5)), VALUES)


def test_lit_slots_have_the_moments_of_random_data() -> None:
    data = np.random.default_rng(0).choice(np.array([-1, 1], np.int8), (4000, SIDE, SIDE))
    levels = haar.encode(data)
    lit = pwm.lit_slots(levels).transpose(1, 0, 2, 3).reshape(4, -1)
    assert lit.mean(1) == pytest.approx(MEAN_LIT, abs=0.01)
    assert np.cov(lit) == pytest.approx(COVARIANCE, abs=0.01)
    assert np.cov(lit, levels.ravel())[4, :4] == pytest.approx(SLOPES, abs=0.01)
    stated = partial_exposure.MEAN_LIT, partial_exposure.COVARIANCE, partial_exposure.SLOPES
    for one, derived in zip(stated, (MEAN_LIT, COVARIANCE, SLOPES), strict=True):
        assert one == pytest.approx(derived)


def test_the_response_is_what_the_light_of_each_value_shows() -> None:
    weights = np.array([0.1, 0.6, -0.3, 0.2])
    assert np.array_equal(partial_exposure.VALUES, VALUES)
    shown = [observed(light_about_mean(haar.encode(value.reshape(2, 2)), weights)) for value in VALUES]
    assert response(weights) == pytest.approx(np.stack(shown))


def test_moments_go_through_all_values_of_a_square() -> None:
    rng = np.random.default_rng(2)
    table, mean = response(np.array([0.1, 0.6, 0.3, 0.0])), rng.uniform(-0.9, 0.9, 4)
    chance = np.prod((1 + VALUES * mean) / 2, 1)
    first, second = moments(table, mean)
    assert first == pytest.approx(chance @ table)
    assert second == pytest.approx(chance @ table**2 - first**2)


@pytest.mark.parametrize("known", [0.0, 0.6, 1.0])
def test_symbols_of_a_square_say_more_of_each_other_the_more_they_are_known(known: float) -> None:
    rng = np.random.default_rng(3)
    table = response(np.array([0.1, 0.6, 0.3, 0.0]))
    observed, variance = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    for i in range(4):
        mean = known * np.array([1.0, -1.0, -1.0, 1.0])
        mean[i] = 0.0
        chance = np.prod((1 + VALUES * mean) / 2, 1)
        fit = (table - observed) ** 2 / variance / 2
        up = VALUES[:, i] > 0
        own, joint = (
            np.log((chance * np.exp(-part))[up].sum() / (chance * np.exp(-part))[~up].sum())
            for part in (fit[:, i], fit.sum(1))
        )
        # power ratio between symbol products and symbols
        products = np.mean(table**2) / np.mean(table * VALUES) ** 2 - 1
        assert 0.05 < products < 0.5
        # trust in the other three symbols: product of squared means
        trust = products + (1 - products) * known**6
        llr = own + trust * (joint - own)
        assert symbol_llrs(table, observed, variance, mean)[i] == pytest.approx(llr, abs=1e-6)


def test_the_prior_of_a_symbol_is_not_in_its_llr() -> None:
    rng = np.random.default_rng(4)
    table = response(np.array([0.1, 0.6, 0.3, 0.0]))
    observed, variance, mean = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4), rng.uniform(-0.9, 0.9, 4)
    for i in range(4):
        other = mean.copy()
        other[i] = -0.3
        llrs = [symbol_llrs(table, observed, variance, m)[i] for m in (mean, other)]
        assert llrs[0] == pytest.approx(llrs[1])


@pytest.mark.parametrize("far", [30.0, 3000.0])
def test_what_no_symbols_explain_leaves_moments_and_llrs_finite(far: float) -> None:
    table, mean = response(np.array([0.1, 0.6, 0.3, 0.0])), np.array([1.0, -1.0, 1.0, 1.0])
    observed, variance = far * np.array([-1.0, 1.0, 1.0, -1.0]), np.full(4, 1e-4)
    first, second = posterior_moments(table, observed, variance, mean)
    assert (np.abs(first) <= np.abs(table).max()).all()
    assert (second <= (table**2).max()).all()
    assert np.isfinite(symbol_llrs(table, observed, variance, mean)).all()


def test_posterior_moments_weigh_all_values_by_what_is_observed() -> None:
    rng = np.random.default_rng(5)
    table, mean = response(np.array([0.1, 0.6, 0.3, 0.0])), rng.uniform(-0.9, 0.9, 4)
    observed, variance = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    chance = np.prod((1 + VALUES * mean) / 2, 1) * np.exp(-((table - observed) ** 2 / variance / 2).sum(1))
    chance /= chance.sum()
    first, second = posterior_moments(table, observed, variance, mean)
    assert first == pytest.approx(chance @ table)
    assert second == pytest.approx(chance @ table**2)


def test_in_step_the_llr_is_that_of_a_bit_in_gaussian_noise() -> None:
    observed, variance = np.array([0.3, -1.2, 0.8, 0.1] * 4), np.linspace(0.2, 3, 16)
    llr = symbol_llrs(VALUES, observed, variance, np.zeros(16))
    assert llr == pytest.approx(2 * observed / variance)


def test_known_levels_are_observed_as_they_are() -> None:
    lit = np.zeros((SIDE, SIDE), bool)
    lit[:4, 4:] = True
    weights = np.array([0.2, 0.1, 0.0, 0.3])
    levels = np.where(lit, 4, 0).astype(np.uint8)
    assert response_of_levels(weights, lit) == pytest.approx(observed(light_about_mean(levels, weights)))
