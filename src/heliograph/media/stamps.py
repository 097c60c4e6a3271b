"""Time stamps of a film: frame rate, frame numbers, and times free of the rounding in a container."""

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
from heliograph.media.reader import FilmReader, Frames, Reading, checked_size, read_blocks
from heliograph.media.record import FASTEST_HZ

SAMPLE_FRAMES = 64  # stamps in the sample at the start of a film

_EVEN_RATIO = 0.9  # smallest ratio of even gaps in even stamps

_ROUNDING_TICKS = 0.51  # distance of a stamp from the grid of frames: half a tick, and rounding errors

_UNIT_RATIO = 10.0  # ratio between the stated rate and the rate of the stamps from which the unit of time is wrong


@dataclass(frozen=True, slots=True)
class Pace:
    """Frame rate of a film by the stamps."""

    # Frames per second
    rate_hz: float
    # True if gaps are multiples of the frame period within a quarter: then a longer gap shows missing frames
    is_even: bool

    def steps(self, gap_s: float) -> int:
        """Return the frame periods in a gap, at least 1."""
        return max(1, round(gap_s * self.rate_hz)) if self.is_even and math.isfinite(gap_s) else 1


class TimedReader(FilmReader):
    """A film with time stamps or frame numbers; see `FilmReader`.

    If the user gives the rate of the camera, frame k has the time ``k / rate_hz``. The number k counts from 0; in a
    film with a nominal rate, from the number of the first frame. Frames missing between even stamps count as well.
    """

    # True if the stamps are multiples of a stated period
    _states_numbers: bool = False
    # Frame rate of the stamps; None if they show none
    _pace: Pace | None = None

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._channel = reading.channel

    def _set_rate(self, stated_hz: float | None = None, source: Path | None = None) -> None:
        """Set the stated rate, or else the given rate."""
        rate_hz = stated_hz or self._true_hz
        if not rate_hz:
            cure = "say how many frames a second the camera took, by --fps (rate_hz; on page Watch Frames/s)"
            raise MediaError(f"{source or self.path} has no clock: {cure}")
        self.claimed_hz = rate_hz

    def _number_frames(self, stated_hz: float | None = None, source: Path | None = None) -> None:
        """Set the rate of a film with frame numbers in place of stamps."""
        self._set_rate(stated_hz, source)
        self._pace, self._states_numbers = Pace(self.claimed_hz, is_even=True), True

    def _frames(self) -> Frames:
        index, last_s, count = -1, -math.inf, 0
        for stamp_s, pixels, bits in self._pictures():
            self._check_form(pixels, bits, count)
            time_s = stamp_s
            if self._true_hz is not None:
                if count:
                    index += self._pace.steps(stamp_s - last_s) if self._pace else 1
                else:
                    index = max(0, round(stamp_s * self.claimed_hz)) if self._states_numbers else 0
                time_s = index / self._true_hz
            if not abs(time_s) <= LATEST_S:
                place = f"at {time_s:g} s after {count} whole frames"
                raise MediaError(f"{self.path} has a frame {place}: times are in seconds")
            if self._true_hz is None:
                if time_s < last_s:
                    cure = "times must rise; correct them, or number the frames by --fps (rate_hz)"
                    place = f"at {time_s:.6f} s after one at {last_s:.6f} s, after {count} whole frames"
                    raise MediaError(f"{self.path} has a frame {place}: {cure}")
                index = max(index + 1, round(time_s * self.claimed_hz))
            last_s = stamp_s
            yield Frame(index, time_s, pixels, bits)
            count += 1
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    def _check_form(self, pixels: Pixels, bits: int, count: int) -> None:
        """Refuse a frame of another size or other bits."""
        if pixels.shape != (self.height, self.width) or bits != self.bits:
            got = f"{pixels.shape[1]}x{pixels.shape[0]} pixels of {bits} bits after {count} whole frames"
            form = f"{self.width}x{self.height} of {self.bits}"
            raise MediaError(f"{self._frame_name(count)} has {got}, the film {form}: make a film of each size")

    def _frame_name(self, count: int) -> str:  # noqa: ARG002 - pictures have files
        """Return the name of a frame's file."""
        return str(self.path)

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        """Yield each frame's time stamp in s, gray levels and bits."""


class BlockReader(TimedReader):
    """A film with a block of bytes of the same size for each frame; see `FilmReader`."""

    _start = 0

    def _set_blocks(self, frames: int, frame_bytes: int) -> None:
        """Set the number of frames stated by the header, and the bytes of each."""
        checked_size(self.path, self.width, self.height)
        self._claimed, self._frame_bytes = frames, frame_bytes
        self.frame_count = min(frames, self.path.stat().st_size // frame_bytes)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        blocks = read_blocks(self.path, self._places(), self._frame_bytes)
        for data, time_s in zip(blocks, self._times(), strict=False):
            yield time_s, self._levels(data), self.bits

    def _places(self) -> Iterator[int]:
        """Yield the place of each frame's bytes in the file."""
        return (self._start + number * self._frame_bytes for number in range(self._claimed))

    def _times(self) -> Iterator[float]:
        """Yield the time stamp of each frame in s."""
        return (number / self.claimed_hz for number in range(self._claimed))

    @abstractmethod
    def _levels(self, data: bytearray) -> Pixels:
        """Return the gray levels of a frame's bytes."""


def measure_pace(stamps_s: Sequence[float] | Floats) -> Pace | None:
    """Return the frame rate by the stamps of successive frames; None if they show none."""
    known = np.asarray(stamps_s, np.float64)
    known = known[np.isfinite(known)]
    gaps = np.diff(known)
    longer = gaps[gaps > 0]
    if not longer.size or np.median(gaps) < 0:
        return None
    if len(longer) < _EVEN_RATIO * len(gaps):  # frames share stamps of a coarse tick
        span_s = float(known[-1] - known[0])
        return Pace((len(known) - 1) / span_s, is_even=False) if span_s > 0 else None
    period_s = frame_period(longer.tolist())
    usual = gaps[(gaps > 0) & (gaps < _UNIT_RATIO * period_s)]
    steps = np.maximum(np.round(usual / period_s), 1)
    even_hz, mean_hz = float(steps.sum() / usual.sum()), float(len(usual) / usual.sum())
    off = np.abs(longer * even_hz - np.maximum(np.round(longer * even_hz), 1))
    is_even = bool((off <= 0.25).sum() >= _EVEN_RATIO * len(gaps))
    return Pace(even_hz if is_even else mean_hz, is_even)


def frame_period(gaps_s: Iterable[float]) -> float:
    """Return the median of single frame periods; up to three quarters of the gaps may hold missing frames."""
    gaps = sorted(gaps_s)
    median = gaps[len(gaps) // 2]
    short = [gap for gap in gaps if gap < 0.7 * median]
    return short[len(short) // 2] if len(short) >= len(gaps) / 4 else median


class StampClock:
    """Times of frames by stamps rounded to the tick of a container.

    If a stated rate explains the stamps of the sample, the clock moves such stamps back to the grid of frames.
    """

    def __init__(self, sample_s: Sequence[float], tick_s: float, stated_hz: Iterable[float]):
        stated = [rate for rate in stated_hz if 0 < rate <= FASTEST_HZ]
        self.pace = measure_pace(sample_s)
        self._rounding_s = _ROUNDING_TICKS * tick_s
        self._start_s, self._origin_s, self._number = 0.0, 0.0, -1
        self._stamp_s = self._last_s = -math.inf
        self._grid_hz: float | None = None
        self.rate_hz = self.pace.rate_hz if self.pace else (*stated, 25.0)[0]  # FFmpeg's assumption
        if self.pace is None:
            return
        tolerance = 0.01 + 2 * tick_s / max(sample_s[-1] - sample_s[0], tick_s)
        for rate in stated:
            near = abs(rate / self.pace.rate_hz - 1) <= tolerance
            origin_s, missing = _fit_grid(sample_s, rate, tick_s)
            if origin_s is not None and (near or missing <= 0.25 * len(sample_s)):
                self._grid_hz, self._start_s, self._origin_s = rate, sample_s[0], origin_s
                self.pace = Pace(rate, is_even=True)
            if near or self._grid_hz:
                self.rate_hz = rate
                return

    def time(self, stamp_s: float, next_s: float | None) -> float:
        """Return the time in s of the next frame, by this stamp and the following stamp."""
        time_s, fell = stamp_s, stamp_s < self._stamp_s
        self._stamp_s = stamp_s
        if self._grid_hz is not None:
            number = _frame_number(self._number, stamp_s, self._origin_s, self._grid_hz, self._rounding_s)
            if number is not None:
                self._number = number
                time_s = self._start_s + number / self._grid_hz
        if time_s <= self._last_s and not fell:  # the stamp of the previous frame again
            period_s = 1 / self.rate_hz
            room_s = math.inf if next_s is None or next_s <= self._last_s else next_s - self._last_s
            time_s = self._last_s + (period_s if room_s > 1.5 * period_s else room_s / 2)
        self._last_s = time_s
        return time_s


def _frame_number(last: int, stamp_s: float, origin_s: float, rate_hz: float, rounding_s: float) -> int | None:
    """Return the first frame after the last frame with a time near a stamp; None if no frame has."""
    number = max(last + 1, math.ceil((stamp_s - origin_s - rounding_s) * rate_hz))
    return number if number <= (stamp_s - origin_s + rounding_s) * rate_hz else None


def _fit_grid(sample_s: Sequence[float], rate_hz: float, tick_s: float) -> tuple[float | None, int]:
    """Return the start in s of a grid of frames at the stamps, or None, and the number of missing frames."""
    fits: dict[float, tuple[int, int]] = {}
    for origin_s in sample_s[0] + tick_s * np.linspace(-0.5, 0.5, 11):
        last, count = -1, 0
        for stamp_s in sample_s:
            number = _frame_number(last, stamp_s, origin_s, rate_hz, _ROUNDING_TICKS * tick_s)
            last, count = (last, count) if number is None else (number, count + 1)
        fits[float(origin_s)] = count, count - last - 1
    count, missing = best = max(fits.values())  # most frames explained, then the fewest missing
    origins = [origin_s for origin_s, fit in fits.items() if fit == best]
    return (float(np.median(origins)) if count >= _EVEN_RATIO * len(sample_s) else None), -missing


def check_times(path: Path, times: Any, stated_hz: float, numbered: bool) -> Pace | None:
    """Return the frame rate by the times in a file, or refuse other units than seconds."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers too large for a double become infinite
        known = np.asarray(times, np.float64)
    known = known[np.isfinite(known)]
    if len(known) < 2:
        return None
    pace = measure_pace(known)
    rate_hz = stated_hz or (pace.rate_hz if pace else 0.0)
    step_s = float(np.spacing(np.asarray(np.median(np.abs(known)), times.dtype))) if times.dtype.kind == "f" else 0.0
    if step_s * (rate_hz or 4.0) > 0.25:  # frame periods
        if numbered:
            return None
        cure = "write them as float64, or number the frames by --fps"
        raise MediaError(f"{path}: times_s of {times.dtype} have a resolution of {step_s:.2g} s: {cure}")
    if np.median(np.diff(known)) <= 0:
        raise MediaError(f"{path}: times_s do not rise; write the time of each frame there, in seconds")
    if numbered or pace is None:
        return pace
    too_slow = not stated_hz and pace.rate_hz < 2.0  # milliseconds and frame numbers give less
    too_late = float(np.median(np.abs(known))) > LATEST_S
    ratio = stated_hz / pace.rate_hz if stated_hz else 1.0
    if too_slow or too_late or pace.rate_hz > FASTEST_HZ or not (ratio == 1.0 or agrees(stated_hz, pace)):
        stated = f" and rate_hz says {shown(stated_hz)}" if stated_hz else ""
        show = f"{shown(pace.rate_hz)} frames/s{stated}{_guess_unit(pace.rate_hz, ratio)}"
        raise MediaError(f"{path}: times_s show {show}; write times_s in seconds, or say the rate by --fps")
    return pace


def agrees(stated_hz: float, pace: Pace) -> bool:
    """True if a stated rate and the rate of the stamps have the same unit of time."""
    return 1 / _UNIT_RATIO < stated_hz / pace.rate_hz < _UNIT_RATIO


def _guess_unit(rate_hz: float, ratio: float) -> str:
    """Return a clause with the likely unit of times; if no rate is stated, by camera rates of 10 to 10,000."""
    units = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
    if ratio != 1.0:
        fits = [unit for unit, factor in units.items() if 1 / 2 < ratio / factor < 2]
    elif abs(rate_hz - 1) < 1e-6:
        fits = ["milliseconds or frame numbers"]
    else:
        fits = [unit for unit, factor in units.items() if 10 <= rate_hz * factor < 1e4]
    return f": they look like {fits[0]}" if fits else ""
