"""The soft receiver: calibration of its LLRs, and error of its distances."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.calibration.pictures import distance_errors, reliability_diagram
from heliograph.experiments.calibration.recorder import (
    FIRST,
    LAST,
    CalibrationFilm,
    CalibrationRecord,
    ReliabilityBin,
    ReliabilityCounts,
    record,
)
from heliograph.experiments.calibration.verdicts import DistanceErrors, accurate, by_distance, calibrated, rms_m
from heliograph.experiments.result import Context, ExperimentResult, Table
from heliograph.link.settings import load_settings

STATIC, DRIVING, WHOLE = "at rest", "driving", "whole drives"

QUICK_M = (40.0, 80.0, 125.0)
FULL_M = (25.0, 40.0, 60.0, 70.0, 80.0, 90.0, 100.0, 125.0, 150.0, 180.0, 210.0)

TEXT = (
    "Packets of the reference link at rest (one packet a film, the array at its own place on the pixel grid) and on "
    "the road at 30 km/h (three packets a film, road of class B), and whole drives from 80 m to 25 m, received blind "
    "by the soft receiver. LLRs: each LLR that the equaliser hands to the decoder predicts that its sign is wrong "
    "with the probability 1 / (1 + exp |LLR|); the observed rate stands beside it. First iteration: nothing is known "
    "yet. Last iteration: codewords that were not decoded at once, as they were last given to the decoder, with other "
    "layers cancelled or estimated. Distance: that of the packet, from the pitch in the image, against the true one in "
    "the packet's middle. The first packet has one header only; intervals of an rms take errors as independent and "
    "normal."
)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Predictions and distances of all packets."""

    # Bits by `FIRST` and `LAST`
    reliability: dict[str, ReliabilityCounts]
    # Rows of `CalibrationRecord.distances` by case
    distances: dict[str, Floats]

    @classmethod
    def of(cls, records: Iterable[CalibrationRecord]) -> "Calibration":
        """All records together."""
        reliability = {name: ReliabilityCounts() for name in (FIRST, LAST)}
        rows: dict[str, list[Floats]] = {}
        for one in records:
            rows.setdefault(one.case, []).append(one.distances)
            for name, counts in reliability.items():
                counts.include(one.reliability[name])
        return cls(reliability, {case: np.concatenate(parts) for case, parts in rows.items()})

    def plain(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "reliability": {name: counts.table.sum(0).tolist() for name, counts in self.reliability.items()},
            "distances": {case: rows.tolist() for case, rows in self.distances.items()},
        }


def run(context: Context) -> ExperimentResult:
    """Receive packets by distance; compare predictions and distances with the truth."""
    measured = Calibration.of(context.each("the soft receiver", record, films(context)))
    bins = {name: counts.bins() for name, counts in measured.reliability.items()}
    errors = by_distance(measured.distances)
    diagram = "Observed over predicted error probability; between the dashed lines it is as asked."
    return ExperimentResult(
        key="soft",
        title="The soft receiver: calibration of LLRs, and distances",
        text=TEXT,
        findings=[*(calibrated(name, part) for name, part in bins.items()), accurate(errors)],
        pictures=[
            (reliability_diagram(bins), diagram),
            (distance_errors(measured.distances), "Error of a packet's distance."),
        ],
        tables=[*(_reliability_table(name, part) for name, part in bins.items()), _distance_table(errors)],
        data=measured.plain(),
    )


def films(context: Context) -> list[CalibrationFilm]:
    """Films to be received; far ones, which take longest, first."""
    out = []
    for z in sorted(QUICK_M if context.quick else FULL_M, reverse=True):
        for case, preset, packets, count in ((STATIC, "static", 1, 24), (DRIVING, "paper", 3, 8)):
            channel = {"distance_m": z, "stop_m": 5.0}
            # the LLRs of the equaliser are counted, near packets included
            receive = {"receiver": "soft", "soft": {"led_by_led": False}}
            settings = load_settings(preset, {"channel": channel, "receive": receive})
            seeds = [1000 * context.seed + k for k in range(3 if context.quick else count)]
            out += [CalibrationFilm(case=case, settings=settings, seed=seed, packets=packets) for seed in seeds]
    whole = load_settings("paper", None, ["receive.receiver=soft"])
    seeds = [1000 * context.seed + k for k in range(3)]
    drives = [CalibrationFilm(case=WHOLE, settings=whole, seed=seed, packets=None) for seed in seeds]
    return out if context.quick else drives + out


def _reliability_table(name: str, bins: Sequence[ReliabilityBin]) -> Table:
    rows = [
        [
            one.range_text(),
            str(one.count.trials),
            str(one.count.errors),
            f"{one.expected:.1f}",
            one.ratio_text(),
        ]
        for one in bins
    ]
    head = ["predicted", "bits", "wrong", "expected", "ratio"]
    return Table(f"Bits by predicted error probability, {name}", head, rows)


def _distance_table(errors: Sequence[DistanceErrors]) -> Table:
    rows = []
    for one in errors:
        rms, least, most = rms_m(one.errors_m)
        spread = f"{rms:.3f} ({least:.3f} to {most:.3f})"
        place = f"{one.from_m:g} to {one.to_m:g} m"
        rows.append([one.case, place, str(len(one.errors_m)), spread, f"{one.errors_m.mean():+.3f}"])
    return Table("Error of distance in m", ["case", "distance", "packets", "rms (95 %)", "bias"], rows)
