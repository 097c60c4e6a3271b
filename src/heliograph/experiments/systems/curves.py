"""The systems that are compared: how each sends and reads bits, and its range."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.experiments import plots
from heliograph.experiments.plots import LAYER_COLOURS
from heliograph.experiments.systems.schemes import SCHEMES, ReadMethod
from heliograph.measure.statistics import Count


@dataclass(frozen=True, slots=True)
class SystemCurve:
    """A system, and how its error rate is drawn."""

    # Its name in tables
    name: str
    # scheme, method, part: how bits are sent and read, and the part of the pattern that is counted
    scheme: str
    method: ReadMethod
    part: str
    # colour, dashes: style of its line
    colour: str
    dashes: str

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        part = SCHEMES[self.scheme].parts[self.part]
        return part.stop - part.start


CURVES = (
    SystemCurve("on-off keying", "ook", "plain", "all", plots.DARK_GRAY, "-"),
    SystemCurve("on-off keying, inverse", "ook", "inverse", "all", plots.DARK_GRAY, "--"),
    SystemCurve("on-off keying, inverse, pose known", "ook", "known", "all", plots.MIDDLE_GRAY, ":"),
    *(SystemCurve(f"hierarchical, {n}", "haar", "plain", n, LAYER_COLOURS[n], "-") for n in LAYER_COLOURS),
    *(SystemCurve(f"hierarchical, {n}, inverse", "haar", "inverse", n, LAYER_COLOURS[n], "--") for n in LAYER_COLOURS),
    SystemCurve("on-off keying, 2 x 2 LEDs a bit", "repeat2", "plain", "all", plots.VIOLET, "-"),
    SystemCurve("on-off keying, 4 x 4 LEDs a bit", "repeat4", "plain", "all", plots.RED, "-"),
)

Points = Sequence[tuple[float, Count]]
"""Bits and errors by distance in m, near first."""


def error_free_m(points: Points) -> tuple[float, Count] | None:
    """Largest distance in m with no error there and nearer, and the bits counted; None: not even the first."""
    total, last = Count(), None
    for z, count in points:
        if not count.trials or count.errors:
            break
        total.add(count.trials, 0)
        last = z
    return None if last is None else (last, total)


def range_m(points: Points, rate: float) -> float | None:
    """Distance in m at which the error rate passes a rate; None: it does not within the distances measured.

    The logarithm of the rate is taken as linear in distance between two points.
    """
    before: tuple[float, float] | None = None
    for z, count in points:
        if not count.trials:
            return None
        # no error met: half an error
        log = float(np.log10(max(count.errors, 0.5) / count.trials))
        if log > np.log10(rate):
            if before is None:
                return None
            fraction = (np.log10(rate) - before[1]) / (log - before[1])
            return float(before[0] + fraction * (z - before[0]))
        before = z, log
    return None
