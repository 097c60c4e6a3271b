"""Which LED is lit for which part of an exposure: equations (1), (2), (4) and (6)."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.channel.settings import Placement
from heliograph.signal.pwm import SLOTS

Floats = NDArray[np.float64]

SLIVER = 1e-6
"""Pieces of an exposure shorter than this share of a slot are rounding errors of the clocks, not light."""

HELD = 8
"""Patterns kept: an exposure is at most T_b and reads two, or three with clocks that differ."""


class PatternFeed:
    """The patterns of one array, read as time goes on.

    Raises
    ------
    ValueError
        There are none, they are not square uint8 levels 0 to 4, or their size changes.
    """

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
        """Pattern of a number that does not fall behind the newest by more than `HELD`; None before and after all."""
        while self._next <= number:
            pattern = next(self._source, None)
            if pattern is None:
                break
            self._held[self._next] = self._checked(pattern)
            self._held.pop(self._next - HELD, None)
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
    """An exposure cut at the PWM slots' boundaries; the slots in which the array is dark are left out.

    Attributes
    ----------
    start_s, end_s
        (k,) true times of the pieces.
    on
        (k, n, n) float64: 1 where an LED is lit.
    patterns
        Numbers of the patterns shown, in the order of time.
    """

    start_s: Floats
    end_s: Floats
    on: Floats
    patterns: tuple[int, ...]

    def moments(self, start_s: float, end_s: float) -> tuple[Floats, Floats, Floats]:
        """When each LED is lit in an exposure.

        Returns
        -------
        share
            (n, n) share of the exposure it is lit.
        late
            (n, n) centroid of its lit time, from the middle of the exposure in s.
        spread
            (n, n) variance of its lit time in s^2.
        """
        length = self.end_s - self.start_s
        centre = (self.start_s + self.end_s - start_s - end_s) / 2
        rows = np.stack([length, length * centre, length * (centre**2 + length**2 / 12)])
        sums = np.tensordot(rows, self.on, 1)
        total = np.maximum(sums[0], 1e-30)
        late = sums[1] / total
        return sums[0] / (end_s - start_s), late, np.maximum(sums[2] / total - late**2, 0)

    def split(self, longest_s: float) -> "Lit":
        """The same, with no piece longer than a time."""
        count = np.maximum(np.ceil((self.end_s - self.start_s) / longest_s - 1e-9), 1).astype(int)
        part = np.concatenate([np.arange(c) for c in count])
        length = np.repeat((self.end_s - self.start_s) / count, count)
        start = np.repeat(self.start_s, count) + part * length
        return Lit(start, start + length, np.repeat(self.on, count, 0), self.patterns)


@dataclass(frozen=True)
class Faults:
    """What keeps an array from showing its patterns.

    Attributes
    ----------
    dead, stuck, hidden
        (n, n) LEDs that never shine, that always do, and that something hides.
    off_s
        Times (from, to) for which all are dark.
    """

    dead: NDArray[np.bool_]
    stuck: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    off_s: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, place: Placement, side: int, rng: np.random.Generator) -> "Faults":
        """The faults of an array; which LEDs fail is drawn at random."""
        order = rng.permutation(side * side).reshape(side, side)
        many, more = round(place.dead * side * side), round(place.stuck * side * side)
        hidden = np.zeros((side, side), bool)
        if place.hidden:
            left, top, right, low = place.hidden
            v, u = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side])
            hidden = (v > left) & (v < right) & (u > top) & (u < low)
        return cls(order < many, (order >= many) & (order < many + more), hidden, place.off_s)

    def left(self, on: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """What shines of LEDs (k, n, n) that should."""
        return np.asarray(((on & ~self.dead) | self.stuck) & ~self.hidden)

    def cut(self, begin_s: float, end_s: float) -> Iterator[tuple[float, float]]:
        """The parts of a time for which the array is not off."""
        for off, on in sorted(self.off_s):
            if off > begin_s:
                yield begin_s, min(off, end_s)
            begin_s = max(begin_s, on)
            if begin_s >= end_s:
                return
        yield begin_s, end_s


@dataclass(frozen=True)
class Lighting:
    """When an array shows its patterns.

    Attributes
    ----------
    feed
        Its patterns.
    start_s, period_s
        Start of pattern 0, and the pattern period by the array's own clock.
    slot_order
        Order in which slots are lit as the level rises.
    faults
        What keeps it from showing them.
    """

    feed: PatternFeed
    start_s: float
    period_s: float
    slot_order: tuple[int, ...]
    faults: Faults

    def lit(self, start_s: float, end_s: float) -> Lit | None:
        """What is lit in an exposure; None where the array shows no pattern."""
        slot_s = self.period_s / SLOTS
        pieces: list[tuple[float, float, int, int, NDArray[np.uint8]]] = []
        # (1), (2): x(t) = sum_k x_k g(t - k T_b); (4), (5): the shutter is open from start to end
        for slot in range(math.floor((start_s - self.start_s) / slot_s), math.ceil((end_s - self.start_s) / slot_s)):
            begin = max(start_s, self.start_s + slot * slot_s)
            end = min(end_s, self.start_s + (slot + 1) * slot_s)
            number, phase = divmod(slot, SLOTS)
            pattern = self.feed.at(number) if end - begin > SLIVER * slot_s else None
            if pattern is not None:
                parts = [part for part in self.faults.cut(begin, end) if part[1] - part[0] > SLIVER * slot_s]
                pieces += [(*part, number, phase, pattern) for part in parts]
        if not pieces:
            return None
        begins, ends, numbers, phases, patterns = zip(*pieces, strict=True)
        rank = np.argsort(np.asarray(self.slot_order))[list(phases)]
        on = self.faults.left(np.stack(patterns) > rank[:, None, None]).astype(float)
        return Lit(np.array(begins), np.array(ends), on, tuple(dict.fromkeys(numbers)))
