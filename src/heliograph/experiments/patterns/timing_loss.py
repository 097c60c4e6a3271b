"""A pair of patterns filmed by a camera out of step: what the best combination of its frames loses, by computation."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.receive.sync import combine as partial_exposure
from heliograph.receive.sync.combine import Combination, combine_pair

PAIRS = 20
"""Pairs in a row through which a camera is followed."""

CASES = ((1.0, 1.0), (1.0, 0.75), (1.0, 0.5), (1.0, 0.25), (1.5, 2 / 3), (2.0, 0.5), (2.7, 0.37), (4.0, 0.25))
"""Frames a pattern, and exposure in T_b."""

TEXT = (
    "For each rate in frames a pattern, exposure in T_b and phase (start of the first exposure after that of a "
    "pattern, in T_b) the best combination of frames for a pair, means over a row of pairs. Slope: over the levels, by "
    "that of a camera in step. Noise: its standard deviation by that of the difference of two frames. Loss: noise over "
    "slope in dB, of the worst pair. Around: standard deviation of the pairs before and after in it, by that of the "
    "levels. Rest: the same of the part that is not linear in the levels. Bits: information on each symbol without "
    "noise, the pairs around known. Header: largest contrast of the header in any frame wholly within it."
)


@dataclass(frozen=True, slots=True)
class TimingLoss:
    """The best combinations of frames for pairs at a rate, an exposure and a phase."""

    # Frames a pattern, 1 or more
    rate: float
    # exposure, phase: exposure, and start of the first one after that of a pattern, in T_b
    exposure: float
    phase: float
    # Mean slope over the levels, as a ratio to that of a camera in step
    slope: float
    # Standard deviation of the noise, by that of the difference of two frames
    noise: float
    # Noise over slope of the worst pair in dB
    loss_db: float
    # Standard deviation of the light of the pairs before and after, by that of the levels
    around: float
    # Standard deviation of the part not linear in the levels, by that of the levels
    rest: float
    # Information on each symbol in bit without noise, the pairs around known, up to 1
    bits: float
    # Largest contrast of the header less its inverse in a frame wholly within the header, up to 1
    header: float


def measure() -> list[TimingLoss]:
    """All cases, at phases that cover a frame's period."""
    out = []
    for rate, exposure in CASES:
        step = 0.1 if rate == 1 else 0.25 / rate
        out += [timing_loss(rate, exposure, float(phase)) for phase in np.arange(0, 1 / rate - 1e-9, step)]
    return out


def timing_loss(rate: float, exposure: float, phase: float) -> TimingLoss:
    """The best combinations for some pairs in a row."""
    rows = np.array([_row(combination) for combination in _combinations(rate, exposure, phase)])
    with np.errstate(divide="ignore"):
        loss = 20 * np.log10(rows[:, 1] / rows[:, 0]).max()
    slope, noise, around, rest, bits = map(float, rows.mean(0))
    return TimingLoss(
        rate, exposure, phase, slope, noise, float(loss), around, rest, bits, _header(rate, exposure, phase)
    )


def _combinations(rate: float, exposure: float, phase: float) -> list[Combination | None]:
    """Best combinations for some pairs in a row; frame 0 begins `phase` after a pair."""
    starts = phase + np.arange(-2 * rate, (2 * PAIRS + 2) * rate) / rate
    near = [starts[(starts >= 2 * k - 1) & (starts <= 2 * k + 3)] - 2 * k for k in range(PAIRS)]
    return [combine_pair(part, exposure, (0, 1, 2, 3)) for part in near]


def _row(combination: Combination | None) -> Floats:
    """Slope, noise, pairs around, rest and bits."""
    if combination is None:
        return np.array([0.0, np.inf, np.nan, np.nan, 0.0])
    slots = combination.slots
    slope = float(slots[1] @ partial_exposure.SLOPES)
    around = sum(float(slots[q] @ partial_exposure.COVARIANCE @ slots[q]) for q in (0, 2))
    rest = float(slots[1] @ partial_exposure.COVARIANCE @ slots[1]) - slope**2
    _, counts = np.unique(np.round(combination.response, 6), axis=0, return_counts=True)
    bits = -float((counts / 16) @ np.log2(counts / 16)) / 4
    return np.array(
        [2 * slope, np.sqrt(combination.noise), np.sqrt(around) / slope, np.sqrt(max(rest, 0)) / slope, bits]
    )


def _header(rate: float, exposure: float, phase: float) -> float:
    """Largest magnitude of the header in a frame within a header of four patterns."""
    starts = phase + np.arange(-2 * rate, 6 * rate) / rate
    starts = starts[(starts > -1e-9) & (starts + exposure < 4 + 1e-9)]
    integral = np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    seen = [np.interp(t, range(5), integral) for t in (starts + exposure, starts)]
    return float(np.abs(seen[0] - seen[1]).max() / exposure)


def table(losses: Iterable[TimingLoss]) -> Table:
    """A row a case and phase."""
    head = ("rate", "exposure", "phase", "slope", "noise", "loss (dB)", "around", "rest", "bits", "header")
    return Table("The best combination for a pair", head, [_cells(one) for one in losses])


def _cells(one: TimingLoss) -> Sequence[str]:
    forms = {"rate": "g", "loss_db": ".1f"}
    return [format(getattr(one, field.name), forms.get(field.name, ".2f")) for field in fields(one)]


def run(context: Context) -> ExperimentResult:  # noqa: ARG001 - every experiment takes a context
    """Compute all cases."""
    losses = measure()
    in_step = [one for one in losses if one.rate == 1 and one.exposure == 1]
    worst = max(in_step, key=lambda one: one.loss_db)
    return ExperimentResult(
        key="timing-loss",
        title="Loss of a camera out of step",
        text=TEXT,
        findings=[
            Finding(
                "Asked: the loss where frames straddle two patterns.",
                f"With one frame a pattern, exposed through, at most {worst.loss_db:.1f} dB, at a phase of "
                f"{worst.phase:.1f} T_b.",
                "shown",
            )
        ],
        tables=[table(losses)],
        data={"cases": [_plain(one) for one in losses]},
    )


def _plain(one: TimingLoss) -> dict[str, float | None]:
    """Plain values; None where there is no number, which JSON does not have."""
    return {name: value if np.isfinite(value) else None for name, value in asdict(one).items()}
