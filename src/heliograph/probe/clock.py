"""The light's clock in the camera's, by the starts of packets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive import Packet
from heliograph.signal.settings import SignalSettings

START_ERROR = 0.02
"""Standard deviation in patterns of a packet's start by the soft receiver's clock: 0.005 to 0.02."""

TOLD_PPM = 200.0
"""Standard error of a clock's rate above which it is not told: quartz clocks differ by less."""

OUT_OF_STEP = 0.1
"""Phase in patterns from which on frames show two patterns."""


@dataclass(frozen=True, slots=True)
class Clock:
    """The light's clock in the camera's."""

    # When patterns begin after frames do, in patterns: -0.5 to 0.5, 0 in step
    phase: float
    # By how many millionths a pattern lasts longer than the settings say; None where it is not told
    rate_ppm: float | None
    # Its standard error; None where it is not told
    rate_error_ppm: float | None

    @property
    def in_step(self) -> bool:
        """Whether frames show one pattern each, if a pattern lasts a frame."""
        return abs(self.phase) <= OUT_OF_STEP


def clock_of(packets: Sequence[Packet], frames: Sequence[Frame], signal: SignalSettings) -> Clock:
    """The light's clock in the camera's, by the starts of packets."""
    starts: Floats = np.array([one.start_time_s for one in packets])
    steps = np.diff([one.time_s for one in frames])
    period_s = float(np.median(steps))
    after = (starts[0] - frames[0].time_s) / period_s
    phase = (after - round(after)) * period_s / signal.pattern_period_s
    numbers = np.round((starts - starts[0]) / signal.packet_s)
    if len(starts) < 2 or numbers[-1] < 1:
        return Clock(float(phase), None, None)
    spread = float(np.sqrt(((numbers - numbers.mean()) ** 2).sum()))
    error = START_ERROR * signal.pattern_period_s / (spread * signal.packet_s) * 1e6
    slope = float(np.polyfit(numbers, starts, 1)[0])
    told = error <= TOLD_PPM
    return Clock(float(phase), (slope / signal.packet_s - 1) * 1e6 if told else None, error if told else None)
