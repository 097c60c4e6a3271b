"""Arrays that are turned or seen from a side: tried with the corners that their light shows."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.probe.clock import clock_of
from heliograph.probe.light import LightRate
from heliograph.probe.reading import Asked, read
from heliograph.probe.trials import Found, receivers_tried, retimed
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE

EDGE = 0.5
"""Change from frame to frame at an array's edge over that within it: blur halves it there."""

MOST_TIMES = 64
"""Most pairs of frames of which the change is taken: LEDs then change by a tenth more or less than their mean."""

CLOSED = 5
"""Pixels across gaps that are closed between LEDs. An array of larger gaps is not found turned."""

LEAST_TURN_DEG, MOST_SKEW = 5.0, 1.1
"""Turn, and ratio of an outline's sides, up to which detectors find an array by themselves: no trial is needed."""

Corners = tuple[float, ...]
"""x and y in px of four corners in turn."""


def outline(frames: Sequence[Frame], centre: tuple[float, float]) -> tuple[Corners, float, float] | None:
    """Find the rectangle that holds what changes about a place."""
    step = max(1, (len(frames) - 1) // MOST_TIMES)
    pairs = [(frames[k].pixels, frames[k + 1].pixels) for k in range(0, len(frames) - 1, step)]
    power = np.mean([(b.astype(np.float32) - a) ** 2 for a, b in pairs], axis=0)
    change = cv2.blur(np.sqrt(power).astype(np.float32), (3, 3))
    bright = float(np.quantile(change, 0.98))
    dark = float(np.median([change[0].mean(), change[-1].mean(), change[:, 0].mean(), change[:, -1].mean()]))
    lit = (change > dark + EDGE * (bright - dark)).astype(np.uint8)
    lit = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, np.ones((CLOSED, CLOSED), np.uint8))
    shapes, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not shapes:
        return None
    x, y = frames[0].origin
    place = centre[0] - x, centre[1] - y
    shape = max(shapes, key=lambda one: cv2.pointPolygonTest(one, place, True))
    middle, sides, turn = cv2.minAreaRect(shape)
    # a contour runs through the middles of its outermost pixels
    wide, high = sides[0] + 1.0, sides[1] + 1.0
    points = np.add(cv2.boxPoints((middle, (wide, high), turn)), (x, y))
    corners = tuple(round(float(n), 1) for n in points.reshape(-1))
    return corners, (turn + 45) % 90 - 45, max(wide, high) / min(wide, high)


def what_reads_turned(
    frames: Sequence[Frame], asked: Asked, rate: LightRate, centre: tuple[float, float], form: Mapping[str, Any]
) -> Found | None:
    """Read a region by the corners that its light shows."""
    found = outline(frames, centre)
    if found is None or asked.signal.header != "m_sequence":
        return None
    corners, turn, skew = found
    if abs(turn) < LEAST_TURN_DEG and skew < MOST_SKEW:
        return None
    other = abs(rate.frames / asked.frames_a_pattern - 1) > STEP_TOLERANCE
    seen = retimed(frames, rate, asked.signal) if other else frames
    for receiver in receivers_tried(asked.settings, rate.frames):
        changed = {} if receiver == asked.settings.receiver else {"receiver": receiver}
        changes = {"signal": form, "receive": {**changed, "detect": {"corners": corners, "region": ()}}}
        tried = asked.changed(changes)
        reading = read(seen, tried.signal, tried.settings)
        if reading.read:
            good = [one for one in reading.packets if one.has_codeword]
            return Found(reading, changes, other, clock_of(good, seen, tried.signal))
    return None
