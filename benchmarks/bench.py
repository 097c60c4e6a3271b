"""Speed of the link bench: pattern pairs a second on one core, beside a matrix product in the same run.

python -m benchmarks.bench
"""

import os
import time
from collections.abc import Callable

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: a worker has one core

import numpy as np

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block

RUNS = 5

CASES = (
    ("static, 25 m", "static", ("channel.distance_m=25",)),
    ("static, 50 m", "static", ("channel.distance_m=50",)),
    ("static, 80 m", "static", ("channel.distance_m=80",)),
    ("driving, from 50 m, 1 s", "paper", ("channel.distance_m=50", "channel.duration_s=1")),
)


def pairs_per_second(settings: LinkSettings) -> float:
    """Median over runs, by the time of this process."""
    rates = []
    for seed in range(RUNS):
        start = time.process_time()
        frames = run_block(settings, seed).frames
        rates.append(frames / 2 / (time.process_time() - start))
    return float(np.median(rates))


def baseline_ms() -> float:
    """Median time in ms of a 256 x 256 by 256 x 1000 product in single precision: how fast the core is now."""
    a = np.random.default_rng(0).standard_normal((256, 1256)).astype(np.float32)
    return _median_ms(lambda: a[:, :256] @ a[:, 256:])


def _median_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(50):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times)) * 1e3


def main() -> None:
    limit_threads()
    run_block(load_settings("static"), 0, max_packets=1)  # compiles
    product = baseline_ms()
    print(f"{'256 x 256 x 1000 float32 product':34} {product:8.3f} ms")
    for name, preset, changes in CASES:
        rate = pairs_per_second(load_settings(preset, None, changes))
        print(f"{name:34} {rate:8.0f} pattern pairs/s a core, {1e3 / rate / product:7.2f} products a pair")


if __name__ == "__main__":
    main()
