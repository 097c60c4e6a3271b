"""Time stamps of a film: its frame rate, the number of each frame, and times free of a container's rounding."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import LATEST_S, Frame, Pixels
from heliograph.media.reader import FilmReader, checked_time
from heliograph.media.record import FASTEST_HZ


@dataclass(frozen=True, slots=True, kw_only=True)
class StampLimits:
    """Limits by which time stamps are judged."""

    # Frames at a film's start whose stamps are judged
    sample_frames: int = 64
    # Largest distance of a gap from whole frame periods, in periods, for the gap to be even
    gap_tolerance: float = 0.25
    # Least part of even gaps for stamps to be even
    even_ratio: float = 0.9
    # Largest departure of a stated rate from the stamps' rate, as a fraction, for the two to agree
    rate_tolerance: float = 0.01
    # Largest part of frames missing from the grid of a stated rate for the rate to be that of the stamps
    missing_ratio: float = 0.25
    # Ticks by which a stamp may be off the grid of frames and still be rounded to it: half a tick, and errors
    rounding_ticks: float = 0.51
    # Least frames per second of times without a stated rate. Whole milliseconds and frame numbers show less
    min_rate_hz: float = 2.0
    # Largest step of the numbers that hold the times, in frame periods
    resolution_periods: float = 0.25
    # Least ratio between the stated rate and the stamps' rate that only another unit explains. Lost frames make gaps,
    # but not most of them
    unit_ratio: float = 10.0


LIMITS = StampLimits()

FALLBACK_HZ = 25.0
"""Frames a second where a video neither states nor shows them: FFmpeg's own assumption."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Frame rate of a film by its stamps."""

    # Frames per second
    rate_hz: float
    # True if the gaps between stamps are whole frame periods: a longer gap then shows missing frames
    is_even: bool

    def steps(self, gap_s: float) -> int:
        """Frame periods from one frame to the next, at least 1."""
        return max(1, round(gap_s * self.rate_hz)) if self.is_even and math.isfinite(gap_s) else 1


class TimedReader(FilmReader):
    """A film whose frames have time stamps or numbers; see `FilmReader`.

    If the user gives the rate of the camera, frame k has the time ``k / rate_hz``. The number k counts from 0; in a
    film with a nominal rate, from the number of the first frame. Frames missing between even stamps count as well.
    """

    # True if the stamps are whole multiples of a period that the film states
    _states_numbers: bool = False
    # Frame rate of the stamps; None if they show none
    _pace: Pace | None = None

    def _number_frames(self, rate_hz: float) -> None:
        """Set the rate of a film that has frame numbers in place of stamps."""
        self.claimed_hz, self._pace, self._states_numbers = rate_hz, Pace(rate_hz, is_even=True), True

    def _frames(self) -> Iterator[Frame]:
        index, last_s, count = -1, -math.inf, 0
        for count, (stamp_s, pixels, bits) in enumerate(self._pictures(), 1):
            if self._true_hz is not None:
                if count > 1:
                    index += self._pace.steps(stamp_s - last_s) if self._pace else 1
                else:
                    index = max(0, round(stamp_s * self.claimed_hz)) if self._states_numbers else 0
                time_s = checked_time(self.path, index / self._true_hz, count - 1)
            else:
                time_s = checked_time(self.path, stamp_s, count - 1)
                if time_s < last_s:
                    raise MediaError(
                        f"{self.path} has a frame at {time_s:.6f} s after one at {last_s:.6f} s, after {count - 1} "
                        "whole frames: times must rise; correct them, or number the frames by --fps (rate_hz)"
                    )
                index = max(index + 1, round(time_s * self.claimed_hz))
            last_s = stamp_s
            yield Frame(index, time_s, pixels, bits)
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        """Yield each frame's time stamp in s, gray levels and bits."""


def measure_pace(stamps_s: Sequence[float] | Floats, limits: StampLimits = LIMITS) -> Pace | None:
    """Frame rate by the stamps of successive frames; None if they show none."""
    known = np.asarray(stamps_s, np.float64)
    known = known[np.isfinite(known)]
    gaps = np.diff(known)
    longer = gaps[gaps > 0]
    if not longer.size or np.median(gaps) < 0:
        return None
    if len(longer) < limits.even_ratio * len(gaps):  # several frames share a stamp: its tick is too coarse for them
        span_s = float(known[-1] - known[0])
        return Pace((len(known) - 1) / span_s, is_even=False) if span_s > 0 else None
    period_s = frame_period(longer.tolist())
    usual = gaps[(gaps > 0) & (gaps < limits.unit_ratio * period_s)]
    steps = np.maximum(np.round(usual / period_s), 1)
    even_hz, mean_hz = float(steps.sum() / usual.sum()), float(len(usual) / usual.sum())
    off = np.abs(longer * even_hz - np.maximum(np.round(longer * even_hz), 1))
    is_even = bool((off <= limits.gap_tolerance).sum() >= limits.even_ratio * len(gaps))
    return Pace(even_hz if is_even else mean_hz, is_even)


def frame_period(gaps_s: Iterable[float]) -> float:
    """Return the median of gaps of one frame period; up to three quarters of the gaps may hold missing frames."""
    gaps = sorted(gaps_s)
    median = gaps[len(gaps) // 2]
    short = [gap for gap in gaps if gap < 0.7 * median]
    return short[len(short) // 2] if len(short) >= len(gaps) / 4 else median


class StampClock:
    """Times of frames by stamps that a container rounds to its tick.

    If a stated rate explains the sample's stamps, each stamp that it explains is put back on the grid of frames.
    """

    def __init__(
        self, sample_s: Sequence[float], tick_s: float, stated_hz: Iterable[float], limits: StampLimits = LIMITS
    ):
        stated = [rate for rate in stated_hz if 0 < rate <= FASTEST_HZ]
        self.pace = measure_pace(sample_s, limits)
        self._rounding_s = limits.rounding_ticks * tick_s
        self._start_s, self._origin_s, self._number = 0.0, 0.0, -1
        self._stamp_s = self._last_s = -math.inf
        self._grid_hz: float | None = None
        self.rate_hz = self.pace.rate_hz if self.pace else (*stated, FALLBACK_HZ)[0]
        if self.pace is None:
            return
        tolerance = limits.rate_tolerance + 2 * tick_s / max(sample_s[-1] - sample_s[0], tick_s)
        for rate in stated:
            near = abs(rate / self.pace.rate_hz - 1) <= tolerance
            grid = _fit_grid(sample_s, rate, tick_s, limits)
            if grid is not None and (near or grid.missing <= limits.missing_ratio * len(sample_s)):
                self._grid_hz, self._start_s, self._origin_s = rate, sample_s[0], grid.origin_s
                self.pace = Pace(rate, is_even=True)
            if near or self._grid_hz:
                self.rate_hz = rate
                return

    def time(self, stamp_s: float, next_s: float | None) -> float:
        """Time in s of the next frame, by its stamp and the one after it."""
        time_s, fell = stamp_s, stamp_s < self._stamp_s
        self._stamp_s = stamp_s
        if self._grid_hz is not None:
            number = _frame_number(self._number, stamp_s, self._origin_s, self._grid_hz, self._rounding_s)
            if number is not None:
                self._number = number
                time_s = self._start_s + number / self._grid_hz
        if time_s <= self._last_s and not fell:  # it has the stamp of the frame before
            period_s = 1 / self.rate_hz
            room_s = math.inf if next_s is None or next_s <= self._last_s else next_s - self._last_s
            time_s = self._last_s + (period_s if room_s > 1.5 * period_s else room_s / 2)
        self._last_s = time_s
        return time_s


def _frame_number(last: int, stamp_s: float, origin_s: float, rate_hz: float, rounding_s: float) -> int | None:
    """First frame after the last one whose time rounds to a stamp; None if there is none."""
    number = max(last + 1, math.ceil((stamp_s - origin_s - rounding_s) * rate_hz))
    return number if number <= (stamp_s - origin_s + rounding_s) * rate_hz else None


@dataclass(frozen=True, slots=True)
class _Grid:
    """Grid of frames that explains stamps rounded to a tick: its start in s, and frames missing from it."""

    origin_s: float
    missing: int


def _fit_grid(sample_s: Sequence[float], rate_hz: float, tick_s: float, limits: StampLimits) -> _Grid | None:
    """Grid of a rate that explains the stamps; None if too few of them lie on it."""
    fits: dict[float, tuple[int, int]] = {}
    for origin_s in sample_s[0] + tick_s * np.linspace(-0.5, 0.5, 11):
        last, count = -1, 0
        for stamp_s in sample_s:
            number = _frame_number(last, stamp_s, origin_s, rate_hz, limits.rounding_ticks * tick_s)
            last, count = (last, count) if number is None else (number, count + 1)
        fits[float(origin_s)] = count, count - last - 1
    count, missing = best = max(fits.values())  # most frames explained, and then the fewest missing
    if count < limits.even_ratio * len(sample_s):
        return None
    return _Grid(float(np.median([origin_s for origin_s, fit in fits.items() if fit == best])), -missing)


def check_times(path: Path, times: Any, stated_hz: float, numbered: bool, limits: StampLimits = LIMITS) -> Pace | None:
    """Frame rate by times in seconds that a file holds; times that cannot be seconds are refused."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that no double holds become infinite
        known = np.asarray(times, np.float64)
    known = known[np.isfinite(known)]
    if len(known) < 2:
        return None
    pace = measure_pace(known, limits)
    rate_hz = stated_hz or (pace.rate_hz if pace else 0.0)
    step_s = float(np.spacing(np.asarray(np.median(np.abs(known)), times.dtype))) if times.dtype.kind == "f" else 0.0
    if step_s * (rate_hz or 1 / limits.resolution_periods) > limits.resolution_periods:
        if numbered:
            return None
        raise MediaError(
            f"{path}: times_s of {times.dtype} have a resolution of {step_s:.2g} s: write them as float64 "
            "or from the film's start on, or number the frames by --fps"
        )
    if np.median(np.diff(known)) <= 0:
        raise MediaError(f"{path}: times_s do not rise; write the time of each frame there, in seconds")
    if numbered or pace is None:
        return pace
    too_slow = not stated_hz and pace.rate_hz < limits.min_rate_hz
    too_late = float(np.median(np.abs(known))) > LATEST_S
    ratio = stated_hz / pace.rate_hz if stated_hz else 1.0
    if too_slow or too_late or pace.rate_hz > FASTEST_HZ or not (ratio == 1.0 or agrees(stated_hz, pace, limits)):
        says = f" and rate_hz says {shown(stated_hz)}" if stated_hz else ""
        raise MediaError(
            f"{path}: times_s show {shown(pace.rate_hz)} frames/s{says}{_unit(pace.rate_hz, ratio)}; write times_s in "
            "seconds, or say what the camera did with --fps"
        )
    return pace


def agrees(stated_hz: float, pace: Pace, limits: StampLimits = LIMITS) -> bool:
    """Return whether a stated rate and that of the stamps have one unit of time."""
    return 1 / limits.unit_ratio < stated_hz / pace.rate_hz < limits.unit_ratio


def _unit(rate_hz: float, ratio: float) -> str:
    """The unit that times seem to be in, as a clause; without a stated rate, by the rates of cameras, 10 to 10,000."""
    units = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
    if ratio != 1.0:
        fits = [unit for unit, factor in units.items() if 1 / 2 < ratio / factor < 2]
    elif abs(rate_hz - 1) < 1e-6:
        fits = ["milliseconds or frame numbers"]
    else:
        fits = [unit for unit, factor in units.items() if 10 <= rate_hz * factor < 1e4]
    return f": they look like {fits[0]}" if fits else ""
