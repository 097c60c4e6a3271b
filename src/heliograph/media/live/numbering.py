"""Numbers and times of a live camera's frames, by the camera's numbers and stamps, with counts of missing frames."""

from collections import deque

from heliograph.media.stamps import frame_period

LARGEST_SHORT = 65535
"""Largest number of a counter of 16 bits as in GigE Vision 1; the next number is 1, as 0 means none."""


class Numbering:
    """Gives frames numbers and times."""

    def __init__(self, rate_hz: float, even: bool):
        self.lost = self.incomplete = self.skipped = self.jumps = 0
        self.host_clock = False
        self.period_s = 1 / rate_hz
        self._even = even
        self._gaps: deque[float] = deque(maxlen=31)
        self._broken = 0
        # the last frame: number and time, number and stamp of the camera, arrival by the host's clock
        self._index, self._time_s = -1, 0.0
        self._number: int | None = None
        self._stamp_ns: int | None = None
        self._host_ns = 0
        # largest lead of the camera's clock over the host's clock: frames come late, never early
        self._ahead_ns: float | None = None

    @property
    def _knows_period(self) -> bool:
        """True if enough gaps replace the stated rate; three of eight may be long."""
        return len(self._gaps) >= 8

    def broke(self) -> None:
        """Count an incomplete frame, which has used up a number."""
        self.incomplete += 1
        self._broken += 1

    def restart(self) -> None:
        """Forget the camera's numbers and clock after a reconnection."""
        self._number = self._stamp_ns = self._ahead_ns = None

    def place(self, number: int | None, stamp_ns: int | None, host_ns: int) -> tuple[int, float] | None:
        """Return the number and the time in s of the next frame; None for a repeated frame."""
        self.host_clock = stamp_ns is None
        if self._index < 0:
            self._index = 0
        else:
            counted = _count_steps(self._number, number)
            is_later = self._stamp_ns is not None and stamp_ns is not None and stamp_ns > self._stamp_ns
            if counted == 0 or (counted is not None and counted < 0 and not is_later):
                return None
            self._advance(counted if counted and counted > 0 else None, stamp_ns, host_ns)
        self._note_clock(stamp_ns, host_ns)
        self._number, self._stamp_ns, self._host_ns, self._broken = number, stamp_ns, host_ns, 0
        return self._index, self._time_s

    def _advance(self, counted: int | None, stamp_ns: int | None, host_ns: int) -> None:
        """Move to a frame `counted` numbers after the last frame; None if the numbers are unknown."""
        stamped_s = self._stamp_gap(stamp_ns, host_ns)
        gap_s = max((host_ns - self._host_ns) / 1e9, self.period_s) if stamped_s is None else stamped_s
        periods = gap_s / self.period_s
        steps = counted or 1
        # a camera with numbers may be slower than stated, as gaps show
        is_sure = counted is None or (stamped_s is not None and self._knows_period)
        # a frame is missing if the stamp is late by 0.75 periods, as in `timing.camera_clock`
        if self._even and is_sure and periods >= steps + 0.75:
            if self._number is not None or self._stamp_ns is not None:  # the camera was not lost meanwhile
                self.skipped += max(0, round(periods) - steps - (0 if counted else self._broken))
            steps = round(periods)
        self.lost += max(0, (counted or 1) - 1 - self._broken)
        if stamped_s is not None or self._stamp_ns is None:
            self._gaps.append(gap_s / (counted or steps))
            if self._knows_period:
                self.period_s = frame_period(self._gaps)
        self._index, self._time_s = self._index + steps, self._time_s + gap_s

    def _stamp_gap(self, stamp_ns: int | None, host_ns: int) -> float | None:
        """Return the time in s since the last frame by the camera's clock; None after a jump, or if unknown."""
        if stamp_ns is None or self._stamp_ns is None:
            return None
        # setting a clock moves the time by more than 1 s, as by time of day in place of time since power-on
        early = self._ahead_ns is not None and stamp_ns - host_ns > self._ahead_ns + 1e9
        if stamp_ns <= self._stamp_ns or early:
            self.jumps += 1
            self._ahead_ns = None
            return None
        return (stamp_ns - self._stamp_ns) / 1e9

    def _note_clock(self, stamp_ns: int | None, host_ns: int) -> None:
        """Update the lead of the camera's clock; 1e-3 is five times the drift of poor quartz clocks."""
        if stamp_ns is None:
            return
        ahead_ns = float(stamp_ns - host_ns)
        if self._ahead_ns is not None:
            ahead_ns = max(ahead_ns, self._ahead_ns - 1e-3 * (host_ns - self._host_ns))
        self._ahead_ns = ahead_ns


def _count_steps(last: int | None, number: int | None) -> int | None:
    """Return the numbers from a frame to the next; below 1 for a late or repeated frame, None if unknown."""
    if number is None or last is None:
        return None
    steps = number - last
    if steps < 0 and last <= LARGEST_SHORT and steps + LARGEST_SHORT <= LARGEST_SHORT // 2:
        return steps + LARGEST_SHORT
    return steps if steps >= -64 else None  # a larger step back is a new count
