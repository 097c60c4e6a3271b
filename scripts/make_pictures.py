"""Make the README's picture: what the camera sees of a pattern, its inverse and their sum, by distance.

The animation docs/pictures/drive.webp is that of `make demo`.
"""

from pathlib import Path

import numpy as np

from heliograph.experiments.plots import image_row
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate

DISTANCES = (80, 60, 40, 25)
PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
SHOWN = 6
"""Pattern of the film that is shown; the header takes the first four."""


def main() -> None:
    images, titles = [], []
    for kind in ("pattern", "inverted", "sum"):
        for distance in DISTANCES:
            settings = load_settings(
                "static", assignments=[f"channel.distance_m={distance}", "channel.duration_s=0.02"]
            )
            frames = [f.pixels for f, _ in simulate(settings, default_messages(settings), 0, roi_margin_px=3)]
            up, down = (frames[SHOWN + k].astype(float) for k in (0, 1))
            images.append({"pattern": up, "inverted": down, "sum": np.minimum(up + down, 255)}[kind])
            titles.append(f"{kind}, {distance} m")
    PICTURES.mkdir(exist_ok=True)
    image_row(images, titles, rows=3).savefig(PICTURES / "by-distance.png", dpi=110)


if __name__ == "__main__":
    main()
