"""LMMSE equaliser against dense matrices."""

from collections.abc import Sequence

import equalise_oracle as reference
import numpy as np
import pytest
from known_packets import by_matrices
from numpy.typing import NDArray
from scenes import SIDE
from whole_pairs import GAIN, MOTIONS, SYMBOLS, WholePair, moving, pair_of, random_levels

from heliograph.base.threads import one_thread
from heliograph.receive.equalise.lmmse import equalise, products
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import whiten

Floats = NDArray[np.float64]

KNOWN = 1e-3
"""Symbols with a smaller variance count as known."""


def pair_at_rest(distance_m: float) -> WholePair:
    poses = moving(distance_m, 0.0, (0.0, 0.0))
    return WholePair(poses, pair_of(poses, random_levels()[1]), Noise(4.0, 4.0))


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("unknown", [1, 63, 64, 128, 200])
def test_variances_of_any_number_of_symbols(unknown: int, scattered: bool) -> None:
    pair, symbols = whiten(pair_at_rest(90).cutout, Noise(4.0, 4.0), SIDE).statistics, random_levels()[0]
    which = np.sort(np.random.default_rng(8).permutation(SYMBOLS)[:unknown]) if scattered else np.arange(unknown)
    variance = np.where(np.isin(np.arange(SYMBOLS), which), 0.7, 0.0)
    got = equalise(pair, GAIN, 4.0, np.where(variance > 0, 0.0, symbols), variance)
    gram = pair.gram[np.ix_(which, which)].astype(np.float64)
    want = np.linalg.inv(GAIN**2 / 4.0 * gram + np.eye(unknown) / 0.7)
    assert got.spread == pytest.approx(np.diag(want), abs=1e-5)
    assert got.trace == pytest.approx(float(np.trace(gram @ want)), rel=1e-3)


@pytest.mark.parametrize("unknown", [0, 1, 64, 150])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.slow
def test_products_before_the_light_of_symbols(motion: tuple[float, float], unknown: int) -> None:
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
    if motion == (0.0, 0.0):
        noise = np.eye(flat.shape[1]) + scale * b @ b.T
        assert got == pytest.approx(flat @ np.linalg.solve(noise, flat.T), abs=2e-3 * want.max())


def priors(kind: str) -> tuple[Floats, Floats]:
    """Return prior mean and variance per symbol."""
    rng = np.random.default_rng(6)
    mean = {"nothing": np.zeros(SYMBOLS), "something": np.tanh(rng.normal(0, 1.5, SYMBOLS))}.get(kind)
    if mean is None:  # high layer known
        mean = np.where(np.arange(SYMBOLS) < SYMBOLS // 4, random_levels()[0], 0.0)
    return mean, np.where(np.abs(mean) == 1, 0.0, np.maximum(1 - mean**2, 2 * KNOWN))


@pytest.mark.parametrize("kind", ["nothing", "something", "the high layer"])
@pytest.mark.parametrize("distance_m", [60, 110])
@pytest.mark.slow
def test_the_estimate_is_linear_mmse(distance_m: float, kind: str) -> None:
    symbols, x = random_levels()
    noise, poses = Noise(4.5, 1.4), moving(distance_m, 0.02, (0.1, 0.05))
    whole = WholePair(poses, pair_of(poses, x, noise=1.5), noise)
    used = whole.w > 0
    b, d, o, w = whole.b[used], whole.d[used], whole.o[used], whole.w[used]
    mean, variance = priors(kind)
    with one_thread():
        got = equalise(by_matrices(b, d, o, w), GAIN, noise.lit, mean, variance)
        want = reference.lmmse(GAIN * b, d - GAIN * o, noise.lit / w, mean, variance)
    open_ = variance > 0
    assert got.mean == pytest.approx(want.mean, abs=2e-3)
    assert got.llr[open_] == pytest.approx(want.extrinsic[open_], abs=0.03, rel=0.01)
    assert not got.llr[~open_].any()
    trace = float(np.trace(b.T @ (w[:, None] * b) @ want.covariance))
    assert got.trace == pytest.approx(trace, rel=2e-3)
    # most symbols in the best layer are correct
    assert np.mean((got.llr > 0) == (symbols > 0), where=open_) > 0.6


@pytest.mark.parametrize("kind", ["nothing", "something", "the high layer"])
def test_extrinsic_gaussian_excludes_the_prior(kind: str) -> None:
    """Extrinsic Gaussian times prior gives the posterior."""
    mean, variance = priors(kind)
    pair = whiten(pair_at_rest(80).cutout, Noise(4.0, 4.0), SIDE).statistics
    got = equalise(pair, GAIN, 4.0, mean, variance)
    precision, weighted = got.extrinsic
    u = got.unknown
    assert u.tolist() == np.flatnonzero(variance > 0).tolist()
    assert 1 / (precision[u] + 1 / variance[u]) == pytest.approx(got.spread, rel=1e-6)
    assert (weighted[u] + mean[u] / variance[u]) * got.spread == pytest.approx(got.mean[u], abs=1e-6)
    known = np.setdiff1d(np.arange(SYMBOLS), u)
    assert not precision[known].any()
    assert not weighted[known].any()


def test_known_symbols_are_not_estimated() -> None:
    symbols, pair = random_levels()[0], whiten(pair_at_rest(80).cutout, Noise(4.0, 4.0), SIDE).statistics
    got = equalise(pair, GAIN, 4.0, symbols, np.zeros(SYMBOLS))
    assert np.array_equal(got.mean, symbols)
    assert got.trace == 0
    assert not got.llr.any()
    assert [part.any() for part in got.extrinsic] == [False, False]


@pytest.mark.parametrize(("variances", "unknown"), [((2e-3, 5e-4, 1.0), [0, 2]), ((9e-4, 9e-4, 0.0), [])])
def test_symbol_of_small_variance_is_known(variances: Sequence[float], unknown: list[int]) -> None:
    rng = np.random.default_rng(7)
    b, d = rng.normal(size=(9, 3)), rng.normal(size=9)
    got = equalise(by_matrices(b, d, np.zeros(9)), 1.0, 1.0, np.array([0.1, -1.0, 0.2]), np.array(variances))
    assert got.unknown.tolist() == unknown
    known = [k for k in range(3) if k not in unknown]
    assert got.mean[known].tolist() == [[0.1, -1.0, 0.2][k] for k in known]
