"""Pictures of tracking: the array cut out without and with tracking, and the errors over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.tracking.runs import TrackingRun

COLOURS = (plots.GRAY, plots.BLUE, plots.GREEN, plots.ORANGE, plots.PINK, plots.PURPLE)
"""Colour of each tracker."""


def pictures(runs: Sequence[TrackingRun]) -> list[tuple[Figure, str]]:
    """The array cut out without and with tracking in the first film, and the errors in all; each with its caption."""
    shown = runs[0]
    names = [f"{time:.2f} s" for time, _ in shown.cuts]
    drawn = []
    for place, label in ((0, "Fig. 11: without tracking"), (1, "Fig. 12: with tracking by inverted signals")):
        images = [cuts[place] for _, cuts in shown.cuts]
        figure = plots.image_row(images, names, largest=max(float(image.max()) for image in images))
        caption = f"{label}: pattern plus inverse, cut out twice as wide as the array was found, {shown.name}."
        drawn.append((figure, caption))
    caption = "Error of the tracked centre over time; the dashed line is half of the array's side, where it is lost."
    return [*drawn, (_error_lines(runs), caption)]


def _error_lines(runs: Sequence[TrackingRun]) -> Figure:
    columns = min(len(runs), 4)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(12, 0.6 + 2.8 * rows))
    for k, one in enumerate(runs):
        axes = figure.add_subplot(rows, columns, k + 1)
        for (name, errors), colour in zip(one.errors.items(), COLOURS, strict=True):
            off = np.maximum(np.hypot(errors[:, 0], errors[:, 1]), 1e-4)
            axes.plot(one.times_s, off, color=colour, lw=0.8, label=name)
        axes.plot(one.times_s, one.side_px / 2, color=plots.BLACK, lw=0.8, ls="--")
        axes.set(yscale="log", ylim=(1e-4, 1e3), title=one.name, xlabel="time (s)")
        axes.set_ylabel("error (px)" if k % columns == 0 else "")
        plots.tidy(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.tight_layout(rect=(0, 0.3 / figure.get_figheight() * 1.2, 1, 1))
    figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure
