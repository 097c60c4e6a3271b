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

SLIVER = 1e-6
"""Minimum length of an exposure piece in slots; shorter pieces are rounding errors of the clocks."""

MAX_PATTERNS = 64
"""Number of recent patterns in memory, enough for a rolling shutter and the response of a screen."""


class PatternFeed:
    """Patterns of an array, read on demand."""

    def __init__(self, patterns: Iterable[NDArray[np.uint8]], name: str) -> None:
        self._source: Iterator[NDArray[np.uint8]] = iter(patterns)
        self._name = name
        self._recent: dict[int, NDArray[np.uint8]] = {}
        self._next = 0
        self.side = 0
        first = self.at(0)
        if first is None:
            raise ValueError(f"{name} has no patterns; remove the array from the scene")

    def at(self, number: int) -> NDArray[np.uint8] | None:
        """Return a pattern; None beyond the end or before the last `MAX_PATTERNS`."""
        while self._next <= number:
            pattern = next(self._source, None)
            if pattern is None:
                break
            self._recent[self._next] = self._checked(pattern)
            self._recent.pop(self._next - MAX_PATTERNS, None)
            self._next += 1
        return self._recent.get(number)

    def _checked(self, pattern: NDArray[np.uint8]) -> NDArray[np.uint8]:
        p = np.asarray(pattern)
        self.side = self.side or (p.shape[0] if p.ndim else 0)
        if p.shape != (self.side, self.side) or p.dtype != np.uint8 or p.size == 0:
            raise ValueError(f"patterns of {self._name} are (n, n) uint8 of equal n, not {p.shape} {p.dtype}")
        if p.max() > SLOTS:
            raise ValueError(f"levels of {self._name} are 0 to {SLOTS}, not {p.max()}")
        return p


@dataclass(frozen=True, slots=True)
class Lit:
    """Light of each LED in k pieces of an exposure, split at the PWM slots."""

    # (k,) true start of each piece in s
    start_s: Floats
    # (k,) true end of each piece in s
    end_s: Floats
    # (k, n, n) float64 light of each LED, nominally 0 or 1
    on: Floats
    # Numbers of the visible patterns in temporal order
    patterns: tuple[int, ...]

    def moments(self, start_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
        """Return the temporal moments of the light of each LED."""
        rows = _moments(self.start_s, self.end_s, (start_s + end_s) / 2)
        sums = (rows @ self.on.reshape(len(self.start_s), -1)).reshape(3, *self.on.shape[1:])
        return _central(sums, end_s - start_s)

    def split(self, max_s: float) -> "Lit":
        """Return the exposure with each piece split into equal parts."""
        # 1e-9: rounding
        count = np.maximum(np.ceil((self.end_s - self.start_s) / max_s - 1e-9), 1).astype(int)
        part = np.concatenate([np.arange(c) for c in count])
        length = np.repeat((self.end_s - self.start_s) / count, count)
        start = np.repeat(self.start_s, count) + part * length
        return Lit(start, start + length, np.repeat(self.on, count, 0), self.patterns)


def _moments(start_s: Floats, end_s: Floats, centre_s: float) -> Floats:
    """Return temporal moments of exposure pieces about a time, (3, k)."""
    # a piece of length T and centroid c has the moments T, T c and T (c^2 + T^2 / 12)
    length, centre = end_s - start_s, (start_s + end_s) / 2 - centre_s
    return np.array([length, length * centre, length * (centre**2 + length**2 / 12)])


def _central(sums: Floats, exposure_s: float) -> tuple[Floats, Floats, Floats]:
    """Return fraction of the exposure, centroid and variance of the light of each LED, (3, n, n)."""
    total = np.maximum(sums[0], 1e-30)  # avoids division by 0
    late = sums[1] / total
    return sums[0] / exposure_s, late, np.maximum(sums[2] / total - late**2, 0)


@dataclass(frozen=True)
class Faults:
    """Faults of an array."""

    # (n, n) bool, LEDs that are always off
    dead: NDArray[np.bool_]
    # (n, n) bool, LEDs that are always on, except during `off_s`
    stuck: NDArray[np.bool_]
    # (n, n) bool, LEDs behind an obstacle
    hidden: NDArray[np.bool_]
    # (n, n) relative light of each LED, nominally 1, at least 0
    gains: Floats
    # Dark intervals (from, to) in s
    off_s: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, place: Placement, side: int, rng: np.random.Generator) -> "Faults":
        """Return random faults of an array."""
        order = rng.permutation(side * side).reshape(side, side)
        n_dead, n_stuck = round(place.dead * side * side), round(place.stuck * side * side)
        hidden = np.zeros((side, side), bool)
        if place.hidden:
            left, top, right, bottom = place.hidden
            v, u = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side])
            hidden = (v > left) & (v < right) & (u > top) & (u < bottom)
        gains = np.maximum(1 + place.spread * rng.standard_normal((side, side)), 0)
        return cls(order < n_dead, (order >= n_dead) & (order < n_dead + n_stuck), hidden, gains, place.off_s)

    def visible(self, on: NDArray[np.bool_] | Floats, total: Floats | float = 1.0) -> Floats:
        """Return the visible light of each LED, (k, n, n), nominally 0 to 1."""
        lit, dark = self._light
        return dark * total + on * (lit - dark)

    @cached_property
    def _light(self) -> tuple[Floats, Floats]:
        """Light of each LED when on and when off, (n, n)."""
        exposed = ~self.hidden
        return ((~self.dead | self.stuck) & exposed) * self.gains, (self.stuck & exposed) * self.gains

    @cached_property
    def none(self) -> bool:
        """True if all LEDs are intact, except for `off_s`."""
        lit, dark = self._light
        return bool((lit == 1).all() and (dark == 0).all())

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

    def shown(self, start_s: float, end_s: float) -> "Shown | None":
        """Return the patterns during an exposure; None if the array is dark."""
        slot_s = self.period_s / SLOTS
        pieces: list[tuple[float, float, int, int]] = []
        # (1), (2): x(t) = sum_k x_k g(t - k T_b); (4), (5): the shutter is open from start to end
        for slot in range(math.floor((start_s - self.start_s) / slot_s), math.ceil((end_s - self.start_s) / slot_s)):
            begin = max(start_s, self.start_s + slot * slot_s)
            end = min(end_s, self.start_s + (slot + 1) * slot_s)
            number, phase = divmod(slot, SLOTS)
            if end - begin > SLIVER * slot_s and self.feed.at(number) is not None:
                parts = self.faults.cut(begin, end) if self.faults.off_s else ((begin, end),)
                pieces += [(*part, number, phase) for part in parts if part[1] - part[0] > SLIVER * slot_s]
        return Shown(self, start_s, end_s, pieces) if pieces else None

    @cached_property
    def shares(self) -> Floats:
        """Light in each slot for each level, (4, 5)."""
        levels = np.arange(SLOTS + 1)
        if self.steady:
            return np.tile(levels / SLOTS, (SLOTS, 1))
        rank = np.argsort(np.asarray(self.slot_order))  # a slot is lit above this level
        return np.asarray(levels > rank[:, None], float)


@dataclass(frozen=True, slots=True)
class Shown:
    """Patterns in k pieces of an exposure, split at the PWM slots; dark times are excluded."""

    lighting: Lighting
    # True start of the exposure in s
    start_s: float
    # True end of the exposure in s
    end_s: float
    # True start and end in s, pattern number and slot of each piece, in temporal order
    pieces: list[tuple[float, float, int, int]]

    @property
    def patterns(self) -> tuple[int, ...]:
        """Numbers of the visible patterns in temporal order."""
        return tuple(dict.fromkeys([piece[2] for piece in self.pieces]))

    def lit(self) -> Lit:
        """Return the light of each LED in each piece."""
        begins, ends, numbers, phases = zip(*self.pieces, strict=True)
        on = [self.lighting.shares[p][self._pattern(n)] for n, p in zip(numbers, phases, strict=True)]
        return Lit(np.array(begins), np.array(ends), self.lighting.faults.visible(np.array(on)), self.patterns)

    def moments(self) -> tuple[Floats, Floats, Floats]:
        """Return the temporal moments of the light of each LED: fraction, centroid, variance."""
        begins, ends, _, phases = np.array(self.pieces).T
        rows = _moments(begins, ends, (self.start_s + self.end_s) / 2)
        return _central(self._light(rows, phases), self.end_s - self.start_s)

    def _light(self, rows: Floats, phases: Floats) -> Floats:
        """Return the sums of moments of pieces, (m, k), over the lit pieces of each LED, (m, n, n)."""
        # LEDs of equal level are lit at equal times: five sums per pattern suffice
        shares, patterns = self.lighting.shares[phases.astype(int)], self.patterns
        if len(patterns) == 1:
            total = np.take(rows @ shares, self._pattern(patterns[0]), axis=1)
        else:
            numbers = np.array([piece[2] for piece in self.pieces])
            parts = [np.take((rows * (numbers == n)) @ shares, self._pattern(n), axis=1) for n in patterns]
            total = np.sum(parts, 0)
        faults = self.lighting.faults
        return total if faults.none else faults.visible(total, rows.sum(1)[:, None, None])

    def _pattern(self, number: int) -> NDArray[np.uint8]:
        pattern = self.lighting.feed.at(number)
        assert pattern is not None  # by construction of the pieces
        return pattern
