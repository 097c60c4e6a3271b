"""Error-free packets, and modified copies with errors."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import default_messages, transmitters
from heliograph.measure.errors import ErrorCounter
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Packet
from heliograph.transmit import Messages

LAYERS = ("high", "middle", "low")


def perfect(settings: LinkSettings, number: int, messages: Sequence[Messages] | None = None, array: int = 0) -> Packet:
    """Return packet `number` decoded without errors."""
    sender = transmitters(settings, messages or default_messages(settings))[array]
    levels = sender.format.patterns(sender.identity, sender.blocks(number)).astype(float)
    change = (levels[0::2] - levels[1::2])[settings.signal.header_pairs :]
    words = decode_packet(change, np.ones(len(change), bool), sender.format, sender.identity, Decoding())
    place, size = settings.channel.arrays[array], settings.signal.packet_patterns
    start = place.start_s + number * settings.signal.packet_s
    first = round(start * settings.channel.camera.fps)
    pose = Pose(80.0, 60.0, 1.2)
    return Packet(sender.identity, "ok", start, first, first + size - 1, pose, 50.0, 1.0, 1.0, 1.0, words)


def watch(counter: ErrorCounter, frames: range, distances: Any = (50.0,), visible: Any = (True,)) -> None:
    """Pass frame truths at 1000 frames/s to the counter."""
    for frame in frames:
        at = distances(frame) if callable(distances) else distances
        counter.saw(frame * 1e-3, at, visible(frame) if callable(visible) else visible)


def tampered(packet: Packet, layer: str, word: int, bits: Sequence[int], raw: Sequence[int] = (), **to: Any) -> Packet:
    """Return a packet with flipped codeword bits and changed codeword fields."""
    words = list(packet.layers[layer])
    wrong, wrong_raw = words[word].bits.copy(), words[word].raw.copy()
    wrong[list(bits)] ^= 1
    wrong_raw[list(raw)] ^= 1
    words[word] = replace(words[word], bits=wrong, raw=wrong_raw, **to)
    return replace(packet, layers={**packet.layers, layer: tuple(words)})


def sums(counter: ErrorCounter) -> Iterator[tuple[str, int, int, int, int, int, int]]:
    for name, e in counter.total().items():
        yield name, e.bits, e.bit_errors, e.raw_errors, e.codewords, e.codeword_errors, e.missed
