"""The search of the light's clock: rates and phases that are tried, and the best of them refined."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
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

LONGEST_READOUT = 1.0
"""Longest readout of a frame in frame periods."""

MOST_PATTERNS_A_FRAME = 1.7
"""Least frames of a pattern: with fewer, no frame of some rows shows a pattern by itself."""


def searched(
    samples: Samples, periods: Iterable[float], frame_s: float, height: int, row_s: float | None
) -> list[tuple[float, Clock]]:
    """Find clocks that explain what is seen, the best first.

    Parameters
    ----------
    samples
        What is seen, the camera's gain taken out.
    periods
        Pattern periods in question in s.
    frame_s
        Frame period in s.
    height
        Rows of a frame.
    row_s
        Time from row to row where it is known; None to find it.

    Returns
    -------
    Some clocks with what they leave unexplained, refined; none where a film could show none of the periods.
    """
    bins, found, begun = Bins(samples), list[tuple[float, Clock]](), list[tuple[float, Clock]]()
    readouts = [r for r in READOUTS_S if r <= LONGEST_READOUT * frame_s * 1.01] or [0.0]
    rows = [r / height for r in readouts] if row_s is None else [row_s]
    for period in periods:
        if period < MOST_PATTERNS_A_FRAME * frame_s or samples.times_s[-1] - samples.times_s[0] < 4 * period:
            continue
        tried = [
            Clock(float(samples.times_s[0]) + 2 * period * k / PHASES, period, row, min(part * frame_s, period))
            for k in range(PHASES)
            for row in rows
            for part in TRIED_EXPOSURES
        ]
        ranked = sorted(((bins.unexplained(one), k) for k, one in enumerate(tried)))
        begun += [(left, tried[k]) for left, k in ranked[:BEST_CLOCKS]]
    begun.sort(key=lambda one: one[0])
    # a wrong rate leaves so much that it need not be refined
    for _, clock in begun[: 2 * BEST_CLOCKS]:
        found.append(refined(bins, clock, frame_s, height, row_s))
    return sorted(found, key=lambda one: one[0])


def refined(
    bins: Bins, clock: Clock, frame_s: float, height: int, row_s: float | None, steps: int = 120
) -> tuple[float, Clock]:
    """Improve a clock by what it leaves unexplained.

    Parameters
    ----------
    bins
        What is seen, by groups of rows.
    clock
        Clock to begin with.
    frame_s
        Frame period in s.
    height
        Rows of a frame.
    row_s
        Time from row to row where it is known; None to find it.
    steps
        Most evaluations of a clock.

    Returns
    -------
    What it leaves unexplained, and the clock.
    """
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
