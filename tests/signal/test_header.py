"""Headers: half lit, orthogonal, low cross-correlation at every shift."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from heliograph.experiments.detection.header_separation import separation, tables
from heliograph.signal.header import (
    CHIPS,
    IDENTITIES,
    all_header_cells,
    all_on_levels,
    header_cells,
    header_levels,
    identity,
)
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS
from heliograph.signal.pwm import invert

ROOT = Path(__file__).parents[2]


def half_cells(number: int) -> NDArray[np.int64]:
    """Return an identity's header in half cells, padded with dark cells (0)."""
    return np.pad(np.kron(header_cells(number).astype(np.int64), np.ones((2, 2), np.int64)), 8)


def correlations(a: int, b: int) -> NDArray[np.float64]:
    """Return correlations for shifts -7 to 7 half cells down and right; 1 for equal headers at shift 0."""
    still, moved = half_cells(a), half_cells(b)
    shifts = range(-7, 8)
    return np.array([[np.sum(still * np.roll(moved, (s, t), (0, 1))) / 64 for t in shifts] for s in shifts])


@pytest.mark.parametrize("number", range(IDENTITIES))
@pytest.mark.parametrize("side", [4, 16, 20])
def test_half_of_the_array_is_lit(number: int, side: int) -> None:
    levels = header_levels(number, side)
    assert levels.shape == (side, side)
    assert set(np.unique(levels)) == {0, 4}
    assert levels.mean() == invert(levels).mean() == 2
    cells = levels.reshape(4, side // 4, 4, side // 4)
    assert np.all(cells == cells[:, :1, :, :1])
    assert np.array_equal(np.where(cells[:, 0, :, 0] > 0, 1, -1), header_cells(number))


def test_identity_numbers() -> None:
    assert IDENTITIES == 30
    for number in range(IDENTITIES):
        assert identity(number) == (HEADER_POLYNOMIALS[number // 15], number % 15)


def test_chips_run_to_and_fro() -> None:
    # x^4 + x^3 + 1 from 1000: the paper's sequence, arranged by hand
    assert (header_cells(0) > 0).astype(int).tolist() == [[1, 0, 0, 0], [1, 1, 1, 1], [0, 1, 0, 1], [0, 0, 0, 1]]
    assert all(header_cells(number)[3, 0] == -1 for number in range(IDENTITIES))


def test_identities_of_a_polynomial_are_orthogonal() -> None:
    flat = all_header_cells().reshape(IDENTITIES, -1).astype(int)
    gram = flat @ flat.T
    assert np.array_equal(gram[:CHIPS, :CHIPS], 16 * np.eye(CHIPS))
    assert np.array_equal(gram[CHIPS:, CHIPS:], 16 * np.eye(CHIPS))
    # different polynomials: correlation at most 1/2
    assert np.abs(gram[:CHIPS, CHIPS:]).max() <= 8


@pytest.mark.slow
def test_identities_stay_apart_at_every_shift() -> None:
    for a in range(IDENTITIES):
        for b in range(a, IDENTITIES):
            found = np.abs(correlations(a, b))
            if a == b:
                assert found[7, 7] == 1
                found[7, 7] = 0
            assert found.max() <= 0.625


def image(number: int, x: float, y: float, pitch: float) -> NDArray[np.float64]:
    """Render header minus inverse on 40 x 40 pixels with the reference link's blur; full scale is 1."""
    sigma = np.sqrt(0.5**2 + (pitch / 8) ** 2 / 4)
    edges = np.arange(41) - 20.0

    def shares(offset: float) -> NDArray[np.float64]:
        leds = (np.arange(16) - 7.5) * pitch + offset
        return np.asarray(np.diff(erf((edges - leds[:, None]) / (sigma * np.sqrt(2))), axis=1) / 2)

    signs = np.kron(header_cells(number), np.ones((4, 4)))
    return np.asarray(0.8 * pitch**2 * shares(y).T @ signs @ shares(x))


@pytest.mark.slow
def test_separation_under_the_blur() -> None:
    """The documented table matches the experiment and independently rendered images."""
    row = tables([separation(80.0)])[0].markdown().splitlines()[-1]
    assert row in (ROOT / "docs" / "air-interface.md").read_text(encoding="utf-8")
    pitch = 58.3 / 80
    still = image(6, 0.2, 0.3, pitch)
    # search around the worst shift for the closest pair
    near = [(x, y) for x in np.arange(-0.3, 0.6, 0.1) for y in np.arange(3.4, 4.3, 0.1)]
    apart = min(np.linalg.norm(image(28, 0.2 + x * pitch, 0.3 + y * pitch, pitch) - still) for x, y in near)
    assert apart / np.sqrt(2) / 0.006 == pytest.approx(695, abs=1)


@pytest.mark.parametrize("number", [-1, 30])
def test_unknown_identity(number: int) -> None:
    with pytest.raises(ValueError, match="identity is 0 to 29"):
        header_levels(number)


def test_side_is_a_multiple_of_four() -> None:
    with pytest.raises(ValueError, match="multiple of 4"):
        header_levels(0, 18)


def test_all_on_header_is_all_light_then_none() -> None:
    assert np.array_equal(all_on_levels(8), np.full((8, 8), 4))
    assert not invert(all_on_levels(8)).any()
