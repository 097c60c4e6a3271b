"""False detections of the all-on header and of the M-sequence, and identities.

Short films of the reference link with and without an array. Backgrounds are footage of a moving camera, a drawn street,
and a street full of lamps: moving, flickering with the mains, pulsed at 100 Hz to 1000 Hz, rotating beacons, and matrix
signs with rows lit in turn. All films include the shake of the car.

Four variants of the detector search each film for the header with no score threshold. They search for the lit array or
for the M-sequences of 30 identities, in the difference of two frames or in f0 - 3 f1 + 3 f2 - f3 of four. All use the
search and fit of the receiver, on the same scenes, shake and noise. Three size ranges have separate candidates, since
parts of a lit square are lit squares. The score is the correlation of pixels and fitted header. A false alarm is a film
with no array and a candidate above the threshold. An array is found if a candidate of this place, size and (M-sequence)
identity exceeds the threshold. Arrays are searched only at the true place, false alarms in full frames: other places in
the frame may score higher than an array. The channel fades between frames of a clip, so moving objects change evenly,
which cancels in four frames but not in two; the shake moves the scene frame by frame.

Two thresholds apply: 0.9 as in the receiver, and the threshold that 95 % of these arrays exceed, which is high because
the arrays are clean, sharp and unoccluded. Footage and the street at rest are judged separately from the street full of
lamps, which is designed to deceive and has three times as many films. Curves, and the table of arrays found at equal
false alarms, use this mixture. The receiver has all its checks, for instance of alternating frames. Identities are
filmed separately, and with an array of another identity 0.5 m to 1.2 m away, with unsynchronised packets; each array is
searched at the true place. Intervals are Clopper-Pearson, 95 %.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.detection.clutter import LAMPS, ClutterFilm, Surroundings, backdrops
from heliograph.experiments.detection.trials import (
    DISTANCES_M,
    FOUND,
    RECEIVER,
    SCORE,
    Confusion,
    DetectionScores,
    Example,
    Scores,
    confusion,
    measure,
)
from heliograph.experiments.detection.variants import PAPER, REFERENCE, VARIANTS
from heliograph.experiments.report import (
    Context,
    ExperimentResult,
    Finding,
    Table,
    count_text,
    interval_text,
    verdict_of,
)
from heliograph.link.simulate import load_imu
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.signal.header import IDENTITIES

FAR_M = 150.0
"""Distance in m beyond the range of the paper."""


@dataclass(frozen=True, slots=True)
class DetectionEffort:
    """Number of films."""

    # Films of each scene with no array, and with an array at each distance
    without: int
    with_array: int
    # Frames of a clip, from the first on
    reach: int
    # Films of an identity at each distance
    repeats: int
    # Step between filmed identities
    step: int = 1


def run(context: Context, effort: DetectionEffort | None = None) -> ExperimentResult:
    """Search films for false detections and identities."""
    effort = effort or (DetectionEffort(6, 3, 16, 1) if context.quick else DetectionEffort(75, 20, 220, 10))
    scenes, imu = backdrops(context.clips, effort.reach), load_imu(context.imu) if context.imu else None
    surroundings = Surroundings(scenes, imu, context.seed)
    scores, example = measure(surroundings, effort.without, effort.with_array, context)
    places, shown, repeats = (*DISTANCES_M, FAR_M), range(0, IDENTITIES, effort.step), effort.repeats
    alone = confusion(surroundings, places, shown, repeats, context, (0.7, 0.9))
    # a film counts two arrays
    beside = confusion(surroundings, places, shown, -(-repeats // 2), context, (0.9, 1.0), two_in_view=True)
    return report(scores, example, alone, beside)


def report(
    scores: Scores, example: Example | None, alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> ExperimentResult:
    """Judge, draw and tabulate scores and identities."""
    pictures = [
        (_roc(scores), "Arrays found against false alarms for falling thresholds, all scenes together; left: none."),
        (_matrices(alone), "Identity shown (down) and found (across; last column: missed), a single array in view."),
        (_matrices(beside), "The same, two arrays of different identities in view, both counted."),
    ]
    if example:
        caption = "Fig. 6: a false detection of the all-on detector; frame, and difference of two frames."
        pictures.insert(0, (_example(*example), caption))
    return ExperimentResult(
        findings=[
            *compared(scores),
            _identities_found(alone, "alone"),
            _identities_found(beside, "two in view"),
            ingredients(scores),
            _receiver_finding(scores),
        ],
        pictures=pictures,
        tables=[*_score_tables(scores), _identity_table(alone, beside)],
        data={
            "scores": {name: _plain(scores[name], "true", _rounded) for name in VARIANTS},
            "receiver": _plain(scores[RECEIVER], "found", _counts),
            "identities": {f"{z:g} m": c.counts.tolist() for z, c in alone.items()},
            "identities_two_in_view": {f"{z:g} m": c.counts.tolist() for z, c in beside.items()},
        },
    )


def _plain(scores: DetectionScores, true: str, plain: Callable[[list[float]], list[float]]) -> dict[str, Any]:
    """Plain values of the scores, by scene, and with the key `true` by scene and distance."""
    return {
        "false": {scene: plain(values) for scene, values in scores.false.items()},
        true: {f"{scene}, {z:g} m": plain(values) for (scene, z), values in scores.true.items()},
    }


def _rounded(scores: list[float]) -> list[float]:
    return [round(score, 4) for score in scores]


def _counts(scores: list[float]) -> list[float]:
    return [int(sum(scores)), len(scores)]


@plots.styled
def _example(score: float, film: ClutterFilm, pose: Pose) -> Figure:
    first, second = (film.frames[film.first + k].pixels.astype(float) for k in (0, 1))
    figure = Figure(figsize=(12, 3.4))
    panels = figure.subplots(1, 2, subplot_kw={"xticks": [], "yticks": []})
    shown = ((first, 0, 255, "frame"), (first - second, -80, 80, f"difference; score of the candidate {score:.2f}"))
    for axes, (image, low, high, title) in zip(panels, shown, strict=True):
        axes.imshow(image, vmin=low, vmax=high)
        axes.set_title(title)
        plots.mark_square(axes, pose.x, pose.y, 8 * pose.pitch)
    return figure


def curve(false: Floats, true: Floats) -> tuple[list[float], list[float]]:
    """Fractions of false alarms and of arrays found for falling thresholds."""
    thresholds = np.unique(np.concatenate([false, true, [0.0, 1.0]]))[::-1]
    alarms, found = ([float((scores > t).mean()) for t in thresholds] for scores in (false, true))
    return alarms, found


@plots.styled
def _roc(measured: Scores) -> Figure:
    figure = Figure(figsize=(12, 5))
    smallest = 0.5 / max(measured[REFERENCE].all_false().size, 1)
    # lines of different widths stay visible below each other
    styles = (("C3", 8.0), (plots.ORANGE, 5.5), (plots.GREEN, 3.2), (plots.BLUE, 1.4))
    for axes, distance in zip(figure.subplots(1, 3, sharey=True), DISTANCES_M, strict=True):
        for name, (colour, width) in zip(VARIANTS, styles, strict=True):
            alarms, found = curve(measured[name].all_false(), measured[name].all_true(distance))
            rates = 1000 * np.maximum(alarms, smallest)
            axes.step(rates, found, where="post", color=colour, lw=width, label=name)
        receiver = measured[RECEIVER]
        false, found_rate = max(receiver.false_alarms().rate, smallest), receiver.found(distance_m=distance).rate
        axes.plot(1000 * false, found_rate, "*", color="black", ms=15, label=RECEIVER, clip_on=False, zorder=5)
        axes.set(xscale="log", xlim=(700 * smallest, 1000), ylim=(-0.03, 1.03))
        axes.set(xlabel="false alarms in 1000 frames", title=f"{distance:g} m")
        axes.xaxis.set_minor_formatter(NullFormatter())
    figure.axes[0].set_ylabel("fraction of arrays found")
    plots.legend_below(figure)
    return figure


@plots.styled
def _matrices(confusions: Mapping[float, Confusion]) -> Figure:
    figure = Figure(figsize=(12, 3.4))
    for axes, (distance, one) in zip(figure.subplots(1, len(confusions)), confusions.items(), strict=True):
        rate = one.counts / np.maximum(one.counts.sum(1, keepdims=True), 1)
        axes.imshow(rate, cmap="Blues", vmin=0, vmax=1)
        axes.grid(visible=False)
        axes.axvline(29.5, color=plots.GRAY, lw=0.8)
        axes.set(xlabel="found", xticks=[0, 10, 20, 30], yticks=[0, 10, 20])
        axes.set_title(f"{distance:g} m: {count_text(one.right)} right")
        axes.set_xticklabels(["0", "10", "20", "none"])
    figure.axes[0].set_ylabel("shown")
    return figure


def compared(measured: Scores) -> list[Finding]:
    """Judge the two claims about false detections at the threshold of the receiver, by kind of scene."""
    groups = _kinds(measured)
    return [
        *(_false_alarms(measured, kind, scenes) for kind, scenes in groups.items()),
        *(_unique(measured, kind, scenes) for kind, scenes in groups.items()),
    ]


def _kinds(measured: Scores) -> dict[str, list[str]]:
    """Scenes by kind: recorded and drawn scenes at rest, and the drawn lamps."""
    names = list(measured[REFERENCE].false)
    groups = {
        "footage and a street at rest": [name for name in names if name != LAMPS],
        "drawn lamps": [name for name in names if name == LAMPS],
    }
    return {kind: scenes for kind, scenes in groups.items() if scenes}


def _false_alarms(measured: Scores, kind: str, scenes: list[str]) -> Finding:
    all_on = measured[REFERENCE]
    alarms, why = all_on.false_alarms(scenes=scenes), ""
    if not alarms.errors:
        highest = max(chain.from_iterable(all_on.false[scene] for scene in scenes), default=0.0)
        best = f"the best candidate scored {highest:.2f}" if highest else "none had a candidate"
        why = (
            f"No false alarm in {alarms.trials} films: {best}. The shake leaves only edges of the background; the "
            "round and rectangular lights of the paper are among the lamps."
        )
    return Finding(
        f"Fig. 6: with all LEDs on, the rest of the background can be mistaken for the array: {kind}.",
        f"All on, 2 frames, score above {SCORE}, films with a false alarm: {_by_scene(all_on, scenes)}.",
        verdict_of(bool(alarms.errors)),
        why,
    )


def _unique(measured: Scores, kind: str, scenes: list[str]) -> Finding:
    alarms = {name: measured[name].false_alarms(scenes=scenes) for name in (PAPER, REFERENCE)}
    fewer, parts = is_lower(alarms[PAPER], alarms[REFERENCE]), []
    for name in alarms:
        scores, fitted = measured[name], measured[name].fitted_threshold()
        parts.append(f"{_summary(name, scores, scenes)}; above {fitted:.3f}, {_by_scene(scores, scenes, fitted)}")
    return Finding(
        f"Section IV-A: the M-sequence is unique in the background and makes detection reliable: {kind}.",
        f"Score above {SCORE}, and above the threshold that {FOUND:.0%} of all these arrays exceed. "
        f"{'. '.join(parts)}.",
        verdict_of(fewer),
        "" if fewer is not None else "The intervals overlap: these films do not decide the claim.",
    )


def is_lower(a: Count, b: Count) -> bool | None:
    """True if a rate is lower than another; None if their 95 % intervals overlap."""
    if a.interval()[1] < b.interval()[0]:
        return True
    return False if a.interval()[0] > b.interval()[1] else None


def _by_scene(scores: DetectionScores, scenes: Collection[str], threshold: float = SCORE) -> str:
    """Films with a false alarm, by scene."""
    return ", ".join(f"{scene} {counted(scores.false_alarms(threshold, [scene]))}" for scene in scenes)


def _summary(name: str, scores: DetectionScores, scenes: list[str]) -> str:
    """False alarms and arrays found at the threshold of the receiver."""
    found = count_text(scores.found(scenes=scenes))
    return f"{name}: films with a false alarm {_by_scene(scores, scenes)}, found {found}"


def _identities_found(confusions: Mapping[float, Confusion], view: str) -> Finding:
    """Check the identities of detected arrays."""
    wrong, right = Count(), Count()
    for z in DISTANCES_M:
        wrong.include(confusions[z].wrong)
        right.include(confusions[z].right)
    far = confusions[FAR_M]
    return Finding(
        f"Section IV-A: arrays with different M-sequences are distinguished, {view}.",
        f"At 25 m to 80 m: right {counted(right)}, taken for another {counted(wrong)}; at {FAR_M:g} m right "
        f"{count_text(far.right)}, taken for another {count_text(far.wrong)}.",
        verdict_of(not wrong.errors and right.rate >= FOUND),
    )


def ingredients(measured: Scores) -> Finding:
    """Effect of the header and of the number of frames."""
    parts = [
        _summary(f"{name}, {kind}", measured[name], scenes)
        for name in VARIANTS
        for kind, scenes in _kinds(measured).items()
    ]
    claim = f"Question: the effect of header and number of frames, score above {SCORE}."
    return Finding(claim, "; ".join(parts) + ".", "shown")


def _receiver_finding(measured: Scores) -> Finding:
    """Results of the detector of the receiver."""
    parts, receiver = [], measured[RECEIVER]
    for kind, scenes in _kinds(measured).items():
        found = ", ".join(f"{z:g} m {count_text(receiver.found(scenes=scenes, distance_m=z))}" for z in DISTANCES_M)
        parts.append(f"{kind}: films with a false alarm {_by_scene(receiver, scenes)}, found {found}")
    return Finding("Question: the receiver's detector with default settings.", "; ".join(parts) + ".", "shown")


def counted(count: Count) -> str:
    """Count with 95 % interval as text."""
    return f"{count_text(count)} ({interval_text(count, '.1%', '-')})"


def _score_tables(measured: Scores) -> list[Table]:
    """Arrays found at 1 % of false alarms, and false alarms by scene at both thresholds."""
    rows = [[name, *(counted(measured[name].found_at(z, 0.01)) for z in DISTANCES_M)] for name in VARIANTS]
    rows.append([RECEIVER, *(counted(measured[RECEIVER].found(distance_m=z)) for z in DISTANCES_M)])
    tables = [
        Table(
            "Arrays found at no more than 10 false alarms in 1000 frames",
            ["variant", *(f"{z:g} m" for z in DISTANCES_M)],
            rows,
        )
    ]
    fitted = {name: measured[name].fitted_threshold() for name in VARIANTS}
    scenes = list(measured[REFERENCE].false)
    for thresholds, title in (
        (dict.fromkeys(VARIANTS, SCORE), "the receiver's threshold"),
        (fitted, f"the threshold that {FOUND:.0%} of the arrays exceed"),
    ):
        rows = [
            [name, f"{t:.3f}", *(counted(measured[name].false_alarms(t, [scene])) for scene in scenes)]
            for name, t in thresholds.items()
        ]
        tables.append(Table(f"Films with a false alarm at {title}", ["variant", "threshold", *scenes], rows))
    return tables


def _identity_table(alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]) -> Table:
    rows = [
        [f"{z:g} m, {view}", counted(c.right), counted(c.wrong), counted(c.missed)]
        for view, by_distance in (("alone", alone), ("two in view", beside))
        for z, c in by_distance.items()
    ]
    return Table("Identities", ["distance", "right", "taken for another (of those found)", "missed"], rows)
