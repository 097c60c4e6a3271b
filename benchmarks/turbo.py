"""Turbo decoder: speed on one core and block error rates.

``python -m benchmarks.turbo`` prints median processor times with two yardsticks from the same run: memory copy and
NumPy reference. ``python -m benchmarks.turbo bler`` measures block error rates (a minute). Eb includes the tail: the
rate is K / (3 K + 12), 0.017 dB harder at K = 1024 than rate 1/3.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from heliograph.signal.code import Algorithm
from heliograph.signal.turbo import DecoderOptions, TurboCode
from heliograph.signal.turbo.code import Stop
from heliograph.signal.turbo.qpp import interleaver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))
import turbo_oracle as oracle

ITERATIONS = 8


def noisy_blocks(
    code: TurboCode, blocks: int, ebn0_db: float, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return random blocks and LLRs after BPSK in white Gaussian noise."""
    bits = rng.integers(0, 2, (blocks, code.k), dtype=np.uint8)
    variance = 1 / (2 * code.rate * 10 ** (ebn0_db / 10))
    noise = rng.standard_normal((blocks, code.length), dtype=np.float32)
    samples = 1 - 2 * code.encode(bits).astype(np.float32) + np.float32(variance**0.5) * noise
    return bits, samples * np.float32(2 / variance)


def medians_s(calls: list[Callable[[], object]], repeats: int) -> list[float]:
    """Return the median processor time per call, for alternating calls after a warm-up."""
    times = np.empty((repeats + 1, len(calls)))
    for row in times:
        for column, call in enumerate(calls):
            start = time.process_time()
            call()
            row[column] = time.process_time() - start
    return [float(median) for median in np.median(times[1:], axis=0)]


def speed() -> None:
    rng = np.random.default_rng(1)
    print(f"information Mbit/s, medians, at most {ITERATIONS} iterations, Eb/N0 1 dB, one thread")
    for k in (64, 256, 1024, 6144):
        for blocks in (1, 4, 32, 64, 512):
            print(_speed_row(TurboCode(k=k), blocks, rng))
    code = TurboCode(k=1024)
    print("time of K=1024: ms of max-log and of log-MAP, ratio of the two")
    for blocks in (1, 2, 4, 64, 512):
        print(_ratio_row(code, blocks, rng))
    _, llr = noisy_blocks(code, 64, 1.0, rng)
    options = DecoderOptions(iterations=ITERATIONS, stop="none")
    (kernel,) = medians_s([lambda: code.decode(llr, iterations=ITERATIONS, stop="none")], 31)
    (slow,) = medians_s([lambda: oracle.decode(llr.astype(np.float64), interleaver(1024), options)], 3)
    (copy,) = medians_s([lambda: llr.copy()], 31)
    print(f"K=1024, 64 blocks: kernel {kernel * 1e3:.2f} ms, {64 * 1.024e-3 / kernel:.1f} Mbit/s")
    print(f"  NumPy reference {slow * 1e3:.0f} ms: ratio {slow / kernel:.0f}")
    print(f"  copy of the same LLRs {copy * 1e6:.0f} us: ratio {kernel / copy:.0f}")
    print(f"  per trellis step {kernel / (2 * ITERATIONS * 1024 * 64) * 1e9:.2f} ns")


def _speed_row(code: TurboCode, blocks: int, rng: np.random.Generator) -> str:
    _, llr = noisy_blocks(code, blocks, 1.0, rng)
    runs: list[tuple[Algorithm, Stop]] = [("max-log", "none"), ("max-log", "agreement"), ("log-map", "none")]
    times = medians_s([partial(code.decode, llr, algorithm=algorithm, stop=stop) for algorithm, stop in runs], 9)
    figures = [
        f"{algorithm}/{stop} {blocks * code.k * 1e-6 / seconds:6.2f}"
        for (algorithm, stop), seconds in zip(runs, times, strict=True)
    ]
    return f"K={code.k:5d} blocks={blocks:4d}  " + "  ".join(figures)


def _ratio_row(code: TurboCode, blocks: int, rng: np.random.Generator) -> str:
    """Time full iterations, and soft receiver use: early stopping and LLRs for coded bits."""
    _, llr = noisy_blocks(code, blocks, 1.0, rng)
    algorithms: list[Algorithm] = ["max-log", "log-map"]
    whole = [partial(code.decode, llr, algorithm=algorithm, stop="none") for algorithm in algorithms]
    soft = [partial(code.decode, llr, algorithm=algorithm, coded_output=True) for algorithm in algorithms]
    times = medians_s([*whole, *soft], 31 if blocks < 100 else 9)
    pairs = {"all iterations": times[:2], "as the soft receiver": times[2:]}
    figures = [f"{name} {a * 1e3:.2f} {b * 1e3:.2f} {b / a:.2f}" for name, (a, b) in pairs.items()]
    return f"blocks={blocks:4d}  " + "  ".join(figures)


def bler() -> None:
    """Print block error rates at K = 1024, mother rate, with 95 % Clopper-Pearson intervals."""
    points: list[tuple[Algorithm, Stop, float, int]] = [
        ("max-log", "none", 0.5, 20_480),
        ("max-log", "agreement", 0.5, 20_480),
        ("log-map", "none", 0.5, 20_480),
        ("max-log", "none", 1.0, 122_880),
        ("max-log", "agreement", 1.0, 122_880),
        ("log-map", "agreement", 1.0, 122_880),
    ]
    for point in points:
        print(_bler_row(*point), flush=True)


def _bler_row(algorithm: Algorithm, stop: Stop, ebn0_db: float, blocks: int) -> str:
    code, rng = TurboCode(k=1024), np.random.default_rng(2024)
    errors, iterations = 0, 0
    for _ in range(blocks // 1024):
        bits, llr = noisy_blocks(code, 1024, ebn0_db, rng)
        result = code.decode(llr, algorithm=algorithm, iterations=ITERATIONS, stop=stop)
        errors += int((result.bits != bits).any(axis=-1).sum())
        iterations += int(result.iterations.sum())
    low, high = beta.ppf(0.025, errors, blocks - errors + 1), beta.ppf(0.975, errors + 1, blocks - errors)
    return (
        f"{algorithm:8s} {stop:9s} Eb/N0 {ebn0_db} dB: {errors}/{blocks} = {errors / blocks:.3e} "
        f"[{low:.2e}, {high:.2e}], {iterations / blocks:.2f} iterations"
    )


def main() -> None:
    if "bler" in sys.argv[1:]:
        bler()
    else:
        speed()


if __name__ == "__main__":
    main()
