"""The soft receiver: are its bits as likely as it claims, and how far is the array?"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments.calibration.recorder import FIRST, LAST, Bin, Block, Claims, listen
from heliograph.experiments.result import Chapter, Context, Finding, Table, Verdict
from heliograph.link.settings import load_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

STATIC, DRIVING, WHOLE = "at rest", "driving", "whole drives"

QUICK_M = (40.0, 80.0, 125.0)
FULL_M = (25.0, 40.0, 60.0, 70.0, 80.0, 90.0, 100.0, 125.0, 150.0, 180.0, 210.0)

TOLERANCE = 0.1
"""Departure of observed from claimed error probability that is allowed, as a share."""

ENOUGH = 30
"""Errors claimed or observed from which on a bin is judged."""

GOOD_M, GOOD_TO_M = 0.25, 80.0
"""Rms error of distance that is asked for, and up to where."""

DISTANCE_BINS = (22.5, 32.5, 50.0, 65.0, 75.0, 82.5, 95.0, 110.0, 140.0, 165.0, 195.0, 225.0)

TEXT = (
    "Packets of the reference link at rest (one packet a film, the array at its own place on the pixel grid) and on "
    "the road at 30 km/h (three packets a film, road of class B), and whole drives from 80 m to 25 m, received blind "
    "by the soft receiver. Likelihood: each LLR that the equaliser hands to the decoder claims that its sign is wrong "
    "with the probability 1 / (1 + exp |LLR|); beside it stands how often it was. First round: nothing is known yet. "
    "Last round: codewords that were not decoded at once, as they were last given to the decoder, other layers "
    "cancelled or guessed. Distance: that of the packet, from the pitch in the image, against the true one in the "
    "packet's middle. The first packet has one header only; intervals of an rms take errors as independent and "
    "normal."
)


def run(context: Context) -> Chapter:
    """Receive packets by distance; compare claims and distances with the truth."""
    told = context.each("the soft receiver", listen, blocks(context))
    claims = {name: Claims() for name in (FIRST, LAST)}
    for one in told:
        for name, part in claims.items():
            part.include(one.claims[name])
    cases = dict.fromkeys(t.case for t in told)
    distances = {case: np.concatenate([t.distances for t in told if t.case == case]) for case in cases}
    parts = _parts(distances)
    return Chapter(
        key="soft",
        title="The soft receiver: likelihoods and distances",
        text=TEXT,
        findings=[
            *(_likelihood(name, part.bins()) for name, part in claims.items()),
            _accuracy(parts),
        ],
        pictures=[
            (_reliability(claims), "Observed over claimed error probability; between the dashed lines it is as asked."),
            (_errors(distances), "Error of a packet's distance."),
        ],
        tables=[*(_table(name, part.bins()) for name, part in claims.items()), _distance_table(parts)],
        data={
            "claims": {name: part.table.sum(0).tolist() for name, part in claims.items()},
            "distances": {case: rows.tolist() for case, rows in distances.items()},
        },
    )


def blocks(context: Context) -> list[Block]:
    """Films to be received; far ones take longest."""
    out = []
    for z in sorted(QUICK_M if context.quick else FULL_M, reverse=True):
        for case, preset, packets, count in ((STATIC, "static", 1, 24), (DRIVING, "paper", 3, 8)):
            channel = {"distance_m": z, "stop_m": 5.0}
            settings = load_settings(preset, {"channel": channel, "receive": {"receiver": "soft"}})
            seeds = range(3 if context.quick else count)
            out += [Block(case=case, settings=settings, seed=1000 * context.seed + k, packets=packets) for k in seeds]
    whole = load_settings("paper", None, ["receive.receiver=soft"])
    drives = [Block(case=WHOLE, settings=whole, seed=1000 * context.seed + k, packets=None) for k in range(3)]
    return out if context.quick else drives + out


def _judged(bins: Sequence[Bin]) -> list[Bin]:
    return [one for one in bins if max(one.count.errors, one.claimed * one.count.trials) >= ENOUGH]


def _likelihood(name: str, bins: Sequence[Bin]) -> Finding:
    """Whether observed and claimed error probabilities agree."""
    judged = _judged(bins)
    off = [one for one in judged if one.ratio()[1] > 1 + TOLERANCE or one.ratio()[2] < 1 - TOLERANCE]
    near = [one for one in judged if abs(one.ratio()[0] - 1) <= TOLERANCE]
    bits, errors = sum(one.count.trials for one in bins), sum(one.count.errors for one in bins)
    claimed = sum(one.claimed * one.count.trials for one in bins)
    ours = (
        f"{errors} of {bits} bits wrong, {claimed:.0f} claimed; of {len(judged)} bins with {ENOUGH} errors or more "
        f"{len(near)} are within {TOLERANCE:.0%}, {len(off)} apart for certain."
    )
    why = "Apart: " + "; ".join(f"{_range(one)}: {_ratio(one)}" for one in off) + "." if off else ""
    verdict: Verdict = "differs" if off else "holds" if judged else "shown"
    return Finding(f"Asked: claimed and observed error probability within 10 %, {name}.", ours, verdict, why)


def _range(one: Bin) -> str:
    return f"{one.edges[0]:g} to {one.edges[1]:g}"


def _ratio(one: Bin) -> str:
    ratio, low, high = one.ratio()
    return f"{ratio:.2f} ({low:.2f} to {high:.2f})" if one.count.trials and one.claimed else "-"


def _table(name: str, bins: Sequence[Bin]) -> Table:
    rows = [
        [
            _range(one),
            str(one.count.trials),
            str(one.count.errors),
            f"{one.claimed * one.count.trials:.1f}",
            _ratio(one) if one.count.trials else "-",
        ]
        for one in bins
    ]
    return Table(f"Bits by claimed error probability, {name}", ["claimed", "bits", "wrong", "expected", "ratio"], rows)


Part = tuple[str, float, float, Floats]
"""Case, from and to in m, errors of distance."""


def _parts(distances: dict[str, Floats]) -> list[Part]:
    """Errors by case and distance; first packets apart."""
    out: list[Part] = []
    for case, rows in distances.items():
        for name, chosen in (("first packet", rows[:, 2] == 0), ("later packets", rows[:, 2] > 0)):
            for low, high in pairwise(DISTANCE_BINS):
                here = rows[chosen & (rows[:, 0] >= low) & (rows[:, 0] < high) & np.isfinite(rows[:, 1])]
                if len(here):
                    out.append((f"{case}, {name}", low, high, here[:, 1] - here[:, 0]))
    return out


def _rms(errors: Floats) -> tuple[float, float, float]:
    """Rms and its 95 % interval."""
    from scipy.special import chdtri

    total, n = float((errors**2).sum()), len(errors)
    # sum of squares / sigma^2 is chi-square of n
    return (total / n) ** 0.5, (total / chdtri(n, 0.025)) ** 0.5, (total / chdtri(n, 0.975)) ** 0.5


def _accuracy(parts: Sequence[Part]) -> Finding:
    """Whether distances are as good as asked."""
    near = [part for part in parts if part[2] <= GOOD_TO_M + 2.5]
    worst = max(near, key=lambda part: _rms(part[3])[0])
    rms, low, high = _rms(worst[3])
    count = sum(len(part[3]) for part in near)
    pooled = _rms(np.concatenate([part[3] for part in near]))[0]
    return Finding(
        f"Asked: distance from one camera below {GOOD_M:g} m rms up to {GOOD_TO_M:g} m.",
        f"{count} packets to {GOOD_TO_M:g} m: {pooled:.3f} m rms; worst are {len(worst[3])} packets {worst[0]}, "
        f"{worst[1]:g} to {worst[2]:g} m: {rms:.3f} m ({low:.3f} to {high:.3f}).",
        "holds" if rms < GOOD_M else "differs",
        "Published: 0.5 m at 60 m from two cameras, 0.75 m within 100 m from an event camera.",
    )


def _distance_table(parts: Sequence[Part]) -> Table:
    rows = []
    for case, low, high, errors in parts:
        rms, least, most = _rms(errors)
        spread = f"{rms:.3f} ({least:.3f} to {most:.3f})"
        rows.append([case, f"{low:g} to {high:g} m", str(len(errors)), spread, f"{errors.mean():+.3f}"])
    return Table("Error of distance in m", ["case", "distance", "packets", "rms (95 %)", "bias"], rows)


def _reliability(claims: dict[str, Claims]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (name, part), colour in zip(claims.items(), ("#1b6ca8", "#d1741f"), strict=True):
        judged = _judged(part.bins())
        if judged:
            ratio, low, high = np.array([one.ratio() for one in judged]).T
            x = [one.claimed for one in judged]
            axes.errorbar(x, ratio, (ratio - low, high - ratio), color=colour, marker="o", ms=4, capsize=2, label=name)
    for line in (1 - TOLERANCE, 1 + TOLERANCE):
        axes.axhline(line, color="#8a929b", lw=0.8, ls="--")
    axes.set(xscale="log", yscale="log", xlabel="claimed error probability", ylabel="observed / claimed")
    axes.legend(frameon=False)
    return figure


def _errors(distances: dict[str, Any]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (case, rows), colour in zip(distances.items(), ("#1b6ca8", "#d1741f", "#5b8c3a"), strict=False):
        for first, marker in ((True, "o"), (False, ".")):
            here = rows[(rows[:, 2] == 0) == first]
            if len(here):
                label = f"{case}, {'first packet' if first else 'later packets'}"
                fill: Literal["none", "full"] = "none" if first else "full"
                error = here[:, 1] - here[:, 0]
                axes.plot(here[:, 0], error, marker, color=colour, label=label, fillstyle=fill, ms=4, alpha=0.6)
    for line in (-GOOD_M, GOOD_M):
        axes.axhline(line, color="#8a929b", lw=0.8, ls="--")
    axes.set(xlabel="distance (m)", ylabel="error (m)")
    axes.legend(frameon=False)
    return figure
