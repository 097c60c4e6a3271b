"""Claims on flicker beside the measures."""

from collections.abc import Mapping

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.flicker.metrics import MFTP_S, SVM_LIMIT
from heliograph.experiments.flicker.signals import (
    ALL_ON,
    ALL_ON_BARE,
    ALL_ON_HEADER,
    BARE,
    DATA,
    HEADER,
    ORDER,
    ORDERED,
    PAIRS,
    SINGLE,
    STRETCH_S,
    STRETCHES,
    SignalFlicker,
    pair_means,
)
from heliograph.experiments.result import Finding, Verdict
from heliograph.signal import pwm


def findings(found: Mapping[str, SignalFlicker], waves: Mapping[str, Floats], slot_s: float) -> list[Finding]:
    """The paper's claims, and questions of our own."""
    ours, bare, header, all_on = (found[name] for name in (PAIRS, BARE, HEADER, ALL_ON_HEADER))
    means = pair_means(waves[PAIRS])
    same = int((np.abs(means - means[0]) < 1e-12).sum())
    return [
        Finding(
            "Section IV-B: inverted signals suppress flicker.",
            f"Mean light over {2e3 * pwm.SLOTS * slot_s:g} ms: equal in {same} of {means.size} pairs. Period "
            f"{ms_text(ours)} with inverses, {ms_text(bare)} without; largest modulation below 90 Hz "
            f"{ours.text('slow_percent', '.3f')} %, {ours.text('slow_limit_share')} of the limit, and "
            f"{bare.text('slow_percent', '.3f')} %, {bare.text('slow_limit_share')} of it. {_STATED}",
            _verdict(kept(ours, SLOW), _opposite(kept(bare, SLOW))),
        ),
        Finding(
            "Section V: the flicker is eliminated by the inverted signals.",
            f"Whole signal: {_all(ours)}. {_STATED}",
            _verdict(kept(ours)),
            "" if kept(ours) else f"Not kept in all: {', '.join(_broken(ours))}. {_why(found)}",
        ),
        Finding(
            "Asked: the header keeps the light steady too.",
            f"M-sequence header alone: {_all(header)}. All-on header alone: {_all(all_on)}. With "
            f"data, all-on: {_all(found[ALL_ON])}. {_STATED}",
            _verdict(kept(header), _opposite(kept(all_on))),
        ),
        Finding(
            "Asked: headers without inverses.",
            f"M-sequence: period {ms_text(bare)}; all on: period {ms_text(found[ALL_ON_BARE])}, "
            f"{found[ALL_ON_BARE].text('slow_limit_share', '.1f')} of the limit below 90 Hz. {_STATED}",
            "shown",
        ),
        Finding(
            "Asked: data without inverses (single mode, balanced by coding) flicker as pairs do.",
            f"Single mode: {_all(found[SINGLE])}; largest modulation below 90 Hz "
            f"{found[SINGLE].text('slow_percent', '.3f')} %. Pairs: {_all(ours)}; below 90 Hz "
            f"{ours.text('slow_percent', '.3f')} %. {_STATED}",
            _verdict(*(_no_more(found[SINGLE], ours, name) for name in ("slow_percent", "limit_share", "svm"))),
        ),
    ]


_STATED = f"Medians of {STRETCHES} stretches (5-95 %), bandwidth {1 / STRETCH_S:g} Hz."

LIMITS = {
    "IEEE 1789's low risk": ("limit_share", 1.0),
    f"SVM {SVM_LIMIT}": ("svm", SVM_LIMIT),
    f"{1e3 * MFTP_S:g} ms of IEEE 802.15.7": ("period_s", MFTP_S),
}
SLOW = {"below 90 Hz": ("slow_limit_share", 1.0), "period": ("period_s", MFTP_S)}
"""Limits of slow changes: measures and their largest values."""


def kept(one: SignalFlicker, limits: Mapping[str, tuple[str, float]] = LIMITS) -> bool | None:
    """Whether all limits are kept (by 95 % of the stretches) or one is broken (by 95 %); None: neither."""
    ranges = [(one.range(name), largest) for name, largest in limits.values()]
    if all(high <= largest for (_, _, high), largest in ranges):
        return True
    return False if any(low > largest for (low, _, _), largest in ranges) else None


def _no_more(one: SignalFlicker, other: SignalFlicker, name: str) -> bool:
    """Whether the median of a measure is at most the other's, a hundredth left for chance."""
    return one.range(name)[1] <= 1.01 * other.range(name)[1]


def _opposite(kept: bool | None) -> bool | None:
    return None if kept is None else not kept


def _verdict(*parts: bool | None) -> Verdict:
    """Whether all parts are true; "shown" where one is None and none is false."""
    if all(parts):
        return "holds"
    return "differs" if False in parts else "shown"


def _broken(one: SignalFlicker) -> list[str]:
    """Limits that are not kept in 95 % of the stretches."""
    return [what for what, (name, largest) in LIMITS.items() if one.range(name)[2] > largest]


def _why(found: Mapping[str, SignalFlicker]) -> str:
    """The part of the signal that breaks a limit."""
    data, header = found[DATA], found[HEADER]
    return (
        f"The header alone has SVM {header.text('svm')}, the data alone {data.text('svm')}: with one slot order for "
        f"all LEDs the array is brighter at the start of each T_b, {data.text('limit_share')} of the limit at "
        f"{data.hz()}. Slot order {', '.join(map(str, ORDER))} makes it {found[ORDERED].text('limit_share')} at "
        f"{found[ORDERED].hz()}, SVM {found[ORDERED].text('svm')}."
    )


def _all(one: SignalFlicker) -> str:
    return (
        f"{one.text('limit_share')} of IEEE 1789's limit at {one.hz()}, SVM {one.text('svm')} (limit {SVM_LIMIT}), "
        f"period {ms_text(one)}"
    )


def ms_text(one: SignalFlicker) -> str:
    """Flickering time period as text: median and range in ms."""
    return f"{one.text('period_s', '.3g', 1e3)} ms"
