"""Kernels of observations, compared with full matrices."""

import numpy as np
import observe_oracle as reference
import pytest
from numpy.typing import NDArray
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at
from whole_pairs import CUT, SYMBOLS, T

from heliograph.receive import Pose
from heliograph.receive.geometry.footprint import Footprints, footprints
from heliograph.receive.geometry.kernels import add_image
from heliograph.receive.observe import kernels
from heliograph.receive.observe.statistics import gram_of
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]

SHAPE = (40, 44)

POSES = [
    Pose(21.3, 19.6, pitch_at(100), 0.0, 0.51),
    Pose(20.8, 20.2, pitch_at(60), 0.03, 0.53),
    Pose(21.0, 18.9, 1.9, -0.4, 0.9),
    Pose(3.0, 38.0, 1.1, 0.1, 0.6),
]
"""The last pose is partly outside the window."""


def light_of(pose: Pose) -> Footprints:
    return footprints(pose, (0, 0), SHAPE, SIDE)


def symbol_matrix(pose: Pose) -> Floats:
    """B, (pixels, symbols)."""
    return blur_matrix(pose, SIDE, (0, 0), SHAPE) @ T


def test_the_transform_is_that_of_the_signal() -> None:
    rng = np.random.default_rng(0)
    form = PacketFormat(SignalSettings(data_pairs=8))
    symbols = rng.choice(np.array([-1, 1], np.int8), (8, SYMBOLS))
    levels = haar.encode(form.join(symbols))
    assert np.allclose(symbols @ T.T, levels.reshape(8, -1) / 2.0 - 1.0)
    assert np.allclose(T.T @ T, np.eye(SYMBOLS) / 4)


def test_symbols_to_leds_and_back() -> None:
    symbols = np.random.default_rng(1).normal(size=SYMBOLS)
    leds = kernels.leds_of(symbols)
    squares = (T @ symbols).reshape(SIDE // 2, 2, SIDE // 2, 2).transpose(0, 2, 1, 3)
    assert leds == pytest.approx(squares.ravel())
    assert kernels.symbols_of(leds) == pytest.approx(symbols)


@pytest.mark.parametrize("pose", POSES)
def test_light_of_symbols(pose: Pose) -> None:
    symbols = np.random.default_rng(2).normal(size=SYMBOLS)
    image = np.zeros(SHAPE)
    add_image(kernels.leds_of(symbols), *light_of(pose), image)
    assert image.ravel() == pytest.approx(symbol_matrix(pose) @ symbols, abs=CUT * np.abs(symbols).max())
    add_image(kernels.leds_of(symbols), *light_of(pose), image)
    assert image.ravel() == pytest.approx(2 * symbol_matrix(pose) @ symbols, abs=2 * CUT * np.abs(symbols).max())


@pytest.mark.parametrize("pose", POSES)
def test_correlation_of_an_image_with_symbols(pose: Pose) -> None:
    rng, out, many = np.random.default_rng(3), np.empty(SYMBOLS), np.empty((SYMBOLS, 5))
    image, others = rng.normal(size=SHAPE), rng.normal(size=(*SHAPE, 5))
    kernels.correlate(image, *light_of(pose), out)
    want = symbol_matrix(pose).T @ image.ravel()
    assert out == pytest.approx(want, abs=2 * CUT)
    assert np.abs(want).max() > 100 * CUT
    kernels.correlate_all(others, *light_of(pose), many)
    for k in range(5):
        kernels.correlate(np.ascontiguousarray(others[..., k]), *light_of(pose), out)
        assert many[:, k] == pytest.approx(out, abs=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_gram(pose: Pose) -> None:
    out = gram_of(light_of(pose), SHAPE)
    want = symbol_matrix(pose).T @ symbol_matrix(pose)
    assert np.abs(out - want).max() < 4 * CUT * want.max()
    assert np.abs(out - out.T).max() < 1e-6 * want.max()
    light = np.zeros((*SHAPE, SYMBOLS), np.float32)
    kernels.add_light(*light_of(pose), light)
    assert np.abs(light.reshape(-1, SYMBOLS) - symbol_matrix(pose)).max() < CUT


def test_background_motion_is_subtracted_by_slopes() -> None:
    rng = np.random.default_rng(10)
    change, total, got = *rng.normal(size=(2, *SHAPE)), np.empty(SHAPE)
    gains, first, last = rng.random(SYMBOLS), (*light_of(POSES[0]),), (*light_of(POSES[1]),)
    kernels.compensate_motion(change, total, first, last, gains, 3.0, 0.2, -0.4, got)
    lit = np.zeros(SHAPE)
    for light in (first, last):
        add_image(gains, *light, lit)
    down, right = np.gradient(0.5 * (total - 3.0 * lit))
    assert got == pytest.approx(change - 0.2 * right + 0.4 * down)


def test_background_power() -> None:
    difference = np.random.default_rng(12).normal(size=SHAPE)
    lit = np.zeros(SHAPE)
    add_image(np.ones(SYMBOLS), *light_of(POSES[0]), lit)
    power, count = kernels.measure_background(difference, (*light_of(POSES[0]),), 0.3)
    assert 0 < count == (lit < 0.3).sum() < lit.size
    assert power == pytest.approx((difference[lit < 0.3] ** 2).sum())


@pytest.mark.parametrize("even", [False, True])
def test_unevenness_of_a_sum(even: bool) -> None:
    """Also with even light, as of a near array, which is linearly dependent on the plane."""
    rng = np.random.default_rng(11)
    lit = np.ones(SHAPE) if even else symbol_matrix(POSES[0]).clip(0).sum(1).reshape(SHAPE)
    total, inside = rng.normal(100, 2, SHAPE) + 30 * lit, rng.random(SHAPE) < 0.4
    found = np.empty(SHAPE)
    assert kernels.fit_unevenness(total, lit, inside, found) == inside.sum()
    assert np.isnan(found[~inside]).all()
    assert np.allclose(found[inside], reference.uneven(total, lit, inside), atol=1e-9)
