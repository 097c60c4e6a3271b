"""Frames lost without a gap in their times, found by what they show.

A camera that numbers the frames it delivers says nothing of those it lost. From then on pattern and inverse change
places. A slip shows itself. Let r~_i be frame i less the mean of the frames, at the LEDs' places. Then

    epsilon_ij = |r~_i + r~_j|^2 / (|r~_i|^2 + |r~_j|^2)

is near 0 for a pattern and its inverse, and near 1 for patterns of different pairs. Where something hides the array,
epsilon says nothing. Where a pair is uneven, the frames after it are awaited. They are then paired at the least cost:
epsilon for each pair, `SLIP_COST` for each frame taken as the one left of a pair. A pair that is lost as a whole leaves
sums even. The next header shows the loss, as it comes two patterns early; `lost_pair` finds the place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync import kernels
from heliograph.receive.sync.pairing import PoseAt, is_data
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

EVEN_SUM_POWER = 0.4
"""Largest epsilon of an even pair: 4 standard deviations below that of 60 independent values of two patterns.

Half of it is asked for where a copy is to explain a gap that the times have.
"""

SLIP_COST = 0.45
"""Cost of a slip, beside epsilon of pairs.

Two frames in a row may be lost, one from each of two pairs. The frames left of the two then look like one uneven pair,
with an epsilon near 1. Two slips must cost less than that; they cost 0.9.
"""

LEAST_EVEN_PAIRS = 2
"""Least number of even pairs after a slip: one may be even by chance, where the array is hidden."""

MOST_SLIPS = 2
"""Most frames taken as lost of those in hand.

Where a frame in 50 is lost, three of ten are lost once in 1000 times. At the start of a fast passage poses may be wrong
for two pairs. Four slips would explain these.
"""

CORRECTED_PITCHES = 0.25
"""Pitches by which a pose may change before a frame in hand is viewed again: a pair is then still even, by its blur.

After a post the pose may come back by 2 px at once. A frame viewed before and one after it look like no pair.
"""

AWAITED_FRAMES = 9
"""Frames in hand when a slip is decided on: four pairs with it, and four without."""

HEADER_CORRELATION = 0.7
"""Least correlation of each frame of a header with its image, for the numbers to follow it.

Half of the frame's power, 0.7^2, is then the header's. Of a pattern of 60 independent values the correlation has a
standard deviation of 1 / sqrt(60) = 0.13: 0.7 is five of them.
"""

POWER_RATIO = 0.25
"""Least power of one frame over another's, and of a frame less its mean over all of it, for both to be patterns.

Random data of 60 independent values differ by less than half, and their mean has 1/64 of the power; something before
the array is even, or of another brightness.
"""

RIM_DIVISOR = 8
"""Part of an array's side that is left out on either side, one in so many: 2 of 16 LEDs.

Before a bright sky a pose off by 0.2 px at 95 m made the rim of even pairs look uneven.
"""

MEAN_FRAME_WEIGHT = 0.1
"""Weight of a pair in the mean of frames: ten pairs count, as in the tracker's gain."""

OUT_OF_STEP_PATTERNS = 0.2
"""T_b by which a frame may be out of step for its pairs to be even: epsilon is then 0.08 or less."""

HEADER_SPANS = 3
"""Lengths of a header over which frames are compared with it: it may end its own length early or as much late."""

WIDER_PX = 0.5
"""Pixels by which an LED's square is taken wider than its pitch, before the nearest odd width of a mean is taken.

Motion widens the light of an LED, so a pitch of 1.5 px has a mean over 3 px already.
"""


@dataclass(slots=True, eq=False)
class _Held:
    """A frame whose number is not decided.

    Its own number by its time; the array's pose when it was viewed; what it shows at the LEDs' places, and about the
    mean of frames; the power of the latter, and whether it may be a pattern's. Then a memo: the frame that it was last
    compared with, and their epsilon.
    """

    frame: Frame
    number: int
    pose: Pose
    shown: Floats
    about: Floats | None
    power: float
    pattern: bool
    other: "_Held | None" = None
    uneven: float | None = None


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Frames in hand paired: the cost of it, epsilon of each pair, and the frames taken as the ones left of a pair."""

    cost: float
    uneven: tuple[float, ...]
    slips: int


class SlipWatch:
    """Gives frames of one array the times they would have, had every lost frame left a gap."""

    def __init__(self, identity: int, signal: SignalSettings):
        self.lost = 0
        self._signal, self._period_s, self._packet_patterns = signal, signal.pattern_period_s, signal.packet_patterns
        self._header_patterns = 2 * signal.header_pairs
        # without its rim, where a bright background shines in
        self._rim = signal.side // RIM_DIVISOR
        inner = slice(self._rim, signal.side - self._rim)
        self._signs = (header_levels(identity, signal.side) / 2.0 - 1.0)[inner, inner].ravel()
        self._held: list[_Held] = []
        self._mean: Floats | None = None
        self._headers: dict[int, float] = {}
        self._last_s: float | None = None
        self._number = 0
        self._even_before = True

    def push(self, frame: Frame, origin_s: float, pose_at: PoseAt, paired: bool) -> Iterator[Frame]:
        """Take the next frame; yield those whose times are known by now."""
        period_s, last_s = self._period_s, self._last_s
        self._last_s = frame.time_s
        place = (frame.time_s + self.lost * period_s - origin_s) / period_s
        number = round(place) - self.lost
        stepped = last_s is None or frame.time_s - last_s > (1 - OUT_OF_STEP_PATTERNS) * period_s
        if not (paired and stepped and place > -0.5 and abs(place - round(place)) < OUT_OF_STEP_PATTERNS):
            yield from self.flush()
            yield self._timed(frame)
            return
        # what has come since may have corrected the poses at which frames in hand were viewed
        self._held = [self._corrected(one, pose_at(one.frame.time_s + self.lost * period_s)) for one in self._held]
        self._held.append(self._viewed(frame, number, pose_at(frame.time_s + self.lost * period_s)))
        while self._held and self._ready():
            yield from self._release()

    def flush(self) -> Iterator[Frame]:
        """Yield the frames held back, as there will be no more."""
        while self._held:
            yield from self._release()

    def _timed(self, frame: Frame) -> Frame:
        """The frame at the time of what it shows."""
        if not self.lost:
            return frame
        return replace(frame, time_s=frame.time_s + self.lost * self._period_s)

    def _corrected(self, held: _Held, pose: Pose) -> _Held:
        """A frame in hand, viewed again where the array is now known to have been elsewhere."""
        off_px = hypot(pose.x - held.pose.x, pose.y - held.pose.y)
        return held if off_px < CORRECTED_PITCHES * pose.pitch else self._viewed(held.frame, held.number, pose)

    def _viewed(self, frame: Frame, number: int, pose: Pose) -> _Held:
        """What a frame shows of an array at a pose."""
        side, place = self._signal.side, (pose.x - frame.origin[0], pose.y - frame.origin[1])
        # over all of an LED's square: motion shifts the light of each by its own part of a pattern
        width = 2 * int((pose.pitch + WIDER_PX) / 2) + 1
        shown = kernels.means_at_leds(frame.pixels, *place, pose.axes, width, self._rim, side)
        if self._mean is None:
            return _Held(frame, number, pose, shown, None, 0.0, False)
        about = np.empty(shown.shape)
        power, mean = kernels.about_mean(shown, self._mean, about)
        return _Held(frame, number, pose, shown, about, power, power - about.size * mean**2 > POWER_RATIO * power)

    def _ready(self) -> bool:
        """Whether enough frames are in hand to release the first."""
        first = self._held[0]
        if (first.number + self.lost) % 2 or len(self._held) >= AWAITED_FRAMES:
            return len(self._held) > 1 or not self._left_alone(first)
        return len(self._held) > 1 and (self._gap(0) > 1 or not self._odd(0))

    def _release(self) -> Iterator[Frame]:
        """Release the first frame, or the first pair; or drop the first where its other half is lost without a gap."""
        first = self._held[0]
        if len(self._held) == 1:
            yield self._pop()
        elif (first.number + self.lost) % 2:
            if self._left_alone(first) and self._gap(0) == 1 and self._even(0, EVEN_SUM_POWER / 2):
                # the frame that seems missing before it was a copy, which the clock left out
                self.lost -= 1
            else:
                yield self._pop()
        elif self._gap(0) > 1:
            copied = self._gap(0) == 2 and self._even(0, EVEN_SUM_POWER / 2)
            yield self._pop()
            self.lost -= copied
        elif not (self._odd(0) and self._slipped()):
            self._even_before = self._mean is None or self._even(0)
            mean = 0.5 * (first.shown + self._held[1].shown)
            self._mean = mean if self._mean is None else self._mean + MEAN_FRAME_WEIGHT * (mean - self._mean)
            yield self._pop()
            yield self._pop()
        else:
            # it may be the pattern or the inverse
            self._number = self._held.pop(0).number
            self.lost += 1

    def _pop(self) -> Frame:
        """The first frame, its number decided on."""
        first = self._held.pop(0)
        self._number = first.number
        out, number = self._timed(first.frame), first.number + self.lost
        near = (number + self._header_patterns) % self._packet_patterns < HEADER_SPANS * self._header_patterns
        if near and first.about is not None:
            self._headers[number] = float(first.about @ self._signs) / max(first.power * self._signs.size, TINY) ** 0.5
            self._follow_header(number)
        return out

    def _follow_header(self, number: int) -> None:
        """Take the frames after a header that ended early, or late after a slip that was none, for what follows it."""
        patterns, length = self._packet_patterns, self._header_patterns
        early = (length - 1 - number + patterns // 2) % patterns - patterns // 2
        last = [self._headers.get(number - k, 0.0) for k in range(length)]
        if 0 < abs(early) <= length and all((-1) ** (k + 1) * h > HEADER_CORRELATION for k, h in enumerate(last)):
            self.lost += early
        self._headers = {k: h for k, h in self._headers.items() if k > number - length}

    def shows_header(self, pair: int) -> bool:
        """Whether the frames taken for a pair of data are a header's: a pair before it was lost as a whole."""
        up, down = (self._headers.get(2 * pair + k, 0.0) for k in range(2))
        return up > HEADER_CORRELATION and down < -HEADER_CORRELATION

    def _gap(self, place: int) -> int:
        """Frame periods from a frame in hand to the next."""
        return self._held[place + 1].number - self._held[place].number

    def _left_alone(self, first: _Held) -> bool:
        """Whether the frame before an inverse of data is missing by its time."""
        number = first.number + self.lost
        return number % 2 == 1 and first.number > self._number + 1 and is_data(number // 2, self._signal)

    def _uneven(self, place: int) -> float | None:
        """The measure epsilon of a frame in hand and the next, at most 1; None where one of them shows no pattern."""
        one, other = self._held[place], self._held[place + 1]
        if one.other is not other:
            one.other, one.uneven = other, _epsilon(one, other)
        return one.uneven

    def _even(self, place: int, least: float = EVEN_SUM_POWER) -> bool:
        """Whether a frame in hand and the next are surely a pair."""
        e = self._uneven(place)
        return e is not None and e < least

    def _odd(self, place: int) -> bool:
        """Whether a frame in hand and the next are surely none."""
        e = self._uneven(place)
        return e is not None and e >= EVEN_SUM_POWER

    def _slipped(self) -> bool:
        """Whether the first frame's other half is lost: without it the frames after it make even pairs.

        Where the pair before was uneven as well, poses may be wrong, or the array hidden. A header is then even at any
        place, so all pairs that follow must change for the better.
        """
        found: dict[tuple[int, int], _Pairs] = {}
        regular, slipped = self._regular(0, self.lost, found), self._paired(1, self.lost + 1, found)
        even = len(slipped.uneven) >= LEAST_EVEN_PAIRS and max(slipped.uneven) < EVEN_SUM_POWER
        even &= slipped.slips < MOST_SLIPS
        if not self._even_before:
            even &= all(self._even(k + 1) and self._odd(k) for k in range(0, len(self._held) - 2, 2))
        return even and SLIP_COST + slipped.cost < regular.cost

    def _paired(self, place: int, lost: int, found: dict[tuple[int, int], _Pairs]) -> _Pairs:
        """The frames in hand from one on, paired at the least cost; `found` keeps what is found by place and parity."""
        key = place, lost % 2
        if key not in found:
            found[key] = self._least(place, lost, found)
        return found[key]

    def _least(self, place: int, lost: int, found: dict[tuple[int, int], _Pairs]) -> _Pairs:
        """The first frame paired, or left alone, whichever costs less."""
        if not self._begins(place, lost):
            return self._regular(place, lost, found)
        slipped = self._paired(place + 1, lost + 1, found)
        slipped = _Pairs(SLIP_COST + slipped.cost, slipped.uneven, slipped.slips + 1)
        return min(self._regular(place, lost, found), slipped, key=lambda one: one.cost)

    def _regular(self, place: int, lost: int, found: dict[tuple[int, int], _Pairs]) -> _Pairs:
        """The frames in hand from one on, the first of which is not left alone."""
        if place >= len(self._held) - 1:
            return _Pairs(0.0, (), 0)
        if not self._begins(place, lost):
            return self._paired(place + 1, lost, found)
        e, rest = self._uneven(place), self._paired(place + 2, lost, found)
        return rest if e is None else _Pairs(e + rest.cost, (e, *rest.uneven), rest.slips)

    def _begins(self, place: int, lost: int) -> bool:
        """Whether a frame in hand begins a pair whose other half is the next."""
        if place >= len(self._held) - 1:
            return False
        return (self._held[place].number + lost) % 2 == 0 and self._gap(place) <= 1


def _epsilon(one: _Held, other: _Held) -> float | None:
    """The measure epsilon of two frames, at most 1; None where one of them shows no pattern."""
    u, v, p, q = one.about, other.about, one.power, other.power
    if u is None or v is None or not (one.pattern and other.pattern) or min(p, q) < POWER_RATIO * max(p, q):
        return None
    return min(1 + 2 * float(u @ v) / max(p + q, TINY), 1.0)
