"""Check the assumptions and accuracy of `heliograph budget`.

python -m benchmarks.budget needs     REQUIRED_INFORMATION of heliograph.link.budget, by code rate
python -m benchmarks.budget points    predicted and measured codeword loss by distance, receiver, mode and blur
"""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from heliograph.link.budget import binary_information, budget
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import pooled
from heliograph.signal.code import Code
from heliograph.signal.formats import SIGNALLED_RATES
from heliograph.signal.turbo.code import turbo_plan

CODED_BITS = 3072
"""Codeword length in the reference link."""

LOST = 0.01
"""Codeword error rate at maximum range."""

POINTS = (
    (60.0, "plain", "paired", 0.5), (70.0, "plain", "paired", 0.5), (80.0, "plain", "paired", 0.5),
    (95.0, "soft", "single", 0.5), (110.0, "soft", "single", 0.5), (125.0, "soft", "single", 0.5),
    (145.0, "soft", "single", 0.5),
    (80.0, "soft", "paired", 0.8), (90.0, "soft", "paired", 0.8), (105.0, "soft", "paired", 0.8),
    (125.0, "soft", "paired", 0.8),
)  # fmt: skip
"""Distance in m, receiver, mode and blur in px near the predicted maximum range."""


def needs(blocks: int) -> None:
    """Print the mutual information required for codeword error rate LOST, by rate."""
    print("rate    information at which 1 % of the codewords are wrong")
    for rate in (1 / 3, *SIGNALLED_RATES):
        code, found = turbo_plan(CODED_BITS, rate).code, []
        for information in np.arange(rate + 0.02, 1.0, 0.01):
            lost = _lost(code, float(information), blocks)
            found.append((float(information), lost))
            if lost < LOST / 3:
                break
        x, y = np.array([(x, np.log(y)) for x, y in found if 0 < y < 0.3]).T
        slope, start = np.polyfit(x, y, 1)
        print(f"{rate:.3f}   {(np.log(LOST) - start) / slope:.3f}", flush=True)


def _lost(code: Code, information: float, blocks: int) -> float:
    """Return the codeword error rate for a given mutual information per bit."""
    ratio = brentq(lambda r: float(binary_information(np.array([r]))[0]) - information, 1e-4, 40.0)
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2, (blocks, code.k), dtype=np.uint8)
    sent = 1 - 2.0 * code.encode(bits)
    llr = 2 * ratio * sent + 2 * np.sqrt(ratio) * rng.standard_normal(sent.shape)
    return float((code.decode(llr, algorithm="log-map").bits != bits).any(1).mean())


def point(distance_m: float, receiver: str, mode: str, blur_px: float) -> LinkSettings:
    """Return reference link settings for a point at rest."""
    over = {
        "channel": {"distance_m": distance_m, "camera": {"blur_px": blur_px}},
        "receive": {"receiver": receiver},
        "transmit": {"formats": [] if mode == "paired" else [{"mode": mode}]},
    }
    return load_settings("static", over)


def points(films: int, chosen: Sequence[tuple[float, str, str, float]] = POINTS) -> None:
    """Print predicted and measured codeword loss for each point and layer."""
    print("distance  receiver  mode    blur    layer   reads to  at most  information here  needed  lost (95 %)")
    for distance_m, receiver, mode, blur_px in chosen:
        settings = point(distance_m, receiver, mode, blur_px)
        layers = pooled(run_block(settings, seed).layers for seed in range(films))
        for one in budget(settings).layers:
            if (one.receiver, one.mode) == (receiver, mode):
                lost = layers[one.layer].words
                low, high = lost.interval()
                print(
                    f"{distance_m:5.0f} m   {receiver:8}  {mode}  {blur_px:.1f} px  {one.layer:6}  "
                    f"{one.range_m:6.0f} m  {one.most_m:5.0f} m  {one.here:16.3f}  {one.needed:6.3f}  "
                    f"{lost.errors}/{lost.trials} "
                    f"[{low:.2g}, {high:.2g}]",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("needs", "points"), default="needs")
    parser.add_argument("--count", type=int, help="codewords of each rate and information (300), or films (12)")
    chosen = parser.parse_args()
    if chosen.what == "needs":
        needs(chosen.count or 300)
    else:
        points(chosen.count or 12)


if __name__ == "__main__":
    main()
