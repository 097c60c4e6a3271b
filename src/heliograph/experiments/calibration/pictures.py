"""Pictures of calibration: the reliability diagram, and the error of each distance."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.calibration.recorder import ReliabilityBin
from heliograph.experiments.calibration.verdicts import GOOD_M, TOLERANCE, judged


def reliability_diagram(bins: Mapping[str, Sequence[ReliabilityBin]]) -> Figure:
    """Observed over predicted error probability of the bins that are judged, with 95 % intervals."""
    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (name, part), colour in zip(bins.items(), (plots.BLUE, plots.ORANGE), strict=True):
        here = judged(part)
        if here:
            ratio, low, high = np.array([one.ratio() for one in here]).T
            x = [one.predicted for one in here]
            axes.errorbar(x, ratio, (ratio - low, high - ratio), color=colour, marker="o", ms=4, capsize=2, label=name)
    for line in (1 - TOLERANCE, 1 + TOLERANCE):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.set(xscale="log", yscale="log", xlabel="predicted error probability", ylabel="observed / predicted")
    axes.legend(frameon=False)
    return figure


def distance_errors(distances: Mapping[str, Floats]) -> Figure:
    """Error of each packet's distance."""
    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (case, rows), colour in zip(distances.items(), (plots.BLUE, plots.ORANGE, plots.GREEN), strict=False):
        for first, marker in ((True, "o"), (False, ".")):
            here = rows[(rows[:, 2] == 0) == first]
            if len(here):
                label = f"{case}, {'first packet' if first else 'later packets'}"
                fill: Literal["none", "full"] = "none" if first else "full"
                error = here[:, 1] - here[:, 0]
                axes.plot(here[:, 0], error, marker, color=colour, label=label, fillstyle=fill, ms=4, alpha=0.6)
    for line in (-GOOD_M, GOOD_M):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.set(xlabel="distance (m)", ylabel="error (m)")
    axes.legend(frameon=False)
    return figure
