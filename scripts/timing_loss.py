#!/usr/bin/env python3
"""What a camera out of step sees of a pair of patterns, by computation: the tables of docs/receiver.md.

    python scripts/timing_loss.py

For each rate, exposure (in T_b) and phase (start of the first exposure after that of a pattern, in T_b), of the best
combination of frames for a pair, means over a row of pairs:

slope   how strongly it follows the levels, against a camera in step
noise   its standard deviation against that of the difference of two frames
loss    noise over slope in dB, of the worst pair
around  standard deviation of what it holds of the pairs before and after, against that of the levels
rest    the same of what in it is not linear in the levels
bits    what is left of a bit per cell without noise, the pairs around known
header  largest share of the header less its inverse in any frame wholly within the header
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.soft import squares
from heliograph.receive.soft.mix import Mix, SlotLight, mix_pair

Floats = NDArray[np.float64]
LIGHT = SlotLight((0, 1, 2, 3))
PAIRS = 20
"""Pairs in a row that a camera is followed through."""


def mixes(rate: float, exposure: float, phase: float) -> list[Mix | None]:
    """Best combinations for some pairs in a row; frame 0 begins `phase` after a pair."""
    starts = phase + np.arange(-2 * rate, (2 * PAIRS + 2) * rate) / rate
    near = [starts[(starts >= 2 * k - 1) & (starts <= 2 * k + 3)] - 2 * k for k in range(PAIRS)]
    return [mix_pair(part, exposure, LIGHT) for part in near]


def row(mix: Mix | None) -> Floats:
    """Slope, noise, neighbours, rest and bits."""
    if mix is None:
        return np.array([0.0, np.inf, np.nan, np.nan, 0.0])
    slope = float(mix.slots[1] @ squares.SLOPES)
    around = sum(float(mix.slots[q] @ squares.COVARIANCE @ mix.slots[q]) for q in (0, 2))
    rest = float(mix.slots[1] @ squares.COVARIANCE @ mix.slots[1]) - slope**2
    _, counts = np.unique(np.round(mix.table, 6), axis=0, return_counts=True)
    bits = -float((counts / 16) @ np.log2(counts / 16)) / 4
    return np.array([2 * slope, np.sqrt(mix.noise), np.sqrt(around) / slope, np.sqrt(max(rest, 0)) / slope, bits])


def header(rate: float, exposure: float, phase: float) -> float:
    """Largest magnitude of the header in a frame within a header of four patterns."""
    starts = phase + np.arange(-2 * rate, 6 * rate) / rate
    starts = starts[(starts > -1e-9) & (starts + exposure < 4 + 1e-9)]
    integral = np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    seen = [np.interp(t, range(5), integral) for t in (starts + exposure, starts)]
    return float(np.abs(seen[0] - seen[1]).max() / exposure)


def main() -> None:
    print("rate  exposure  phase  slope  noise  loss (dB)  around  rest  bits  header")
    cases = [(1.0, 1.0), (1.0, 0.75), (1.0, 0.5), (1.0, 0.25), (1.5, 2 / 3), (2.0, 0.5), (2.7, 0.37), (4.0, 0.25)]
    for rate, exposure in cases:
        for phase in np.arange(0, 1 / rate - 1e-9, 0.1 if rate == 1 else 0.25 / rate):
            rows = np.array([row(mix) for mix in mixes(rate, exposure, float(phase))])
            with np.errstate(divide="ignore"):
                loss = 20 * np.log10(rows[:, 1] / rows[:, 0]).max()
            slope, noise, around, rest, bits = rows.mean(0)
            head = header(rate, exposure, float(phase))
            print(
                f"{rate:4g}  {exposure:8.2f}  {phase:5.2f}  {slope:5.2f}  {noise:5.2f}  {loss:9.1f}"
                f"  {around:6.2f}  {rest:4.2f}  {bits:4.2f}  {head:6.2f}"
            )


if __name__ == "__main__":
    main()
