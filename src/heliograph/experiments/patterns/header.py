"""Header, sent and received near and at 25 m.

The header shows the 15 chips of the M-sequence on 4 x 4 cells; the 16th cell is dark. The header of each identity is
filmed at rest. A cell is read as lit if the mean luminance at the 16 LEDs exceeds the mean of the array.
"""

from heliograph.experiments import plots
from heliograph.experiments.patterns.received import led_points, luminance_at, static_frame
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, interval_text, verdict_of
from heliograph.measure.statistics import Count
from heliograph.signal.header import IDENTITIES, header_cells, header_levels
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence, periodic_correlation


def run(context: Context) -> ExperimentResult:
    """Film headers and read the cells."""
    identities, distances_m = range(0, IDENTITIES, 3 if context.quick else 1), (10.0, 25.0, 50.0, 80.0, 150.0)
    wrong = {z: _wrong_cells(z, identities, context.seed) for z in distances_m}
    levels = header_levels(0)
    images = [levels * 63, *(static_frame(z, levels, context.seed)[0].pixels for z in distances_m[:4])]
    names = ["sent", *(f"received at {z:g} m" for z in distances_m[:4])]
    rows = [[f"{z:g} m", str(c.errors), str(c.trials), interval_text(c, ".2%")] for z, c in wrong.items()]
    head, near = ["distance", "wrong", "of", "95 % interval"], wrong[25.0]
    peaks = [periodic_correlation(m_sequence(p), m_sequence(p)) for p in HEADER_POLYNOMIALS]
    caption = "The header of identity 0; Fig. 7 of the paper has another layout."
    return ExperimentResult(
        findings=[
            Finding(
                "Section IV-A: the 15-bit M-sequence of x^4 + x^3 + 1 has a good autocorrelation.",
                f"Periodic autocorrelation of both polynomials: {peaks[0][0]} at shift 0, "
                f"{peaks[0][1:].min()} to {peaks[0][1:].max()} at the 14 others.",
                verdict_of(all(p[0] == 15 and set(p[1:].tolist()) == {-1} for p in peaks)),
            ),
            Finding(
                "Fig. 7(b): the pattern is received at 25 m.",
                f"{near.errors} of {near.trials} cells read wrong at 25 m (rate {near.text()}).",
                verdict_of(not near.errors),
            ),
        ],
        pictures=[(plots.image_row(images, names), caption)],
        tables=[Table("Cells of the header read wrong, one frame each", head, rows)],
        data={"wrong_cells": {f"{z:g} m": [c.errors, c.trials] for z, c in wrong.items()}},
    )


def _wrong_cells(distance_m: float, identities: range, seed: int) -> Count:
    count = Count()
    for number in identities:
        frame, truth = static_frame(distance_m, header_levels(number), seed + number)
        light = luminance_at(frame, led_points(truth))
        lit = light.reshape(4, 4, 4, 4).mean((1, 3)) > light.mean()
        count.add(16, int((lit != (header_cells(number) > 0)).sum()))
    return count
