"""How many patterns a second a screen shows, by the frames alone: nobody need be told."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from heliograph.base.frames import Frame
from heliograph.probe.activity import LEAST_FRAMES, stretch_of
from heliograph.probe.light import light_rate
from heliograph.probe.regions import regions_of
from heliograph.receive.timing.camera_clock import frame_period
from heliograph.signal.pwm import SLOT_ORDER

USUAL_HZ = (1, 2, 3, 4, 5, 6, 7.5, 8, 10, 12, 15, 20, 24, 25, 30, 40, 48, 50, 60, 72, 80, 120)
"""Patterns a second that are taken for meant where one is near: those that divide usual displays' rates."""

NEAR = 0.015
"""Departure from a usual rate, as a fraction, that is taken for the measurement's."""

THINNED = (1, 4)
"""Every so many frames are looked at: a pattern of 1 s lasts 30 frames, more than `light_rate` tries."""

CEILING = 255
"""Full scale of 8 bits."""


def patterns_per_s(frames: Sequence[Frame]) -> float | None:
    """Return how many patterns a second some frames show; None where nothing blinks as patterns do.

    Parameters
    ----------
    frames
        Frames of 8 bits in the order of time, some dozens.
    """
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
    """Return the usual rate near a measured one, or the measured one where none is.

    Parameters
    ----------
    rate_hz
        Patterns a second as measured.
    """
    nearest = min(USUAL_HZ, key=lambda one: abs(one / rate_hz - 1))
    return float(nearest if abs(nearest / rate_hz - 1) < NEAR else rate_hz)
