"""Light of an array before its header was found: a packet began earlier."""

from collections.abc import Sequence

import numpy as np

from heliograph.base.frames import Frame
from heliograph.receive.acquire.detection import Detection
from heliograph.receive.image.window import cut_out, window_around
from heliograph.signal.settings import SignalSettings

SHINES = 0.25
"""Least contrast of an array that sends data, as a fraction of the contrast of its header.

Chosen: data have 0.4 to 0.6 of it, a dark array 0.02 at 50 m and 0.15 at 100 m.
"""


def shone_before(detection: Detection, frames: Sequence[Frame], signal: SignalSettings) -> bool:
    """Return True if the last frame before a header shows the array with a pattern as well."""
    start_s, period_s = detection.start_time_s, signal.pattern_period_s
    end_s = start_s + 2 * signal.header_pairs * period_s
    before = [frame for frame in frames if frame.time_s < start_s - period_s / 2]
    header = [frame for frame in frames if start_s - period_s / 4 <= frame.time_s < end_s - period_s]
    if not before or not header:
        return False
    window = window_around(detection.fit.pose, signal.side, 0.0)
    contrasts = [float(cut_out(frame, window).std()) for frame in header]
    return float(cut_out(before[-1], window).std()) > SHINES * float(np.median(contrasts))
