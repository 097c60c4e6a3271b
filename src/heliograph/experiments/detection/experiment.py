"""Fig. 6: false detections of the all-on header and of the M-sequence, and identities."""

from collections.abc import Mapping
from typing import Any

from heliograph.experiments.detection import ablation
from heliograph.experiments.detection.ablation import VARIANTS
from heliograph.experiments.detection.clutter import backdrops
from heliograph.experiments.detection.identities import BESIDE_M, Confusion, confusion
from heliograph.experiments.detection.pictures import pictures
from heliograph.experiments.detection.trials import (
    DISTANCES,
    FOUND,
    SCORE,
    DetectionEffort,
    DetectionTrials,
    found_at,
    measure,
    threshold_of,
)
from heliograph.experiments.detection.verdicts import FAR_M, as_set, compared, counted, identities_found, ingredients
from heliograph.experiments.result import Context, ExperimentResult, Table
from heliograph.link.recordings import load_imu
from heliograph.measure.statistics import Count
from heliograph.signal.header import IDENTITIES

TEXT = (
    "Short films of the reference link with and without an array, before footage of a moving camera, a drawn street, "
    "and a street full of lamps that move, flicker with the mains, are pulsed at 100 Hz to 1000 Hz, turn as beacons "
    "or are matrix signs with rows lit in turn; all with the shake of the car. In each film four variants of the "
    "detector search for the header, with no threshold on the score: for the lit array's shape or for the M-sequences "
    "of 30 identities, in the difference of two frames or in f0 - 3 f1 + 3 f2 - f3 of four. All use the receiver's "
    "search and fit, on the same scenes, shake and noise. Candidates of three ranges of size are kept apart, since "
    "parts of a lit square are lit squares. The score is the correlation of pixels and fitted header. A false alarm is "
    "a film without an array in which a candidate exceeds the threshold. An array counts as found where a candidate at "
    "its place, of its size, and (M-sequence) of its identity exceeds the threshold. Arrays are searched at their "
    "place only, false alarms in whole frames: that an array is found means that its own candidate passes, not that "
    "no other place in the frame scores higher. Between frames of a clip the channel fades, so things that move by "
    "themselves change evenly there, which four frames cancel and two do not; the shake moves the whole scene frame by "
    "frame. Two thresholds: the receiver's own of 0.9, and the one that 95 % of these arrays exceed, which can be so "
    "high only because the arrays are clean, sharp and unhidden. Footage and the street at rest are judged apart from "
    "the street full of lamps, which is drawn to deceive. Three times as many films are taken of the lamps as of each "
    "other scene; the curves, and the table of arrays found at equal false alarms, are of this mixture, which no road "
    "has. The receiver beside these has all its checks, also that the header's frames alternate in step. Identities: "
    f"each filmed alone, and with an array of another identity {BESIDE_M[0]:g} m to {BESIDE_M[1]:g} m beside it in the "
    "same view, their packets not in step; each array is found, or missed, at its own place. Intervals are "
    "Clopper-Pearson, 95 %."
)


QUICK, FULL = DetectionEffort(6, 3, 16, 1), DetectionEffort(75, 20, 220, 10)


def run(context: Context, effort: DetectionEffort | None = None) -> ExperimentResult:
    """Film, search, compare."""
    effort = effort or (QUICK if context.quick else FULL)
    imu = load_imu(context.imu) if context.imu else None
    scenes = backdrops(context.clips, effort.reach)
    measured = measure(scenes, effort, imu, context)
    places, shown = (*DISTANCES, FAR_M), range(0, IDENTITIES, effort.step)
    alone = confusion(places, scenes, effort.repeats, imu, context, (0.7, 0.9), shown)
    # each film counts two
    films = -(-effort.repeats // 2)
    beside = confusion(places, scenes, films, imu, context, (0.9, 1.0), shown, beside=True)
    return ExperimentResult(
        key="fig6",
        title="Fig. 6: false detections and identities",
        text=TEXT,
        findings=[
            *compared(measured),
            identities_found(alone),
            identities_found(beside, beside=True),
            ingredients(measured),
            as_set(measured),
        ],
        pictures=pictures(measured, alone, beside),
        tables=[_found_table(measured), *_scene_tables(measured), _identity_table(alone, beside)],
        data=_data(measured, alone, beside),
    )


def _found_table(measured: DetectionTrials) -> Table:
    """Arrays found where at most 1 % of the films without one give an alarm; and as set."""
    rows = [
        [variant.name, *(counted(found_at(measured.scores[variant.name], z, 0.01)) for z in DISTANCES)]
        for variant in VARIANTS
    ]
    rows.append(["receiver as set", *(counted(measured.set_found(z)) for z in DISTANCES)])
    return Table(
        "Arrays found at no more than 10 false alarms in 1000 frames",
        ["variant", *(f"{z:g} m" for z in DISTANCES)],
        rows,
    )


def _scene_tables(measured: DetectionTrials) -> list[Table]:
    """False alarms by scene, at the receiver's threshold and at that for `FOUND`."""
    fixed = {variant.name: SCORE for variant in VARIANTS}
    fitted = {variant.name: threshold_of(measured.scores[variant.name]) for variant in VARIANTS}
    return [
        _scene_table(measured, fixed, "Films with a false alarm at the receiver's threshold"),
        _scene_table(
            measured, fitted, f"Films with a false alarm at the threshold that {FOUND:.0%} of the arrays exceed"
        ),
    ]


def _scene_table(measured: DetectionTrials, thresholds: Mapping[str, float], title: str) -> Table:
    rows = []
    for name, threshold in thresholds.items():
        scores = measured.scores[name]
        counts = [Count(len(f), sum(s > threshold for s in f)) for f in scores.false.values()]
        rows.append([name, f"{threshold:.3f}", *map(counted, counts)])
    return Table(title, ["variant", "threshold", *measured.scores[VARIANTS[0].name].false], rows)


def _identity_table(alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]) -> Table:
    rows = [
        [f"{z:g} m, {what}", counted(c.right), counted(c.wrong), counted(c.missed)]
        for what, by in (("alone", alone), ("two in view", beside))
        for z, c in by.items()
    ]
    return Table("Identities", ["distance", "right", "taken for another (of those found)", "missed"], rows)


def _data(
    measured: DetectionTrials, alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> dict[str, Any]:
    return {
        "scores": ablation.plain(measured.scores),
        "receiver": {
            "false": {scene: [c.errors, c.trials] for scene, c in measured.receiver_false.items()},
            "found": {f"{scene}, {z:g} m": [c.errors, c.trials] for (scene, z), c in measured.receiver_found.items()},
        },
        "identities": {f"{z:g} m": c.counts.tolist() for z, c in alone.items()},
        "identities_two_in_view": {f"{z:g} m": c.counts.tolist() for z, c in beside.items()},
    }
