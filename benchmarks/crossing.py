"""Arrays that a camera passes sideways: `python -m benchmarks.crossing [--passages 40] [--seed 1]`.

Each passage is the preset "crossing" at a distance (15 to 40 m), speed (25 to 60 km/h), side and turn of the array (up
to 25 degrees, so that the camera is within 35 degrees of its axis) drawn by the seed. The camera looks across its road,
so the array crosses the sensor from one side to the other. Wrong codewords of sent are counted by layer and by how far
the image moves from frame to frame.
"""

import argparse

import numpy as np

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS

REACH = 0.164
"""Way of the array to either side as a fraction of the distance: all of it stays on the sensor."""

BINS_PX = (0.5, 1.0, 1.5, 2.5, 3.5)
"""Bounds of the motions that are counted together, in px from frame to frame."""


def draw(rng: np.random.Generator, receiver: str) -> tuple[LinkSettings, float]:
    """Draw a passage: its settings, and its motion in px from frame to frame.

    Parameters
    ----------
    rng
        Source of randomness.
    receiver
        Name of the receiver.
    """
    distance_m, speed_m_s = rng.uniform(15, 40), rng.uniform(25, 60) / 3.6
    side, yaw_deg = float(rng.choice([-1, 1])), rng.uniform(-25, 25)
    half_m = REACH * distance_m
    array = {"x_m": -side * half_m, "y_m": rng.uniform(-0.5, 0.5), "vx_m_s": side * speed_m_s, "yaw_deg": yaw_deg}
    channel = {"distance_m": distance_m, "duration_s": 2 * half_m / speed_m_s, "arrays": [array]}
    settings = load_settings("crossing", {"receive": {"receiver": receiver}, "channel": channel})
    return settings, settings.channel.camera.focal_px * speed_m_s / distance_m * settings.signal.pattern_period_s


def main() -> None:
    """Count wrong codewords."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passages", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for receiver in ("plain", "soft"):
        counts = {(k, layer): Count() for k in range(len(BINS_PX) - 1) for layer in LAYERS}
        for number in range(given.passages):
            settings, motion_px = draw(np.random.default_rng((given.seed, number)), receiver)
            found = run_block(settings, number)
            for layer, sent in found.layers.items():
                counts[int(np.searchsorted(BINS_PX, motion_px)) - 1, layer].add(sent.codewords, sent.codeword_errors)
        for k in range(len(BINS_PX) - 1):
            texts = []
            for layer in LAYERS:
                one = counts[k, layer]
                low, high = one.interval() if one.trials else (0.0, 1.0)
                texts.append(f"{layer} {one.errors}/{one.trials} ({low:.1e} to {high:.1e})")
            print(f"{receiver}, {BINS_PX[k]} to {BINS_PX[k + 1]} px a frame: " + ", ".join(texts), flush=True)


if __name__ == "__main__":
    main()
