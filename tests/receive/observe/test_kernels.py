"""Kernels of observations, compared with full matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at
from whole_pairs import CUT, SYMBOLS, T

from heliograph.receive import Pose
from heliograph.receive.geometry.footprint import Footprints, footprints
from heliograph.receive.geometry.kernels import add_image
from heliograph.receive.observe import kernels
from heliograph.receive.observe.statistics import gram_of, leds_of, light_of_symbols, symbols_of
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
    leds = leds_of(symbols)
    squares = (T @ symbols).reshape(SIDE // 2, 2, SIDE // 2, 2).transpose(0, 2, 1, 3)
    assert leds == pytest.approx(squares.ravel())
    assert symbols_of(leds) == pytest.approx(symbols)


@pytest.mark.parametrize("pose", POSES)
def test_light_of_symbols(pose: Pose) -> None:
    symbols = np.random.default_rng(2).normal(size=SYMBOLS)
    image = np.zeros(SHAPE)
    add_image(leds_of(symbols), *light_of(pose), image)
    assert image.ravel() == pytest.approx(symbol_matrix(pose) @ symbols, abs=CUT * np.abs(symbols).max())
    add_image(leds_of(symbols), *light_of(pose), image)
    assert image.ravel() == pytest.approx(2 * symbol_matrix(pose) @ symbols, abs=2 * CUT * np.abs(symbols).max())


@pytest.mark.parametrize("pose", POSES)
def test_correlation_of_images_with_symbols(pose: Pose) -> None:
    images, out = np.random.default_rng(3).normal(size=(*SHAPE, 5)), np.empty((SYMBOLS, 5))
    kernels.correlate(images, *light_of(pose), out)
    want = symbol_matrix(pose).T @ images.reshape(-1, 5)
    assert out == pytest.approx(want, abs=2 * CUT)
    assert np.abs(want).max() > 100 * CUT


@pytest.mark.parametrize("pose", POSES)
def test_gram(pose: Pose) -> None:
    out = gram_of(light_of(pose), SHAPE)
    want = symbol_matrix(pose).T @ symbol_matrix(pose)
    assert np.abs(out - want).max() < 4 * CUT * want.max()
    assert np.abs(out - out.T).max() < 1e-6 * want.max()
    assert np.abs(light_of_symbols(light_of(pose), SHAPE).T - symbol_matrix(pose)).max() < CUT
