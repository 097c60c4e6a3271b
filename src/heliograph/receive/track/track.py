"""Whether an array is in sight where it should be: pattern and inverse differ there; a hidden array stands still.

What comes before an array from a side: it covers the array's surroundings before it hides an LED.

The sum of a pattern and its inverse shows all LEDs and the background, whatever is sent. Along a column or a row of
LEDs, and along a line beside the array, it hardly changes from pair to pair. A post that comes near changes it at once.
Its light would pull the pose: an array seems to end where a post begins.

Which LEDs are in sight: where a pattern and its inverse hardly differ, something hides them.

Data are random, so over a few pairs every LED in sight changes from pattern to inverse. What hides an array stands
still from one frame to the next, whatever its gray.

What is known of an array that is followed, and of a pair in which it was.

What a pair shows of an array before its pose is found: how much it changes, where it is hidden, what covers it.

Cut-outs without the LEDs that a post or a car hides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import ceil, erf, exp, hypot, inf, pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.fit import Fit, RenderCache
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.track import kernels
from heliograph.receive.track.kalman import PoseState

PIXEL_STD_PX = 12**-0.5
"""Standard deviation in pixels of a pixel's own width."""

NOISY = 1.5
"""Factor on the noise variance that a change must exceed: the variance of some hundred pixels is known to a fifth."""

ACTIVITY = 0.06
"""Least rms change from pattern to inverse of an array in sight, as a fraction of its light and of `contrast`.

Random data change the light by half of it; an eighth of that leaves room for dim LEDs and a gain that is too large.
"""

INSIDE_EDGE_PX, BESIDE_EDGE_PX = 0.5, 1.0
"""Pixels inside and beside an array's edge that are left out where its change is compared with that beside it.

A pixel whose centre is 0.5 px inside is inside as a whole. A blur of 0.5 px leaves 2 % of the light 1 px beside an
edge.
"""

LEAST_HALF_PX = 1.5
"""Half the side in px, at least, of the square whose change counts: 3 px, however small an array seems."""

MOST_BLUR_SIDES, MOST_FRAMES = 0.5, 2.0
"""Widest blur of what is followed, in its sides, and widest side, in those of a frame: beyond them nothing is read.

Of what flickered and was taken for an array the blur came to 170,000 px, and no memory held its image.
"""


def check_pose(pose: Pose, side: int, shape: tuple[int, ...]) -> None:
    """Check that what is followed may still be an array."""
    width = side * pose.pitch
    if not width <= MOST_FRAMES * max(shape):
        raise np.linalg.LinAlgError(f"a width of {width:.3g} px is none of an array in a frame of {max(shape)} px")
    if not pose.blur <= MOST_BLUR_SIDES * width:
        raise np.linalg.LinAlgError(f"a blur of {pose.blur:.3g} px of {width:.3g} px is none of an array")


def is_active(change: Floats, noise: float, pose: Pose, corner: tuple[int, int], side: int, gain: float) -> bool:
    """Whether pattern and inverse differ where the array should be: a hidden or dark array shows no change."""
    half = max(0.5 * side * pose.pitch - INSIDE_EDGE_PX, LEAST_HALF_PX)
    power, count = kernels.power_within(change, pose.x - corner[0], pose.y - corner[1], half)
    least = ACTIVITY * contrast(pose) * gain
    return bool(count and power >= count * (least**2 + NOISY * noise**2))


def noise_around(change: Floats, pose: Pose, corner: tuple[int, int], side: int) -> float:
    """Standard deviation of a difference around the array, in gray levels; 0 where nothing is around it."""
    half = 0.5 * side * pose.pitch + BESIDE_EDGE_PX
    return float(kernels.noise_beside(change, pose.x - corner[0], pose.y - corner[1], half))


def contrast(pose: Pose) -> float:
    """Fraction of the contrast of squares of 2 x 2 LEDs that blur and pixels leave, 0 to 1."""
    # along x and y alike: int (box * Gaussian)^2 / w = erf u - (1 - exp(-u^2)) / (sqrt(pi) u), u = w / 2 s
    u = pose.pitch / hypot(pose.blur, PIXEL_STD_PX)
    return erf(u) - (1 - exp(-(u**2))) / (sqrt(pi) * u)


BESIDE_PITCHES, BESIDE_PX = 1.5, 2.0
"""Distance of a line beside the array from its edge, in pitches, and at least in px.

2 px from an edge a blur of 0.7 px leaves 0.2 % of the array's light, and 8 % of an array 1 px off its place.
"""

LEAST_CHANGED = 0.15
"""Least change of a line that counts, as a fraction of the array's light.

Without it posts pull the pose: of 7389 pairs in 44 passages 931 were off by over half a pitch, with it 613 of 7281.
"""


def line_distance(pose: Pose, side: int) -> float:
    """Distance of the lines beside an array from its centre, in pitches."""
    return 0.5 * side + max(BESIDE_PITCHES, BESIDE_PX / pose.pitch)


SQUARE_LEDS, SQUARE_PX = 5, 4.0
"""Side of the square about an LED whose change counts, in LEDs, and at least in px.

Of random data the mean power of 25 LEDs is within a quarter of its expectation. After the blur, fewer than 16 pixels
show too few LEDs.
"""

RECENT_PAIR_WEIGHT = 0.25
"""Weight of the newest pair in the recent change of an LED.

With 25 LEDs about each and four pairs, the recent change has an error of a tenth, at most a fifth. A post that passes
in 0.1 s hides an LED each 3 ms, so the recent change lags by two or three LEDs.
"""

LEAST_CHANGE_IN_SIGHT = 0.2
"""Least recent change of an LED in sight, as a fraction of that of the others.

It lies four standard deviations below theirs. Because of the blur an LED of the rim changes half as much as others, one
in a corner a third as much.
"""

BRIGHT_QUANTILE = 0.8
"""Quantile of the LEDs' changes that stands for one in sight: a fifth of the array is enough."""

LEAST_DATA_POWER = 0.1
"""Least of that quantile, as a fraction of the power that random data have: below it all are hidden.

The change then has sqrt(0.1) = 0.32 of the amplitude of data. So LEDs may be three times dimmer than the gain says.
"""

MOST_CHANGE = 2.0
"""Most that a pair counts for an LED in sight, as a multiple of that quantile.

It bounds how long a hidden LED counts as in sight, whatever was seen of it: 2 * 0.75^n is below `LEAST_CHANGE_IN_SIGHT`
after nine pairs. From 1, which the LED at that quantile has, it takes six.
"""

LEAST_OPEN = 0.9
"""Least part of the open pixels that whole columns or rows must leave.

What hides a side leaves all of them. What hides a quarter in a corner leaves two thirds: at 80 m the codewords of such
an array were lost without the rest.
"""

LEAST_DARK_ZONE = 0.4
"""Least fraction of the LEDs about one that are dark in a header for it to lie in a zone that something hid then.

Of 16 LEDs in a row two columns at the rim have 3/5 or more, one column 2/5. Of LEDs that are dead here and there, 15 %
in all, one in 500 has as many dead ones about it.
"""


def in_sight(change: Floats) -> Floats:
    """1 for LEDs in sight, 0 for those that something hides, (n, n)."""
    return (change >= LEAST_CHANGE_IN_SIGHT).astype(np.float64)


def around_leds(values: Floats, pose: Pose) -> Floats:
    """Mean of values of LEDs over the squares about them."""
    width = square_leds(pose, len(values))
    return np.asarray(cv2.blur(values, (width, width), borderType=cv2.BORDER_REFLECT), np.float64)


def square_leds(pose: Pose, side: int) -> int:
    """LEDs in a row of the square about one, whose change counts for it."""
    return min(max(SQUARE_LEDS, ceil(SQUARE_PX / pose.pitch) | 1), side - 1 | 1)


def dark_zone(dark: NDArray[np.bool_], pose: Pose) -> NDArray[np.bool_]:
    """LEDs that something hides, of those that a header shows dark: they lie together, and dead ones do not."""
    return dark & (around_leds(dark.astype(np.float64), pose) >= LEAST_DARK_ZONE)


def open_pixels(seen: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Pixels before which nothing is: those whose LED and its neighbours are in sight."""
    side = len(seen)
    sure = cv2.erode(seen.astype(np.float32), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    middle, inverse = 0.5 * (side - 1), np.linalg.inv(pose.axes)
    first = inverse @ (np.array(corner, float) - (pose.x, pose.y)) + middle
    return np.asarray(
        cv2.warpAffine(
            sure,
            np.column_stack([inverse, first]),
            (shape[1], shape[0]),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        np.float64,
    )


def open_lines(unhidden: Floats) -> tuple[Floats, Floats]:
    """Unoccluded columns or rows, whichever keep more pixels: passing objects have a straight edge."""
    rows, columns = unhidden.shape
    across, down = unhidden.min(0), unhidden.min(1)
    by_columns, by_rows = across.sum() * rows, down.sum() * columns
    if max(by_columns, by_rows) < LEAST_OPEN * unhidden.sum():
        return np.ones(columns), np.ones(rows)
    return (across, np.ones(rows)) if by_columns >= by_rows else (np.ones(columns), down)


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
    drawn: RenderCache = field(default_factory=RenderCache, compare=False, repr=False)

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


USUAL_PAIRS = 50
"""Pairs after which it is known what an array and its surroundings usually show in sums: a packet.

Of arrays found while a post was leaving them, what it had covered was taken for covered when it came to light.
"""


@dataclass(frozen=True, slots=True)
class Look:
    """What a pair shows of an array where it is expected."""

    # (rows, columns) pattern less inverse in gray levels
    differs: Floats
    # (rows, columns) their sum
    total: Floats
    # Standard deviation of the noise of the difference in gray levels
    noise: float
    # The array's track with what the pair adds to `Track.change`, `Track.lines` and `Track.clear`
    track: Track


def look(track: Track, up: Floats, down: Floats, corner: tuple[int, int], pose: Pose) -> Look:
    """Look at a pair where an array is expected."""
    side = len(track.change)
    differs, total = np.empty(up.shape), np.empty(up.shape)
    after, sight, clear = np.empty((side, side)), np.empty((side, side)), np.empty((side, side))
    lines = np.full((2, side + 2), np.nan) if track.lines is None else track.lines.copy()
    # an array just found may be covered in part: what is usual shows later
    light = max(track.gain, track.data_gain) if track.pairs >= USUAL_PAIRS else inf
    # random data change the light by half of it
    least = LEAST_DATA_POWER * (0.5 * contrast(pose) * track.data_gain) ** 2
    noise, hidden, covered = kernels.look(
        up,
        down,
        np.array((pose.x - corner[0], pose.y - corner[1])),
        pose.axes,
        0.5 * side * pose.pitch + BESIDE_EDGE_PX,
        track.change,
        least,
        square_leds(pose, side),
        int(BRIGHT_QUANTILE * (side**2 - 1)),
        MOST_CHANGE,
        RECENT_PAIR_WEIGHT,
        LEAST_CHANGE_IN_SIGHT,
        line_distance(pose, side),
        LEAST_CHANGED * light,
        lines,
        differs,
        total,
        after,
        sight,
        clear,
    )
    seen = track.looked_at(after, sight if hidden else None, lines, clear if covered else None)
    return Look(differs, total, noise, seen)


NOTICED_PAIRS = 6
"""Pairs after which an LED that is hidden from one pair to the next is known to be so.

Its recent change falls by 0.75 a pair (`RECENT_PAIR_WEIGHT`), from 1 to `LEAST_CHANGE_IN_SIGHT` in six.
"""


def beside_what_hides(cutout: Cutout, in_sight: Floats) -> Cutout:
    """A cut-out without the pixels that something hides, or may hide in part: LEDs next to hidden ones."""
    across, down = open_lines(open_pixels(in_sight, cutout.middle, cutout.corner, cutout.shape))
    if cutout.covered is not None:
        across, down = across * cutout.covered[0], down * cutout.covered[1]
    return replace(cutout, in_sight=in_sight, covered=(across, down))


def mask_occluded_retroactively(cutouts: Mapping[int, Cutout], place: int, in_sight: Floats) -> dict[int, Cutout]:
    """Cut-outs of earlier pairs in which LEDs were hidden already that are noticed as hidden only now."""
    found = dict[int, Cutout]()
    for earlier in range(place - NOTICED_PAIRS, place):
        cutout = cutouts.get(earlier)
        seen = None if cutout is None else cutout.shining(in_sight)
        if cutout is not None and seen is not None and not np.array_equal(seen, cutout.shining(np.ones(seen.shape))):
            found[earlier] = beside_what_hides(cutout, seen)
    return found
