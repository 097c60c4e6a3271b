"""Tracks of arrays and the visibility of the LEDs.

Data are random, so each visible LED changes between pattern and inverse within a few pairs. An unchanged LED is
hidden by an object of any gray level.

An object that approaches from a side covers the surroundings first, and the light of the object would pull the pose.
The sum of a pattern and the inverse shows all LEDs and the background, and hardly changes along the rows and columns of
LEDs and along the lines just outside the array. Lines that change, from a side inwards, are covered.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
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


@dataclass(frozen=True)
class TrackParameters:
    """Parameters of the tracker and of the visibility of LEDs."""

    # Maximum number of Gauss-Newton steps per pair
    pair_steps: int = 3
    # Minimum fraction of visible LEDs for a fit
    min_visible_part: float = 0.25
    # Margin in px outside the edge of an array for the noise
    outside_edge_px: float = 1.0
    # Minimum change of a covered line, as a fraction of the light of the array
    min_line_change: float = 0.15
    # Pairs after which the usual levels of the lines are known: a packet
    learning_pairs: int = 50
    # Weight of the last pair in the recent change
    change_rate: float = 0.25
    # Minimum recent change of a visible LED, as a fraction of bright LEDs: four standard deviations below the mean
    min_visible: float = 0.2
    # Quantile of the changes of visible LEDs
    bright_quantile: float = 0.8
    # Maximum change of a pair relative to that quantile: bounds the time until a hidden LED is noticed
    max_change: float = 2.0
    # Errors of the pose beyond the noise of pixels, from simulations at other seeds than those of tests:
    # uncertain delay of the size in packets, as the headers show the size once a packet
    uncertain_packets: float = 0.45
    # part of 1 - correlation^2 of the sums that equal LEDs leave
    equal_residual: float = 6e-4
    # errors of x and y in px, by perspective and by combined frames
    position_error_px: float = 0.02
    # errors of x and y in px, and of ln pitch, roll, stretch and shear, relative to the light of unequal LEDs
    position_error: float = 0.8
    shape_errors: tuple[float, ...] = (0.05, 0.15, 0.0, 0.07, 0.07)


PARAMETERS = TrackParameters()


def check_pose(pose: Pose, side: int, shape: tuple[int, ...]) -> None:
    """Raise LinAlgError if a tracked pose is implausible."""
    width = side * pose.pitch
    if not width <= 2 * max(shape):
        raise np.linalg.LinAlgError(f"a width of {width:.3g} px is none of an array in a frame of {max(shape)} px")
    if not pose.blur <= 0.5 * width:
        raise np.linalg.LinAlgError(f"a blur of {pose.blur:.3g} px of {width:.3g} px is none of an array")


def is_visible(change: Floats, noise: float, pose: Pose, corner: tuple[int, int], side: int, gain: float) -> bool:
    """Return True if pattern and inverse differ at the array; a hidden or dark array shows no change."""
    half = max(0.5 * side * pose.pitch - 0.5, 1.5)
    power, count = kernels.power_within(change, pose.x - corner[0], pose.y - corner[1], half)
    # an eighth of the rms change of random data
    least = 0.06 * contrast(pose) * gain
    return bool(count and power >= count * (least**2 + 1.5 * noise**2))


def estimate_noise(change: Floats, pose: Pose, corner: tuple[int, int], side: int) -> float:
    """Estimate the noise of a difference around the array in gray levels; 0 if the array fills the image."""
    half = 0.5 * side * pose.pitch + PARAMETERS.outside_edge_px
    return float(kernels.noise_outside(change, pose.x - corner[0], pose.y - corner[1], half))


def contrast(pose: Pose) -> float:
    """Return the contrast of 2 x 2 LEDs after blur and pixels, 0 to 1."""
    # along x and y alike: int (box * Gaussian)^2 / w = erf u - (1 - exp(-u^2)) / (sqrt(pi) u), u = w / 2 s
    u = pose.pitch / hypot(pose.blur, 12**-0.5)
    return erf(u) - (1 - exp(-(u**2))) / (sqrt(pi) * u)


def line_distance(pose: Pose, side: int) -> float:
    """Return the distance of the lines outside an array from the centre, in pitches."""
    # beyond the blur
    return 0.5 * side + max(1.5, 2 / pose.pitch)


def square_leds(pose: Pose, side: int) -> int:
    """Return the side in LEDs of the square of an LED, which averages the change: 5 LEDs, and at least 4 px."""
    return min(max(5, ceil(4 / pose.pitch) | 1), side - 1 | 1)


def average_around_leds(values: Floats, pose: Pose) -> Floats:
    """Average values of LEDs over the squares around the LEDs."""
    width = square_leds(pose, len(values))
    return np.asarray(cv2.blur(values, (width, width), borderType=cv2.BORDER_REFLECT), np.float64)


def dark_zone(dark: NDArray[np.bool_], pose: Pose) -> NDArray[np.bool_]:
    """Select the hidden LEDs among the dark LEDs of a header: hidden LEDs are adjacent, dead LEDs are not."""
    return dark & (average_around_leds(dark.astype(np.float64), pose) >= 0.4)


def visible_pixels(visible: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Return 1 for pixels of a visible LED with visible neighbours, 0 for other pixels."""
    side = len(visible)
    inner = cv2.erode(visible.astype(np.float32), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    middle, inverse = 0.5 * (side - 1), np.linalg.inv(pose.axes)
    first = inverse @ (np.array(corner, float) - (pose.x, pose.y)) + middle
    map_, flags = np.column_stack([inverse, first]), cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(inner, map_, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float64)


def visible_lines(visible: Floats) -> tuple[Floats, Floats]:
    """Return visible columns or rows, depending on the number of pixels left: occluders have straight edges."""
    rows, columns = visible.shape
    across, down = visible.min(0), visible.min(1)
    by_columns, by_rows = across.sum() * rows, down.sum() * columns
    # an occluded corner would cost too many pixels
    if max(by_columns, by_rows) < 0.9 * visible.sum():
        return np.ones(columns), np.ones(rows)
    return (across, np.ones(rows)) if by_columns >= by_rows else (np.ones(columns), down)


@dataclass(frozen=True)  # without slots, for the cached properties
class Track:
    """State of a tracked array."""

    # Pose and rates, with the covariance
    state: PoseState
    # Gray levels of the sum of a pair with all LEDs on
    gain: float
    # The same by headers, without the background
    data_gain: float
    # (n, n) gains of the LEDs, at least 0, 1 for the median LED
    led_gains: Floats
    # Time in seconds of the last pair with a visible array
    last_seen_s: float
    # (n, n) recent change of each LED from pattern to inverse, 1 for visible LEDs
    change: Floats
    # Correlation of recent sums with the image of the array; 1 before the first
    score: float = 1.0
    # Number of pairs
    pairs: int = 0
    # (2, n + 2) usual gray levels of sums along columns and rows and along the lines outside; NaN if unknown
    lines: Floats | None = None
    # (n, n) 0 for LEDs covered from a side, 1 for other LEDs; None if no LED is covered
    clear: Floats | None = None
    # Images of the array with all LEDs on, for the fits of sums
    render_cache: RenderCache = field(default_factory=RenderCache, compare=False, repr=False)

    @cached_property
    def visible(self) -> Floats:
        """1 for visible LEDs, 0 for hidden LEDs, (n, n)."""
        return (self.change >= PARAMETERS.min_visible).astype(np.float64)

    @cached_property
    def all_visible(self) -> bool:
        """True if all LEDs are visible."""
        return bool(self.change.min() >= PARAMETERS.min_visible)

    @property
    def uncovered(self) -> Floats:
        """1 for visible and uncovered LEDs, (n, n)."""
        return self.visible if self.clear is None else self.visible * self.clear

    @property
    def is_occluded(self) -> bool:
        """True if an LED is hidden or covered."""
        return not self.all_visible if self.clear is None else not self.uncovered.all()

    @cached_property
    def shining(self) -> Floats:
        """Gains of the LEDs, 0 for hidden LEDs, (n, n)."""
        return self.led_gains if self.all_visible else self.led_gains * self.visible


@dataclass(frozen=True, slots=True)
class TrackedPair:
    """A pattern and the inverse with the pose found in the sum."""

    # The track before the pair
    before: Track
    # The track after the pair
    track: Track
    # The fit of the sum
    fit: Fit
    # True if the array was visible
    seen: bool
    # The two frames less the background, if the data have no inverses
    cutouts: tuple[Cutout, ...] = ()

    @property
    def state(self) -> PoseState:
        """Pose and rates in the middle of the pair."""
        return self.track.state


def preview_pair(
    track: Track, up: Floats, down: Floats, corner: tuple[int, int], pose: Pose
) -> tuple[Floats, Floats, float, Track]:
    """Return difference and sum of a pair, the noise of the difference, and the track with updated visibility."""
    side, parameters = len(track.change), PARAMETERS
    lines = np.full((2, side + 2), np.nan) if track.lines is None else track.lines.copy()
    # a detected array may be partly covered: the usual levels are still unknown
    light = max(track.gain, track.data_gain) if track.pairs >= parameters.learning_pairs else inf
    middle = np.array((pose.x - corner[0], pose.y - corner[1]))
    limits = (
        0.5 * side * pose.pitch + parameters.outside_edge_px,
        square_leds(pose, side),
        int(parameters.bright_quantile * (side**2 - 1)),
        # a tenth of the power of random data, which change the light by half
        0.1 * (0.5 * contrast(pose) * track.data_gain) ** 2,
        parameters.max_change,
        parameters.change_rate,
        parameters.min_visible,
        line_distance(pose, side),
        parameters.min_line_change * light,
    )
    difference, total = up - down, up + down
    noise, change, (clear, covers) = kernels.preview(difference, total, middle, pose.axes, track.change, lines, limits)
    clear = clear if covers else None
    return difference, total, noise, replace(track, change=change, pairs=track.pairs + 1, lines=lines, clear=clear)


def mask_occluded(cutout: Cutout, visible: Floats) -> Cutout:
    """Mask the hidden pixels of a cut-out, and the pixels next to hidden LEDs."""
    across, down = visible_lines(visible_pixels(visible, cutout.middle, cutout.corner, cutout.shape))
    if cutout.covered is not None:
        across, down = across * cutout.covered[0], down * cutout.covered[1]
    return replace(cutout, in_sight=visible, covered=(across, down))


def mask_occluded_retroactively(cutouts: Mapping[int, Cutout], place: int, visible: Floats) -> dict[int, Cutout]:
    """Mask earlier cut-outs, as hidden LEDs are noticed some pairs late; returns the changed cut-outs."""
    masked = dict[int, Cutout]()
    # 0.75^n falls below `min_visible` after six pairs
    for earlier in range(place - 6, place):
        cutout = cutouts.get(earlier)
        if cutout is None:
            continue
        shining = cutout.shining(visible)
        if not np.array_equal(shining, cutout.shining(np.ones(shining.shape))):
            masked[earlier] = mask_occluded(cutout, shining)
    return masked
