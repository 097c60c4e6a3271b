"""Claims on error rates beside what was counted."""

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from heliograph.experiments.error_rates.comparison import MARGIN, RISK, Comparison
from heliograph.experiments.error_rates.films import CountsByDistance, all_layers
from heliograph.experiments.result import Finding, Verdict
from heliograph.measure.errors import BIN_M
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS

LOST_MARGIN = 0.05
"""Difference of the fractions of packets lost up to which driving and static count as alike."""

RARE = 1e-2
"""Bound of the rate of wrong codewords below which a layer without a wrong one counts as free of error."""

TOO_MUCH = 0.13
"""Raw error rate from which on the code may be the reason of wrong codewords; rate 1/3 corrects about 0.15."""


def alike(found: Sequence[Comparison], driving: Count, static: Count) -> Finding:
    """Whether error rates and losses while driving are like those at rest."""
    single, pooled = ([c for c in found if (c.bin_m is None) == whole] for whole in (False, True))
    count = {name: sum(c.verdict == name for c in single) for name in ("alike", "apart", "open")}
    apart = "; ".join(f"{c.layer} at {c.bin_m:g} m: {c.ratio:.2f}" for c in single if c.verdict == "apart")
    ratios = ", ".join(f"{c.layer} {c.ratio:.2f} ({c.low:.2f} to {c.high:.2f})" for c in pooled)
    ours = (
        f"Raw errors driving over static, by packets at the same distances: {ratios or 'too few errors'}. "
        f"Of {len(single)} bins by layer {count['alike']} are alike within a factor {MARGIN:g}, "
        f"{count['apart']} apart, {count['open']} open{': ' + apart if apart else ''}. "
        f"Packets lost: {driving.errors} of {driving.trials} driving, {static.errors} of {static.trials} at rest."
    )
    claim = "The driving field trial shows tendencies similar to the static case."
    return Finding(claim, ours, *_judged(single, pooled, _loss(driving, static)))


def _loss(driving: Count, static: Count) -> Literal["alike", "apart", "open"]:
    """Whether more packets are lost driving, by Fisher's exact test; alike: surely not more by the margin."""
    from scipy.stats import fisher_exact

    if not driving.trials or not static.trials:
        return "open"
    table = [[one.errors, one.trials - one.errors] for one in (driving, static)]
    _, chance = fisher_exact(table, alternative="greater")
    if chance < RISK:
        return "apart"
    # bound of the difference: Newcombe 1998
    up, down = driving.interval()[1] - driving.rate, static.rate - static.interval()[0]
    return "alike" if driving.rate - static.rate + float(np.hypot(up, down)) < LOST_MARGIN else "open"


def _judged(single: Sequence[Comparison], pooled: Sequence[Comparison], loss: str) -> tuple[Verdict, str]:
    """Apart anywhere: it differs. Alike in each layer as a whole and in loss: it holds. Else it is not decided."""
    reasons = []
    if any(c.verdict == "apart" for c in (*single, *pooled)):
        reasons.append(f"They differ significantly (Holm, {RISK:g}) and by more than the margin.")
    if loss == "apart":
        reasons.append(f"Significantly more packets are lost driving (Fisher, one-sided, {RISK:g}).")
    if reasons:
        return "differs", " ".join(reasons)
    if pooled and all(c.verdict == "alike" for c in pooled) and loss == "alike":
        return "holds", ""
    return "shown", "Too few packets to decide."


def error_free(driving: CountsByDistance) -> Iterator[Finding]:
    """Whether the drive from 80 m to 25 m with a code of rate one-third is free of error, for each layer."""
    for name in LAYERS:
        words, missed = Count(), 0
        first: tuple[float, Count] | None = None
        for place, layers in sorted(driving.places.items()):
            here = layers[name]
            words.add(here.codewords, here.codeword_errors)
            missed += here.missed
            if first is None and here.codeword_errors:
                first = place - BIN_M / 2, here.raw
        ours = f"{words.errors} of {words.trials} codewords wrong while driving ({words.text()})"
        ours += "." if first is None else f", none of them nearer than {first[0]:g} m."
        claim = f"With a turbo code of rate one-third 25 m to 80 m are free of error while driving: {name} layer."
        if first is not None:
            yield Finding(claim, ours, "differs", _reasons(words.errors, missed, first[1]))
        elif words.interval()[1] < RARE:
            yield Finding(claim, ours, "holds")
        else:
            yield Finding(claim, ours, "shown", f"Too few codewords to bound the rate of wrong ones below {RARE:g}.")


def _reasons(wrong: int, missed: int, raw: Count) -> str:
    """Why codewords are wrong: their packets were missed; too many raw errors where the first of them are."""
    reasons = [f"{missed} of the {wrong} wrong codewords are of packets not received."] if missed else []
    if missed < wrong and raw.rate > TOO_MUCH:
        reasons.append(f"The raw error rate is {raw.text()} where the first are wrong, too much for rate 1/3.")
    return " ".join(reasons)


def keying(static: CountsByDistance, keyed: CountsByDistance) -> Finding:
    """Raw error rate of plain on-off keying beside those of the layers."""
    shared = [z for z in sorted(keyed.places) if z in static.places and z >= 50]
    parts, between = [], []
    for z in shared:
        one = all_layers(keyed.places[z])
        rates = {name: static.places[z][name].raw for name in LAYERS}
        if one.errors:
            parts.append(f"{z:g} m: {one.text()} beside {' / '.join(rates[name].text() for name in LAYERS)}")
            between.append(rates["high"].rate < one.rate)
    return Finding(
        "The hierarchical code protects its high layer: fewer errors than plain on-off keying at the same place.",
        f"Raw rates of on-off keying beside high / middle / low: {'; '.join(parts) or 'no errors from 50 m on'}.",
        "shown" if not between else "holds" if all(between) else "differs",
    )
