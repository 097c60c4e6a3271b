"""LED patterns as a table in text, .csv: a line for each slot, or for each pattern where levels are written.

The first line names the columns: the time in s, ``slot_s`` of slots or ``time_s`` of patterns, then ``led_u_v`` for
row u and column v.
"""

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.signal import pwm

SUFFIX = ".csv"
"""Suffix of a table."""

MOST_LINE = 1 << 17
"""Most characters of a line: the first one of 64 x 64 LEDs takes 46 kB."""

LATE = 0.01
"""Share of a period by which a line's time may be off the place of the line, as it is written with nine digits."""

_TIMES = {"slot_s": True, "time_s": False}


def write_table(path: Path, patterns: Iterable[NDArray[np.uint8]], side: int, period_s: float, slots: bool) -> None:
    """Write a table."""
    with path.open("w", encoding="ascii") as file:
        file.write(_names(side, slots) + "\n")
        for index, pattern in enumerate(patterns):
            file.write(f"{index * period_s:.9g}," + ",".join(map(str, pattern.ravel().tolist())) + "\n")


def read_head(path: Path) -> tuple[int, bool, float, int]:
    """Return what a table holds: LEDs of a side, whether lines are slots, time from line to line in s, and lines."""
    with path.open(encoding="ascii") as file:
        names = file.readline(MOST_LINE)
        first, _, _ = names.partition(",")
        side = round(names.count(",") ** 0.5)
        if first not in _TIMES or names != _names(side, _TIMES[first]) + "\n":
            raise ValueError
        times = [float(line.partition(",")[0]) for line in islice(_lines(file), 2)]
        count = 2 + sum(1 for _ in _lines(file))
    start_s, next_s = times
    if not 0 == start_s < next_s < np.inf:
        raise ValueError
    return side, _TIMES[first], next_s, count


def rows(path: Path, side: int, slots: bool, period_s: float) -> Iterator[NDArray[np.uint8]]:
    """Yield the (n, n) uint8 of each line."""
    most, count = 1 if slots else pwm.SLOTS, 0
    with path.open(encoding="ascii", errors="replace") as file:
        file.readline(MOST_LINE)
        for line in _lines(file):
            time_s, _, values = line.partition(",")
            try:
                led = np.array(values.split(","), np.int64)
                late = abs(float(time_s) / period_s - count)
            except ValueError:
                led, late = np.empty(0, np.int64), np.inf
            if not line.endswith("\n") or led.size != side * side or not 0 <= led.min() <= led.max() <= most:
                raise _damaged(path, count, "cut or damaged")
            if not late <= LATE + 1e-8 * count:
                raise _damaged(path, count, "late or early")
            yield led.reshape(side, side).astype(np.uint8)
            count += 1


def _names(side: int, slots: bool) -> str:
    time = "slot_s" if slots else "time_s"
    return ",".join((time, *(f"led_{u}_{v}" for u in range(side) for v in range(side))))


def _lines(file: TextIO) -> Iterator[str]:
    """Lines of a file, none of them longer than any table has."""
    return iter(lambda: file.readline(MOST_LINE), "")


def _damaged(path: Path, count: int, how: str) -> MediaError:
    return MediaError(f"line {count + 2} of {path} is {how}; write it again by 'heliograph transmit'")
