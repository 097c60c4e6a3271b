"""Pictures of error rates by distance, and of driving over static."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.error_rates.comparison import MARGIN, Comparison
from heliograph.experiments.error_rates.films import CountsByDistance, all_layers
from heliograph.experiments.plots import LAYER_COLOURS
from heliograph.measure.counts import Layers
from heliograph.measure.statistics import Clustered, Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import legend_entries

LEAST_SHOWN = 1e-6
"""Least bit error rate that is drawn; intervals may reach lower. Chosen."""


def pictures(
    static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance, found: Sequence[Comparison]
) -> list[tuple[Figure, str]]:
    """Rates by distance, and driving over static; each with its caption."""
    rates = (
        "Bit error rate before and after the turbo code, by layer: static (lines), driving (open squares), on-off "
        "keying before any code (gray). Both are drawn half a metre aside. 95 % intervals; an arrow is a bound (3/n), "
        "no error met in n bits before the code, in n packets after it."
    )
    ratio = (
        "Raw errors driving over static at the same distances, 95 % over packets or drives; "
        f"gray: alike, a factor {MARGIN:g}."
    )
    return [(_rates_picture(static, driving, keyed), rates), (_ratio_picture(found), ratio)]


def _rates_picture(static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance) -> Figure:
    """A column for each layer, a row before and one after the code."""
    figure = Figure(figsize=(12, 7.4))
    places = figure.subplots(2, len(LAYERS), sharex=True, sharey="row")
    for row, (kind, title) in zip(places, (("raw", "before"), ("decoded", "after")), strict=True):
        for axes, name in zip(row, LAYERS, strict=True):
            count = partial(_of, name, kind)
            _draw(axes, static, count, LAYER_COLOURS[name], "static", "-", -0.5)
            _draw(axes, driving, count, plots.BLACK, "driving", "none", 0.5)
            if kind == "raw":
                _draw(axes, keyed, all_layers, plots.GRAY, "on-off keying, static", "--")
            axes.set_yscale("log")
            axes.set_title(f"{name}, {title} the turbo code", fontsize=11)
            plots.tidy(axes)
        row[0].set_ylabel("bit error rate")
        row[0].set_ylim(max(row[0].get_ylim()[0], LEAST_SHOWN), 1.5)
    for axes in places[1]:
        axes.set_xlabel("distance (m)")
    entries = [legend_entries(axes) for axes in places.flat]
    # the first place has all systems, and any place may have bounds
    named = {label: handle for handles, labels in entries for label, handle in zip(labels, handles, strict=True)}
    handles, labels = list(named.values()), list(named)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    if handles:
        figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure


def _draw(
    axes: Axes,
    sums: CountsByDistance,
    count: Callable[[Layers], Count],
    colour: str,
    label: str,
    dashes: str,
    aside_m: float = 0.0,
) -> None:
    counts = [(z + aside_m, count(layers)) for z, layers in sorted(sums.places.items())]
    style: dict[str, Any] = {"color": colour, "ls": dashes, "lw": 1.2, "capsize": 2}
    style |= {"marker": "s", "mfc": "none", "ms": 6} if dashes == "none" else {"marker": "o", "ms": 4, "lw": 1.8}
    plots.draw_rates(axes, counts, label, **style)


def _ratio_picture(found: Sequence[Comparison]) -> Figure:
    figure = Figure(figsize=(9, 3.6))
    axes = figure.subplots()
    axes.axhspan(1 / MARGIN, MARGIN, color=plots.PALE_GRAY, zorder=0)
    axes.axhline(1, color=plots.LIGHT_GRAY, lw=1, zorder=1)
    for k, name in enumerate(LAYERS):
        rows = [(c.bin_m + k - 1, c.ratio, c.low, c.high) for c in found if c.layer == name and c.bin_m is not None]
        if rows:
            z, ratio, low, high = np.array(rows).T
            high = np.minimum(high, 1e3)
            bars = (ratio - np.minimum(low, ratio), np.maximum(high, ratio) - ratio)
            axes.errorbar(z, ratio, bars, color=LAYER_COLOURS[name], marker="o", ms=4, ls="none", capsize=2, label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.2, 5)
    axes.set_yticks((0.2, 0.5, 1, 2, 5), ("0.2", "0.5", "1", "2", "5"))
    axes.minorticks_off()
    axes.set_xlabel("distance (m)")
    axes.set_ylabel("driving / static")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, ncols=3)
    plots.tidy(axes)
    figure.tight_layout()
    return figure


def _of(layer: str, kind: str, layers: Layers) -> Clustered:
    return layers[layer].raw if kind == "raw" else layers[layer].decoded
