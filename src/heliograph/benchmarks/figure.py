"""Figure of the benchmark: codeword error rates with intervals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import legend_below, styled
from heliograph.receive.registry import is_bound
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.tally import PointTally


def label_of(receiver: str) -> str:
    """Return the name of a receiver, marked if it is a bound."""
    return f"{receiver} (bound)" if is_bound(receiver) else receiver


@styled
def draw(tallies: Sequence[PointTally]) -> Figure:
    """Draw the codeword error rate of each layer: a row for each scenario, a marker for each receiver."""
    scenarios = list(dict.fromkeys(tally.point.choice["scenario"] for tally in tallies))
    receivers = list(dict.fromkeys(tally.point.choice["receiver"] for tally in tallies))
    figure = Figure(figsize=(10, 1.4 + len(scenarios) * (0.15 + 0.09 * len(receivers))))
    for axes, layer in zip(figure.subplots(1, len(LAYERS), sharey=True), LAYERS, strict=True):
        for number, receiver in enumerate(receivers):
            counted = [
                (scenarios.index(tally.point.choice["scenario"]), tally.total.layers[layer].words)
                for tally in tallies
                if tally.point.choice["receiver"] == receiver and tally.total.codewords
            ]
            row, rate, low, high = np.array([(k, c.rate, *c.interval()) for k, c in counted]).reshape(-1, 4).T
            offset = 0.7 * ((number + 0.5) / len(receivers) - 0.5)
            marker = "osD^vP*X"[number % 8]
            style = {"fmt": marker, "fillstyle": "none" if is_bound(receiver) else "full"}
            axes.errorbar(rate, row + offset, xerr=(rate - low, high - rate), label=label_of(receiver), **style)
        axes.set(xlim=(-0.03, 1.03), xlabel="codeword error rate", title=f"{layer} layer")
        axes.set_yticks(range(len(scenarios)), scenarios)
    axes.set_ylim(len(scenarios) - 0.5, -0.5)
    legend_below(figure)
    return figure
