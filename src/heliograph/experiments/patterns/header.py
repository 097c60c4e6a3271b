"""Fig. 7: the header's M-sequence, sent and received near and at 25 m."""

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments import plots
from heliograph.experiments.patterns.received import led_points, luminance_at, static_frame
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.measure.statistics import Count
from heliograph.signal.header import IDENTITIES, header_cells, header_levels
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence, periodic_correlation

NEAR_M, PAPER_M = 10.0, 25.0
DISTANCES = (NEAR_M, PAPER_M, 50.0, 80.0, 150.0)

TEXT = (
    "The 15 chips of the M-sequence on 4 x 4 cells, the 16th dark. Each identity's header is filmed at rest; a cell is "
    "read as lit where the light at its 16 LEDs' places is above the mean of the array."
)


def run(context: Context) -> ExperimentResult:
    """Film headers and read their cells."""
    wrong = measure(range(0, IDENTITIES, 3 if context.quick else 1), context.seed)
    pictures = [
        header_levels(0) * 63,
        *(static_frame(z, header_levels(0), context.seed)[0].pixels for z in DISTANCES[:4]),
    ]
    names = ["sent", *(f"received at {z:g} m" for z in DISTANCES[:4])]
    return ExperimentResult(
        key="fig7",
        title="Fig. 7: the header",
        text=TEXT,
        findings=[_autocorrelation(), _received(wrong[PAPER_M])],
        pictures=[
            (plots.image_row(pictures, names), "The header of identity 0 (another layout than the paper's Fig. 7).")
        ],
        tables=[
            Table(
                "Cells of the header read wrong, one frame each",
                ["distance", "wrong", "of", "95 % interval"],
                [[f"{z:g} m", str(c.errors), str(c.trials), _interval(c)] for z, c in wrong.items()],
            )
        ],
        data={"wrong_cells": {f"{z:g} m": [c.errors, c.trials] for z, c in wrong.items()}},
    )


def measure(identities: range, seed: int) -> dict[float, Count]:
    """Cells read wrong, by distance in m."""
    return {z: _wrong_cells(z, identities, seed) for z in DISTANCES}


def _autocorrelation() -> Finding:
    peaks = [periodic_correlation(m_sequence(p), m_sequence(p)) for p in HEADER_POLYNOMIALS]
    good = all(p[0] == 15 and set(p[1:].tolist()) == {-1} for p in peaks)
    return Finding(
        "Section IV-A: the 15-bit M-sequence of x^4 + x^3 + 1 has a good autocorrelation.",
        f"Periodic autocorrelation of both polynomials: {peaks[0][0]} at shift 0, "
        f"{peaks[0][1:].min()} to {peaks[0][1:].max()} at the 14 others.",
        "holds" if good else "differs",
    )


def _received(wrong: Count) -> Finding:
    return Finding(
        "Fig. 7(b): the pattern is received at 25 m.",
        f"{wrong.errors} of {wrong.trials} cells read wrong at {PAPER_M:g} m (rate {wrong.text()}).",
        "holds" if not wrong.errors else "differs",
    )


def _wrong_cells(distance: float, identities: range, seed: int) -> Count:
    count = Count()
    for number in identities:
        frame, truth = static_frame(distance, header_levels(number), seed + number)
        count.add(16, int((_cells(luminance_at(frame, led_points(truth))) != (header_cells(number) > 0)).sum()))
    return count


def _cells(light: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(light.reshape(4, 4, 4, 4).mean((1, 3)) > light.mean())


def _interval(count: Count) -> str:
    low, high = count.interval()
    return f"{low:.2%} to {high:.2%}"
