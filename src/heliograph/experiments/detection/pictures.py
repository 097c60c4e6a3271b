"""Pictures of detection: a false alarm, arrays found against false alarms, and identities shown and found."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from heliograph.experiments import plots
from heliograph.experiments.detection import ablation
from heliograph.experiments.detection.ablation import VARIANTS
from heliograph.experiments.detection.clutter import ClutterFilm
from heliograph.experiments.detection.identities import Confusion
from heliograph.experiments.detection.trials import DISTANCES, DetectionTrials
from heliograph.receive import Pose

COLOURS = (plots.PINK, plots.ORANGE, plots.GREEN, plots.BLUE)
"""Colour of each variant."""

WIDTHS = (8.0, 5.5, 3.2, 1.4)
"""Width of each variant's line, so that each shows where the next lies over it."""


def pictures(
    measured: DetectionTrials, alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> list[tuple[Figure, str]]:
    """All pictures, each with its caption."""
    shown = [
        (_roc(measured), "Arrays found against false alarms as the threshold falls, all scenes together; left: none."),
        (_matrices(alone), "Identity shown (down) and found (across; last column: missed), one array in view."),
        (_matrices(beside), "The same, two arrays of different identities in one view, both counted."),
    ]
    if measured.example:
        caption = "Fig. 6: a false detection of the all-on detector; frame, and difference of two frames."
        shown.insert(0, (_example(*measured.example), caption))
    return shown


def _example(score: float, film: ClutterFilm, pose: Pose) -> Figure:
    half = 8 * pose.pitch
    first, second = (film.frames[film.first + k].pixels.astype(float) for k in (0, 1))
    figure = Figure(figsize=(12, 3.4))
    shown = ((first, 0, 255, "frame"), (first - second, -80, 80, f"difference; score of the candidate {score:.2f}"))
    for axes, (image, low, high, title) in zip(figure.subplots(1, 2), shown, strict=True):
        axes.imshow(image, cmap="gray", vmin=low, vmax=high)
        corners_x, corners_y = (
            pose.x + half * np.array([-1, 1, 1, -1, -1]),
            pose.y + half * np.array([-1, -1, 1, 1, -1]),
        )
        axes.plot(corners_x, corners_y, color=plots.MARK, lw=1.2)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=10)
    figure.tight_layout()
    return figure


def _roc(measured: DetectionTrials) -> Figure:
    figure = Figure(figsize=(12, 5))
    for axes, distance in zip(figure.subplots(1, 3, sharey=True), DISTANCES, strict=True):
        for variant, colour, width in zip(VARIANTS, COLOURS, WIDTHS, strict=True):
            scores = measured.scores[variant.name]
            alarms, found = ablation.curve(scores.all_false(), scores.all_true(distance))
            least = 0.5 / scores.all_false().size
            axes.step(
                1000 * np.maximum(alarms, least),
                found,
                where="post",
                color=colour,
                lw=width,
                label=variant.name,
            )
        count, false = measured.set_found(distance), max(measured.set_false().rate, least)
        axes.plot(
            1000 * false, count.rate, "*", color=plots.BLACK, ms=15, label="receiver as set", clip_on=False, zorder=5
        )
        axes.set(
            xscale="log",
            xlim=(700 * least, 1000),
            ylim=(-0.03, 1.03),
            xlabel="false alarms in 1000 frames",
            title=f"{distance:g} m",
        )
        axes.xaxis.set_minor_formatter(NullFormatter())
        plots.tidy(axes)
    figure.axes[0].set_ylabel("fraction of arrays found")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure


def _matrices(confusions: Mapping[float, Confusion]) -> Figure:
    figure = Figure(figsize=(12, 3.4))
    for axes, (distance, one) in zip(figure.subplots(1, len(confusions)), confusions.items(), strict=True):
        rate = one.counts / np.maximum(one.counts.sum(1, keepdims=True), 1)
        axes.imshow(rate, cmap="Blues", vmin=0, vmax=1, interpolation="nearest")
        axes.axvline(29.5, color=plots.GRAY, lw=0.8)
        axes.set_title(f"{distance:g} m: {one.right.errors} of {one.right.trials} right", fontsize=9)
        axes.set(xlabel="found", xticks=[0, 10, 20, 30], yticks=[0, 10, 20])
        axes.set_xticklabels(["0", "10", "20", "none"])
    figure.axes[0].set_ylabel("shown")
    figure.tight_layout()
    return figure
