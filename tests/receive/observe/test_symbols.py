"""Symbol images against dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at
from whole_pairs import CUT, SYMBOLS, T, WholePair, moving, pair_of, random_levels

from heliograph.receive import Pose
from heliograph.receive.geometry.footprint import Footprints, footprints, sum_of_leds
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import gram_of, leds_of, light_of_symbols, transform_quarters, whiten
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
    """Return B, (pixels, symbols)."""
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
    squares = (T @ symbols).reshape(SIDE // 2, 2, SIDE // 2, 2).transpose(1, 3, 0, 2)
    assert leds == pytest.approx(squares.ravel())
    assert transform_quarters(leds) == pytest.approx(symbols)


@pytest.mark.parametrize("pose", POSES)
def test_light_of_symbols(pose: Pose) -> None:
    symbols = np.random.default_rng(2).normal(size=SYMBOLS)
    image = sum_of_leds(leds_of(symbols), light_of(pose))
    assert image.ravel() == pytest.approx(symbol_matrix(pose) @ symbols, abs=CUT * np.abs(symbols).max())


def test_correlation_of_images_with_symbols() -> None:
    poses = moving(90, 0.02, (0.1, 0.05))
    whole = WholePair(poses, pair_of(poses, random_levels()[1]), Noise(4.0, 4.0))
    images = np.random.default_rng(3).normal(size=(5, *whole.cutout.shape))
    got = whiten(whole.cutout, Noise(4.0, 4.0), SIDE).correlate(images)
    want = (np.sqrt(whole.w)[:, None] * whole.b).T @ images.reshape(5, -1).T
    assert got == pytest.approx(want, abs=0.02 * np.abs(want).max())


@pytest.mark.parametrize("pose", POSES)
def test_gram(pose: Pose) -> None:
    out = gram_of(light_of(pose))
    want = symbol_matrix(pose).T @ symbol_matrix(pose)
    assert np.abs(out - want).max() < 4 * CUT * want.max()
    assert np.abs(out - out.T).max() < 1e-6 * want.max()
    assert np.abs(light_of_symbols(light_of(pose)).T - symbol_matrix(pose)).max() < CUT
