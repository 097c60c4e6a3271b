"""A packet of solved pairs: gains taken out, frames that do not fit left out, and its codewords decoded."""

from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import SettingsError
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.receive.packets import Words
from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.headers import HeaderSeen
from heliograph.receive.screen.pairs import Solved, solved
from heliograph.receive.screen.samples import Samples
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

GAIN_STEPS = 3
"""Times that the gain of each row is estimated anew. Chosen: each takes three quarters of what is left of bands."""

UNIT_GAIN = 0.3
"""Weight of a gain of 1, by the power of a frame's contrast: a frame between pattern and inverse has none. Chosen."""

OUTLIER = 4.0
"""Misfit of a frame, by the median one, from which it does not count: repeated by the camera, or shaken."""


@dataclass(frozen=True)
class ReadPacket:
    """A packet as it was read."""

    # Its header, of score 0 where it was not seen
    header: HeaderSeen
    # The format that it names
    form: Format
    # Why nothing was read, empty otherwise
    reason: str
    # Codewords by layer, empty where nothing was read
    words: Words
    # start_s, end_s: times between which it was shown, by the camera's clock
    start_s: float
    end_s: float
    # (pairs, n, n) differences of its data pairs, upright
    change: Floats
    # (pairs,) whether a data pair was seen
    seen: Floats

    @property
    def good(self) -> int:
        """Codewords that are right."""
        return sum(word.status == "ok" for words in self.words.values() for word in words)


def solved_evenly(samples: Samples, clock: Clock) -> Solved:
    """Solve pairs with the gain of each row, and without frames that do not fit."""
    found = solved(samples, clock)
    for _ in range(GAIN_STEPS):
        fitted = samples.light - found.left
        contrast = _contrast_gain(samples.light, fitted)[:, None, None]
        samples = replace(samples, light=samples.light / contrast)
        gain = (samples.light * fitted).sum(2, keepdims=True) / np.maximum((fitted**2).sum(2, keepdims=True), TINY)
        samples = replace(samples, light=samples.light / np.clip(gain, 0.5, 2.0))
        rms = np.sqrt((found.left**2).mean((1, 2)))
        weights = 1 / (1 + (rms / (OUTLIER * max(float(np.median(rms)), TINY))) ** 4)
        found = solved(samples, clock, weights)
    return found


def _contrast_gain(light: Floats, fitted: Floats) -> Floats:
    """Gain of each frame by its contrast: its mean may be that of the data."""
    seen, known = (one - one.mean((1, 2), keepdims=True) for one in (light, fitted))
    power = (known**2).sum((1, 2))
    held = UNIT_GAIN * max(float(np.median(power)), TINY)
    return np.clip(((seen * known).sum((1, 2)) + held) / (power + held), 0.5, 2.0)


def decoded(
    header: HeaderSeen, form: Format, found: Solved, clock: Clock, signal: SignalSettings, options: Decoding
) -> ReadPacket:
    """Decode a packet."""
    pairs, n = signal.data_pairs, signal.side
    first = header.place + signal.header_pairs
    there = found.change[first : first + pairs] / np.maximum(found.light, 0.05)
    change, seen = np.zeros((pairs, n, n)), np.zeros(pairs, bool)
    change[: len(there)] = there
    # a pair of which the frames show next to nothing has a large variance
    typical = float(np.median(found.variance))
    seen[: len(there)] = found.variance[first : first + pairs].mean((1, 2)) < 10 * typical
    upright = np.stack([header.orientation.upright(one) for one in change])
    reason, words = "", {}
    if form.mode == "single":
        reason = "the receiver screen reads pairs of patterns alone, this packet is of the single mode"
    else:
        try:
            words = decode_packet(upright, seen, PacketFormat(signal, form), header.identity, options)
        except SettingsError as error:
            reason = str(error)
    start = clock.begins(found.pairs[0] + header.place)
    end = clock.begins(found.pairs[0] + first + pairs)
    return ReadPacket(header, form, reason, words, start, end, upright, seen)
