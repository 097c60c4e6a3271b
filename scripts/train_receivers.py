"""Train the receivers "svm" and "mlp" on simulated films: `python scripts/train_receivers.py`, in about two minutes.

Writes src/heliograph/published/learned.npz. Needs scikit-learn (extra dev). Seeds, distances, brightness and
hand motion of the films differ from those of sweeps and tests.
"""

import sys
import time
import warnings
from collections import deque
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.svm import LinearSVC

from heliograph.base.arrays import Floats
from heliograph.link.film import frames_of
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate, transmitters
from heliograph.measure.bench import lasting, placed_within_pixel, random_messages, window_margin_px
from heliograph.published.learned import PARAMETERS, POWERS, take_squares
from heliograph.receive.build import plain_receiver
from heliograph.receive.events import ignore
from heliograph.receive.geometry.footprint import to_quarters
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.signal.packet import PacketFormat

FIRST_SEED = 7_450_000  # seeds of sweeps are hashes of settings, those of tests small numbers
DISTANCES_M = np.arange(23.0, 104.0, 3.0) + 0.37
Bits = NDArray[np.bool_]
Sample = tuple[Floats, Floats, Bits]  # cut-outs (squares, pixels), 1 / pitch (squares,) and bits (squares, 4)


def main() -> None:
    start_s, parameters = time.monotonic(), dict[str, Any]()
    for modulation in ("haar", "ook"):
        samples = [film_samples(modulation, k, float(z)) for k, z in enumerate(DISTANCES_M)]
        cutouts, inverse_pitch, bits = (np.concatenate(parts) for parts in zip(*samples, strict=True))
        parameters["inverse_pitch"] = np.array([inverse_pitch.min(), inverse_pitch.max()])
        report(f"{modulation}: {len(bits)} squares", start_s)
        parameters[f"svm_{modulation}"] = train_svm(cutouts, inverse_pitch, bits)
        report(f"{modulation}: svm", start_s)
        for k, values in enumerate(train_mlp(cutouts, inverse_pitch, bits)):
            parameters[f"mlp_{modulation}_{k}"] = values
        report(f"{modulation}: mlp", start_s)
    np.savez_compressed(PARAMETERS, **{name: values.astype(np.float32) for name, values in parameters.items()})
    report(f"{PARAMETERS.name}: {PARAMETERS.stat().st_size} bytes", start_s)


def film_samples(modulation: str, number: int, distance_m: float) -> Sample:
    """Film a packet and read the cut-outs at the tracked poses."""
    rng = np.random.default_rng([FIRST_SEED, number])
    link = film_link(modulation, distance_m, rng)
    messages, signal, form = random_messages(link, FIRST_SEED + number), link.signal, PacketFormat(link.signal)
    sent = list(islice(transmitters(link, messages)[0].levels(), frames_of(link)))
    cutouts, pitches, bits = list[Floats](), list[float](), list[Bits]()

    def read(pair: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float) -> Floats:
        cutouts.append(take_squares(pair, poses, gain, signal.side).reshape(signal.side**2 // 4, -1))
        pitches.append(poses[0].pitch)
        data = form.soft_data(sent[pair[0].index].astype(np.float64) - 2)
        half = signal.side // 2
        quarters = data.reshape(2, half, 2, half).swapaxes(1, 2) if modulation == "haar" else to_quarters(data)
        bits.append(quarters.reshape(4, -1).T > 0)
        return np.zeros((signal.side, signal.side))

    receiver = plain_receiver(signal, link.receive, ignore, read)
    for frame, _ in simulate(link, messages, FIRST_SEED + number, None, window_margin_px(link)):
        deque(receiver.push(frame), maxlen=0)
    inverse = np.repeat(1 / np.array(pitches), signal.side**2 // 4)
    return np.concatenate(cutouts), inverse, np.concatenate(bits)


def film_link(modulation: str, distance_m: float, rng: np.random.Generator) -> LinkSettings:
    """Return the settings of a film of a packet, with hand motion."""
    changes = [f"signal.modulation={modulation}", f"channel.distance_m={distance_m}", "receive.detect.min_side_px=4"]
    changes += [f"channel.arrays.0.brightness={rng.uniform(0.7, 1.1)}", "channel.shake=hand", "channel.hand_deg=0.02"]
    link = placed_within_pixel(load_settings("static", None, changes), rng)
    return lasting(link, link.signal.packet_s + 2e-3)


def train_svm(cutouts: Floats, inverse_pitch: Floats, bits: Bits) -> Floats:
    """Train a hyperplane through 0 for each bit: w, (powers, pixels, 4)."""
    features = (inverse_pitch[:, None, None] ** POWERS[:, None] * cutouts[:, None]).reshape(len(cutouts), -1)
    # a quarter of the squares: more cost time and hardly change the hyperplanes
    machine = LinearSVC(dual=False, fit_intercept=False, C=0.03, tol=1e-2)
    normals = [machine.fit(features[::4], bit[::4]).coef_[0].reshape(len(POWERS), -1) for bit in bits.T]
    return np.stack(normals, axis=-1)


def train_mlp(cutouts: Floats, inverse_pitch: Floats, bits: Bits) -> list[Floats]:
    """Train a hidden layer by Adam with decreasing steps: weights and bias of both layers."""
    # the inverse of a pattern has the opposite bits
    features = np.column_stack([np.concatenate([cutouts, -cutouts]), np.tile(inverse_pitch, 2)])
    targets = np.concatenate([bits, ~bits])
    network = MLPClassifier((64,), batch_size=256, n_iter_no_change=99, alpha=1e-3, warm_start=True, random_state=45)
    with warnings.catch_warnings():
        # each stage ends by the number of epochs
        warnings.simplefilter("ignore", ConvergenceWarning)
        for step, epochs in ((2e-3, 8), (2e-4, 4), (2e-5, 2)):
            network.set_params(learning_rate_init=step, max_iter=epochs).fit(features, targets)
    (weights_1, weights_2), (bias_1, bias_2) = network.coefs_, network.intercepts_
    return [weights_1, bias_1, weights_2, bias_2]


def report(text: str, start_s: float) -> None:
    print(f"{time.monotonic() - start_s:6.1f} s  {text}", file=sys.stderr)


if __name__ == "__main__":
    main()
