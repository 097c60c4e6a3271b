"""Make the gallery's picture of a pattern, its inverse and their sum, by distance.

The animation docs/pictures/drive.webp is that of `make demo`.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import figure_svg, styled
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate

DISTANCES_M = (80, 60, 40, 25)
HALF_M = 0.24
"""Half of the shown width; the array is 0.32 m wide."""

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
SHOWN = 6
"""Pattern of the film that is shown; the header takes the first four."""


@styled
def draw() -> Figure:
    """Draw a column for each distance, all at the same scale in metres."""
    figure = Figure(figsize=(8, 6.3))
    panels = figure.subplots(3, len(DISTANCES_M), sharex=True, sharey=True)
    for column, distance_m in zip(panels.T, DISTANCES_M, strict=True):
        settings = load_settings("static", assignments=[f"channel.distance_m={distance_m}", "channel.duration_s=0.02"])
        frames = list(simulate(settings, default_messages(settings), 0, roi_margin_px=8))[SHOWN : SHOWN + 2]
        (up, truth), (down, _) = frames
        array = truth.arrays[0]
        pixel_m = settings.channel.emitter.pitch_m / array.pitch_px
        (x, y), (rows, columns) = up.origin, up.pixels.shape
        edges_px = (x - 0.5 - array.x, x + columns - 0.5 - array.x, y + rows - 0.5 - array.y, y - 0.5 - array.y)
        extent = [pixel_m * edge for edge in edges_px]
        light = [frame.pixels.astype(float) for frame in (up, down)]
        for axes, image in zip(column, (*light, np.minimum(sum(light), 255)), strict=True):
            axes.imshow(image, vmin=0, vmax=255, extent=extent)
            axes.set(xlim=(-HALF_M, HALF_M), ylim=(HALF_M, -HALF_M), xticks=[], yticks=[])
            axes.grid(visible=False)
        column[0].set_title(f"{distance_m} m: {array.pitch_px:.2g} px per LED")
    for axes, name in zip(panels[:, 0], ("pattern", "inverse", "sum"), strict=True):
        axes.set_ylabel(name)
    panels[-1, 0].plot((-0.05, 0.05), (0.215, 0.215), color="white", lw=2, solid_capstyle="butt")
    panels[-1, 0].text(0.06, 0.215, "0.1 m", color="white", va="center", fontsize=8)
    return figure


def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    (PICTURES / "by-distance.svg").write_bytes(figure_svg(draw()))


if __name__ == "__main__":
    main()
