"""Light clock estimation from cell luminance."""

import numpy as np
import pytest

from heliograph.base.arrays import Floats
from heliograph.receive.screen.cells import SearchBudget
from heliograph.receive.screen.clock import Clock, Samples
from heliograph.receive.screen.packets import solve_pairs

HEIGHT, FRAME_S, SIDE = 720, 1 / 30, 8
TRUE = Clock(start_s=0.037, period_s=0.1, row_s=2.5e-5, exposure_s=0.02, response_s=0.008)


def change(seed: int, pairs: int) -> Floats:
    """Return random differences between pattern and inverse."""
    return np.random.default_rng(seed).integers(-2, 3, (pairs, SIDE, SIDE)).astype(float)


def seen(clock: Clock, frames: int, row_s: float | None = None, noise: float = 0.02) -> Samples:
    """Integrate samples numerically for a clock."""
    data = change(1, 40)
    times = 0.5 + FRAME_S * np.arange(frames, dtype=float)
    rows = np.ones((frames, SIDE, SIDE)) * np.linspace(100, 600, SIDE)[None, :, None]
    fine = np.arange(0, times[-1] + 0.1, 5e-4)
    pair, half = np.divmod(fine - clock.start_s, 2 * clock.period_s)
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
    found = seen(TRUE, 48).search([0.1, 1 / 15, 0.2])
    left, clock = found[0]
    assert left < 0.02
    assert clock.period_s == pytest.approx(0.1, rel=3e-3)
    # wrong periods leave a large residual
    assert all(left > 0.3 for left, one in found if abs(one.period_s / 0.1 - 1) > 0.05)
    middle = clock.start_of(round(clock.pair_at(1.3))) + clock.row_s * 350
    true = TRUE.start_of(round(TRUE.pair_at(1.3))) + TRUE.row_s * 350
    assert middle == pytest.approx(true, abs=0.012)


def test_pairs_are_solved_with_a_known_clock() -> None:
    samples = seen(TRUE, 48)
    (pairs, solved, _, _), _ = solve_pairs(samples, TRUE, samples.light)
    data = change(1, 40)
    for k, pair in enumerate(pairs):
        if TRUE.start_of(pair) > 0.55 and TRUE.start_of(pair + 1) < 1.95:
            assert solved[k] == pytest.approx(data[pair], abs=0.15)


def test_known_row_time_is_kept() -> None:
    found = seen(TRUE, 48, TRUE.row_s).search([0.1])
    assert found[0][1].row_s == TRUE.row_s
    assert found[0][0] < 0.02


def test_too_few_frames_give_no_clock() -> None:
    assert seen(TRUE, 10).search([0.1]) == []
    assert seen(TRUE, 48).search([0.02]) == []
