"""Pairs of which one frame is lost: the other still shows the data, as the sums of the pairs around are known.

The sum r + r' shows all LEDs and the background, whatever is sent. With the sum of the lost pair taken from those
around, what a frame shows is the difference

    r - r' = 2 r - (r + r'),

r being the frame that is left; of the inverse it is the negative of that. A sum moves with the array: what it holds
beside the array's light is taken along from pose to pose, and the array's light put in at the pose of the frame left.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import HALF_LIT, RIM_PX, covered, cut_out, window_around
from heliograph.receive.observe.cutout import RING_PX, Cutout
from heliograph.receive.sync.pairing import UnpairedFrame
from heliograph.receive.track.kalman import POSE_SIZE, RATE_STATES, PoseState

SUMS, REACH = 6, 6
"""Sums of which that of a lost pair is taken, and pairs within which the nearest of them must be.

Their noise adds 1/6 to the 2 of the frame's own. 6 pairs are 12 ms, half a period of shake at 40 Hz.
"""

UNEVEN = 0.25
"""Largest mean of the difference over the array, as a fraction of its light; more is something before the array.

The mean of random data has a standard deviation of 1/32.
"""


@dataclass(frozen=True, slots=True)
class SeenPair:
    """A pair of data of which both frames are there."""

    # The array in it, as it was followed
    state: PoseState
    # Its frames about the array
    cutout: Cutout


def around(place: int, seen: Mapping[int, object]) -> list[int]:
    """Places of the pairs whose sums stand for that of another, nearest first."""
    nearest = sorted(seen, key=lambda k: (abs(k - place), k))[:SUMS]
    return nearest if nearest and abs(nearest[0] - place) <= REACH else []


def state_between(time_s: float, states: Mapping[int, PoseState], place: int) -> PoseState:
    """The array's state at a time between two at which it was seen.

    Poses follow the cubic that has the poses and rates of both (Hermite's).
    """
    before = max((k for k in states if k < place), default=None)
    after = min((k for k in states if k > place), default=None)
    if before is None or after is None:
        near = states[min(states, key=lambda k: abs(k - place))]
        return _at(near, time_s, near.pose_at(time_s).vector(), near.mean[RATE_STATES])
    one, other = states[before], states[after]
    h = other.time_s - one.time_s
    t = (time_s - one.time_s) / h
    p, q = one.mean[:POSE_SIZE], other.mean[:POSE_SIZE]
    u, v = (np.append(state.mean[RATE_STATES], np.zeros(POSE_SIZE - 3)) * h for state in (one, other))
    u[3:] = v[3:] = (q - p)[3:]
    vector = p + t * u + t**2 * (3 * (q - p) - 2 * u - v) + t**3 * (2 * (p - q) + u + v)
    rates = (u + 2 * t * (3 * (q - p) - 2 * u - v) + 3 * t**2 * (2 * (p - q) + u + v))[:3] / h
    return _at(one, time_s, vector, rates)


def lone_cutout(
    lone: UnpairedFrame, place: int, seen: Mapping[int, SeenPair], late_s: float, gain: float, led_gains: Floats
) -> Cutout | None:
    """What the frame left of a pair shows of it."""
    chosen = around(place, seen)
    if not chosen:
        return None
    state = state_between(lone.frame.time_s, {k: one.state for k, one in seen.items()}, place)
    data, mean_light = state.pose_at(lone.frame.time_s + late_s), state.pose_at(lone.frame.time_s + lone.late_s)
    side = len(led_gains)
    x, y, cols, rows = window_around(data, side, RIM_PX + RING_PX)
    corner, shape = (x, y), (rows, cols)
    lit = image_of(led_gains, mean_light, corner, shape)
    steady = [_background(seen[k], lone.late_s - late_s, gain, led_gains, state.pose, corner, shape) for k in chosen]
    total = gain * lit + np.mean(steady, axis=0)
    shown = 2 * cut_out(lone.frame, (x, y, cols, rows)) - total
    inside = lit > HALF_LIT * lit.max()
    if abs(shown[inside].mean()) > UNEVEN * gain:
        return None
    # 4 s^2 of the frame and 2 s^2 / k of k sums, over the 2 s^2 of a difference of two frames
    noise = 2 + 1 / len(chosen)
    difference = -shown if lone.inverted else shown
    return Cutout(total, difference, corner, (data,), covered=covered((lone.frame,), corner, shape), noise=noise)


def _background(
    pair: SeenPair,
    earlier_s: float,
    gain: float,
    led_gains: Floats,
    pose: Pose,
    corner: tuple[int, int],
    shape: tuple[int, int],
) -> Floats:
    """A pair's sum less the array's light, as it would be were the array at a pose.

    `earlier_s` is the time of the mean light after that of the data, to which the cut-out's poses belong.
    """
    cutout, middle = pair.cutout, pair.state.pose
    step = earlier_s * pair.state.mean[RATE_STATES][:2]
    lit = sum(image_of(led_gains, one.moved(*step), cutout.corner, cutout.shape) for one in cutout.poses)
    rest = np.asarray(cutout.total - 0.5 * gain * lit, np.float32)
    # pixel (x, y) of the result is the one as far from the array in the pair
    dx = corner[0] - cutout.corner[0] + middle.x - pose.x
    dy = corner[1] - cutout.corner[1] + middle.y - pose.y
    along = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(rest, along, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float64
    )


def _at(state: PoseState, time_s: float, vector: Floats, rates: Floats) -> PoseState:
    """A state with another pose and other rates."""
    mean = state.mean.copy()
    mean[:POSE_SIZE], mean[RATE_STATES] = vector, rates
    return PoseState(time_s, mean, state.covariance, state.tilt)
