"""Packets with known pose, gain and noise: full-matrix statistics, no camera, no tracking.

Decoders read a packet through `KnownPoses`, which records each pose refinement.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from observe_oracle import pair_model, transform
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at
from scipy.sparse import csr_array
from slot_light import light_about_mean, observed

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.turbo_equaliser import TurboEqualiser, decode_iteratively
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import EqualiseEvent, ignore
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Words
from heliograph.receive.settings import Feedback
from heliograph.receive.sync.combine import Combination
from heliograph.signal import haar
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Blocks = dict[str, list[Block]]
Statistics = list[PairStatistics | None]

GAIN, NOISE = 180.0, 4.5
FORM = PacketFormat(SignalSettings(data_pairs=24))
IDENTITY = 5
T = transform(SIDE)
SPARSE = csr_array(T)  # four non-zero elements per row
SHAPE = (26, 26)


def random_blocks(seed: int) -> Blocks:
    """Draw random blocks, each with a separate message."""
    rng = np.random.default_rng([seed, 1])
    return {
        name: [
            Block(name, IDENTITY, i, 0, layer.payload_bytes, rng.bytes(layer.payload_bytes))
            for i in range(layer.codewords)
        ]
        for name, layer in FORM.layers.items()
    }


def symbols_of(blocks: Blocks) -> Floats:
    """Return symbols +-1, shape (pairs, symbols)."""
    return 1.0 - 2.0 * np.concatenate([FORM.layers[name].encode(blocks[name]) for name in FORM.layers], axis=1)


def by_matrices(b: Floats, d: Floats, o: Floats, w: Floats | float = 1.0) -> PairStatistics:
    """Return full-matrix statistics for a pair d = B c + o + n with pixel weights w.

    b is (pixels, symbols); d, o and w are (pixels,).
    """
    # NumPy computes B^T B at half the cost of a general product
    gram = (w * (b.T @ b) if isinstance(w, float) else b.T @ (w[:, None] * b)).astype(np.float32)
    w = np.broadcast_to(w, d.shape)
    cross, offset_power, power = (float(x @ (w * y)) for x, y in ((d, o), (o, o), (d, d)))
    return PairStatistics(gram, b.T @ (w * d), b.T @ (w * o), cross, offset_power, power, int((w > 0).sum()))


def statistics_of(blocks: Blocks, distance_m: float, seed: int = 0, noise: float = NOISE) -> Statistics:
    """Return statistics per pair, with random subpixel positions, motion, and known noise variance."""
    return list(_statistics(symbols_of(blocks).tobytes(), distance_m, seed, noise))


@lru_cache(maxsize=24)  # 6 MB each; several tests share a packet
def _statistics(symbols: bytes, distance_m: float, seed: int, noise: float) -> tuple[PairStatistics | None, ...]:
    rng = np.random.default_rng([seed, 2])
    found = []
    for c in np.frombuffer(symbols).reshape(-1, SIDE * SIDE):
        x, y = rng.uniform(12, 13, 2)
        pose = Pose(float(x), float(y), pitch_at(distance_m), float(rng.normal(0, 0.01)), 0.505)
        poses = pose, pose.moved(*(float(v) for v in rng.normal(0, 0.05, 2)))
        first, second = (blur_matrix(p, SIDE, (0, 0), SHAPE) for p in poses)
        with one_thread():
            b, o = pair_model(first, second, SPARSE)
            found.append(by_matrices(b, GAIN * (b @ c + o) + rng.normal(0, noise**0.5, len(b)), o))
    return tuple(found)


def combined_statistics_of(blocks: Blocks, distance_m: float, combination: Combination) -> Statistics:
    """Return statistics per pair for combined frames at rest, between two header pairs."""
    rng = np.random.default_rng([0, 3])
    data, header = haar.encode(FORM.join(symbols_of(blocks).astype(np.int8))), FORM.header_pattern(IDENTITY)
    levels = np.stack([header, *data, header])
    found: Statistics = []
    for before, own, after in zip(levels, levels[1:], levels[2:], strict=False):
        c = observed(np.sum(list(map(light_about_mean, (before, own, after), combination.slots)), 0))
        x, y = (float(v) for v in rng.uniform(12, 13, 2))
        a = blur_matrix(Pose(x, y, pitch_at(distance_m), 0.01, 0.505), SIDE, (0, 0), SHAPE)
        with one_thread():
            b, o = a @ T, (combination.levels[0] - combination.levels[1]) * a.sum(1)
            noise = rng.normal(0, (NOISE * combination.noise) ** 0.5, len(b))
            pair = by_matrices(b, GAIN * (b @ c + o) + noise, o).scaled(1 / combination.noise)
        found.append(replace(pair, combination=combination))
    return found


class KnownPoses(ObservedPacket):
    """Pairs with correct poses, so that a refinement has no effect, except that the first `moves` report a change.

    The attributes hold the known symbols per pair, and the gain and noise, at each refinement.
    """

    def __init__(self, statistics: Sequence[PairStatistics | None], moves: int = 0, noise: float = NOISE):
        super().__init__((), Noise(noise, noise), FORM, LedGains.sound(SIDE))
        self._known_statistics, self._moves = statistics, moves
        self.known: list[int] = []
        self.channels: list[tuple[float, float]] = []

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        return self._known_statistics

    def refine_poses(self, mean: Floats, variance: Floats, gain: float, noise: float) -> bool:
        """Record the number of known symbols, the gain and the noise."""
        assert mean.shape == variance.shape
        self.known.append(int((variance[0] == 0).sum()))
        self.channels.append((gain, noise))
        return len(self.known) <= self._moves

    def apply_brightness(self, *_: object) -> bool:
        """Return False: all LEDs have equal gains."""
        return False


Packet = Sequence[PairStatistics | None] | KnownPoses


def equalised(
    packet: Packet,
    feedback: Feedback = "propagation",
    channel: tuple[float, float] = (GAIN, NOISE),
    buffer: SoftBuffer | None = None,
    identity: int = IDENTITY,
    observe: Callable[[EqualiseEvent], None] = ignore,
    known: Words | None = None,
) -> TurboEqualiser:
    """Equalise and decode a packet with the soft receiver."""
    observed = packet if isinstance(packet, KnownPoses) else KnownPoses(packet, noise=channel[1])
    with one_thread():  # as in the receiver
        options = Decoding("log-map", feedback=feedback)
        return decode_iteratively(observed, channel[0], identity, options, buffer, observe, known)


def decoded(
    packet: Packet, feedback: Feedback = "propagation", buffer: list[SoftBuffer] | None = None, **more: Any
) -> Words:
    """Decode a packet with the soft receiver, combining the last buffer; append the new buffer."""
    read = equalised(packet, feedback, buffer=buffer[-1] if buffer else None, **more)
    if buffer is not None and read.buffer is not None:
        buffer.append(read.buffer)
    return read.words


def right(words: Words, blocks: Blocks) -> list[bool]:
    """Return correctness per codeword: high, middle, middle, low."""
    return [word.block == block for name in FORM.layers for word, block in zip(words[name], blocks[name], strict=True)]
