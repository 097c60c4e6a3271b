"""Plots of error rates: points with intervals, and upper bounds for zero errors."""

import sys
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.base.errors import HeliographError, shown
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.dataset import ERROR_RATES

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

ARROW = r"$\downarrow$"  # marker of an upper bound

BOUND, MISSED, UNCODED = "no error: upper bound", "no packet found", "uncoded bit errors"
"""Legend texts, and ids in axes, of upper bounds, missed arrays and uncoded bits."""

LAYER_COLOURS = dict(zip(LAYERS, ("#1b6ca8", "#d1741f", "#5b8c3a"), strict=True))
"""Colours of the layers in all plots."""


def plot_rates(
    data: "xarray.Dataset", rate: str = "fer", along: str | None = None, axes: "Axes | None" = None
) -> "Axes":
    """Plot an error rate of a sweep over a key, a line for each layer and combination of the other keys.

    The colour is that of the layer, dashes and marker are those of the other keys. Measured rates have 95 % intervals.
    An arrow is an upper bound for zero errors, 3 / n, and joins no line. A cross at the lower edge marks a point
    with no received packet. Behind rates after the decoder, a dotted line is the bit error rate without a code.

    Parameters
    ----------
    data
        Dataset of `sweep`, or a selection.
    rate
        "ber" after the decoder, "raw_ber" by the first equalisation, "final_raw_ber" by the last equalisation, or "fer"
        of codewords.
    along
        Key on the horizontal axis; by default, the first key with several numbers, or the first key.
    axes
        Axes for the plot; by default, of a new figure, ``plot_rates(...).figure``.

    Returns
    -------
    The axes.

    Raises
    ------
    HeliographError
        The rate or key is unknown, no key varies, or the data are no Dataset.
    """
    # a Dataset implies that xarray is loaded
    if not isinstance(data, getattr(sys.modules.get("xarray"), "Dataset", ())):
        raise HeliographError(f"plot_rates draws the xarray.Dataset of heliograph.sweep, not {shown(data)}")
    if rate not in ERROR_RATES:
        raise HeliographError(f"unknown rate '{rate}'; there are {', '.join(ERROR_RATES)}")
    keys = [str(key) for key in data[rate].dims if key != "layer"]
    key = _along(data, keys) if along is None else along
    if key not in keys:
        raise HeliographError(f"nothing varies by '{key}'; there {'is' if len(keys) == 1 else 'are'} {', '.join(keys)}")
    if axes is None:
        from matplotlib.figure import Figure

        axes = Figure(figsize=(7, 4.5), layout="constrained").add_subplot()
    others = [other for other in keys if other != key]
    layers = [str(name) for name in np.atleast_1d(data["layer"].values)]
    lines = data if "layer" in data[rate].dims else data.expand_dims("layer")
    for number, place in enumerate(np.ndindex(*(data.sizes[other] for other in others))):
        part = lines.isel(dict(zip(others, place, strict=True)))
        about = ", ".join(_words(other, part[other].values) for other in others)
        for layer in layers:
            label = ", ".join(filter(None, (about, layer)))
            one = part.sel(layer=layer)
            _line(axes, one, rate, key, label, LAYER_COLOURS[layer], number)
            if rate in ("ber", "fer"):
                # without a code a layer has the errors of its coded bits
                x, raw = one[key].values, one["raw_ber"].where(one["detected"] > 0).values
                if (wrong := raw > 0).any():
                    axes.plot(x[wrong], raw[wrong], ":", color=LAYER_COLOURS[layer], lw=0.8, zorder=1, gid=UNCODED)
    unit = data[key].attrs.get("units", "1")
    xlabel, ylabel = key if unit == "1" else f"{key} ({unit})", textwrap.fill(ERROR_RATES[rate], 40)
    axes.set(xlabel=xlabel, ylabel=ylabel, yscale="log")
    rates = np.concatenate([line.get_ydata() for line in axes.lines if line.get_gid() != MISSED] or [[]])
    if (rates > 0).any():
        # the interval of a few errors reaches down to 0
        axes.set_ylim(bottom=max(axes.get_ylim()[0], rates[rates > 0].min() / 30))
    axes.grid(alpha=0.3)
    axes.legend(*legend_entries(axes), fontsize="small", loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    return axes


def legend_entries(axes: "Axes") -> tuple[list[Any], list[str]]:
    """Return handles and labels of a legend: all lines, and the meaning of arrows and crosses."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    drawn = {line.get_gid() for line in axes.lines}
    for note, marker, line in ((BOUND, ARROW, "none"), (MISSED, "x", "none"), (UNCODED, "", ":")):
        if note in drawn:
            handles.append(Line2D([], [], color="k", ls=line, lw=0.8, marker=marker))
            labels.append(note)
    return handles, labels


def _words(key: str, value: Any) -> str:
    """Return a value for the legend, with the name of the key if the value is a number."""
    return f"{key.rsplit('.', 1)[-1]} {value}" if np.issubdtype(value.dtype, np.number) else str(value)


def _along(data: "xarray.Dataset", keys: list[str]) -> str:
    if not keys:
        raise HeliographError("nothing varies in this Dataset: the plot needs an axis")
    several = [key for key in keys if data.sizes[key] > 1 and np.issubdtype(data[key].dtype, np.number)]
    return (several or keys)[0]


def _line(axes: "Axes", part: Any, rate: str, key: str, label: str, colour: str, number: int) -> None:
    """Plot measured rates with intervals, bounds with arrows, and missed points with crosses."""
    x, y = part[key].values, part[rate].values
    low, high = part[f"{rate}_low"].values, part[f"{rate}_high"].values
    bound, found = part[f"{rate}_is_bound"].values.astype(bool), part["detected"].values > 0
    counted = ~np.isnan(y) & found
    marks, dashes = "osD^vP*X", ("-", "--", "-.", (0, (1, 1)))
    # larger and hollow, so that equal points of earlier lines stay visible
    style: dict[str, Any] = {"color": colour, "marker": marks[number % len(marks)], "ms": 5 + 2.5 * number}
    style["mfc"] = "none" if number else colour
    measured, bounds = counted & ~bound, counted & bound
    axes.plot(x[measured], y[measured], lw=1.2, ls=dashes[number % len(dashes)], label=label, **style)
    errors = [(y - low)[measured], (high - y)[measured]]
    axes.errorbar(x[measured], y[measured], errors, fmt="none", ecolor=colour, lw=1, alpha=0.4)
    if bounds.any():
        axes.plot(x[bounds], high[bounds], ls="none", gid=BOUND, **style | {"marker": ARROW, "ms": style["ms"] + 3})
    if (~found).any():
        edge = np.full((~found).sum(), 0.02)
        axes.plot(x[~found], edge, "x", color="k", gid=MISSED, transform=axes.get_xaxis_transform())
