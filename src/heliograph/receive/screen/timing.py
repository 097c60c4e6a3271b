"""The search of the light's clock: rates and phases that are tried, and the best of them refined."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.screen.budget import SearchBudget
from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.samples import Bins, Samples

PHASES = 16
"""Phases of a pair that are tried: an eighth of a pattern apart, which loses little of a match; they are refined."""

BEST_CLOCKS = 2
"""Clocks of a rate from which a search is refined. Chosen: phase and readout of one may lie on the wrong side."""

READOUTS_S = (0.0, 0.008, 0.016, 0.024)
"""Times for all rows of a frame that are tried: phones take 5 to 30 ms."""

TRIED_EXPOSURES = (0.3, 0.9)
"""Exposures that are tried, in frame periods."""

ROUGH_EXPOSURE, ROUGH_PHASES, BEST_RATES = 0.6, 8, 4
"""Exposure in frame periods and phases by which rates are compared at first, and how many of them are looked at
closely. Chosen: a wrong readout or exposure leaves a right rate ahead of others."""

UNFOLLOWED = 0.85
"""Part of what changes from which a clock that a search begins with is not followed up: of what is no light at all it
is 0.9 to 1.1."""

NEARBY, NEARER_STEPS = (0.985, 0.995, 1.005, 1.015), 3
"""Pattern periods about the best one that are tried, by it, and how often. Chosen: rates that are tried are 3 %
apart."""

MUCH_BETTER = 0.7
"""Part of what is unexplained that a rate nearby must leave at most. Chosen: patterns of a display that skips refreshes
come early and late, which other rates explain by a fifth better."""

LONGEST_READOUT = 1.0
"""Longest readout of a frame in frame periods."""

MOST_PATTERNS_A_FRAME = 1.7
"""Least frames of a pattern: with fewer, no frame of some rows shows a pattern by itself."""


def searched(
    samples: Samples,
    periods: Iterable[float],
    frame_s: float,
    height: int,
    row_s: float | None,
    budget: SearchBudget | None = None,
) -> list[tuple[float, Clock]]:
    """Find clocks that explain what is seen, the best first."""
    bins = Bins(samples, budget)
    readouts = [r for r in READOUTS_S if r <= LONGEST_READOUT * frame_s * 1.01] or [0.0]
    rows = [r / height for r in readouts] if row_s is None else [row_s]
    length = float(samples.times_s[-1] - samples.times_s[0])
    shown = [one for one in periods if one >= MOST_PATTERNS_A_FRAME * frame_s and length >= 4 * one]
    if len(shown) > BEST_RATES:
        rough = [rows[len(rows) // 2]], [ROUGH_EXPOSURE * frame_s]
        first = {one: _begun(bins, one, *rough, ROUGH_PHASES)[0][0] for one in shown}
        shown = sorted((one for one in shown if first[one] < UNFOLLOWED), key=lambda one: first[one])[:BEST_RATES]
    exposures = [part * frame_s for part in TRIED_EXPOSURES]
    begun = [one for period in shown for one in _begun(bins, period, rows, exposures)[:BEST_CLOCKS]]
    # a wrong rate leaves so much that it need not be refined
    begun = sorted((one for one in begun if one[0] < UNFOLLOWED), key=lambda one: one[0])
    found = [refined(bins, clock, frame_s, height, row_s) for _, clock in begun[: 2 * BEST_CLOCKS]]
    found.sort(key=lambda one: one[0])
    if found:
        found[0] = _nearer(bins, *found[0], frame_s, height, row_s)
    return found


def _nearer(
    bins: Bins, left: float, clock: Clock, frame_s: float, height: int, row_s: float | None
) -> tuple[float, Clock]:
    """A better clock of a rate nearby, and what it leaves unexplained: a refined one hardly leaves the rate tried."""
    middle, first = clock.begins(round(clock.pair_at(float(bins.times_s.mean())))), (left, clock)
    for _ in range(NEARER_STEPS):
        tried = [replace(clock, start_s=middle, period_s=clock.period_s * by) for by in NEARBY]
        less, best = min(((bins.unexplained(one), one) for one in tried), key=lambda one: one[0])
        if less >= left:
            break
        left, clock = refined(bins, best, frame_s, height, row_s)
    return (left, clock) if left < MUCH_BETTER * first[0] else first


def _begun(
    bins: Bins, period_s: float, rows_s: list[float], exposures_s: list[float], phases: int = PHASES
) -> list[tuple[float, Clock]]:
    """Clocks of a rate with what they leave unexplained, the best first."""
    tried = [
        Clock(float(bins.times_s[0]) + 2 * period_s * k / phases, period_s, row, min(exposure, period_s))
        for k in range(phases)
        for row in rows_s
        for exposure in exposures_s
    ]
    return sorted(((bins.unexplained(one), one) for one in tried), key=lambda one: one[0])


def refined(
    bins: Bins, clock: Clock, frame_s: float, height: int, row_s: float | None, steps: int = 120
) -> tuple[float, Clock]:
    """Improve a clock by what it leaves unexplained."""
    from scipy.optimize import minimize

    middle = float(bins.times_s.mean())
    anchor = clock.begins(round(clock.pair_at(middle)))
    scale = np.array([0.1 * clock.period_s, 3e-3 / height, 0.25 * frame_s, 3e-3, 1e-3 * clock.period_s])

    def made(v: Floats) -> Clock:
        start, row, exposure, response, period = v * scale
        return Clock(
            anchor + start,
            clock.period_s + period,
            clock.row_s + (row if row_s is None else 0.0),
            clock.exposure_s + exposure,
            clock.response_s + response,
        )

    def cost(v: Floats) -> float:
        one = made(v)
        # what no device does costs as much as it is off
        off = max(0.0, -one.row_s * height) + max(0.0, one.row_s * height - LONGEST_READOUT * frame_s)
        off += max(0.0, 0.03 * frame_s - one.exposure_s) + max(0.0, one.exposure_s - frame_s)
        off += max(0.0, -one.response_s) + max(0.0, one.response_s - 0.03)
        bounded = replace(
            one,
            row_s=float(np.clip(one.row_s, 0, LONGEST_READOUT * frame_s / height)),
            exposure_s=float(np.clip(one.exposure_s, 0.03 * frame_s, frame_s)),
            response_s=float(np.clip(one.response_s, 0, 0.03)),
        )
        drift = (one.period_s / clock.period_s - 1) / 2e-3
        return bins.unexplained(bounded) + off / frame_s + 1e-3 * drift**2

    found = minimize(
        cost,
        np.zeros(5),
        method="Nelder-Mead",
        options={"maxfev": steps, "xatol": 1e-2, "fatol": 1e-5, "initial_simplex": np.vstack([np.zeros(5), np.eye(5)])},
    )
    one = made(found.x)
    one = replace(
        one,
        row_s=float(np.clip(one.row_s, 0, LONGEST_READOUT * frame_s / height)),
        exposure_s=float(np.clip(one.exposure_s, 0.03 * frame_s, frame_s)),
        response_s=float(np.clip(one.response_s, 0, 0.03)),
    )
    return bins.unexplained(one), one
