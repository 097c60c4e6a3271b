"""What is known of an array that is followed, and of a pair in which it was."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.image.fit import Drawn, Fit
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.sight import in_sight


@dataclass(frozen=True)  # without slots, which leave no room for what is cached
class Track:
    """What is known of an array that is followed."""

    # Pose and rates, with their covariance
    state: PoseState
    # Gray levels of a pair's sum with all LEDs on
    gain: float
    # The same as headers show it, where the background cancels
    data_gain: float
    # (n, n) gains of its LEDs, at least 0, 1 for the median LED
    led_gains: Floats
    # Time in seconds when it was last in sight
    last_seen_s: float
    # (n, n) how much each LED changed from pattern to inverse in recent pairs, as a fraction of LEDs in sight, 0 to
    # `sight.MOST_CHANGE`
    change: Floats
    # Correlation of recent sums with the array's image; 1 before the first
    score: float = 1.0
    # Pairs that were followed so far
    pairs: int = 0
    # (2, n + 2) gray levels that sums usually show along columns, from left to right, and rows, from top to bottom, and
    # beside them; NaN where nothing was seen yet; None before the first pair
    lines: Floats | None = None
    # (n, n) 1 for LEDs before which nothing has come from a side, else 0; None if all are
    clear: Floats | None = None
    # The array with all LEDs on as it was last drawn, which saves fits of sums the drawing
    drawn: Drawn = field(default_factory=Drawn, compare=False, repr=False)

    def looked_at(self, change: Floats, in_sight: Floats | None, lines: Floats, clear: Floats | None) -> "Track":
        """The track after one more pair was looked at."""
        gains = self.state, self.gain, self.data_gain, self.led_gains, self.last_seen_s
        after = Track(*gains, change, self.score, self.pairs + 1, lines, clear, self.drawn)
        known = after.__dict__
        known["whole"] = in_sight is None
        known["in_sight"] = _all_leds(len(change)) if in_sight is None else in_sight
        if "sound" in self.__dict__:
            known["sound"] = self.sound
        return after

    def found(self, state: PoseState, gain: float, score: float, seen_s: float) -> "Track":
        """The track after its pose was found; what is known of its LEDs need not be worked out again."""
        leds = self.change, score, self.pairs, self.lines, self.clear, self.drawn
        after = Track(state, gain, self.data_gain, self.led_gains, seen_s, *leds)
        for name in ("in_sight", "whole", "unhidden", "hidden", "sound", "shining"):
            if name in self.__dict__:
                after.__dict__[name] = self.__dict__[name]
        return after

    @cached_property
    def in_sight(self) -> Floats:
        """1 for LEDs in sight, 0 for those that something hides, (n, n)."""
        return in_sight(self.change)

    @cached_property
    def whole(self) -> bool:
        """Whether all LEDs are in sight."""
        return bool(self.in_sight.all())

    @cached_property
    def unhidden(self) -> Floats:
        """1 for LEDs in sight that nothing covers, as far as is known, (n, n)."""
        return self.in_sight if self.clear is None else self.in_sight * self.clear

    @cached_property
    def hidden(self) -> bool:
        """Whether something hides or covers an LED."""
        return not self.whole if self.clear is None else not self.unhidden.all()

    @cached_property
    def sound(self) -> bool:
        """Whether no LED is dead."""
        return bool(self.led_gains.all())

    @cached_property
    def shining(self) -> Floats:
        """Gains of the LEDs, 0 where something hides them, (n, n)."""
        return self.led_gains if self.whole else self.led_gains * self.in_sight


@lru_cache(maxsize=8)  # arrays of one film have one size
def _all_leds(side: int) -> Floats:
    """1 for all LEDs, (side, side)."""
    return np.ones((side, side))


@dataclass(frozen=True, slots=True)
class TrackedPair:
    """A pattern and its inverse with the pose found in their sum."""

    # The track before the pair
    before: Track
    # The track after it
    track: Track
    # The fit of the sum
    fit: Fit
    # Whether the array was in sight
    seen: bool
    # Of data without inverses, the two frames less their background; else none
    cutouts: tuple[Cutout, ...] = ()

    @property
    def state(self) -> PoseState:
        """Pose and rates in the middle of the pair."""
        return self.track.state
