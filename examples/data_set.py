"""Create and use a training data set: films with ground truth and cut-outs, in three splits.

Run `python examples/data_set.py`. The script writes a small data set to data_set/, trains a linear decoder on cut-outs
from the split "train" and counts LED errors on "test"; the splits share no seed. data_set.png shows a frame with true
corners, a cut-out, and decoded LEDs. For training on other data sets, `read` suffices.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure

import heliograph

FOLDER = Path("data_set")
SMALL = ["channel.camera.width=96", "channel.camera.height=80", "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0"]


def read(split: str) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Read a split frame by frame: frame, corners, cut-out and transmitted levels for the first array."""
    for path in sorted((FOLDER / split).glob("*.h5")):
        with h5py.File(path) as film:
            sent, patterns = film["sent/0/levels"][:], film["truth/patterns"][:, 0, 0]
            patterns -= film["sent/0"].attrs["first_pattern"]
            frames, corners, cutouts = film["frames"], film["truth/corners"], film["cutouts/pixels"]
            yield from zip(frames, corners[:, 0], cutouts[:, 0], sent[patterns], strict=True)


def examples(split: str) -> tuple[np.ndarray, np.ndarray]:
    """Return decoder inputs (cut-outs with an appended 1) and targets (luminances from 0 to 1)."""
    cutouts, levels = zip(*((cutout, sent) for _, _, cutout, sent in read(split)), strict=True)
    pixels = np.reshape(cutouts, (len(cutouts), -1)) / 255
    return np.column_stack([pixels, np.ones(len(pixels))]), np.reshape(levels, (len(levels), -1)) / 4


def main(few: bool) -> None:
    """Write the data set, train, test and plot."""
    films, changes = (5, [*SMALL, "signal.data_pairs=8"]) if few else (40, SMALL)
    plan = heliograph.write_dataset(FOLDER, {"channel.distance_m": [30]}, set=changes, films=films, splits=(8, 1, 1))
    print(f"{len(plan.films)} films, {plan.frames} frames, {plan.bytes / 1e6:.1f} MB")
    pixels, levels = examples("train")
    power = pixels.T @ pixels
    decoder = np.linalg.solve(power + 1e-3 * np.trace(power) / len(power) * np.eye(len(power)), pixels.T @ levels)
    tried, known = examples("test")
    wrong = ((tried @ decoder > 0.5) != (known > 0.5))[known != 0.5]
    print(f"{wrong.sum()} of {wrong.size} LEDs taken for lit that were dark, or the other way round")
    frame, corners, cutout, sent = next(read("test"))
    figure = Figure(figsize=(12, 3.2), layout="constrained")
    pictures = {"a frame, and its true corners": frame, "its cut-out": cutout, "sent": sent,
                "decoded": (tried[0] @ decoder).reshape(sent.shape)}  # fmt: skip
    for axes, (title, picture) in zip(figure.subplots(1, 4), pictures.items(), strict=True):
        axes.imshow(picture, "gray")
        axes.set(title=title, xticks=[], yticks=[])
    figure.axes[0].plot(*np.vstack([corners, corners[:1]]).T, color="tab:red")
    figure.savefig("data_set.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
