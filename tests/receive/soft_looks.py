"""Looks at packets of an array whose pose, gain and noise are known: no camera, no tracking."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from receive_scenes import SIDE, pitch_at

from heliograph.receive import Pose, ReceiveSettings
from heliograph.receive.packets import Codeword, Observer, ignore
from heliograph.receive.soft import reference
from heliograph.receive.soft.cancel import Light, LookAgain, decode_looks
from heliograph.receive.soft.look import Look
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.threads import one_thread
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]
Blocks = dict[str, list[Block]]
Feedback = Literal["none", "decoded", "soft"]

GAIN, NOISE = 180.0, 4.5
FORM = PacketFormat(SignalSettings(data_pairs=24))
IDENTITY = 5
T = reference.transform(SIDE)


def random_blocks(seed: int) -> Blocks:
    """Blocks of a packet, each a message of its own."""
    rng = np.random.default_rng([seed, 1])
    return {
        name: [
            Block(name, IDENTITY, i, 0, layer.payload_bytes, rng.bytes(layer.payload_bytes))
            for i in range(layer.codewords)
        ]
        for name, layer in FORM.layers.items()
    }


def cells_of(blocks: Blocks) -> Floats:
    """Cells +-1 of a packet, (pairs, cells)."""
    return 1.0 - 2.0 * np.concatenate([FORM.layers[name].encode(blocks[name]) for name in FORM.layers], axis=1)


def looks_at(blocks: Blocks, z: float, seed: int = 0, noise: float = NOISE) -> list[Look | None]:
    """A look at each pair of a packet from z m: anywhere between the pixels, moving, noise of a known variance."""
    rng, shape = np.random.default_rng([seed, 2]), (26, 26)
    looks: list[Look | None] = []
    for cells in cells_of(blocks):
        x, y = rng.uniform(12, 13, 2)
        pose = Pose(float(x), float(y), pitch_at(z), float(rng.normal(0, 0.01)), 0.505)
        poses = pose, pose.moved(*(float(v) for v in rng.normal(0, 0.05, 2)))
        first, second = (reference.blur_matrix(p, SIDE, (0, 0), shape) for p in poses)
        b, o = reference.pair_model(first, second, T)
        d = GAIN * (b @ cells + o) + rng.normal(0, noise**0.5, len(b))
        looks.append(Look((b.T @ b).astype(np.float32), b.T @ d, b.T @ o, float(d @ o), float(o @ o)))
    return looks


def decoded(
    looks: Sequence[Look | None],
    rounds: int = 16,
    light: Light | None = None,
    memory: Memory | None = None,
    identity: int = IDENTITY,
    feedback: Feedback = "soft",
    propagate: bool = True,
    observe: Observer = ignore,
    again: LookAgain | None = None,
) -> dict[str, tuple[Codeword, ...]]:
    """What the soft receiver makes of looks."""
    settings = ReceiveSettings(receiver="soft")
    settings = replace(settings, soft=replace(settings.soft, rounds=rounds, feedback=feedback, propagate=propagate))

    def same(mean: Floats, variance: Floats, light: Light) -> tuple[Sequence[Look | None], bool]:
        """Poses are known: looking again shows the same."""
        return looks, False

    light, memory = light or Light(GAIN, NOISE), memory or Memory()
    with one_thread():  # as in the receiver
        return decode_looks(looks, light, FORM, identity, settings, memory, again or same, observe)


def right(words: dict[str, tuple[Codeword, ...]], blocks: Blocks) -> list[bool]:
    """Which codewords were read as they were sent: high, middle, middle, low."""
    return [word.block == block for name in FORM.layers for word, block in zip(words[name], blocks[name], strict=True)]
