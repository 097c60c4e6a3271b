"""A junction from above: the lanes of a MAPEM in the colours of a SPATEM."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.road.read import Values

ASPHALT, STRIPES = "#d9dde2", "#9aa1a8"
LIGHTS = {
    "red": "#d0342c", "red-yellow": "#e0862a", "yellow": "#e0b02a", "flashing": "#e0b02a", "green": "#2f9d4a",
    "green-free": "#2f9d4a",
}  # fmt: skip
"""Colour of what a light shows."""

POINTS_A_METRE = 3.2
"""Width of a line by the lane's width in m, as the picture is scaled. Chosen by eye."""


def junction_picture(junction: Values, groups: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Draw a junction."""
    figure = Figure(figsize=(7.5, 6.2))
    axes = figure.subplots()
    width = POINTS_A_METRE * (junction["lane_width_m"] or 3.0)
    for lane in junction["lanes"]:
        if not lane["points_m"]:
            continue
        x, y = zip(*lane["points_m"], strict=True)
        crossing = lane["kind"] == "crosswalk"
        style = {"color": STRIPES, "ls": (0, (0.5, 0.5))} if crossing else {"color": ASPHALT, "solid_capstyle": "butt"}
        axes.plot(x, y, lw=width, **style, zorder=2 if crossing else 1)
        group = next((groups[number] for number in lane["groups"] if number in groups), None)
        if group is not None:
            colour = LIGHTS.get(group["phase"], plots.GRAY)
            axes.plot(x, y, color=colour, lw=2.2, zorder=3)
            axes.plot(x[0], y[0], "o", color=colour, ms=13, zorder=4)
            left = "" if group["left_s"] is None else f" {max(group['left_s'], 0.0):.0f} s"
            upright = abs(y[0]) > abs(x[0])
            place = ((x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2)
            words = f"{group['phase']}{left}"
            if upright:
                axes.annotate(words, place, (24, 0), textcoords="offset points", va="center")
            else:
                axes.annotate(words, place, (0, 24), textcoords="offset points", ha="center", va="center")
    name = str(junction["name"] or f"junction {junction['id']}").replace("$", r"\$")  # no formula
    axes.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=name)
    plots.tidy(axes)
    figure.tight_layout()
    return figure
