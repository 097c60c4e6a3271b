"""Read a panel from another system: 32 x 24 LEDs in three colours, without Heliograph packets.

Run `python examples/any_panel.py`. The script simulates a film as a folder of pictures, locates and tracks the panel,
reads the LEDs and counts bit errors. any_panel.png shows the first frame with LED positions and bits. For other films,
`read` suffices.
"""

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

import heliograph

ROWS, COLUMNS = 24, 32


def read(film: Path) -> tuple[np.ndarray, list[heliograph.Place]]:
    """Read LED states (frames, rows, columns, 3) as red, green and blue, and panel places."""
    with heliograph.open_colours(film, rate_hz=100) as opened:
        frames = list(opened)
    start = heliograph.locate(frames[:2], rows=ROWS, columns=COLUMNS)
    places = list(heliograph.follow(frames, start, ROWS, COLUMNS))
    values = np.array([heliograph.sample(frame, place, ROWS, COLUMNS, unblur=True)
                       for frame, place in zip(frames, places, strict=True)])  # fmt: skip
    return values > values.mean(axis=0), places


def draw(folder: Path, bits: np.ndarray) -> None:
    """Draw a film: LEDs on a board, with perspective, camera shake, blur and noise."""
    rng, size = np.random.default_rng(1), 10
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    dot = np.hypot(x, y) < 0.3 * size
    for number, lit in enumerate(bits):
        board = np.kron(200.0 * lit, dot[..., None])
        corners = np.array([[40, 30], [270, 55], [262, 215], [50, 205]]) + rng.normal(0, 1.0, 2)
        corner_px = np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]]) * size - 0.5
        view = cv2.getPerspectiveTransform(corner_px.astype(np.float32), corners.astype(np.float32))
        seen = cv2.warpPerspective(cv2.GaussianBlur(board, (0, 0), 3.0), view, (320, 240))
        seen = cv2.GaussianBlur(seen, (0, 0), 2.2) + 20 + rng.normal(0, 2.0, (240, 320, 3))
        cv2.imwrite(str(folder / f"img{number:04d}.png"), np.clip(seen, 0, 255).astype(np.uint8)[..., ::-1])


def main(few: bool) -> None:
    """Draw a film, read the film, and plot both."""
    sent = np.random.default_rng(0).random((4 if few else 40, ROWS, COLUMNS, 3)) < 0.5
    with tempfile.TemporaryDirectory() as folder:
        draw(Path(folder), sent)
        bits, places = read(Path(folder))
        first = cv2.imread(str(Path(folder) / "img0000.png"))[..., ::-1]
    print(f"blur {places[0].blur:.2f} px, corners {places[0].corners.round(2).tolist()}")
    print(f"{(bits != sent).sum()} of {sent.size} bits wrong")
    figure = Figure(figsize=(11, 4), layout="constrained")
    film, found = figure.subplots(1, 2)
    film.imshow(first)
    film.plot(*places[0].leds(ROWS, COLUMNS).reshape(-1, 2).T, ".", color="white", markersize=1.5)
    film.set(title="the first frame, and its LEDs", xticks=[], yticks=[])
    found.imshow(bits[0].astype(float))
    found.set(title="what they show", xticks=[], yticks=[])
    figure.savefig("any_panel.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
