"""Claims on other systems beside what was counted."""

from collections.abc import Mapping

from heliograph.experiments.plots import LAYER_COLOURS
from heliograph.experiments.result import Finding
from heliograph.experiments.systems.curves import CURVES, Points, error_free_m, range_m

KASASHIMA_M = {"plain": 40.0, "inverse": 60.0}
"""Distances to which the field trial of Kasashima et al. 2013 was free of error."""


def findings(points: Mapping[str, Points]) -> list[Finding]:
    """All claims."""
    plain, inverse, known = (points[curve.name] for curve in CURVES[:3])
    return [
        field_trial(
            "Kasashima et al. 2013: on-off keying is free of error to 40 m without the inverse.",
            KASASHIMA_M["plain"],
            plain,
        ),
        field_trial(
            "Kasashima et al. 2013: with the inverse, the channel known, it is free of error to 60 m.",
            KASASHIMA_M["inverse"],
            known,
        ),
        field_trial(
            "Asked: the same to 60 m with pose and blur as the receiver finds them by itself.",
            KASASHIMA_M["inverse"],
            inverse,
            "with the pose known see above: what is left is the estimate's error, most of it of the pitch, which the "
            "inverse does not forgive where LEDs lie closer than pixels, in some places on the pixel grid",
        ),
        _against(points),
    ]


def field_trial(claim: str, claimed_m: float, points: Points, why: str = "") -> Finding:
    """The field trial's distance beside ours: it holds if there is no error to there, and some within 10 m more."""
    here = [count for z, count in points if z <= claimed_m]
    beyond = [(z, count) for z, count in points if claimed_m < z <= claimed_m + 10]
    wrong, bits = sum(c.errors for c in here), sum(c.trials for c in here)
    free = error_free_m(points)
    further = "; ".join(f"{z:g} m: {c.text()}" for z, c in beyond)
    at = next((c.text() for z, c in points if z == claimed_m), "not measured")
    ours = (
        f"{wrong} errors of {bits} bits to {claimed_m:g} m ({at} there); no error to "
        f"{f'{free[0]:g} m' if free else 'any distance'}. Beyond: {further}."
    )
    holds = bool(bits) and not wrong and any(c.errors for _, c in beyond)
    return Finding(claim, ours, "holds" if holds else "differs", "" if holds else why)


def _against(points: Mapping[str, Points]) -> Finding:
    """The hierarchical code beside plain keying: what is left of it further out."""
    limit = 1e-2
    keyed = range_m(points["on-off keying"], limit)
    layers = {name: range_m(points[f"hierarchical, {name}"], limit) for name in LAYER_COLOURS}
    text = ", ".join(f"{name} {_metres(z)}" for name, z in layers.items())
    repeat = range_m(points["on-off keying, 2 x 2 LEDs a bit"], limit)
    high = layers["high"]
    holds = high is not None and keyed is not None and high > keyed
    return Finding(
        "The hierarchical code sends its high layer further than plain keying, in the same pattern as the rest.",
        f"BER 1e-2 before any code: on-off keying {_metres(keyed)}; hierarchical {text}; 2 x 2 LEDs a bit, with the "
        f"bits of the high layer alone, {_metres(repeat)}.",
        "holds" if holds else "differs",
        "Repetition reaches further than the high layer, for it puts all of its light there." if holds else "",
    )


def _metres(z: float | None) -> str:
    return "beyond what was measured" if z is None else f"{z:.0f} m"
