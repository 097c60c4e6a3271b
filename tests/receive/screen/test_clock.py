"""Light clock estimation from cell luminance, and headers in solved pairs."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import ORIENTATIONS, Orientation
from heliograph.receive.screen.cells import SearchBudget
from heliograph.receive.screen.clock import Clock, Samples
from heliograph.receive.screen.packets import find_headers, read_format, solve_pairs
from heliograph.signal import haar
from heliograph.signal.header import header_levels, signalling_levels

HEIGHT, FRAME_S, SIDE = 720, 1 / 30, 8
TRUE = Clock(start_s=0.037, period_s=0.1, row_s=2.5e-5, exposure_s=0.02, response_s=0.008)


def change(seed: int, pairs: int) -> Floats:
    return np.random.default_rng(seed).integers(-2, 3, (pairs, SIDE, SIDE)).astype(float)


def seen(clock: Clock, frames: int, row_s: float | None = None, noise: float = 0.02) -> Samples:
    """Integrate samples numerically for a clock."""
    data = change(1, 40)
    times = 0.5 + FRAME_S * np.arange(frames, dtype=float)
    rows = np.ones((frames, SIDE, SIDE)) * np.linspace(100, 600, SIDE)[None, :, None]
    fine = np.arange(0, times[-1] + 0.1, 5e-4)
    pair, half = np.divmod(fine - clock.start_s, clock.step_s)
    sign = np.where(half < clock.period_s, 1, -1)
    shown = 2 + data[np.clip(pair.astype(int), 0, None)] * np.where(pair >= 0, sign, 0)[:, None, None]
    light = np.empty_like(shown)
    light[0] = shown[0]
    keep = np.exp(-5e-4 / clock.response_s)
    for k in range(1, len(fine)):
        light[k] = keep * light[k - 1] + (1 - keep) * shown[k]
    total = np.concatenate([np.zeros((1, SIDE, SIDE)), np.cumsum(light, axis=0)])
    out = np.empty((frames, SIDE, SIDE))
    for i, t in enumerate(times):
        for u in range(SIDE):
            a = round((t + clock.row_s * rows[i, u, 0]) / 5e-4)
            b = a + round(clock.exposure_s / 5e-4)
            out[i, u] = (total[b, u] - total[a, u]) / (b - a)
    out += noise * np.random.default_rng(2).standard_normal(out.shape)
    return Samples(times, rows, out, np.ones(frames), (FRAME_S, HEIGHT, row_s), SearchBudget())


def test_clock_is_found_among_periods() -> None:
    (left, clock), *others = seen(TRUE, 48).search([0.1, 1 / 15, 0.2])
    assert left < 0.02
    assert clock.period_s == pytest.approx(0.1, rel=3e-3)
    # wrong periods leave a large residual
    assert all(left > 0.3 for left, one in others if abs(one.period_s / 0.1 - 1) > 0.05)
    middle, true = (one.start_of(round(one.pair_at(1.3))) + one.row_s * 350 for one in (clock, TRUE))
    assert middle == pytest.approx(true, abs=0.012)


def test_pairs_are_solved_with_a_known_clock() -> None:
    samples, data = seen(TRUE, 48), change(1, 40)
    (pairs, solved, _, _), _ = solve_pairs(samples, TRUE, samples.light)
    for pair, found in zip(pairs, solved, strict=False):
        if TRUE.start_of(pair) > 0.55 and TRUE.start_of(pair + 1) < 1.95:
            assert found == pytest.approx(data[pair], abs=0.15)


def test_patterns_without_inverses_are_found_and_solved() -> None:
    true = replace(TRUE, paired=False)
    samples, data = seen(true, 48), change(1, 40)
    left, clock = samples.search([0.1], paired=False)[0]
    assert left < 0.02
    assert clock.period_s == pytest.approx(0.1, rel=3e-3)
    assert samples.repetition(clock) < 0.5
    assert samples.search([0.1])[0][0] > 0.3
    (patterns, solved, _, _), _ = solve_pairs(samples, true, samples.light)
    inner = [k for k, p in enumerate(patterns) if true.start_of(p) > 0.55 and true.start_of(p + 1) < 2.0]
    expected = data[np.array(patterns)[inner]]
    # each cell has an unknown constant light
    assert solved[inner] - solved[inner].mean(0) == pytest.approx(expected - expected.mean(0), abs=0.2)


@pytest.mark.parametrize("period_s", [0.1, 0.2, 0.3])
def test_pairs_of_slower_patterns_are_no_patterns_without_inverses(period_s: float) -> None:
    samples = seen(replace(TRUE, period_s=period_s), 60)
    left, clock = samples.search([0.1], paired=False)[0]
    assert left < 0.05
    assert samples.repetition(clock) > 0.9


def test_known_row_time_is_kept() -> None:
    left, clock = seen(TRUE, 48, TRUE.row_s).search([0.1])[0]
    assert clock.row_s == TRUE.row_s
    assert left < 0.02


def test_too_few_frames_give_no_clock() -> None:
    assert seen(TRUE, 10).search([0.1]) == []
    assert seen(TRUE, 48).search([0.02]) == []


@pytest.mark.parametrize("side", [8, 16])
@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
def test_headers_and_formats_are_found(side: int, orientation: Orientation) -> None:
    rng = np.random.default_rng(side)
    for identity, form in ((0, 0), (17, 0o2222), (29, 0o1765)):
        data = haar.encode(rng.choice([-1, 1], (7, side, side))).astype(float)
        data[3], data[4] = header_levels(identity, side), signalling_levels(identity, form, side)
        change = np.stack([orientation.turned(pair) for pair in data - 2]) + rng.normal(0, 0.3, data.shape)
        headers = find_headers(change, 2)
        found = [h for h in headers if (h.orientation, h.identity) == (orientation, identity)]
        assert found
        assert found[0].place == 3
        assert read_format(found[0], change, 2) == form


def test_data_are_not_taken_for_headers() -> None:
    data = haar.encode(np.random.default_rng(1).choice([-1, 1], (200, 8, 8))).astype(float) - 2
    assert find_headers(data, 2) == []
