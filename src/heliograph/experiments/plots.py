"""Colours and pictures that several experiments share."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.measure.counts import LayerCounts
from heliograph.measure.errors import BIN_M
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import ARROW, BOUND, legend_entries

BLUE, ORANGE, GREEN, PINK, PURPLE = "#1b6ca8", "#d1741f", "#5b8c3a", "#b5446e", "#6b4fa0"
VIOLET, RED = "#8e44ad", "#c0392b"
BLACK, DARK_GRAY, GRAY, MIDDLE_GRAY = "#1d2126", "#4a5056", "#8a929b", "#9aa1a8"
LIGHT_GRAY, PALE_GRAY = "#c9ced6", "#eef0f2"
ASIDE_M = 0.7
"""Distance in m by which layers are drawn beside each other."""

MARK = "#ff6b35"
"""Colour that marks a place in an image."""

LAYER_COLOURS = {"high": BLUE, "middle": ORANGE, "low": GREEN}
"""Colour of each layer."""


def tidy(axes: Axes) -> None:
    """Take the upper and the right line of the frame off, and draw a pale grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)


def image_row(images: Sequence[NDArray[Any]], titles: Sequence[str], rows: int = 1, largest: float = 255) -> Figure:
    """Gray images side by side, each with a title."""
    columns = -(-len(images) // rows)
    figure = Figure(figsize=(min(2.0 * columns, 12), 2.3 * rows))
    for k, (image, title) in enumerate(zip(images, titles, strict=True)):
        axes = figure.add_subplot(rows, columns, k + 1)
        axes.imshow(image, cmap="gray", vmin=0, vmax=largest, interpolation="nearest")
        axes.set_title(title, fontsize=9)
        axes.set_axis_off()
    figure.tight_layout(pad=0.4)
    return figure


def frame_with_array(pixels: NDArray[Any], x: float, y: float, half: float, title: str, largest: float = 255) -> Figure:
    """A whole frame, the array marked, and the array enlarged beside it."""
    figure = Figure(figsize=(12, 3.6))
    whole, near = figure.subplots(1, 2, width_ratios=(2.2, 1))
    whole.imshow(pixels, cmap="gray", vmin=0, vmax=largest)
    for axes in (whole, near):
        axes.set_xticks([])
        axes.set_yticks([])
    box_x = [x - half, x + half, x + half, x - half, x - half]
    whole.plot(box_x, [y - half, y - half, y + half, y + half, y - half], color=MARK, lw=1)
    near.imshow(pixels, cmap="gray", vmin=0, vmax=largest, interpolation="nearest")
    near.set_xlim(x - half, x + half)
    near.set_ylim(y + half, y - half)
    whole.set_title(title, fontsize=10)
    near.set_title("the array", fontsize=10)
    figure.tight_layout()
    return figure


def track(times: NDArray[Any], found: Mapping[str, NDArray[Any]], truth: Mapping[str, NDArray[Any]]) -> Figure:
    """Position and distance over time, found and true, and the errors of position."""
    figure = Figure(figsize=(12, 6))
    axes = figure.subplots(2, 2, sharex=True)
    panels = (("x", "x (px)"), ("y", "y (px)"), ("distance_m", "distance (m)"))
    for (name, label), place in zip(panels, axes.flat, strict=False):
        place.plot(times, truth[name], color="#cdd3da", lw=5, label="true")
        place.plot(times, found[name], color=BLUE, lw=1, label="found")
        place.set_ylabel(label)
    axes[0, 0].legend(frameon=False)
    for name, colour in (("x", BLUE), ("y", ORANGE)):
        axes[1, 1].plot(times, found[name] - truth[name], color=colour, lw=0.6, label=f"error of {name}")
    axes[1, 1].set_ylabel("error (px)")
    axes[1, 1].set_ylim(-0.3, 0.3)
    axes[1, 1].legend(frameon=False, ncols=2)
    for place in axes[1]:
        place.set_xlabel("time (s)")
    _tidy_all(figure)
    return figure


def errors_by_distance(bins: Mapping[float, Mapping[str, LayerCounts]]) -> Figure:
    """Bit error rate before and after the turbo code, by layer; no error counted is an arrow at its upper bound."""
    figure = Figure(figsize=(12, 4.2))
    for axes, kind, title in zip(figure.subplots(1, 2), ("raw", "decoded_bits"), ("before", "after"), strict=True):
        for k, name in enumerate(LAYERS):
            # a little aside, so that no bar hides another
            counts = [
                (start + BIN_M / 2 + ASIDE_M * (k - 1), getattr(layers[name], kind)) for start, layers in bins.items()
            ]
            style = {"color": LAYER_COLOURS[name], "ms": 5, "lw": 1.8, "elinewidth": 1.2, "capsize": 3}
            draw_rates(axes, counts, name, **style)
        axes.set_yscale("log")
        axes.set_ylim(1e-5, 1)
        axes.set_xlabel("distance (m)")
        axes.set_ylabel("bit error rate")
        axes.set_title(f"{title} the turbo code", fontsize=10)
        if axes.get_legend_handles_labels()[0]:  # nothing received: no bit counted
            axes.legend(*legend_entries(axes), frameon=False)
    _tidy_all(figure)
    return figure


def draw_rates(axes: Axes, counts: Sequence[tuple[float, Count]], label: str, **style: Any) -> None:
    """Draw error rates: those measured with 95 % intervals and a line, bounds as arrows that no line joins."""
    counts = [(z, count) for z, count in counts if count.trials]
    if not counts:
        return
    style = {"marker": "o", "label": label} | style
    met = [(z, c.rate, *c.interval()) for z, c in counts if c.errors]
    z, rate, low, high = np.array(met).reshape(-1, 4).T
    axes.errorbar(z, rate, (rate - low, high - rate), **style)
    if free := [(z, c.bound) for z, c in counts if not c.errors]:
        z, bound = np.array(free).T
        axes.plot(z, bound, color=style["color"], marker=ARROW, ms=8, ls="none", alpha=0.7, gid=BOUND)


def _tidy_all(figure: Figure) -> None:
    for axes in figure.axes:
        tidy(axes)
    figure.tight_layout()
