"""Warm-up of a receiver: compiled functions load before live frames arrive."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.codec import encode
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


def warm_up(signal: SignalSettings, settings: ReceiveSettings, bits: int) -> bool:
    """Decode a synthetic packet; return True on success."""
    receiver, packets = make_receiver(signal, settings), list[Packet]()
    with suppress(HeliographError):  # the live frames raise the same errors
        for frame in _frames(signal, bits):
            packets += receiver.push(frame)
        packets += receiver.finish()
    return any(packet.status == "ok" for packet in packets)


def _frames(signal: SignalSettings, bits: int, pitch: int = 3, margin: int = 16) -> Iterator[Frame]:
    """Yield a packet of synchronous frames: squares for LEDs, and noise."""
    dark, bright, sigma = 0.1, 0.6, 0.006  # in full scales
    # at most 48 data pairs, as in the reference link: decoding takes half a second
    signal = replace(signal, data_pairs=min(signal.data_pairs, 48))
    random, full = np.random.default_rng(0), (1 << bits) - 1
    for index, levels in enumerate(encode({}, 0, signal)):
        lit = np.kron(dark + (bright - dark) * levels / 4, np.ones((pitch, pitch)))
        image = np.pad(lit, margin, constant_values=dark)
        noisy = np.clip(full * (image + random.normal(0, sigma, image.shape)), 0, full)
        pixels = noisy.astype(np.uint8) if bits == 8 else noisy.astype(np.uint16)
        yield Frame(index, index * signal.pattern_period_s, pixels, bits)
