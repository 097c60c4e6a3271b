"""The receivers "svm" and "mlp": decisions learnt from cut-outs around squares of 2 x 2 LEDs.

`scripts/train_receivers.py` trains both on simulated films and writes the parameters, learned.npz.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.build import plain_receiver
from heliograph.receive.decode.per_led import pair_luminances
from heliograph.receive.events import Observer
from heliograph.receive.geometry.footprint import to_grid
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

REACH = 3  # LED positions around a square in a cut-out
POWERS = np.arange(3)  # powers of the distance in the normal vectors of the support vector machine
PARAMETERS = Path(__file__).with_name("learned.npz")


def svm_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "svm": a linear support vector machine for each bit of a square.

    M. H. Rahman et al., "Design of an SVM Classifier Assisted Intelligent Receiver for Reliable Optical Camera
    Communication" (Sensors 21(13), 4283, 2021), separates the regions of transmitting LEDs by a support vector machine
    and decides bits by the median as threshold. Arrays are detected by their headers here, so this receiver applies the
    classifier to the bits:

        bit = sign(w(1 / p)^T c),  w(u) = w_0 + w_1 u + w_2 u^2

    with the cut-out c, (8, 8) luminances at the LED positions around a square of 2 x 2 LEDs, and the pitch p in px. The
    square has four bits: with "ook" a bit for each LED, with "haar" a bit for each quarter of the data matrix. The
    distance from the hyperplane is the soft value of the channel decoder.
    """
    normals = _parameters()[f"svm_{signal.modulation}"]

    def scores(cutouts: Floats, inverse_pitch: float) -> Floats:
        return cutouts @ np.tensordot(inverse_pitch**POWERS, normals, 1)

    return _learned_receiver(signal, settings, observe, scores)


def mlp_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "mlp": a neural network with a hidden layer, on the cut-outs of the receiver "svm".

    S. Park and H. Lee, "Deep Learning Approach to Optical Camera Communication Receiver Design" (IEEE TENSYMP 2021),
    approximate the detector of maximum posterior probability by a convolutional network on the image of a dot matrix.
    The abstract states no layers. This network sees a cut-out and the distance in place of the image:

        L = W_2 max(W_1 (c, 1 / p) + b_1, 0) + b_2

    with the LLRs L of the four bits of a square.
    """
    weights_1, bias_1, weights_2, bias_2 = (_parameters()[f"mlp_{signal.modulation}_{k}"] for k in range(4))

    def scores(cutouts: Floats, inverse_pitch: float) -> Floats:
        hidden = cutouts @ weights_1[:-1] + inverse_pitch * weights_1[-1] + bias_1
        return np.maximum(hidden, 0) @ weights_2 + bias_2

    return _learned_receiver(signal, settings, observe, scores)


def _learned_receiver(
    signal: SignalSettings, settings: ReceiveSettings, observe: Observer, scores: Callable[[Floats, float], Floats]
) -> StreamReceiver:
    """Make a receiver that scores the four bits of each square, (..., 4), positive for bit 0."""
    form, (nearest, farthest) = PacketFormat(signal), _parameters()["inverse_pitch"].tolist()

    def read(frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float) -> Floats:
        inverse_pitch = min(max(1 / poses[0].pitch, nearest), farthest)
        bits = np.moveaxis(scores(take_squares(frames, poses, gain, signal.side), inverse_pitch), -1, 0)
        is_haar = signal.modulation == "haar"
        return form.luminances(np.block([[bits[0], bits[1]], [bits[2], bits[3]]]) if is_haar else to_grid(bits.ravel()))

    return plain_receiver(signal, settings, observe, read)


def take_squares(frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float, side: int) -> Floats:
    """Cut out each square of 2 x 2 LEDs with the LED positions around it, (n / 2, n / 2, pixels), of rms 1."""
    lattice = pair_luminances(frames, poses, gain, side + 2 * REACH, "none")
    size = 2 + 2 * REACH
    squares = sliding_window_view(lattice, (size, size))[::2, ::2].reshape(side // 2, side // 2, -1)
    return np.asarray(squares / max(np.sqrt((squares**2).mean()), TINY))


@cache
def _parameters() -> dict[str, Floats]:
    """Load the trained parameters."""
    with np.load(PARAMETERS) as stored:
        return {name: stored[name].astype(np.float64) for name in stored}
