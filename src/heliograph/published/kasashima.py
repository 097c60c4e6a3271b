"""The receiver "kasashima": cancellation of inter-pixel interference at the samples of the LEDs."""

from functools import partial

import numpy as np
from scipy.linalg import lapack

from heliograph.base.arrays import RCOND, Floats
from heliograph.receive.build import plain_receiver
from heliograph.receive.decode.per_led import pair_luminances
from heliograph.receive.events import Observer
from heliograph.receive.geometry.footprint import footprints, to_grid, to_quarters
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame, window_around
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

MARGIN_PX = 3.0  # pixels around the array that cubic interpolation reads


def kasashima_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "kasashima": cancel the light of the other LEDs by the channel matrix.

    T. Kasashima et al., "Interpixel Interference Cancellation Method for Road-to-Vehicle Visible Light Communication"
    (2013): by diffusion and by the finite size of pixels, the light of an LED reaches the pixels of its neighbours. The
    samples y of all LEDs are

        y = H x + n,  H_ij = light of LED j at the sample of LED i,

    and H^-1 y is free of interference. The field trial extended the error-free distance from 40 m to 60 m.

    The abstract and the introduction leave open how H is measured. Here H follows from the pose and the blur that the
    tracker fits to headers and to the sums of pairs, and a sample is the cubic interpolation at the LED's position, as
    for the receiver "plain". Singular values far below 1e-5 of the largest are damped.
    """
    return plain_receiver(signal, settings, observe, partial(cancel_interference, side=signal.side))


def cancel_interference(frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float, side: int) -> Floats:
    """Normalised luminances x' = level - 2 of a pair without interference."""
    samples = to_quarters(pair_luminances(frames, poses, gain, side, "none"))
    matrix = 0.5 * (channel_matrix(poses[0], side) + channel_matrix(poses[1], side))
    gram = matrix.T @ matrix
    # in place of a singular value decomposition, which takes ten times as long
    loading = RCOND**2 * float(gram.trace())
    _, light, _ = lapack.dposv(gram + loading * np.eye(len(gram)), matrix.T @ samples, overwrite_a=1)
    return to_grid(light)


def channel_matrix(pose: Pose, side: int) -> Floats:
    """Light of each LED at the sample of each LED, (n n, n n), both in quarters."""
    x, y, columns, rows = window_around(pose, side, MARGIN_PX)
    across, down = footprints(pose, (x, y), (rows, columns), side)
    leds = [to_quarters(pose.leds(side)[..., axis] - first) for axis, first in enumerate((x, y))]
    # a product for each sample and LED, because image and interpolation are products of functions of x and of y
    return np.asarray((_weights(leds[0], columns) @ across.T) * (_weights(leds[1], rows) @ down.T))


def _weights(positions: Floats, count: int) -> Floats:
    """Weights of pixels at positions by cubic convolution, (positions, pixels), as in `per_led.at_leds`."""
    t = np.abs(positions[:, None] - np.arange(count))
    inner, outer = (1.5 * t - 2.5) * t * t + 1, ((2.5 - 0.5 * t) * t - 4) * t + 2
    return np.where(t < 1, inner, np.where(t < 2, outer, 0.0))
