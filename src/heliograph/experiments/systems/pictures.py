"""Error rates of all systems by distance, as a picture."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.systems.curves import CURVES, Points
from heliograph.experiments.systems.verdicts import KASASHIMA_M
from heliograph.sweeps.plot import legend_entries

CAPTION = (
    "Bit error rate before any code; 95 % intervals; an arrow is a bound (3/n), no error met. Upright lines: 40 m and "
    "60 m, to which Kasashima et al. found no error without and with the inverse."
)


def error_rates(points: Mapping[str, Points]) -> Figure:
    """On-off keying and repetition left, the hierarchical code right."""
    figure = Figure(figsize=(12, 5))
    left, right = figure.subplots(1, 2, sharey=True)
    for curve in CURVES:
        for axes, shown in (
            (left, curve.scheme != "haar"),
            (right, curve.scheme == "haar" or curve.name == CURVES[0].name),
        ):
            if shown:
                style = {"color": curve.colour, "ls": curve.dashes, "ms": 3, "lw": 1.2}
                plots.draw_rates(axes, points[curve.name], curve.name, **style)
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("distance (m)")
        plots.tidy(axes)
        axes.legend(*legend_entries(axes), frameon=False, fontsize=8, loc="lower right")
    for z in KASASHIMA_M.values():
        left.axvline(z, color=plots.LIGHT_GRAY, lw=1, zorder=0)
    left.set_yscale("log")
    left.set_ylim(1e-6, 1)
    left.set_ylabel("bit error rate")
    figure.tight_layout()
    return figure
