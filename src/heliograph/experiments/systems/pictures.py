"""Error rates of all systems by distance, as a picture."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.systems.curves import CURVES, Points, SystemCurve
from heliograph.experiments.systems.verdicts import KASASHIMA_M

CAPTION = (
    "Bit error rate before any code; 95 % intervals; an arrow is a bound (3/n), no error met. Upright lines: 40 m and "
    "60 m, to which Kasashima et al. found no error without and with the inverse."
)


def error_rates(points: Mapping[str, Points]) -> Figure:
    """On-off keying and repetition left, the hierarchical code right.

    Parameters
    ----------
    points
        Bits and errors by distance, by name of the system, for each of `CURVES`.
    """
    figure = Figure(figsize=(12, 5))
    left, right = figure.subplots(1, 2, sharey=True)
    for curve in CURVES:
        for axes, shown in (
            (left, curve.scheme != "haar"),
            (right, curve.scheme == "haar" or curve.name == CURVES[0].name),
        ):
            if shown:
                _draw(axes, curve, points[curve.name])
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("distance (m)")
        plots.tidy(axes)
        axes.legend(frameon=False, fontsize=8, loc="lower right")
    for z in KASASHIMA_M.values():
        left.axvline(z, color=plots.LIGHT_GRAY, lw=1, zorder=0)
    left.set_yscale("log")
    left.set_ylim(1e-6, 1)
    left.set_ylabel("bit error rate")
    figure.tight_layout()
    return figure


def _draw(axes: Axes, curve: SystemCurve, points: Points) -> None:
    met = [(z, c.rate, *c.interval()) for z, c in points if c.errors]
    if met:
        z, rate, low, high = np.array(met).T
        bars = (rate - low, high - rate)
        axes.errorbar(z, rate, bars, color=curve.colour, ls=curve.dashes, marker="o", ms=3, lw=1.2, label=curve.name)
    free = [(z, c.bound) for z, c in points if c.trials and not c.errors]
    if free:
        z, bound = np.array(free).T
        label = None if met else curve.name
        axes.plot(z, bound, color=curve.colour, marker=r"$\downarrow$", ms=7, ls="none", alpha=0.7, label=label)
