"""How many patterns a second a screen shows, by the frames alone: nobody need be told."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from heliograph.base.frames import Frame
from heliograph.probe.activity import LEAST_FRAMES, stretch_of
from heliograph.probe.light import light_rate
from heliograph.probe.regions import regions_of
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.signal.pwm import SLOT_ORDER

DISPLAYS_HZ = (60, 50, 72, 75, 90, 100, 120, 144, 165, 240)
"""Refreshes a second of usual displays, the most usual one first."""

OFFERED_HZ = (1, 2, 5, 10, 15, 20, 30, 60, 120)
"""Patterns a second about which page *Transmit* offers those that divide the display's refreshes."""

USUAL_HZ = [display / max(1, round(display / rate)) for display in DISPLAYS_HZ for rate in OFFERED_HZ]
"""Patterns a second that are taken for meant where one is near."""

NEAR = 0.01
"""Departure from a usual rate, as a fraction, that is taken for the measurement's. Chosen: three times that of 7 s."""

THINNED = (1, 4)
"""Every so many frames are looked at: a pattern of 1 s lasts 30 frames, more than `light_rate` tries."""

CEILING = 255
"""Full scale of 8 bits."""


def patterns_per_s(frames: Sequence[Frame]) -> float | None:
    """Return how many patterns a second some frames show; None where nothing blinks as patterns do."""
    told = [one for step in THINNED for one in _told(frames[::step])]
    return usual(max(told)[1]) if told else None


def _told(frames: Sequence[Frame]) -> Iterator[tuple[float, float]]:
    """How well a rate explains what a region shows, and the rate in patterns a second, for each region that tells."""
    if len(frames) < LEAST_FRAMES:
        return
    stretch = stretch_of(frames)
    regions, _ = regions_of(stretch, CEILING)
    period_s = frame_period(np.array([b.time_s - a.time_s for a, b in pairwise(frames)]))
    for region in regions:
        found = light_rate(stretch.frames, region, float(np.median(stretch.noise)), CEILING, SLOT_ORDER)
        if found is not None:
            yield found.explained, 1 / (found.frames * period_s)


def usual(rate_hz: float) -> float:
    """Return the usual rate near a measured one, or the measured one where none is."""
    for known, near in ((USUAL_HZ[: len(OFFERED_HZ)], NEAR / 2), (USUAL_HZ, NEAR)):
        nearest = min(known, key=lambda one: abs(one / rate_hz - 1))
        if abs(nearest / rate_hz - 1) < near:
            return float(nearest)
    return rate_hz
