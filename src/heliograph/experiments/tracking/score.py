"""Errors of the trackers, summed up by film and tracker."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.tracking.runs import TrackingRun

NEAR_PX = 0.25
"""Largest error in px that counts as near."""

FEWEST = 10
"""Least pairs of a packet from which a straight line is taken out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingScore:
    """Errors of one tracker in one film."""

    # Pairs of frames tracked
    pairs: int
    # rms_px, q999_px: error of the array's centre in px: rms and the 99.9 % quantile over the pairs
    rms_px: float
    q999_px: float
    # Pairs with an error of up to 0.25 px
    near: int
    # Pairs with an error in x or y of more than half the array's side: in a cut-out twice as wide as the array a part
    # of it is missing
    lost: int
    # Rms error in px within a packet after its best straight line in time is taken out: the vibration left for a
    # receiver that finds the array again at each header and knows its mean motion
    shake_px: float
    # Relative rms error of the pitch; None where the tracker gives none
    pitch: float | None


ScoreTable = Mapping[str, Mapping[str, TrackingScore]]
"""By film and tracker."""


def scores(runs: Sequence[TrackingRun]) -> dict[str, dict[str, TrackingScore]]:
    """Scores of all trackers, by film and tracker."""
    return {run.name: {name: score(run, errors) for name, errors in run.errors.items()} for run in runs}


def score(run: TrackingRun, errors: Floats) -> TrackingScore:
    """Score of a tracker."""
    off = np.hypot(errors[:, 0], errors[:, 1])
    widest = np.abs(errors[:, :2]).max(1)
    pitch = None if np.isnan(errors[:, 2]).any() else float(np.sqrt(np.mean(errors[:, 2] ** 2)))
    return TrackingScore(
        pairs=len(off),
        rms_px=float(np.sqrt(np.mean(off**2))),
        q999_px=float(np.quantile(off, 0.999)),
        near=int((off <= NEAR_PX).sum()),
        lost=int((widest > run.side_px / 2).sum()),
        shake_px=_shake(run, errors[:, :2]),
        pitch=pitch,
    )


def _shake(run: TrackingRun, errors: Floats) -> float:
    rests = []
    for packet in np.unique(run.packet):
        part = run.packet == packet
        if part.sum() >= FEWEST:
            line = np.vander(run.times_s[part] - run.times_s[part][0], 2)
            way = np.linalg.lstsq(line, errors[part], rcond=None)[0]
            rests.append(errors[part] - line @ way)
    return float(np.sqrt(np.mean(np.sum(np.concatenate(rests) ** 2, axis=1)))) if rests else 0.0
