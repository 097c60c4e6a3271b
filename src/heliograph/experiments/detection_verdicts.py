"""The paper's claims about detection beside what was counted."""

from collections.abc import Mapping

from heliograph.experiments.candidates import WAYS, Scores
from heliograph.experiments.chapter import Finding, Verdict
from heliograph.experiments.detection_trials import (
    DISTANCES,
    FOUND,
    SCORE,
    Measured,
    false_alarms,
    found_above,
    less,
    threshold_of,
)
from heliograph.experiments.identities import Confusion
from heliograph.link.statistics import Count

FAR_M = 150.0
"""Beyond the paper's distances, where identities are told apart all the same."""


def compared(measured: Measured) -> list[Finding]:
    """The paper's two claims about false detections, judged at the receiver's own threshold."""
    all_on, paper = (measured.scores[WAYS[k].name] for k in (0, 2))
    alarms = false_alarms(all_on)
    fewer = less(false_alarms(paper), alarms)
    verdicts: dict[bool | None, Verdict] = {True: "holds", False: "differs", None: "shown"}
    clean = ", ".join(
        f"{WAYS[k].name} {false_alarms(s, threshold_of(s)).errors} of {alarms.trials} above {threshold_of(s):.3f}"
        for k, s in ((0, all_on), (2, paper))
    )
    return [
        Finding(
            "Fig. 6: with all LEDs on, what is left of the background can be taken for the array.",
            f"All on, 2 frames, score above {SCORE}: {_alarms(alarms)}.",
            "holds" if alarms.errors else "differs",
            _where(all_on),
        ),
        Finding(
            "Section IV-A: the M-sequence is unique in the background and makes detection reliable.",
            f"Score above {SCORE}: M-sequence, 2 frames, {_alarms(false_alarms(paper))}, found "
            f"{_of(found_above(paper))}; all on, 2 frames, {_alarms(alarms)}, found {_of(found_above(all_on))}. At the "
            f"thresholds that {FOUND:.0%} of these arrays exceed: {clean}.",
            verdicts[fewer],
            "" if fewer is not None else "The intervals overlap: more films are needed to tell.",
        ),
    ]


def _where(scores: Scores) -> str:
    """Which scenes gave false alarms and which gave none."""
    counts = {scene: Count(len(f), sum(s > SCORE for s in f)) for scene, f in scores.false.items()}
    some = [f"{scene} ({_of(count)})" for scene, count in counts.items() if count.errors]
    none = [f"{scene} ({_of(count)})" for scene, count in counts.items() if not count.errors]
    return f"By scene: {', '.join(some) or 'none'} with false alarms; {', '.join(none) or 'none'} without any."


def told_apart(told: Mapping[float, Confusion]) -> Finding:
    """Several arrays by their M-sequences."""
    near = [one for z, one in told.items() if z in DISTANCES]
    wrong = Count(sum(c.wrong.trials for c in near), sum(c.wrong.errors for c in near))
    right = Count(sum(c.right.trials for c in near), sum(c.right.errors for c in near))
    far = told[FAR_M]
    return Finding(
        "Section IV-A: arrays with different M-sequences are told apart.",
        f"At 25 m to 80 m: right {right.errors} of {right.trials} ({_range(right)}), taken for another "
        f"{wrong.errors} of {wrong.trials} ({_range(wrong)}); at {FAR_M:g} m right {far.right.errors} of "
        f"{far.right.trials}, taken for another {far.wrong.errors} of {far.wrong.trials}.",
        "holds" if not wrong.errors and right.rate >= FOUND else "differs",
    )


def ingredients(measured: Measured) -> Finding:
    """What the header and the number of frames each bring."""
    parts = []
    for way in WAYS:
        scores = measured.scores[way.name]
        parts.append(f"{way.name}: {_alarms(false_alarms(scores))}, found {_of(found_above(scores))}")
    return Finding(f"Asked: what each ingredient brings, score above {SCORE}.", "; ".join(parts) + ".", "shown")


def as_set(measured: Measured) -> Finding:
    """The receiver's detector with its own thresholds."""
    found = ", ".join(f"{z:g} m {c.errors} of {c.trials}" for z, c in sorted(measured.receiver_found.items()))
    return Finding(
        "Asked: the receiver's detector as it is set.", f"{_alarms(measured.receiver_false)}; found {found}.", "shown"
    )


def _alarms(count: Count) -> str:
    low, high = (1000 * rate for rate in count.interval())
    return (
        f"{1000 * count.rate:.0f} false alarms in 1000 frames ({count.errors} of {count.trials}, {low:.0f}-{high:.0f})"
    )


def _of(count: Count) -> str:
    return f"{count.errors} of {count.trials}"


def _range(count: Count) -> str:
    low, high = count.interval()
    return f"{low:.1%}-{high:.1%}"


def counted(count: Count) -> str:
    """A count with its interval, as text."""
    return f"{_of(count)} ({_range(count)})"
