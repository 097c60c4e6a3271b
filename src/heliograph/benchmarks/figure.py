"""Figure of the benchmark: codeword error rates with intervals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import styled
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
    height = 1.4 + len(scenarios) * (0.1 + 0.065 * len(receivers))
    figure = Figure(figsize=(10, height), layout="constrained")
    for axes, layer in zip(figure.subplots(1, len(LAYERS), sharey=True), LAYERS, strict=True):
        for number, receiver in enumerate(receivers):
            counted = [
                (scenarios.index(tally.point.choice["scenario"]), tally.total.layers[layer].words)
                for tally in tallies
                if tally.point.choice["receiver"] == receiver and tally.total.codewords
            ]
            if not counted:
                continue
            row, rate, low, high = np.array([(k, c.rate, *c.interval()) for k, c in counted]).T
            offset = 0.85 * ((number + 0.5) / len(receivers) - 0.5)
            marker = "osD^vP*X"[number % 8]
            style = {"fmt": marker, "fillstyle": "none" if is_bound(receiver) else "full"}
            axes.errorbar(rate, row + offset, xerr=(rate - low, high - rate), label=label_of(receiver), **style)
        axes.set(xlim=(-0.03, 1.03), xlabel="codeword error rate", title=f"{layer} layer")
        axes.set_yticks(range(len(scenarios)), scenarios)
        for row in range(0, len(scenarios), 2):
            axes.axhspan(row - 0.5, row + 0.5, color="gray", alpha=0.08, linewidth=0)
    axes.set_ylim(len(scenarios) - 0.5, -0.5)
    figure.legend(*axes.get_legend_handles_labels(), ncols=6, loc="outside upper center")
    return figure
