"""The paper's claims about detection beside what was counted."""

from collections.abc import Collection, Mapping

from heliograph.experiments.detection.ablation import VARIANTS, DetectionScores
from heliograph.experiments.detection.identities import Confusion
from heliograph.experiments.detection.trials import (
    DISTANCES,
    FOUND,
    LAMPS,
    SCORE,
    DetectionTrials,
    false_alarms,
    found_above,
    is_lower,
    threshold_of,
)
from heliograph.experiments.result import Finding, Verdict
from heliograph.measure.statistics import Count

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
