"""Data pairs with one lost frame: the remaining frame shows the data, given the sum of the pair.

The sum r + r' shows all LEDs and the background for any data, so the sums of neighbouring pairs stand for the sum of
the incomplete pair. The remaining frame r then gives the difference

    r - r' = 2 r - (r + r'),

negated for an inverse. A sum moves with the array: the background is shifted from pose to pose, and the light of the
array is added at the pose of the remaining frame.
"""

from collections.abc import Mapping

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import HALF_LIT, RIM_PX, covered, cut_out, window_around
from heliograph.receive.observe.cutout import RING_PX, Cutout
from heliograph.receive.sync.pairing import UnpairedFrame
from heliograph.receive.track.kalman import POSE_SIZE, RATE_STATES, PoseState

MAX_DISTANCE_PAIRS = 6
"""Maximum distance in pairs of the nearest sum: 12 ms, half a period of shake at 40 Hz."""


def nearest_pairs(place: int, pairs: Mapping[int, object]) -> list[int]:
    """Return the numbers of up to six pairs to replace the sum of another pair, nearest first."""
    # the noise of six sums adds 1/6 to the 2 of the frame
    nearest = sorted(pairs, key=lambda k: (abs(k - place), k))[:6]
    return nearest if nearest and abs(nearest[0] - place) <= MAX_DISTANCE_PAIRS else []


def interpolate_state(time_s: float, states: Mapping[int, PoseState], place: int) -> PoseState:
    """Interpolate the state of an array between the neighbouring pairs by a cubic Hermite spline."""
    before = max((k for k in states if k < place), default=None)
    after = min((k for k in states if k > place), default=None)
    if before is None or after is None:
        near = states[min(states, key=lambda k: abs(k - place))]
        return _at(near, time_s, near.pose_at(time_s).vector(), near.mean[RATE_STATES])
    first, last = states[before], states[after]
    h = last.time_s - first.time_s
    t = (time_s - first.time_s) / h
    p, q = first.mean[:POSE_SIZE], last.mean[:POSE_SIZE]
    u, v = (np.append(state.mean[RATE_STATES], np.zeros(POSE_SIZE - 3)) * h for state in (first, last))
    u[3:] = v[3:] = (q - p)[3:]
    vector = p + t * u + t**2 * (3 * (q - p) - 2 * u - v) + t**3 * (2 * (p - q) + u + v)
    rates = (u + 2 * t * (3 * (q - p) - 2 * u - v) + 3 * t**2 * (2 * (p - q) + u + v))[:3] / h
    return _at(first, time_s, vector, rates)


def unpaired_cutout(
    unpaired: UnpairedFrame,
    place: int,
    pairs: Mapping[int, tuple[PoseState, Cutout]],
    late_s: float,
    gain: float,
    led_gains: Floats,
) -> Cutout | None:
    """Cut out the remaining frame of a pair; None if no pair is near or an object occludes the array.

    `pairs` are the states and cut-outs of the pairs with both frames.
    """
    nearest, frame = nearest_pairs(place, pairs), unpaired.frame
    if not nearest:
        return None
    state = interpolate_state(frame.time_s, {k: state for k, (state, _) in pairs.items()}, place)
    data, mean_light = state.pose_at(frame.time_s + late_s), state.pose_at(frame.time_s + unpaired.late_s)
    side = len(led_gains)
    x, y, cols, rows = window_around(data, side, RIM_PX + RING_PX)
    corner, shape = (x, y), (rows, cols)
    lit = image_of(led_gains, mean_light, corner, shape)
    delay_s = unpaired.late_s - late_s
    backgrounds = [_background(*pairs[k], delay_s, gain, led_gains, state.pose, corner, shape) for k in nearest]
    total = gain * lit + np.mean(backgrounds, axis=0)
    difference = 2 * cut_out(frame, (x, y, cols, rows)) - total
    # an uneven difference shows an object; the mean of random data has a standard deviation of 1/32
    if abs(difference[lit > HALF_LIT * lit.max()].mean()) > 0.25 * gain:
        return None
    # 4 s^2 of the frame and 2 s^2 / k of k sums, over the 2 s^2 of a difference of two frames
    noise = 2 + 1 / len(nearest)
    difference = -difference if unpaired.inverted else difference
    return Cutout(total, difference, corner, (data,), covered=covered((frame,), corner, shape), noise=noise)


def _background(
    state: PoseState,
    cutout: Cutout,
    delay_s: float,
    gain: float,
    led_gains: Floats,
    pose: Pose,
    corner: tuple[int, int],
    shape: tuple[int, int],
) -> Floats:
    """Return the sum of a pair less the light of the array, shifted to a pose.

    `delay_s` is the delay of the mean light after the data light, to which the poses of the cut-out belong.
    """
    middle, step = state.pose, delay_s * state.mean[RATE_STATES][:2]
    lit = sum(image_of(led_gains, moved.moved(*step), cutout.corner, cutout.shape) for moved in cutout.poses)
    rest = np.asarray(cutout.total - 0.5 * gain * lit, np.float32)
    # pixel (x, y) of the result has the same offset from the array as in the pair
    dx = corner[0] - cutout.corner[0] + middle.x - pose.x
    dy = corner[1] - cutout.corner[1] + middle.y - pose.y
    along = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(rest, along, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float64
    )


def _at(state: PoseState, time_s: float, vector: Floats, rates: Floats) -> PoseState:
    """Replace time, pose and rates of a state."""
    mean = state.mean.copy()
    mean[:POSE_SIZE], mean[RATE_STATES] = vector, rates
    return PoseState(time_s, mean, state.covariance, state.tilt, state.tilt_covariance)
