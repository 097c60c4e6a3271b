"""Loss of an unsynchronised camera, by computation.

A case has a frame rate (frames per pattern), an exposure (in T_b) and a phase: the start of the first exposure after a
pattern, in T_b. The receiver combines the frames of a pair; all values except the loss are means over a row of pairs.

Slope: over the levels, relative to a synchronised camera. Noise: standard deviation relative to the difference of two
frames. Loss: noise over slope in dB, for the worst pair. Around: standard deviation due to the previous and next pair,
relative to that of the levels. Rest: the same for the part nonlinear in the levels. Bits: noise-free information on
each symbol if the adjacent pairs are known. Header: largest contrast of the header in any frame within the header.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.report import Table
from heliograph.receive.sync import combine as partial_exposure
from heliograph.receive.sync.combine import Combination, combine_pair

CASES = ((1.0, 1.0), (1.0, 0.75), (1.0, 0.5), (1.0, 0.25), (1.5, 2 / 3), (2.0, 0.5), (2.7, 0.37), (4.0, 0.25))
"""Frames per pattern, and exposure in T_b."""


HEAD = ("rate", "exposure", "phase", "slope", "noise", "loss (dB)", "around", "rest", "bits", "header")

TimingLoss = Mapping[str, float]  # loss of a case: the values by the names in `HEAD`; the module docstring defines them


def measure() -> list[TimingLoss]:
    """All cases, at phases over a frame period."""
    out = []
    for rate, exposure in CASES:
        step = 0.1 if rate == 1 else 0.25 / rate
        out += [timing_loss(rate, exposure, float(phase)) for phase in np.arange(0, 1 / rate - 1e-9, step)]
    return out


def timing_loss(rate: float, exposure: float, phase: float) -> TimingLoss:
    """Loss over a row of 20 pairs; frame 0 begins `phase` after a pair."""
    pairs = 20
    starts = phase + np.arange(-2 * rate, (2 * pairs + 2) * rate) / rate
    near = [starts[(starts >= 2 * k - 1) & (starts <= 2 * k + 3)] - 2 * k for k in range(pairs)]
    rows = np.array([_row(combine_pair(part, exposure, (0, 1, 2, 3))) for part in near])
    with np.errstate(divide="ignore"):
        loss = float(20 * np.log10(rows[:, 1] / rows[:, 0]).max())
    slope, noise, around, rest, bits = map(float, rows.mean(0))
    values = (rate, exposure, phase, slope, noise, loss, around, rest, bits, _header(rate, exposure, phase))
    return dict(zip(HEAD, values, strict=True))


def _row(combination: Combination | None) -> Floats:
    """Slope, noise, around, rest and bits of a pair."""
    if combination is None:
        return np.array([0.0, np.inf, np.nan, np.nan, 0.0])
    slots = combination.slots
    slope = float(slots[1] @ partial_exposure.SLOPES)
    before, own, after = (float(slots[q] @ partial_exposure.COVARIANCE @ slots[q]) for q in range(3))
    _, counts = np.unique(np.round(combination.response, 6), axis=0, return_counts=True)
    bits = -float((counts / 16) @ np.log2(counts / 16)) / 4
    around, rest = np.sqrt([before + after, max(own - slope**2, 0)]) / slope
    return np.array([2 * slope, np.sqrt(combination.noise), around, rest, bits])


def _header(rate: float, exposure: float, phase: float) -> float:
    """Largest contrast in a frame within a header of four patterns."""
    starts = phase + np.arange(-2 * rate, 6 * rate) / rate
    starts = starts[(starts > -1e-9) & (starts + exposure < 4 + 1e-9)]
    integral = np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    ends, begins = (np.interp(t, range(5), integral) for t in (starts + exposure, starts))
    return float(np.abs(ends - begins).max() / exposure)


def table(losses: Iterable[TimingLoss]) -> Table:
    """Table with a row per case and phase."""
    forms = {"rate": "g", "loss (dB)": ".1f"}
    rows = [[format(value, forms.get(name, ".2f")) for name, value in loss.items()] for loss in losses]
    return Table("The best combination for a pair", HEAD, rows)
