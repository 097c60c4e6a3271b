"""LMMSE equaliser against dense matrices, LLRs, and expectation propagation against exact posteriors."""

from collections.abc import Sequence
from functools import cache
from itertools import product

import equalise_oracle as reference
import numpy as np
import pytest
from known_packets import by_matrices
from scenes import SIDE, Floats
from whole_pairs import GAIN, MOTIONS, SYMBOLS, WholePair, moving, pair_of, random_levels

from heliograph.base.threads import one_thread
from heliograph.receive.equalise.lmmse import Estimate, ExpectationPropagation, equalise, information, llr_of, products
from heliograph.receive.observe.cutout import Noise, take_cutout
from heliograph.receive.observe.statistics import PairStatistics, whiten

KNOWN = 1e-3  # symbols with a smaller variance count as known


@cache
def pair_at_rest(distance_m: float) -> PairStatistics:
    poses = moving(distance_m, 0.0, (0.0, 0.0))
    pair = pair_of(poses, random_levels()[1])
    return whiten(take_cutout(pair, poses, SIDE), Noise(4.0, 4.0), SIDE).statistics


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("unknown", [1, 63, 64, 200])
def test_variances_of_any_number_of_symbols(unknown: int, scattered: bool) -> None:
    pair, symbols = pair_at_rest(90), random_levels()[0]
    which = np.sort(np.random.default_rng(8).permutation(SYMBOLS)[:unknown]) if scattered else np.arange(unknown)
    variance = np.where(np.isin(np.arange(SYMBOLS), which), 0.7, 0.0)
    got = equalise(pair, GAIN, 4.0, np.where(variance > 0, 0.0, symbols), variance)
    gram = pair.gram[np.ix_(which, which)].astype(np.float64)
    want = np.linalg.inv(GAIN**2 / 4.0 * gram + np.eye(unknown) / 0.7)
    assert got.spread == pytest.approx(np.diag(want), abs=1e-5)
    assert got.trace == pytest.approx(float(np.trace(gram @ want)), rel=1e-3)


@pytest.mark.parametrize("unknown", [0, 1, 64, 150])
@pytest.mark.parametrize("motion", MOTIONS)
def test_products_exclude_the_light_of_unknown_symbols(motion: tuple[float, float], unknown: int) -> None:
    poses, scale, rng = moving(80, 0.02, motion), GAIN**2 / 4.0, np.random.default_rng(9)
    whole = WholePair(poses, pair_of(poses, random_levels()[1]), Noise(4.0, 4.0))
    whitened = whiten(whole.cutout, Noise(4.0, 4.0), SIDE)
    which, images = np.sort(rng.permutation(SYMBOLS)[:unknown]), rng.normal(size=(7, *whole.cutout.shape))
    got = products(whitened, images, which, scale)
    flat = images.reshape(7, -1)
    # B from correlations with unit images, B^T B from the statistics
    pixels = np.eye(flat.shape[1]).reshape(-1, *whole.cutout.shape)
    b = whitened.correlate(pixels).T[:, which]
    gram = whitened.statistics.gram[np.ix_(which, which)].astype(np.float64)
    want = flat @ (flat.T - b @ np.linalg.solve(gram + np.eye(unknown) / scale, b.T @ flat.T))
    assert np.abs(got - want).max() < 1e-5 * want.max()


def priors(kind: str) -> tuple[Floats, Floats]:
    symbols = np.arange(SYMBOLS)
    mean = {
        "none": np.zeros(SYMBOLS),
        "partial": np.tanh(np.random.default_rng(6).normal(0, 1.5, SYMBOLS)),
        "high layer": np.where(symbols < SYMBOLS // 4, random_levels()[0], 0.0),
    }[kind]
    return mean, np.where(np.abs(mean) == 1, 0.0, np.maximum(1 - mean**2, 2 * KNOWN))


@pytest.mark.parametrize(
    ("kind", "distance_m"), [("none", 110), ("partial", 110), ("high layer", 110), ("partial", 80)]
)
@pytest.mark.slow
def test_the_estimate_is_linear_mmse(kind: str, distance_m: float) -> None:
    symbols, x = random_levels()
    noise, poses = Noise(4.5, 1.4), moving(distance_m, 0.02, (0.1, 0.05))
    whole = WholePair(poses, pair_of(poses, x, noise=1.5), noise)
    b, d, o, w = (part[whole.w > 0] for part in (whole.b, whole.d, whole.o, whole.w))
    mean, variance = priors(kind)
    with one_thread():
        got = equalise(by_matrices(b, d, o, w), GAIN, noise.lit, mean, variance)
        expected, covariance, extrinsic = reference.lmmse(GAIN * b, d - GAIN * o, noise.lit / w, mean, variance)
    open_ = variance > 0
    assert got.mean == pytest.approx(expected, abs=2e-3)
    assert got.llr[open_] == pytest.approx(extrinsic[open_], abs=0.03, rel=0.01)
    assert not got.llr[~open_].any()
    assert got.trace == pytest.approx(float(np.trace(b.T @ (w[:, None] * b) @ covariance)), rel=2e-3)
    # most symbols in the best layer are correct
    assert np.mean((got.llr > 0) == (symbols > 0), where=open_) > 0.6


@pytest.mark.parametrize(
    ("variances", "unknown"), [((2e-3, 5e-4, 1.0), [0, 2]), ((9e-4, 9e-4, 0.0), []), ((0.0, 0.0, 0.0), [])]
)
def test_symbols_of_small_variance_are_known_and_not_estimated(variances: Sequence[float], unknown: list[int]) -> None:
    rng, mean = np.random.default_rng(7), np.array([0.1, -1.0, 0.2])
    got = estimated(rng.normal(size=(9, 3)), rng.normal(size=9), mean, np.array(variances))
    known = np.setdiff1d(range(3), unknown)
    assert (got.unknown.tolist(), bool(got.trace)) == (unknown, bool(unknown))
    assert np.array_equal(got.mean[known], mean[known])
    assert not any(part[known].any() for part in (got.llr, *got.extrinsic))


def test_information_in_llrs() -> None:
    llr = np.array([[0.0] * 4, [50.0] * 4, [-1e4] * 4, [np.log(9)] * 4])
    # P(wrong) = 1/2, 0, 0 and 1/10
    assert information(llr) == pytest.approx([0, 1, 1, 1 + 0.1 * np.log2(0.1) + 0.9 * np.log2(0.9)])


def test_llr_is_gaussian_near_a_symbol_and_small_far_from_both() -> None:
    precision, mean = np.array([0.0, 0.5, 4.0, 9.0]), np.array([0.0, -0.3, 0.8, 1.3])
    assert llr_of(precision, precision * mean) == pytest.approx(2 * precision * mean, abs=1e-6)
    precision, mean = np.full(5, 1e4), np.array([-1.0, -0.5, 0.02, 0.2, 1.0])
    llr = llr_of(precision, precision * mean)
    assert (np.sign(llr) == np.sign(mean)).all()
    assert np.abs(llr[1:4]).max() < 4
    assert np.abs(llr[2]) < 0.3
    assert llr[-1] == pytest.approx(-llr[0])
    assert llr[-1] > 30


def estimated(b: Floats, d: Floats, mean: Floats, variance: Floats) -> Estimate:
    return equalise(by_matrices(b, d, np.zeros(len(d))), 1.0, 1.0, mean, variance)


def exact(b: Floats, d: Floats, mean: Floats) -> Floats:
    """Return E c for symbols +-1 with prior means, by enumeration."""
    symbols = np.array(list(product((-1.0, 1.0), repeat=b.shape[1])))
    chance = np.prod(0.5 * (1 + symbols * mean), axis=1) * np.exp(-0.5 * ((d - symbols @ b.T) ** 2).sum(1))
    return np.asarray(chance @ symbols / chance.sum())


def propagated(b: Floats, d: Floats, mean: Floats) -> Floats:
    """Return E c after 12 iterations."""
    propagation, llr = ExpectationPropagation((1, b.shape[1])), np.zeros_like(mean)
    for _ in range(12):
        priors = propagation.priors(mean[None], 1 - mean[None] ** 2)
        llr = propagation.take(0, estimated(b, d, priors[0][0], priors[1][0]))
    return np.tanh(np.arctanh(mean) + 0.5 * llr)


def test_propagation_is_exact_without_overlap() -> None:
    rng = np.random.default_rng(0)
    b, mean = np.diag(rng.uniform(0.2, 2, 6)), rng.uniform(-0.9, 0.9, 6)
    d = b @ rng.choice([-1.0, 1.0], 6) + rng.normal(size=6)
    assert propagated(b, d, mean) == pytest.approx(exact(b, d, mean), abs=2e-3)


def test_propagation_beats_linear_mmse_with_overlap() -> None:
    rng, errors = np.random.default_rng(1), []
    for _ in range(60):
        b, mean = rng.normal(0, 0.8, (7, 9)), np.zeros(9)
        d = b @ rng.choice([-1.0, 1.0], 9) + rng.normal(size=7)
        linear = np.tanh(estimated(b, d, mean, np.ones(9)).extrinsic[1])
        errors.append(np.stack([linear, propagated(b, d, mean)]) - exact(b, d, mean))
    gaussian, two_valued = np.mean(np.square(errors), axis=(0, 2))
    assert two_valued < 0.5 * gaussian


def test_decoded_symbols_keep_their_values_and_dropped_cavities_have_no_effect() -> None:
    rng, propagation = np.random.default_rng(2), ExpectationPropagation((1, 4))
    b, prior = rng.normal(size=(6, 4)), np.array([[[1.0, -1.0, 0.2, 0.0]], [[0.0, 0.0, 0.96, 1.0]]])
    before = np.array(propagation.priors(*prior))
    propagation.take(0, estimated(b, rng.normal(size=6), np.zeros(4), np.ones(4)))
    after = np.array(propagation.priors(*prior))
    assert np.array_equal(after[..., :2], prior[..., :2])
    assert not np.allclose(after[0, 0, 2:], before[0, 0, 2:])
    propagation.forget()
    assert np.allclose(propagation.priors(*prior), before)
    assert np.allclose(before, prior)


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
