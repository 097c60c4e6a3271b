"""Style, colours and plots that several experiments share."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from heliograph.measure.counts import LayerCounts
from heliograph.measure.errors import BIN_M
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import ARROW, BOUND, LAYER_COLOURS, legend_entries

BLUE, ORANGE, GREEN = LAYER_COLOURS.values()
RED, DARK_GRAY, GRAY = "#c0392b", "#4a5056", "#8a929b"

# the ink of the style, and black, become light on dark pages
_DARK_STYLE = """<style>@media (prefers-color-scheme: dark) {
[style*="stroke: #333333"], [style*="stroke: #000000"] { stroke: #d5dae0 !important }
[style*="fill: #333333"], [style*="fill: #000000"] { fill: #d5dae0 !important }
}</style>"""

styled = mpl.rc_context(fname=Path(__file__).with_name("plots.mplstyle"))
"""Decorator of functions that draw or save a figure in the common style."""


@styled
def figure_svg(figure: Figure) -> bytes:
    """SVG file of a figure for light and dark pages, with long lines as images."""
    for line in figure.findobj(lambda artist: isinstance(artist, Line2D) and np.size(artist.get_xdata()) > 1000):
        line.set_rasterized(True)
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue().replace("<defs>", f"{_DARK_STYLE}<defs>", 1).encode()


def legend_below(figure: Figure, columns: int = 6) -> None:
    """Draw a common legend below all axes of a figure."""
    handles = {label: handle for axes in figure.axes for handle, label in zip(*legend_entries(axes), strict=True)}
    rows = -(-len(handles) // columns)
    figure.set_layout_engine("tight", rect=(0, (0.15 + 0.22 * rows) / figure.get_figheight(), 1, 1))
    if handles:
        figure.legend(list(handles.values()), list(handles), ncols=min(columns, len(handles)), loc="lower center")


@styled
def image_row(images: Sequence[NDArray[Any]], titles: Sequence[str], rows: int = 1, largest: float = 255) -> Figure:
    """Gray images side by side, each with a title."""
    columns = -(-len(images) // rows)
    figure = Figure(figsize=(min(2.0 * columns, 10), 2.3 * rows))
    for k, (image, title) in enumerate(zip(images, titles, strict=True), 1):
        axes = figure.add_subplot(rows, columns, k, title=title)
        axes.imshow(image, vmin=0, vmax=largest)
        axes.set_axis_off()
    return figure


def frame_with_array(pixels: NDArray[Any], x: float, y: float, half: float, title: str, largest: float = 255) -> Figure:
    """Frame with the array marked, and an enlarged view of the array."""
    figure = Figure(figsize=(10, 3.6))
    frame, detail = figure.subplots(1, 2, width_ratios=(2.2, 1))
    for axes in (frame, detail):
        axes.imshow(pixels, vmin=0, vmax=largest)
        axes.set_axis_off()
    mark_square(frame, x, y, half)
    frame.set_title(title)
    detail.set(xlim=(x - half, x + half), ylim=(y + half, y - half), title="the array")
    return figure


def mark_square(axes: Axes, x: float, y: float, half: float) -> None:
    """Outline a square of an image."""
    corners = half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
    axes.plot(x + corners[0], y + corners[1], color="#ff6b35", lw=1)


def track(times: NDArray[Any], found: Mapping[str, NDArray[Any]], truth: Mapping[str, NDArray[Any]]) -> Figure:
    """Estimated and true position and distance over time, and position errors."""
    figure = Figure(figsize=(10, 6))
    axes = figure.subplots(2, 2, sharex=True)
    panels = (("x", "x (px)"), ("y", "y (px)"), ("distance_m", "distance (m)"))
    for (name, label), panel in zip(panels, axes.flat, strict=False):
        panel.plot(times, truth[name], color="lightgray", lw=5, label="true")
        panel.plot(times, found[name], color=BLUE, lw=1, label="found")
        panel.set_ylabel(label)
    for name in ("x", "y"):
        axes[1, 1].plot(times, found[name] - truth[name], lw=0.6, label=f"error of {name}")
    axes[1, 1].set(ylabel="error (px)")
    for panel in (axes[0, 0], axes[1, 1]):
        panel.legend(ncols=2)
    for panel in axes[1]:
        panel.set_xlabel("time (s)")
    return figure


def errors_by_distance(bins: Mapping[float, Mapping[str, LayerCounts]], offset_m: float = 0.7) -> Figure:
    """Bit error rates before and after the turbo code, with the layers `offset_m` apart in distance."""
    figure = Figure(figsize=(10, 4.2))
    for axes, kind, title in zip(figure.subplots(1, 2), ("raw", "decoded_bits"), ("before", "after"), strict=True):
        for k, name in enumerate(LAYERS):
            counts = [
                (start + BIN_M / 2 + offset_m * (k - 1), getattr(layers[name], kind)) for start, layers in bins.items()
            ]
            draw_rates(axes, counts, name, color=LAYER_COLOURS[name], ms=5, lw=1.8, elinewidth=1.2, capsize=3)
        axes.set(yscale="log", ylim=(1e-5, 1), xlabel="distance (m)", ylabel="bit error rate")
        axes.set_title(f"{title} the turbo code")
    legend_below(figure)
    return figure


def draw_rates(axes: Axes, counts: Sequence[tuple[float, Count]], label: str, **style: Any) -> None:
    """Draw measured error rates with 95 % intervals, joined by a line, and upper bounds as arrows."""
    counts = [(z, count) for z, count in counts if count.trials]
    if not counts:
        return
    style = {"marker": "o", "label": label} | style
    measured = [(z, c.rate, *c.interval()) for z, c in counts if c.errors]
    z, rate, low, high = np.array(measured).reshape(-1, 4).T
    _, caps, bars = axes.errorbar(z, rate, (rate - low, high - rate), **style)
    for part in (*caps, *bars):
        part.set_alpha(0.4)
    # a bound near 1 is no measurement
    if bounds := [(z, c.bound) for z, c in counts if not c.errors and c.bound < 0.3]:
        z, bound = np.array(bounds).T
        axes.plot(z, bound, color=style["color"], marker=ARROW, ms=8, ls="none", alpha=0.7, gid=BOUND)
