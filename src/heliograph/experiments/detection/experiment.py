"""Fig. 6: false detections of the all-on header and of the M-sequence, and identities, with pictures and verdicts."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from heliograph.experiments import plots
from heliograph.experiments.detection import ablation
from heliograph.experiments.detection.ablation import VARIANTS, DetectionScores
from heliograph.experiments.detection.clutter import ClutterFilm, backdrops
from heliograph.experiments.detection.identities import BESIDE_M, Confusion, confusion
from heliograph.experiments.detection.trials import (
    DISTANCES,
    FOUND,
    LAMPS,
    SCORE,
    DetectionEffort,
    DetectionTrials,
    false_alarms,
    found_above,
    found_at,
    is_lower,
    measure,
    threshold_of,
)
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict
from heliograph.link.simulate import load_imu
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.signal.header import IDENTITIES

COLOURS = (plots.PINK, plots.ORANGE, plots.GREEN, plots.BLUE)
"""Colour of each variant."""


def pictures(
    measured: DetectionTrials, alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> list[tuple[Figure, str]]:
    """All pictures, each with its caption."""
    shown = [
        (_roc(measured), "Arrays found against false alarms as the threshold falls, all scenes together; left: none."),
        (_matrices(alone), "Identity shown (down) and found (across; last column: missed), one array in view."),
        (_matrices(beside), "The same, two arrays of different identities in one view, both counted."),
    ]
    if measured.example:
        caption = "Fig. 6: a false detection of the all-on detector; frame, and difference of two frames."
        shown.insert(0, (_example(*measured.example), caption))
    return shown


def _example(score: float, film: ClutterFilm, pose: Pose) -> Figure:
    half = 8 * pose.pitch
    first, second = (film.frames[film.first + k].pixels.astype(float) for k in (0, 1))
    figure = Figure(figsize=(12, 3.4))
    shown = ((first, 0, 255, "frame"), (first - second, -80, 80, f"difference; score of the candidate {score:.2f}"))
    for axes, (image, low, high, title) in zip(figure.subplots(1, 2), shown, strict=True):
        axes.imshow(image, cmap="gray", vmin=low, vmax=high)
        corners_x, corners_y = (
            pose.x + half * np.array([-1, 1, 1, -1, -1]),
            pose.y + half * np.array([-1, -1, 1, 1, -1]),
        )
        axes.plot(corners_x, corners_y, color=plots.MARK, lw=1.2)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=10)
    figure.tight_layout()
    return figure


def _roc(measured: DetectionTrials) -> Figure:
    figure = Figure(figsize=(12, 5))
    for axes, distance in zip(figure.subplots(1, 3, sharey=True), DISTANCES, strict=True):
        # width of each variant's line, so that each shows where the next lies over it
        for variant, colour, width in zip(VARIANTS, COLOURS, (8.0, 5.5, 3.2, 1.4), strict=True):
            scores = measured.scores[variant.name]
            alarms, found = ablation.curve(scores.all_false(), scores.all_true(distance))
            least = 0.5 / scores.all_false().size
            axes.step(
                1000 * np.maximum(alarms, least),
                found,
                where="post",
                color=colour,
                lw=width,
                label=variant.name,
            )
        count, false = measured.set_found(distance), max(measured.set_false().rate, least)
        axes.plot(
            1000 * false, count.rate, "*", color=plots.BLACK, ms=15, label="receiver as set", clip_on=False, zorder=5
        )
        axes.set(
            xscale="log",
            xlim=(700 * least, 1000),
            ylim=(-0.03, 1.03),
            xlabel="false alarms in 1000 frames",
            title=f"{distance:g} m",
        )
        axes.xaxis.set_minor_formatter(NullFormatter())
        plots.tidy(axes)
    figure.axes[0].set_ylabel("fraction of arrays found")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure


def _matrices(confusions: Mapping[float, Confusion]) -> Figure:
    figure = Figure(figsize=(12, 3.4))
    for axes, (distance, one) in zip(figure.subplots(1, len(confusions)), confusions.items(), strict=True):
        rate = one.counts / np.maximum(one.counts.sum(1, keepdims=True), 1)
        axes.imshow(rate, cmap="Blues", vmin=0, vmax=1, interpolation="nearest")
        axes.axvline(29.5, color=plots.GRAY, lw=0.8)
        axes.set_title(f"{distance:g} m: {one.right.errors} of {one.right.trials} right", fontsize=9)
        axes.set(xlabel="found", xticks=[0, 10, 20, 30], yticks=[0, 10, 20])
        axes.set_xticklabels(["0", "10", "20", "none"])
    figure.axes[0].set_ylabel("shown")
    figure.tight_layout()
    return figure


FAR_M = 150.0
"""A distance in m beyond the paper's, at which identities are found all the same."""


def compared(measured: DetectionTrials) -> list[Finding]:
    """The paper's two claims about false detections at the receiver's own threshold, each by kind of scene."""
    groups = kinds(measured)
    return [
        *(_taken(measured, kind, scenes) for kind, scenes in groups.items()),
        *(_unique(measured, kind, scenes) for kind, scenes in groups.items()),
    ]


def kinds(measured: DetectionTrials) -> dict[str, list[str]]:
    """Scenes by kind: those filmed or drawn at rest, and the drawn lamps, which are made to deceive."""
    names = list(measured.scores[VARIANTS[0].name].false)
    groups = {
        "footage and a street at rest": [name for name in names if name != LAMPS],
        "drawn lamps": [name for name in names if name == LAMPS],
    }
    return {kind: scenes for kind, scenes in groups.items() if scenes}


def _taken(measured: DetectionTrials, kind: str, scenes: list[str]) -> Finding:
    all_on = measured.scores[VARIANTS[0].name]
    alarms = false_alarms(all_on, scenes=scenes)
    return Finding(
        f"Fig. 6: with all LEDs on, what is left of the background can be taken for the array: {kind}.",
        f"All on, 2 frames, score above {SCORE}, films with a false alarm: {_by_scene(all_on, scenes)}.",
        "holds" if alarms.errors else "differs",
        "" if alarms.errors else _nothing(all_on, alarms, scenes),
    )


def _nothing(scores: DetectionScores, alarms: Count, scenes: list[str]) -> str:
    """The reason why there was no false alarm: the best scores of the background."""
    highest = max((score for scene in scenes for score in scores.false[scene]), default=0.0)
    best = f"the best candidate in any scored {highest:.2f}" if highest else "none had a candidate"
    return (
        f"In none of these {alarms.trials} films was anything: {best}. What the shake leaves of them is edges; "
        "the round and rectangular lights that the paper names are among the lamps."
    )


def _unique(measured: DetectionTrials, kind: str, scenes: list[str]) -> Finding:
    all_on, paper = (measured.scores[VARIANTS[k].name] for k in (0, 2))
    fewer = is_lower(false_alarms(paper, scenes=scenes), false_alarms(all_on, scenes=scenes))
    verdicts: dict[bool | None, Verdict] = {True: "holds", False: "differs", None: "shown"}
    parts = [
        f"{VARIANTS[k].name}: films with a false alarm {_by_scene(s, scenes)}, found "
        f"{_of(found_above(s, scenes=scenes))}; above {threshold_of(s):.3f}, {_by_scene(s, scenes, threshold_of(s))}"
        for k, s in ((2, paper), (0, all_on))
    ]
    return Finding(
        f"Section IV-A: the M-sequence is unique in the background and makes detection reliable: {kind}.",
        f"Score above {SCORE}, and above the threshold that {FOUND:.0%} of all these arrays exceed. "
        f"{'. '.join(parts)}.",
        verdicts[fewer],
        "" if fewer is not None else "The intervals overlap: these films do not decide it.",
    )


def _by_scene(scores: DetectionScores, scenes: Collection[str], threshold: float = SCORE) -> str:
    """Films with a false alarm of each scene."""
    return ", ".join(f"{scene} {counted(false_alarms(scores, threshold, [scene]))}" for scene in scenes)


def identities_found(confusions: Mapping[float, Confusion], *, beside: bool = False) -> Finding:
    """Whether arrays are found with their own identities."""
    near = [one for z, one in confusions.items() if z in DISTANCES]
    wrong = Count(sum(c.wrong.trials for c in near), sum(c.wrong.errors for c in near))
    right = Count(sum(c.right.trials for c in near), sum(c.right.errors for c in near))
    far = confusions[FAR_M]
    return Finding(
        f"Section IV-A: arrays with different M-sequences are distinguished, {'two in view' if beside else 'alone'}.",
        f"At 25 m to 80 m: right {right.errors} of {right.trials} ({_range(right)}), taken for another "
        f"{wrong.errors} of {wrong.trials} ({_range(wrong)}); at {FAR_M:g} m right {far.right.errors} of "
        f"{far.right.trials}, taken for another {far.wrong.errors} of {far.wrong.trials}.",
        "holds" if not wrong.errors and right.rate >= FOUND else "differs",
    )


def ingredients(measured: DetectionTrials) -> Finding:
    """The effect of the header and of the number of frames."""
    parts = []
    for variant in VARIANTS:
        scores = measured.scores[variant.name]
        for kind, scenes in kinds(measured).items():
            parts.append(
                f"{variant.name}, {kind}: films with a false alarm {_by_scene(scores, scenes)}, found "
                f"{_of(found_above(scores, scenes=scenes))}"
            )
    return Finding(f"Asked: what each ingredient brings, score above {SCORE}.", "; ".join(parts) + ".", "shown")


def as_set(measured: DetectionTrials) -> Finding:
    """The receiver's detector with its own thresholds."""
    parts = []
    for kind, scenes in kinds(measured).items():
        false = ", ".join(f"{scene} {counted(measured.set_false([scene]))}" for scene in scenes)
        found = ", ".join(f"{z:g} m {_of(measured.set_found(z, scenes))}" for z in DISTANCES)
        parts.append(f"{kind}: films with a false alarm {false}, found {found}")
    return Finding("Asked: the receiver's detector as it is set.", "; ".join(parts) + ".", "shown")


def _of(count: Count) -> str:
    return f"{count.errors} of {count.trials}"


def _range(count: Count) -> str:
    low, high = count.interval()
    return f"{low:.1%}-{high:.1%}"


def counted(count: Count) -> str:
    """A count with its 95 % interval, as text."""
    return f"{_of(count)} ({_range(count)})"


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
