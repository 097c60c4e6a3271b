"""Fig. 6: false detections of the all-on header and of the M-sequence, and identities told apart."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.experiments.detection import ablation as cand
from heliograph.experiments.detection.ablation import WAYS
from heliograph.experiments.detection.clutter import Film, backdrops
from heliograph.experiments.detection.identities import BESIDE_M, Confusion, confusion
from heliograph.experiments.detection.trials import (
    DISTANCES,
    FOUND,
    SCORE,
    Effort,
    Measured,
    found_at,
    measure,
    threshold_of,
)
from heliograph.experiments.detection.verdicts import FAR_M, as_set, compared, counted, ingredients, told_apart
from heliograph.experiments.result import Chapter, Context, Table
from heliograph.link.recordings import load_imu
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.signal.header import IDENTITIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#b5446e", "#d1741f", "#5b8c3a", "#1b6ca8")

TEXT = (
    "Short films of the reference link with and without an array, before footage of a moving camera, a drawn street, "
    "and a street full of lamps that move, flicker with the mains, are pulsed at 100 Hz to 1000 Hz, turn as beacons "
    "or are matrix signs with rows lit in turn; all with the shake of the car. In each, four ways of detecting look "
    "for the header with no threshold on the score: the lit array's shape or the M-sequences of 30 identities, in the "
    "difference of two frames or in f0 - 3 f1 + 3 f2 - f3 of four. All use the receiver's search and fit, on the same "
    "scenes, shake and noise; candidates of three ranges of size are kept apart, since parts of a lit square are lit "
    "squares. The score is the correlation of pixels and fitted header. A false alarm is a film without an array in "
    "which a candidate exceeds the threshold. An array "
    "counts as found where a candidate at its place, of its size, and (M-sequence) of its identity exceeds the "
    "threshold. Arrays are looked for at their place only, false alarms in whole frames: a found array says that its "
    "own candidate passes, not that nothing else in the frame scores higher. "
    "Between frames of a clip the channel fades, so things that move by themselves change evenly there, "
    "which four frames cancel and two do not; the shake moves the whole scene frame by frame. Two thresholds: the "
    "receiver's own of 0.9, and the one that 95 % of these arrays exceed, which is as high as only clean, sharp, "
    "unhidden arrays allow. Footage and the still street are judged apart from the street full of lamps, which is "
    "drawn to deceive. Of the lamps three times as many films are taken as of each other scene; the curves, and the "
    "table of arrays found at equal false alarms, are of this mixture, which no road has. The receiver beside these "
    "has all its checks, also that the header's frames alternate in step. Identities: each filmed alone, and with an "
    f"array of another identity {BESIDE_M[0]:g} m to {BESIDE_M[1]:g} m beside it in the same view, their packets not "
    "in step; each array is found, or missed, at its own place. Intervals are Clopper-Pearson, 95 %."
)


QUICK, FULL = Effort(6, 3, 16, 1), Effort(75, 20, 220, 10)


def run(context: Context, effort: Effort | None = None) -> Chapter:
    """Film, search, compare."""
    effort = effort or (QUICK if context.quick else FULL)
    imu = load_imu(context.imu) if context.imu else None
    scenes = backdrops(context.clips, effort.reach)
    measured = measure(scenes, effort, imu, context)
    places, shown = (*DISTANCES, FAR_M), range(0, IDENTITIES, effort.step)
    told = confusion(places, scenes, effort.repeats, imu, context, (0.7, 0.9), shown)
    # each film counts two
    films = -(-effort.repeats // 2)
    beside = confusion(places, scenes, films, imu, context, (0.9, 1.0), shown, beside=True)
    return Chapter(
        key="fig6",
        title="Fig. 6: false detections, and identities told apart",
        text=TEXT,
        findings=[
            *compared(measured),
            told_apart(told),
            told_apart(beside, beside=True),
            ingredients(measured),
            as_set(measured),
        ],
        pictures=_pictures(measured, told, beside),
        tables=[_found_table(measured), *_scene_tables(measured), _identity_table(told, beside)],
        data=_data(measured, told, beside),
    )


def _found_table(measured: Measured) -> Table:
    """Arrays found where at most 1 % of the films without one give an alarm; and as set."""
    rows = [[way.name, *(counted(found_at(measured.scores[way.name], z, 0.01)) for z in DISTANCES)] for way in WAYS]
    rows.append(["receiver as set", *(counted(measured.set_found(z)) for z in DISTANCES)])
    return Table(
        "Arrays found at no more than 10 false alarms in 1000 frames", ["way", *(f"{z:g} m" for z in DISTANCES)], rows
    )


def _scene_tables(measured: Measured) -> list[Table]:
    """False alarms by scene, at the receiver's threshold and at that for `FOUND`."""
    fixed = {way.name: SCORE for way in WAYS}
    fitted = {way.name: threshold_of(measured.scores[way.name]) for way in WAYS}
    return [
        _scene_table(measured, fixed, "Films with a false alarm at the receiver's threshold"),
        _scene_table(
            measured, fitted, f"Films with a false alarm at the threshold that {FOUND:.0%} of the arrays exceed"
        ),
    ]


def _scene_table(measured: Measured, thresholds: Mapping[str, float], title: str) -> Table:
    rows = []
    for name, threshold in thresholds.items():
        scores = measured.scores[name]
        counts = [Count(len(f), sum(s > threshold for s in f)) for f in scores.false.values()]
        rows.append([name, f"{threshold:.3f}", *map(counted, counts)])
    return Table(title, ["way", "threshold", *measured.scores[WAYS[0].name].false], rows)


def _identity_table(told: Mapping[float, Confusion], beside: Mapping[float, Confusion]) -> Table:
    rows = [
        [f"{z:g} m, {what}", counted(c.right), counted(c.wrong), counted(c.missed)]
        for what, by in (("alone", told), ("two in view", beside))
        for z, c in by.items()
    ]
    return Table("Identities", ["distance", "right", "taken for another (of those found)", "missed"], rows)


def _pictures(
    measured: Measured, told: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> list[tuple["Figure", str]]:
    pictures = [
        (_roc(measured), "Arrays found against false alarms as the threshold falls, all scenes together; left: none."),
        (_matrices(told), "Identity shown (down) and found (across; last column: missed), one array in view."),
        (_matrices(beside), "The same, two arrays of different identities in one view, both counted."),
    ]
    if measured.example:
        caption = "Fig. 6: a false detection of the all-on detector; frame, and difference of two frames."
        pictures.insert(0, (_example(*measured.example), caption))
    return pictures


def _example(score: float, film: Film, pose: Pose) -> "Figure":
    from matplotlib.figure import Figure

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
        axes.plot(corners_x, corners_y, color="#ff6b35", lw=1.2)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=10)
    figure.tight_layout()
    return figure


def _roc(measured: Measured) -> "Figure":
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(12, 4))
    for axes, distance in zip(figure.subplots(1, 3, sharey=True), DISTANCES, strict=True):
        for way, colour in zip(WAYS, COLOURS, strict=True):
            scores = measured.scores[way.name]
            alarms, found = cand.curve(scores.all_false(), scores.all_true(distance))
            least = 0.5 / scores.all_false().size
            axes.step(1000 * np.maximum(alarms, least), found, where="post", color=colour, lw=1.6, label=way.name)
        count, false = measured.set_found(distance), max(measured.set_false().rate, least)
        axes.plot(1000 * false, count.rate, "*", color="#1d2126", ms=11, label="receiver as set")
        axes.set(
            xscale="log",
            xlim=(700 * least, 1000),
            ylim=(-0.03, 1.03),
            xlabel="false alarms in 1000 frames",
            title=f"{distance:g} m",
        )
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
    figure.axes[0].set_ylabel("share of arrays found")
    figure.axes[-1].legend(frameon=False, fontsize=8, loc="lower right")
    figure.tight_layout()
    return figure


def _matrices(told: Mapping[float, Confusion]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 3.4))
    for axes, (distance, one) in zip(figure.subplots(1, len(told)), told.items(), strict=True):
        share = one.counts / np.maximum(one.counts.sum(1, keepdims=True), 1)
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1, interpolation="nearest")
        axes.axvline(29.5, color="#8a929b", lw=0.8)
        axes.set_title(f"{distance:g} m: {one.right.errors} of {one.right.trials} right", fontsize=9)
        axes.set(xlabel="found", xticks=[0, 10, 20, 30], yticks=[0, 10, 20])
        axes.set_xticklabels(["0", "10", "20", "none"])
    figure.axes[0].set_ylabel("shown")
    figure.tight_layout()
    return figure


def _data(measured: Measured, told: Mapping[float, Confusion], beside: Mapping[float, Confusion]) -> dict[str, Any]:
    return {
        "scores": cand.plain(measured.scores),
        "receiver": {
            "false": {scene: [c.errors, c.trials] for scene, c in measured.receiver_false.items()},
            "found": {f"{scene}, {z:g} m": [c.errors, c.trials] for (scene, z), c in measured.receiver_found.items()},
        },
        "identities": {f"{z:g} m": c.counts.tolist() for z, c in told.items()},
        "identities_two_in_view": {f"{z:g} m": c.counts.tolist() for z, c in beside.items()},
    }
