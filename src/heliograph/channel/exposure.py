"""LED light during an exposure: equations (1), (2), (4) and (6)."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.settings import Placement
from heliograph.signal.pwm import SLOTS


class PatternFeed:
    """Patterns of an array, read on demand."""

    def __init__(self, patterns: Iterable[NDArray[np.uint8]], name: str) -> None:
        self._source: Iterator[NDArray[np.uint8]] = iter(patterns)
        self._name = name
        self._recent: dict[int, NDArray[np.uint8]] = {}
        self._next = 0
        self.side = 0
        if self.at(0) is None:
            raise ValueError(f"{name} has no patterns; remove the array from the scene")

    def at(self, number: int) -> NDArray[np.uint8] | None:
        """Return a pattern; None beyond the end or before the last 64 patterns."""
        while self._next <= number:
            pattern = next(self._source, None)
            if pattern is None:
                break
            self._check(pattern)
            self._recent[self._next] = pattern
            # a rolling shutter and the response of a screen need recent patterns
            self._recent.pop(self._next - 64, None)
            self._next += 1
        return self._recent.get(number)

    def _check(self, pattern: NDArray[np.uint8]) -> None:
        self.side = self.side or len(pattern)
        if pattern.shape != (self.side, self.side) or pattern.dtype != np.uint8:
            raise ValueError(f"patterns of {self._name} are (n, n) uint8, not {pattern.shape} {pattern.dtype}")
        if pattern.max() > SLOTS:
            raise ValueError(f"levels of {self._name} are 0 to {SLOTS}, not {pattern.max()}")


Moments = tuple[Floats, Floats, Floats]
"""Fraction of an exposure, centroid and variance of the light of each LED, (3, n, n)."""


@dataclass(frozen=True, slots=True)
class Lit:
    """Light of each LED in k pieces of an exposure, split at the PWM slots; dark times are excluded."""

    # (k,) true start of each piece in s
    start_s: Floats
    # (k,) true end of each piece in s
    end_s: Floats
    # (k, n, n) float64 light of each LED, nominally 0 or 1
    on: Floats
    # Numbers of the visible patterns in temporal order
    patterns: tuple[int, ...]

    def moments(self, start_s: float, end_s: float) -> Moments:
        """Return the temporal moments of the light of each LED about mid-exposure."""
        # a piece of length T and centroid c has the moments T, T c and T (c^2 + T^2 / 12)
        length, centre = self.end_s - self.start_s, (self.start_s + self.end_s) / 2 - (start_s + end_s) / 2
        rows = np.array([length, length * centre, length * (centre**2 + length**2 / 12)])
        sums = np.tensordot(rows, self.on, 1)
        total = np.maximum(sums[0], 1e-30)  # avoids division by 0
        late = sums[1] / total
        return sums[0] / (end_s - start_s), late, np.maximum(sums[2] / total - late**2, 0)

    def split(self, max_s: float) -> "Lit":
        """Return the exposure with each piece split into equal parts."""
        # 1e-9: rounding
        count = np.maximum(np.ceil((self.end_s - self.start_s) / max_s - 1e-9), 1).astype(int)
        part = np.concatenate([np.arange(c) for c in count])
        length = np.repeat((self.end_s - self.start_s) / count, count)
        start = np.repeat(self.start_s, count) + part * length
        return Lit(start, start + length, np.repeat(self.on, count, 0), self.patterns)


@dataclass(frozen=True)
class Faults:
    """Faults of an array."""

    # (n, n) light of each LED when on, nominally 1, at least 0
    lit: Floats
    # (n, n) light of each LED when off, nominally 0
    dark: Floats
    # Dark intervals (from, to) in s
    off_s: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, place: Placement, side: int, rng: np.random.Generator) -> "Faults":
        """Return random faults of an array."""
        order = rng.permutation(side * side).reshape(side, side)
        n_dead, n_stuck = round(place.dead * side * side), round(place.stuck * side * side)
        gains = np.maximum(1 + place.spread * rng.standard_normal((side, side)), 0)
        if place.hidden:
            left, top, right, bottom = place.hidden
            v, u = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side])
            gains[(v > left) & (v < right) & (u > top) & (u < bottom)] = 0
        stuck = (order >= n_dead) & (order < n_dead + n_stuck)
        return cls(np.where(order >= n_dead, gains, 0), np.where(stuck, gains, 0), place.off_s)

    def visible(self, on: Floats) -> Floats:
        """Return the visible light of each LED, (k, n, n), nominally 0 to 1."""
        return self.dark + on * (self.lit - self.dark)

    def cut(self, begin_s: float, end_s: float) -> Iterator[tuple[float, float]]:
        """Yield the parts of an interval outside `off_s`."""
        for off, on in sorted(self.off_s):
            if off > begin_s:
                yield begin_s, min(off, end_s)
            begin_s = max(begin_s, on)
            if begin_s >= end_s:
                return
        yield begin_s, end_s


@dataclass(frozen=True)
class Lighting:
    """Patterns of an array in true time."""

    feed: PatternFeed
    # True start of pattern 0 in s
    start_s: float
    # True pattern period in s, clock error included
    period_s: float
    # Order of the slots for rising levels, a permutation of 0 to 3
    slot_order: tuple[int, ...]
    faults: Faults
    # True for a constant luminance per level, as on a screen, in place of PWM slots
    steady: bool = False

    def shown(self, start_s: float, end_s: float) -> Lit | None:
        """Return the light during an exposure; None if the array is dark."""
        slot_s = self.period_s / SLOTS
        min_s = 1e-6 * slot_s  # shorter pieces are rounding errors of the clocks
        pieces: list[tuple[float, float, int]] = []
        on = []
        # (1), (2): x(t) = sum_k x_k g(t - k T_b); (4), (5): the shutter is open from start to end
        for slot in range(math.floor((start_s - self.start_s) / slot_s), math.ceil((end_s - self.start_s) / slot_s)):
            begin = max(start_s, self.start_s + slot * slot_s)
            end = min(end_s, self.start_s + (slot + 1) * slot_s)
            number, phase = divmod(slot, SLOTS)
            pattern = self.feed.at(number) if end - begin > min_s else None
            if pattern is not None:
                parts = [part for part in self.faults.cut(begin, end) if part[1] - part[0] > min_s]
                pieces += [(*part, number) for part in parts]
                on += [self.shares[phase][pattern]] * len(parts)
        if not pieces:
            return None
        begins, ends, numbers = zip(*pieces, strict=True)
        return Lit(np.array(begins), np.array(ends), self.faults.visible(np.array(on)), tuple(dict.fromkeys(numbers)))

    @cached_property
    def shares(self) -> Floats:
        """Light in each slot for each level, (4, 5)."""
        levels = np.arange(SLOTS + 1)
        if self.steady:
            return np.tile(levels / SLOTS, (SLOTS, 1))
        rank = np.argsort(np.asarray(self.slot_order))  # a slot is lit above this level
        return np.asarray(levels > rank[:, None], float)
