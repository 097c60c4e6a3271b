"""Error rates of a Dataset as a picture: points with intervals, bounds where no error was met."""

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.base.errors import HeliographError, shown
from heliograph.signal.settings import LAYERS

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

RATES = {
    "ber": "bit error rate",
    "raw_ber": "raw bit error rate",
    "fer": "codeword error rate",
    "final_raw_ber": "raw bit error rate of the last equalisation",
}

MARKS = "osD^vP*X"

ARROW = r"$\downarrow$"
"""Mark of an upper bound."""

BOUND, MISSED = "no error met: the rate is below (95 %)", "no packet found"
"""Ids of bounds and of missed arrays in axes, and what a legend says of them."""


def plot_rates(
    data: "xarray.Dataset", rate: str = "fer", along: str | None = None, axes: "Axes | None" = None
) -> "Axes":
    """Draw an error rate of a sweep over one of its keys, a line for each layer and each choice of the other keys.

    Lines join measured rates, each with its 95 % interval. An open mark with an arrow down is an upper bound: no error
    was met. A cross at the lower edge marks a choice at which no packet was found, so that its rate says nothing of a
    link. The legend explains arrows and crosses.

    Parameters
    ----------
    data
        Dataset of `sweep`, or a part of it.
    rate
        "ber" after the decoder, "raw_ber" before it by the first equalisation, "final_raw_ber" by the last one, or
        "fer" of codewords.
    along
        Key on the horizontal axis; None: the first that has numbers and more than one value, else the first.
    axes
        Where to draw; None: in a figure of its own, which is ``plot_rates(...).figure``.

    Returns
    -------
    The axes.

    Raises
    ------
    HeliographError
        There is no such rate or key, or nothing varies; or it is no Dataset.
    """
    # who has a Dataset has loaded xarray, which need not be installed
    if not isinstance(data, getattr(sys.modules.get("xarray"), "Dataset", ())):
        raise HeliographError(f"plot_rates draws the xarray.Dataset of heliograph.sweep, not {shown(data)}")
    if rate not in RATES:
        raise HeliographError(f"there is no rate '{rate}'; there are {', '.join(RATES)}")
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
        about = ", ".join(str(part[other].values) for other in others)
        for layer in layers:
            label = ", ".join(filter(None, (about, layer)))
            _line(axes, part.sel(layer=layer), rate, key, label, (LAYERS.index(layer), number))
    unit = data[key].attrs.get("units", "1")
    axes.set(xlabel=key if unit == "1" else f"{key} ({unit})", ylabel=RATES[rate], yscale="log")
    axes.grid(alpha=0.3)
    axes.legend(*legend_entries(axes), fontsize="small")
    return axes


def legend_entries(axes: "Axes") -> tuple[list[Any], list[str]]:
    """Return what a legend shows of axes with error rates: all labels, and what arrows and crosses mean."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    drawn = {line.get_gid() for line in axes.lines}
    for note, marker in ((BOUND, ARROW), (MISSED, "x")):
        if note in drawn:
            handles.append(Line2D([], [], color="k", ls="none", marker=marker))
            labels.append(note)
    return handles, labels


def _along(data: "xarray.Dataset", keys: list[str]) -> str:
    if not keys:
        raise HeliographError("nothing varies in this Dataset: there is no axis to draw along")
    several = [key for key in keys if data.sizes[key] > 1 and np.issubdtype(data[key].dtype, np.number)]
    return (several or keys)[0]


def _line(axes: "Axes", part: Any, rate: str, key: str, label: str, style: tuple[int, int]) -> None:
    """Draw measured rates with intervals and a line, bounds with arrows, and crosses where nothing was found."""
    layer, number = style
    x, y = part[key].values, part[rate].values
    low, high = part[f"{rate}_low"].values, part[f"{rate}_high"].values
    bound, found = part[f"{rate}_is_bound"].values.astype(bool), part["detected"].values > 0
    counted = ~np.isnan(y) & found
    look: dict[str, Any] = {"color": f"C{layer}", "marker": MARKS[number % len(MARKS)]}
    seen = counted & ~bound
    axes.plot(x[seen], y[seen], lw=1, label=label, **look)
    axes.errorbar(x[seen], y[seen], [y[seen] - low[seen], high[seen] - y[seen]], fmt="none", ecolor=f"C{layer}", lw=1)
    bounds = counted & bound
    if bounds.any():
        reach = [high[bounds] * 0.5, np.zeros(bounds.sum())]
        axes.plot(x[bounds], high[bounds], ls="none", mfc="none", gid=BOUND, **look)
        axes.errorbar(x[bounds], high[bounds], reach, fmt="none", ecolor=f"C{layer}", uplims=True, lw=1)
    if (~found).any():
        edge = np.full((~found).sum(), 0.02)
        axes.plot(x[~found], edge, "x", color="k", gid=MISSED, transform=axes.get_xaxis_transform())
