"""Squares and mixes: what frames of any timing see of patterns lit by PWM, against light drawn slot by slot."""

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.receive.soft import squares
from heliograph.receive.soft.mix import EXACT, SlotLight, mix_header, mix_pair
from heliograph.signal import haar, pwm

Floats = NDArray[np.float64]
SIDE = 8
FINE = 400
"""Steps of T_b in which light is drawn."""


def cells_of(d: NDArray[Any]) -> Floats:
    """A data matrix, or several, in the order of cells: quarters D11, D12, D21, D22, row by row."""
    h = SIDE // 2
    return np.concatenate([d[:h, :h].ravel(), d[:h, h:].ravel(), d[h:, :h].ravel(), d[h:, h:].ravel()]).astype(float)


def random_data(seed: int, count: int) -> NDArray[np.int8]:
    return np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), (count, SIDE, SIDE))


def light_of(pairs: NDArray[np.int8], order: tuple[int, ...]) -> Floats:
    """(FINE steps a pattern, n, n): each LED on or off, of pairs of pattern and inverse in a row."""
    levels = haar.encode(pairs)
    patterns = np.stack([levels, pwm.invert(levels)], 1).reshape(-1, SIDE, SIDE)
    return pwm.lit_slots(patterns, order).reshape(-1, SIDE, SIDE).repeat(FINE // 4, 0).astype(float)


def cells_seen(light: Floats) -> Floats:
    """Cells in a difference of light, which is 2 x - 1 for the whole of a pattern less its inverse."""
    return cells_of(haar.decode(2 * light))


def test_half_of_each_slot_shows_the_cells_themselves() -> None:
    assert np.allclose(squares.seen(np.full(4, 0.5)), squares.VALUES)


def test_lit_slots_have_the_moments_of_random_data() -> None:
    lit = pwm.lit_slots(haar.encode(random_data(0, 4000)))
    assert lit.mean((0, 2, 3)) == pytest.approx(squares.MEAN_LIT, abs=0.01)
    assert np.allclose(squares.MEAN_LIT * 16, [15, 11, 5, 1])
    assert np.allclose(squares.SLOPES, [1 / 8, 3 / 8, 3 / 8, 1 / 8])


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1)])
@pytest.mark.parametrize("exposure", [0.13, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.1, 0.37, 0.6])
@pytest.mark.parametrize("rate", [1.0, 1.5, 2.7])
def test_mix_tells_what_it_holds(order: tuple[int, ...], exposure: float, phase: float, rate: float) -> None:
    exposure = min(exposure, 1 / rate)
    pairs = random_data(5, 3)
    light = light_of(pairs, order)
    starts = phase + np.arange(-10, 10) / rate
    starts = starts[(starts >= -1) & (starts + exposure <= 4)]
    starts, exposure = np.round(starts * FINE) / FINE, round(exposure * FINE) / FINE
    mix = mix_pair(starts, exposure, SlotLight(order))
    assert mix is not None
    first = np.round((starts[mix.frames] + 2) * FINE).astype(int)
    exposures = np.stack([light[k : k + round(exposure * FINE)].mean(0) for k in first])
    change = np.tensordot(mix.change, exposures, 1)
    expected = sum(
        table[_values(cells_of(d)), np.arange(SIDE * SIDE) // (SIDE * SIDE // 4)]
        for table, d in zip((mix.leaks[0], mix.table, mix.leaks[1]), pairs, strict=True)
    )
    # about the mean, which the levels hold
    mean = mix.levels[0] - mix.levels[1]
    assert cells_seen(change - mean) == pytest.approx(expected, abs=1e-9)
    assert mix.change.sum() == pytest.approx(0, abs=1e-9)
    assert np.abs(mix.change).sum() == pytest.approx(2)


def _values(cells: Floats) -> NDArray[np.intp]:
    """For each cell the row of `squares.VALUES` that its square has."""
    square = cells.reshape(4, -1).T
    rows = np.array([np.flatnonzero((v == squares.VALUES).all(1))[0] for v in square])
    return np.tile(rows, 4)


def test_in_step_a_mix_is_two_frames() -> None:
    mix = mix_pair(np.arange(-1.0, 4.0), 1.0, SlotLight((0, 1, 2, 3)))
    assert mix is not None
    assert mix.departure < EXACT
    assert list(mix.frames) == [1, 2]
    assert list(mix.change) == pytest.approx([1, -1])
    assert list(mix.total) == pytest.approx([1, 1])
    # light is on early in a pattern, what differs between levels later
    mean, data = pwm.light_centroids()
    assert mix.light == pytest.approx(mean + 0.5)
    assert mix.data == pytest.approx((data, 1 + data))


def test_half_a_pattern_late_only_neighbours_differ() -> None:
    mix = mix_pair(np.arange(-1.5, 4.0), 1.0, SlotLight((0, 1, 2, 3)))
    assert mix is not None
    assert mix.departure > EXACT
    # the frame within the pair is half lit whatever is sent: it serves the sum alone
    within = list(mix.frames).index(2)
    assert mix.change[within] == 0
    assert mix.total[within] == pytest.approx(2, rel=0.1)
    # half of the slope in step, as much light of the pairs before and after together
    assert mix.slots[1] @ squares.SLOPES == pytest.approx(0.5 * 0.5)
    assert mix.slots[0] == pytest.approx([-0.25, -0.25, 0, 0])
    assert mix.slots[2] == pytest.approx([-0.25, -0.25, 0, 0])


def test_a_pair_that_is_not_filmed_gives_no_mix() -> None:
    light = SlotLight((0, 1, 2, 3))
    assert mix_pair(np.array([]), 1.0, light) is None
    assert mix_pair(np.array([0.0]), 1.0, light) is None
    # twice the pattern, never the inverse
    assert mix_pair(np.array([0.0, 0.5]), 0.5, light) is None


def test_a_headers_sum_is_free_of_it() -> None:
    shown = np.array([0.4, -0.4, 0.7, 0.1])
    half = 0.5 * shown, np.array([0.5, 0.5, 0.6, 0.5])
    mix = mix_header(np.arange(4.0), 1.0, shown, half)
    assert mix is not None
    # cells of half the contrast; their light, where it is uneven, is seen with the weights of the frames
    assert mix.dimmed == pytest.approx((0.5, 0.1 * mix.change[2]))
    assert mix.total @ shown == pytest.approx(0)
    assert mix.total.sum() == pytest.approx(2)
    assert mix.change @ shown == pytest.approx(2)
    assert mix.change.sum() == pytest.approx(0)
    assert mix_header(np.arange(4.0), 1.0, np.array([0.0, 0.01, 0.0, 0.0]), half) is None
    assert mix_header(np.zeros(0), 1.0, np.zeros(0), (np.zeros(0), np.zeros(0))) is None


def test_moments_go_through_all_values_of_a_square() -> None:
    rng = np.random.default_rng(2)
    table, mean = squares.seen(np.array([0.1, 0.6, 0.3, 0.0])), rng.uniform(-0.9, 0.9, 4)
    values = np.array(list(itertools.product((1.0, -1.0), repeat=4)))
    rows = [int(np.flatnonzero((v == squares.VALUES).all(1))[0]) for v in values]
    chance = np.prod((1 + values * mean) / 2, 1)
    first, second = squares.moments(table, mean)
    assert first == pytest.approx(chance @ table[rows])
    assert second == pytest.approx(chance @ table[rows] ** 2 - first**2)


@pytest.mark.parametrize("known", [False, True])
def test_cells_of_a_square_tell_of_each_other_once_they_are_known(known: bool) -> None:
    rng = np.random.default_rng(3)
    table = squares.seen(np.array([0.1, 0.6, 0.3, 0.0]))
    seen, variance = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4)
    for i in range(4):
        mean = np.array([1.0, -1.0, -1.0, 1.0]) if known else np.zeros(4)
        mean[i] = 0.0
        chance = np.prod((1 + squares.VALUES * mean) / 2, 1)
        fit = (table - seen) ** 2 / variance / 2
        up = squares.VALUES[:, i] > 0
        own, joint = (
            np.log((chance * np.exp(-part))[up].sum() / (chance * np.exp(-part))[~up].sum())
            for part in (fit[:, i], fit.sum(1))
        )
        # what is not linear in the cell against what is
        bent = np.mean(table**2) / np.mean(table * squares.VALUES) ** 2 - 1
        assert 0.05 < bent < 0.5
        llr = joint if known else own + bent * (joint - own)
        assert squares.true_llrs(table, seen, variance, mean)[i] == pytest.approx(llr, abs=1e-6)


def test_what_was_known_of_a_cell_is_not_in_its_llr() -> None:
    rng = np.random.default_rng(4)
    table = squares.seen(np.array([0.1, 0.6, 0.3, 0.0]))
    seen, variance, mean = rng.normal(0, 1, 4), rng.uniform(0.1, 2, 4), rng.uniform(-0.9, 0.9, 4)
    for i in range(4):
        other = mean.copy()
        other[i] = -0.3
        llrs = [squares.true_llrs(table, seen, variance, m)[i] for m in (mean, other)]
        assert llrs[0] == pytest.approx(llrs[1])


def test_in_step_the_llr_is_that_of_a_bit_in_gaussian_noise() -> None:
    seen, variance = np.array([0.3, -1.2, 0.8, 0.1] * 4), np.linspace(0.2, 3, 16)
    llr = squares.true_llrs(squares.VALUES, seen, variance, np.zeros(16))
    assert llr == pytest.approx(2 * seen / variance)


def test_known_levels_are_seen_as_they_are() -> None:
    lit = np.zeros((SIDE, SIDE), bool)
    lit[:4, 4:] = True
    weights = np.array([0.2, 0.1, 0.0, 0.3])
    light = np.where(lit, weights.sum(), 0.0) - weights @ squares.MEAN_LIT
    assert squares.seen_of_levels(weights, lit) == pytest.approx(cells_seen(light))
