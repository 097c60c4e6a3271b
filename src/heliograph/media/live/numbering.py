"""Numbers and times of a live camera's frames, by its own numbers and stamps; what is lost is counted."""

from collections import deque
from dataclasses import dataclass

LARGEST_SHORT = 65535
"""Largest number of cameras that count by 16 bits, as GigE Vision 1 does: the number after it is 1, as 0 is none."""

REORDERED = 64
"""Numbers by which a frame may come late, after others. Chosen; no library tried hands frames out of order."""

KNOWN_GAPS = 8
"""Gaps between frames from which on their median is taken for the frame period; the camera's word serves until then.
Chosen: three of them may be long."""

REMEMBERED_GAPS = 31
"""Gaps between frames of which the median is taken. Chosen: twenty-three of them may be long."""

SHORT = 0.7
"""Gaps below this fraction of the median are of one frame period where a quarter are: the median is then of two; as
`timing.camera_clock.SHORT`."""

LATE = 0.75
"""Frame periods by which a stamp must be late for a frame to be missing before it; as `timing.camera_clock.MISSING`."""

JUMP_S = 1.0
"""Time by which a stamp may run ahead of the host's clock. Chosen: stamps come late, by a busy host, never early; a
clock that is set jumps by more, as by time of day in place of time since power-on."""

CLOCK_DRIFT = 1e-3
"""Relative difference of both clocks that is no jump: five times that of the worst quartz clocks, 200 ppm."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a frame stands.

    Attributes
    ----------
    index
        Its number, with a gap for each frame that is missing before it.
    time_s
        Start of its exposure in s since that of the first frame.
    """

    index: int
    time_s: float


@dataclass(slots=True)
class _Last:
    """What the last frame's camera said, and when it came."""

    # Where it stood
    place: Place
    # number, stamp_ns: by the camera; None where it does not say, or has begun anew since
    number: int | None
    stamp_ns: int | None
    # When it came, by the host's clock
    host_ns: int


class Numbering:
    """Gives frames their numbers and times."""

    def __init__(self, rate_hz: float, even: bool):
        self.lost = self.incomplete = self.skipped = self.jumps = 0
        self.host_clock = False
        self._claimed_s, self._even = 1 / rate_hz, even
        self._gaps: deque[float] = deque(maxlen=REMEMBERED_GAPS)
        self._last: _Last | None = None
        self._broken = 0
        self._ahead_ns: float | None = None

    @property
    def period_s(self) -> float:
        """Frame period in s: the median of the last ones, long ones left out, or that which the camera says."""
        if len(self._gaps) < KNOWN_GAPS:
            return self._claimed_s
        gaps = sorted(self._gaps)
        middle = gaps[len(gaps) // 2]
        short = [gap for gap in gaps if gap < SHORT * middle]
        return short[len(short) // 2] if len(short) >= len(gaps) / 4 else middle

    def broke(self) -> None:
        """Take note of a frame of which a part came; it used up a number."""
        self.incomplete += 1
        self._broken += 1

    def restart(self) -> None:
        """Take note that the camera was lost and is back: its numbers and its clock may begin anew."""
        if self._last is not None:
            self._last.number = self._last.stamp_ns = None
        self._ahead_ns = None

    def place(self, number: int | None, stamp_ns: int | None, host_ns: int) -> Place | None:
        """Give the next frame its place."""
        self.host_clock = stamp_ns is None
        last = self._last
        if last is None:
            place = Place(0, 0.0)
        else:
            counted = _counted(last.number, number)
            if counted == 0 or (counted is not None and counted < 0 and not _later(last.stamp_ns, stamp_ns)):
                return None
            place = self._next(last, counted if counted and counted > 0 else None, stamp_ns, host_ns)
        self._note_clock(stamp_ns, host_ns)
        self._last, self._broken = _Last(place, number, stamp_ns, host_ns), 0
        return place

    def _next(self, last: _Last, counted: int | None, stamp_ns: int | None, host_ns: int) -> Place:
        """Place of a frame that is `counted` numbers after the last one, where numbers say."""
        stamped_s = self._stamped(last, stamp_ns, host_ns)
        gap_s = max((host_ns - last.host_ns) / 1e9, self.period_s) if stamped_s is None else stamped_s
        periods = gap_s / self.period_s
        steps = counted or 1
        # a camera that numbers its frames may be slower than it says: its own gaps show that
        sure = counted is None or (stamped_s is not None and len(self._gaps) >= KNOWN_GAPS)
        if self._even and sure and periods >= steps + LATE:
            if last.number is not None or last.stamp_ns is not None:  # else the camera was away meanwhile
                self.skipped += max(0, round(periods) - steps - (0 if counted else self._broken))
            steps = round(periods)
        self.lost += max(0, (counted or 1) - 1 - self._broken)
        if stamped_s is not None or last.stamp_ns is None:
            self._gaps.append(gap_s / (counted or steps))
        return Place(last.place.index + steps, last.place.time_s + gap_s)

    def _stamped(self, last: _Last, stamp_ns: int | None, host_ns: int) -> float | None:
        """Time in s since the last frame by the camera's clock; None where it has none, or has jumped."""
        if stamp_ns is None or last.stamp_ns is None:
            return None
        early = self._ahead_ns is not None and stamp_ns - host_ns > self._ahead_ns + JUMP_S * 1e9
        if stamp_ns <= last.stamp_ns or early:
            self.jumps += 1
            self._ahead_ns = None
            return None
        return (stamp_ns - last.stamp_ns) / 1e9

    def _note_clock(self, stamp_ns: int | None, host_ns: int) -> None:
        """Keep how far the camera's clock is ahead of the host's, by frames that came without delay."""
        if stamp_ns is None:
            return
        ahead_ns = float(stamp_ns - host_ns)
        if self._ahead_ns is not None and self._last is not None:
            ahead_ns = max(ahead_ns, self._ahead_ns - CLOCK_DRIFT * (host_ns - self._last.host_ns))
        self._ahead_ns = ahead_ns


def _counted(last: int | None, number: int | None) -> int | None:
    """Numbers from one frame to the next; below 1 of a frame that is not new, None where numbers do not say."""
    if number is None or last is None:
        return None
    steps = number - last
    if steps < 0 and last <= LARGEST_SHORT and steps + LARGEST_SHORT <= LARGEST_SHORT // 2:
        return steps + LARGEST_SHORT
    return steps if steps >= -REORDERED else None


def _later(last_ns: int | None, stamp_ns: int | None) -> bool:
    return last_ns is not None and stamp_ns is not None and stamp_ns > last_ns
