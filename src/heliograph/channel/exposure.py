"""The LEDs that are lit in each part of an exposure: equations (1), (2), (4) and (6)."""

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
"""Pieces of an exposure shorter than this, in slots, are rounding errors of the clocks: times up to an hour in double
precision are right to 5e-13 s, 2e-9 of a slot of 0.25 ms. They hold no more than 1e-6 of a slot's light."""

HELD_PATTERNS = 64
"""Patterns kept: an exposure is at most T_b long and reads two, or three where the clocks differ. The rows of a rolling
shutter and the response of a screen reach further back: 15 ms of response by up to 30 patterns of 4 ms."""


class PatternFeed:
    """The patterns of one array, read in step with time."""

    def __init__(self, patterns: Iterable[NDArray[np.uint8]], name: str) -> None:
        self._source: Iterator[NDArray[np.uint8]] = iter(patterns)
        self._name = name
        self._held: dict[int, NDArray[np.uint8]] = {}
        self._next = 0
        self.side = 0
        first = self.at(0)
        if first is None:
            raise ValueError(f"the lights of {name} show no pattern at all; leave the array out instead")

    def at(self, number: int) -> NDArray[np.uint8] | None:
        """Return a pattern; None where there is none, or where it is `HELD_PATTERNS` or more before the newest."""
        while self._next <= number:
            pattern = next(self._source, None)
            if pattern is None:
                break
            self._held[self._next] = self._checked(pattern)
            self._held.pop(self._next - HELD_PATTERNS, None)
            self._next += 1
        return self._held.get(number)

    def _checked(self, pattern: NDArray[np.uint8]) -> NDArray[np.uint8]:
        p = np.asarray(pattern)
        self.side = self.side or (p.shape[0] if p.ndim else 0)
        if p.shape != (self.side, self.side) or p.dtype != np.uint8 or p.size == 0:
            raise ValueError(f"patterns of {self._name} are (n, n) uint8 of one n, not {p.shape} {p.dtype}")
        if p.max() > SLOTS:
            raise ValueError(f"levels of {self._name} are 0 to {SLOTS}, not {p.max()}")
        return p


@dataclass(frozen=True, slots=True)
class Lit:
    """An exposure cut into k pieces at the PWM slots' boundaries; times without a pattern are left out."""

    # (k,) true start of each piece in s
    start_s: Floats
    # (k,) true end of each piece in s
    end_s: Floats
    # (k, n, n) float64: light of each LED, 1 where one as bright as the others is lit, 0 where none is
    on: Floats
    # Numbers of the patterns shown, in the order of time
    patterns: tuple[int, ...]

    def moments(self, start_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
        """Return the moments in time of each LED's light."""
        rows = _moments(self.start_s, self.end_s, (start_s + end_s) / 2)
        sums = (rows @ self.on.reshape(len(self.start_s), -1)).reshape(3, *self.on.shape[1:])
        return _central(sums, end_s - start_s)

    def split(self, longest_s: float) -> "Lit":
        """Return the same exposure with each piece cut into equal parts."""
        # excess of a piece over a whole number of parts that counts as a rounding error
        count = np.maximum(np.ceil((self.end_s - self.start_s) / longest_s - 1e-9), 1).astype(int)
        part = np.concatenate([np.arange(c) for c in count])
        length = np.repeat((self.end_s - self.start_s) / count, count)
        start = np.repeat(self.start_s, count) + part * length
        return Lit(start, start + length, np.repeat(self.on, count, 0), self.patterns)


def _moments(start_s: Floats, end_s: Floats, middle_s: float) -> Floats:
    """Moments of pieces of an exposure about its middle, (3, k)."""
    # a piece of length T and centroid c has the moments T, T c and T (c^2 + T^2 / 12)
    length, centre = end_s - start_s, (start_s + end_s) / 2 - middle_s
    return np.array([length, length * centre, length * (centre**2 + length**2 / 12)])


def _central(sums: Floats, exposure_s: float) -> tuple[Floats, Floats, Floats]:
    """Fraction of the exposure, centroid and variance of each LED's light of its moments, (3, n, n)."""
    # least time an LED is lit, for a division: above 0, and below any piece of an exposure
    total = np.maximum(sums[0], 1e-30)
    late = sums[1] / total
    return sums[0] / exposure_s, late, np.maximum(sums[2] / total - late**2, 0)


@dataclass(frozen=True)
class Faults:
    """Faults that keep an array from showing its patterns."""

    # (n, n) bool, LEDs that never shine
    dead: NDArray[np.bool_]
    # (n, n) bool, LEDs that always shine, but for `off_s`
    stuck: NDArray[np.bool_]
    # (n, n) bool, LEDs that an obstacle hides
    hidden: NDArray[np.bool_]
    # (n, n) light of each LED when lit, 1 for as bright as meant, at least 0
    gains: Floats
    # Times (from, to) in s for which all are dark
    off_s: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, place: Placement, side: int, rng: np.random.Generator) -> "Faults":
        """Return the faults of an array; the LEDs that fail, and how much all differ, are drawn at random."""
        order = rng.permutation(side * side).reshape(side, side)
        many, more = round(place.dead * side * side), round(place.stuck * side * side)
        hidden = np.zeros((side, side), bool)
        if place.hidden:
            left, top, right, low = place.hidden
            v, u = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side])
            hidden = (v > left) & (v < right) & (u > top) & (u < low)
        gains = np.maximum(1 + place.spread * rng.standard_normal((side, side)), 0)
        return cls(order < many, (order >= many) & (order < many + more), hidden, gains, place.off_s)

    def visible(self, on: NDArray[np.bool_] | Floats, whole: Floats | float = 1.0) -> Floats:
        """Return the light of each LED that reaches the camera, (k, n, n), 1 for an LED as bright as meant."""
        lit, dark = self._light
        return dark * whole + on * (lit - dark)

    @cached_property
    def _light(self) -> tuple[Floats, Floats]:
        """Light of each LED where a pattern lights it, and where none does, (n, n)."""
        seen = ~self.hidden
        return ((~self.dead | self.stuck) & seen) * self.gains, (self.stuck & seen) * self.gains

    @cached_property
    def none(self) -> bool:
        """Whether each LED shines as it is meant to, but for `off_s`."""
        lit, dark = self._light
        return bool((lit == 1).all() and (dark == 0).all())

    def cut(self, begin_s: float, end_s: float) -> Iterator[tuple[float, float]]:
        """Yield the parts of a time for which the array is not off."""
        for off, on in sorted(self.off_s):
            if off > begin_s:
                yield begin_s, min(off, end_s)
            begin_s = max(begin_s, on)
            if begin_s >= end_s:
                return
        yield begin_s, end_s


@dataclass(frozen=True)
class Lighting:
    """An array's patterns in true time."""

    # The array's patterns by number
    feed: PatternFeed
    # True time at which pattern 0 starts, in s
    start_s: float
    # True pattern period in s, with the error of the array's clock
    period_s: float
    # Order in which slots are lit as the level rises, a permutation of 0 to 3
    slot_order: tuple[int, ...]
    # Faults of the array
    faults: Faults
    # Whether a level is a steady luminance, as on a screen, and not a number of lit slots
    steady: bool = False

    def shown(self, start_s: float, end_s: float) -> "Shown | None":
        """Return what an exposure sees of the patterns; None where the array shows none."""
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
        """Light of an LED of each level in each slot, (4, 5), 1 where it is lit."""
        levels = np.arange(SLOTS + 1)
        if self.steady:
            return np.tile(levels / SLOTS, (SLOTS, 1))
        # level above which each slot is lit
        rank = np.argsort(np.asarray(self.slot_order))
        return np.asarray(levels > rank[:, None], float)


@dataclass(frozen=True, slots=True)
class Shown:
    """An exposure cut into k pieces at the PWM slots' boundaries; times without a pattern are left out."""

    # The array's patterns in true time
    lighting: Lighting
    # True start of the exposure in s
    start_s: float
    # Its true end in s
    end_s: float
    # True start and end of each piece in s, number of the pattern, and slot within it; in the order of time
    pieces: list[tuple[float, float, int, int]]

    @property
    def patterns(self) -> tuple[int, ...]:
        """Numbers of the patterns shown, in the order of time."""
        return tuple(dict.fromkeys([piece[2] for piece in self.pieces]))

    def lit(self) -> Lit:
        """Return the light of each LED in each piece."""
        begins, ends, numbers, phases = zip(*self.pieces, strict=True)
        on = [self.lighting.shares[p][self._pattern(n)] for n, p in zip(numbers, phases, strict=True)]
        return Lit(np.array(begins), np.array(ends), self.lighting.faults.visible(np.array(on)), self.patterns)

    def moments(self) -> tuple[Floats, Floats, Floats]:
        """Return the moments in time of each LED's light, those of `lit`: fraction, centroid, variance; see there."""
        begins, ends, _, phases = np.array(self.pieces).T
        rows = _moments(begins, ends, (self.start_s + self.end_s) / 2)
        return _central(self._light(rows, phases), self.end_s - self.start_s)

    def fraction(self) -> Floats:
        """Return the fraction of the exposure for which each LED is lit, (n, n), 0 to 1: the first of `moments`."""
        begins, ends, _, phases = np.array(self.pieces).T
        return np.asarray(self._light((ends - begins)[None], phases)[0] / (self.end_s - self.start_s))

    def _light(self, rows: Floats, phases: Floats) -> Floats:
        """Sums of the pieces' moments, (m, k), over those for which each LED is lit, (m, n, n)."""
        # LEDs of one level are lit at the same times: five numbers of a pattern say all
        shares, patterns = self.lighting.shares[phases.astype(int)], self.patterns
        if len(patterns) == 1:
            total = np.take(rows @ shares, self._pattern(patterns[0]), axis=1)
        else:
            own = np.array([piece[2] for piece in self.pieces])
            parts = [np.take((rows * (own == n)) @ shares, self._pattern(n), axis=1) for n in patterns]
            total = np.sum(parts, 0)
        faults = self.lighting.faults
        return total if faults.none else faults.visible(total, rows.sum(1)[:, None, None])

    def _pattern(self, number: int) -> NDArray[np.uint8]:
        pattern = self.lighting.feed.at(number)
        assert pattern is not None  # its pieces would not be here
        return pattern
