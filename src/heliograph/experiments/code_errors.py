"""Block error rates of channel codes in white Gaussian noise; all codes and values of Eb/N0 have the same noise."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import figure_svg
from heliograph.measure.statistics import Count
from heliograph.signal.code import CodePlan

BATCH = 100  # blocks


def count_blocks(plan: CodePlan, ebn0_db: float, errors: int, blocks: int, seed: int = 1) -> Count:
    """Count wrong codewords until `errors` are wrong or `blocks` are counted, in batches; BPSK, 1 for bit 0.

    Eb is the energy of an information bit, the tail and the CRC of a code included.
    """
    code, count = plan.code, Count()
    variance = code.length / (2 * code.k * 10 ** (ebn0_db / 10))
    for batch in range(-(-blocks // BATCH)):
        n, rng = min(BATCH, blocks - batch * BATCH), np.random.default_rng([seed, batch])
        noise = rng.standard_normal((n, code.length))
        bits = rng.integers(0, 2, (n, code.k), dtype=np.uint8)
        samples = 1 - 2 * code.encode(bits).astype(float) + np.sqrt(variance) * noise
        count.add(n, int((code.decode(2 / variance * samples).bits != bits).any(axis=1).sum()))
        if count.errors >= errors:
            break
    return count


def draw(counts: Mapping[tuple[str, float], Count], names: Iterable[str]) -> bytes:
    """Draw block error rates with 95 % intervals over Eb/N0, as SVG."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot(xlabel="Eb/N0 (dB)", ylabel="block error rate", yscale="log")
    for name in names:
        points = [(ebn0, count) for (code, ebn0), count in counts.items() if code == name and count.errors]
        rates = np.array([count.rate for _, count in points])
        low, high = np.array([count.interval() for _, count in points]).reshape(-1, 2).T
        axes.errorbar(
            [ebn0 for ebn0, _ in points], rates, [rates - low, high - rates], label=name, capsize=3, marker="."
        )
    axes.legend()
    return figure_svg(figure)
