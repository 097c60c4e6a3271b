"""Error rate plots: lines connect measured rates, arrows are separate."""

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.measure.counts import LayerCounts
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import ARROW, BOUND, legend_entries


def test_no_line_joins_a_bound() -> None:
    axes = Figure().add_subplot()
    counts = [
        (40.0, Count(100, 0)),
        (60.0, Count(100, 5)),
        (80.0, Count(0, 0)),
        (100.0, Count(12, 0)),
        (120.0, Count(5, 0)),
    ]
    plots.draw_rates(axes, counts, "soft", color="C0")
    joined = [line for line in axes.lines if line.get_linestyle() != "None"]
    assert [np.asarray(line.get_xdata()).tolist() for line in joined] == [[60.0]]
    (bounds,) = (line for line in axes.lines if line.get_marker() == ARROW)
    # a bound of 0.6 is no measurement
    assert np.asarray(bounds.get_ydata()).tolist() == [0.03, 0.25]
    assert legend_entries(axes)[1] == ["soft", BOUND]


def test_a_system_without_any_error_keeps_its_place_in_the_legend() -> None:
    bins = {40.0: {name: LayerCounts(raw_bits=1000) for name in LAYERS}}
    before, _ = plots.errors_by_distance(bins).axes
    legend = before.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [*LAYERS, BOUND]


def test_no_error_is_drawn_as_a_bound_of_three_by_n() -> None:
    layers = {"high": LayerCounts(bits=6000), "middle": LayerCounts(), "low": LayerCounts(bits=1000, bit_errors=10)}
    after = plots.errors_by_distance({50.0: layers}).axes[1]
    points = [(float(x), float(y)) for line in after.lines for x, y in np.array(line.get_xydata())]
    # each layer is drawn a little aside
    assert (52.5 - 0.7, 3 / 6000) in points
    assert (52.5 + 0.7, 0.01) in points
