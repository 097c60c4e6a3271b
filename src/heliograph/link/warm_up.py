"""A receiver's loops loaded before frames come that do not wait."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.codec import encode
from heliograph.receive import ReceiveSettings, make_receiver
from heliograph.signal.settings import SignalSettings

PITCH, MARGIN = 3, 16
"""Pixels between LEDs, and beside the array. Chosen: an array of 48 px, as near ones have."""

DARK, BRIGHT = 0.1, 0.6
"""Levels of an LED that is off and on, as fractions of full scale. Chosen."""


def warm_up(signal: SignalSettings, settings: ReceiveSettings, bits: int) -> bool:
    """Receive a packet of drawn frames, so that all that a receiver loads or compiles is there."""
    receiver, read = make_receiver(signal, settings), False
    with suppress(HeliographError):  # what is wrong is said of the real frames
        for frame in _frames(signal, bits):
            read |= any(packet.status == "ok" for packet in receiver.push(frame))
        read |= any(packet.status == "ok" for packet in receiver.finish())
    return read


def _frames(signal: SignalSettings, bits: int) -> Iterator[Frame]:
    """A packet as a camera in step sees it: squares for LEDs, and noise."""
    # most pairs of data in that packet: those of the reference link, which take half a second once all is loaded
    signal = replace(signal, data_pairs=min(signal.data_pairs, 48))
    random, full = np.random.default_rng(0), (1 << bits) - 1
    margins = (MARGIN, MARGIN)
    for index, levels in enumerate(encode({}, 0, signal)):
        lit = np.kron(DARK + (BRIGHT - DARK) * levels / 4, np.ones((PITCH, PITCH)))
        seen = np.pad(lit, (margins, margins), constant_values=DARK)
        # standard deviation of the pixels, as a fraction of full scale: 1.5 levels of 8 bits, that of the reference
        # link
        noisy = np.clip(full * (seen + random.normal(0, 0.006, seen.shape)), 0, full)
        pixels = noisy.astype(np.uint8) if bits == 8 else noisy.astype(np.uint16)
        yield Frame(index, index * signal.pattern_period_s, pixels, bits)
