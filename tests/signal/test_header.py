"""M-sequences against SciPy, and headers: half lit, orthogonal, low cross-correlation at every shift."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import max_len_seq
from scipy.special import erf

from heliograph.experiments.detection.header_separation import separation, tables
from heliograph.signal.header import CHIPS, IDENTITIES, all_header_cells, header_cells, header_levels
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence, periodic_correlation
from heliograph.signal.pwm import invert

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("side", [4, 16, 20])
def test_half_of_the_array_is_lit(side: int) -> None:
    for number in range(IDENTITIES):
        levels = header_levels(number, side)
        assert levels.mean() == invert(levels).mean() == 2
        cells = levels.reshape(4, side // 4, 4, side // 4)
        assert np.all(cells == cells[:, :1, :, :1])
        assert np.array_equal(2 * header_cells(number) + 2, cells[:, 0, :, 0])


def test_identities_of_a_polynomial_are_orthogonal() -> None:
    flat = all_header_cells().reshape(IDENTITIES, -1).astype(int)
    gram = flat @ flat.T
    assert np.array_equal(gram[:CHIPS, :CHIPS], 16 * np.eye(CHIPS))
    assert np.array_equal(gram[CHIPS:, CHIPS:], 16 * np.eye(CHIPS))
    assert np.abs(gram[:CHIPS, CHIPS:]).max() <= 8  # different polynomials: correlation at most 1/2


def test_identities_stay_apart_at_every_shift() -> None:
    """Shift headers by up to 7 half cells down and right; the background has no light."""
    still = np.pad(np.kron(all_header_cells().astype(np.int64), np.ones((1, 2, 2), np.int64)), ((0, 0), (8, 8), (8, 8)))
    for down in range(-7, 8):
        for right in range(-7, 8):
            moved = np.roll(still, (down, right), (1, 2)).reshape(IDENTITIES, -1)
            found = np.abs(still.reshape(IDENTITIES, -1) @ moved.T) / 64
            if not down and not right:
                assert np.all(np.diag(found) == 1)
                np.fill_diagonal(found, 0)
            assert found.max() <= 0.625


def image(number: int, x: float, y: float, pitch: float) -> NDArray[np.float64]:
    """Render header minus inverse on 40 x 40 pixels with the reference link's blur; full scale is 1."""
    sigma, edges = np.sqrt(0.5**2 + (pitch / 8) ** 2 / 4), np.arange(41) - 20.0

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


# primitive polynomials: Peterson and Weldon, Error-Correcting Codes, appendix C (octal)
PRIMITIVE = [0o7, 0o13, 0o23, 0o45, 0o103, 0o211, 0o435]


def phases(chips: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> set[bytes]:
    return {np.roll(chips, s).astype(np.uint8).tobytes() for s in range(len(chips))}


def test_header_polynomials_are_the_papers_and_its_reciprocal() -> None:
    assert HEADER_POLYNOMIALS == (0b11001, 0b10011)
    forward, backward = (m_sequence(p) for p in HEADER_POLYNOMIALS)
    assert phases(forward[::-1]) == phases(backward)
    assert not phases(forward) & phases(backward)


@pytest.mark.parametrize("polynomial", HEADER_POLYNOMIALS)
def test_autocorrelation_of_every_phase(polynomial: int) -> None:
    seen = set()
    for state in range(1, 16):
        chips = m_sequence(polynomial, state)
        assert [int(chips[k]) for k in range(4)] == [state >> k & 1 for k in range(4)]
        assert (periodic_correlation(chips, chips).tolist(), chips.sum()) == ([15] + [-1] * 14, 8)
        seen.add(chips.tobytes())
    assert seen == phases(m_sequence(polynomial))  # each nonzero state selects a distinct phase


@pytest.mark.parametrize("polynomial", [*HEADER_POLYNOMIALS, *PRIMITIVE])
def test_same_as_scipy(polynomial: int) -> None:
    m = polynomial.bit_length() - 1
    theirs, _ = max_len_seq(m, taps=[i for i in range(1, m) if polynomial >> i & 1])
    assert phases(m_sequence(polynomial)) == phases(theirs)
