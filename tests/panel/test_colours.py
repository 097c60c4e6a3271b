"""`unmix_colours` on simulated crosstalk and on a rendered three-colour panel."""

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from panel_films import PanelFilm, keystone

import heliograph

Floats = NDArray[np.float64]
Bits = NDArray[np.bool_]


def mixed(seed: int, lit: float, leak: float, noise: float = 8.0, leds: int = 640) -> tuple[Floats, Bits, Floats]:
    """Return values, bits and crosstalk matrix for randomly lit LEDs."""
    rng = np.random.default_rng([seed, int(100 * lit), int(100 * leak)])
    bits = rng.random((leds, 3)) < lit
    leaks = rng.uniform(0, leak, (3, 3)) * (1 - np.eye(3))
    matrix = (np.eye(3) + leaks) * rng.uniform(60, 140, 3)
    return bits @ matrix.T + rng.uniform(5, 40) + rng.normal(0, noise, bits.shape), bits, matrix


def split(values: Floats) -> Bits:
    """Threshold each channel midway between the means of the values above and below."""
    bits = np.empty(values.shape, bool)
    for k in range(3):
        level = values[:, k]
        threshold = (level.min() + level.max()) / 2
        for _ in range(20):
            threshold = (level[level > threshold].mean() + level[level <= threshold].mean()) / 2
        bits[:, k] = level > threshold
    return bits


@pytest.mark.parametrize(("lit", "leak"), [(0.05, 0.5), (0.1, 0.3), (0.5, 0.4), (0.8, 0.3)])
def test_fewer_bits_are_wrong_than_by_a_threshold(lit: float, leak: float) -> None:
    before = after = 0
    for seed in range(3):
        values, bits, _ = mixed(seed, lit, leak)
        before += int((split(values) != bits).sum())
        after += int((heliograph.unmix_colours(values).bits != bits).sum())
    assert before >= 5
    assert after <= before / 5


def test_matrix_offset_and_light_are_found() -> None:
    values, bits, matrix = mixed(1, 0.5, 0.4, noise=2.0)
    unmixed = heliograph.unmix_colours(values.reshape(2, 20, 16, 3))
    assert unmixed.bits.shape == unmixed.light.shape == (2, 20, 16, 3)
    np.testing.assert_allclose(unmixed.matrix, matrix, atol=1.0)
    assert np.ptp(unmixed.offset) < 1.5
    assert np.abs(unmixed.light.reshape(-1, 3) - bits).max() < 0.3


def test_other_order_of_channels_gives_bits_in_that_order() -> None:
    values, bits, matrix = mixed(2, 0.4, 0.4)
    unmixed = heliograph.unmix_colours(values[:, ::-1])
    assert (unmixed.bits != bits[:, ::-1]).sum() <= 3
    np.testing.assert_allclose(unmixed.matrix, matrix[::-1, ::-1], atol=4)


@pytest.mark.parametrize("start", [np.eye(3), np.ones((3, 3)), -np.eye(3), np.eye(3)[[1, 2, 0]], np.zeros((3, 3))])
def test_bad_starts_do_no_harm(start: Floats) -> None:
    values, bits, _ = mixed(3, 0.3, 0.4)
    assert (heliograph.unmix_colours(values, start).bits != bits).sum() <= 3


def test_clipped_values_are_read() -> None:
    values, bits, matrix = mixed(4, 0.5, 0.4, noise=3.0)
    top = 0.7 * float(matrix.sum(axis=1).min())
    clipped = np.minimum(values, top)
    assert (clipped >= top).mean() > 0.1
    assert (heliograph.unmix_colours(clipped, full_scale=top).bits != bits).sum() <= 6


def test_whole_numbers_of_any_type_are_read() -> None:
    values, bits, _ = mixed(5, 0.5, 0.2, noise=3.0)
    for dtype in (np.uint16, np.float32, np.int64):
        assert (heliograph.unmix_colours(values.astype(dtype)).bits == bits).all()


@pytest.mark.slow
def test_a_rendered_panel_is_read_through_crosstalk() -> None:
    leak = np.array([[0.62, 0.34, 0.06], [0.25, 0.5, 0.32], [0.05, 0.3, 0.62]])
    corners = keystone((75.0, 60.0), 107.0, 1.25, 0.07, 0.15)
    film = PanelFilm(lambda _: corners, 16, 20, 150, 120, 1.6, noise=1.5, leak=leak)
    place = heliograph.Place(corners, 1.77)
    values = np.array([heliograph.sample(film.frame(k), place, 16, 20, unblur=True) for k in range(4)])
    bits = np.array([film.bits(k) for k in range(4)])
    before = int((split(values.reshape(-1, 3)) != bits.reshape(-1, 3)).sum())
    assert before > 40
    assert (heliograph.unmix_colours(values).bits != bits).sum() <= before / 10


RNG = np.random.default_rng(0)
WHITE = (RNG.random((200, 1)) < 0.5) * np.array([90.0, 80, 70])

FAULTS: dict[str, tuple[Any, str]] = {
    "one colour": (np.full((20, 20, 3), 7.0), "three colours that change independently"),
    "noise alone": (RNG.normal(50, 5, (400, 3)), "three colours that change independently"),
    "white alone": (WHITE, "three colours that change independently"),
    "white alone with noise": (WHITE + RNG.normal(0, 3, WHITE.shape), "three colours that change independently"),
    "blue never on": ((RNG.random((300, 3)) < [0.5, 0.5, 0]) * 90 + RNG.normal(0, 4, (300, 3)), "independently"),
    "one LED": (np.array([1.0, 2, 3]), "three colours that change independently"),
    "gray": (np.zeros((8, 8)), "numbers of shape (..., 3)"),
    "no values": (np.zeros((0, 3)), "numbers of shape (..., 3)"),
    "text": ("red", "numbers of shape (..., 3)"),
    "complex": (np.zeros((9, 3), complex), "numbers of shape (..., 3)"),
    "ragged": ([[1, 2, 3], [1]], "numbers of shape (..., 3)"),
    "missing": (np.where(np.arange(30).reshape(10, 3) == 4, np.nan, 1.0), "not finite"),
    "infinite": (np.full((9, 3), np.inf), "not finite"),
}


@pytest.mark.parametrize(("values", "says"), FAULTS.values(), ids=FAULTS)
def test_values_without_three_colours_are_an_error_of_one_line(values: Any, says: str) -> None:
    with pytest.raises(heliograph.HeliographError, match=re.escape(says)):
        heliograph.unmix_colours(values)


@pytest.mark.parametrize(
    "given", [{"start": np.eye(2)}, {"start": "red"}, {"full_scale": "high"}, {"full_scale": np.nan}]
)
def test_wrong_options_are_an_error_of_one_line(given: dict[str, Any]) -> None:
    with pytest.raises(heliograph.HeliographError, match=r"^(start is a matrix|full_scale is a level)"):
        heliograph.unmix_colours(mixed(0, 0.5, 0.2)[0], **given)
