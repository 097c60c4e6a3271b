"""Soft combining: a buffer of failed packets and codewords, to be added to repetitions.

The single packet of a carousel repeats as a packet: the statistics of the pairs are summed, and equalised together. A
codeword that repeats among other codewords is kept as LLRs. LLRs of a repeated packet would not add up: the light of
the other layers disturbs every repetition in the same way.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.signal.code import Code
from heliograph.signal.formats import Format

Kind = tuple[str, Code]  # layer and code, equal for equal codewords


SAME = 5.5  # standard deviations of agreement from which two codewords or packets are the same: 2e-8 by chance


@dataclass(frozen=True, slots=True)
class BufferedPacket:
    """Packet that failed in part, or decoded only with earlier packets."""

    # Mode and code rates
    format: Format
    # LLRs (E,) of each codeword, layer by layer; the largest possible if decoded
    llrs: tuple[Floats, ...]
    # Sum of the statistics of each pair over all repetitions; None for an unseen pair
    statistics: tuple[PairStatistics | None, ...]
    # Gray levels of the array with all LEDs on, the unit of the statistics
    gain: float = 1.0
    # Variance of a pixel of a difference in squared gray levels, a unit of the statistics as well
    noise: float = 1.0

    def joined(
        self, statistics: Sequence[PairStatistics | None], gain: float, noise: float
    ) -> list[PairStatistics | None]:
        """Add the statistics of a repetition."""
        # B g_0 = (B g_0 / g) g, and weights are in units of the noise
        weight, dimmer = noise / self.noise, self.gain / gain
        kept = (None if pair is None else pair.scaled(weight, dimmer) for pair in self.statistics)
        return [a.plus(b) if a and b else a or b for a, b in zip(statistics, kept, strict=True)]

    def likeness(self, llrs: Sequence[Floats]) -> float:
        """Agreement in standard deviations with the codewords of another packet; 0 if any contradicts."""
        measured, expected = np.array([agreement(a, b) for a, b in zip(llrs, self.llrs, strict=True)]).T
        # packets of a carousel may share a codeword that is decoded: then the others must agree
        open_ = np.array([bool((np.abs(llr) < LARGEST_LLR).any()) for llr in self.llrs])
        # agreement from which two packets may be the same (1), not different (0)
        threshold = 0.5 * float(np.linalg.norm(expected[open_]))
        contradicts = (measured < 0.5 * expected - 2.0).any()
        if contradicts or _total(measured[open_], expected[open_]) < threshold:
            return 0.0
        return _total(measured, expected)


@dataclass(frozen=True, slots=True)
class SoftBuffer:
    """Undecoded codewords and packets of an array."""

    # Packets, the oldest first, each summed over all repetitions
    packets: tuple[BufferedPacket, ...] = ()
    # LLRs (E,) of codewords by layer and code, the oldest first, each summed over all repetitions
    codewords: Mapping[Kind, tuple[Floats, ...]] = field(default_factory=dict)

    def same_packet(self, form: Format, llrs: Sequence[Floats]) -> BufferedPacket | None:
        """Find the packet that a new packet repeats."""
        alike = [(packet.likeness(llrs), packet) for packet in self.packets if packet.format == form]
        best, packet = max(alike, key=lambda entry: entry[0], default=(0.0, None))
        return None if best < SAME else packet

    def same_codeword(self, kind: Kind, llr: Floats) -> Floats:
        """Sum of the LLRs (E,) of earlier repetitions of a codeword; zeros if new."""
        alike = [(agreement(llr, other)[0], other) for other in self.codewords.get(kind, ())]
        best, kept = max(alike, key=lambda entry: entry[0], default=(0.0, llr))
        return np.zeros_like(llr) if best < SAME else kept

    def without(self, packet: BufferedPacket) -> "SoftBuffer":
        """Return the buffer less a packet."""
        return replace(self, packets=tuple(other for other in self.packets if other is not packet))

    def with_packet(self, packet: BufferedPacket) -> "SoftBuffer":
        """Return the buffer with a packet, in place of the oldest if full."""
        # 13 MB each of 48 pairs of 16 x 16 LEDs
        return replace(self, packets=(*self.packets, packet)[-4:])

    def with_codeword(self, kind: Kind, llr: Floats, earlier: Floats) -> "SoftBuffer":
        """Return the buffer with an undecoded codeword, in place of the oldest if full."""
        rest = (other for other in self.codewords.get(kind, ()) if not np.array_equal(other, earlier))
        # 0.8 MB of 3072 LLRs: a longer carousel never combines
        kept = (*rest, llr + earlier)[-32:]
        return replace(self, codewords={**self.codewords, kind: kept})


def agreement(a: Floats, b: Floats) -> tuple[float, float]:
    """Agreement of two sets of LLRs in standard deviations, and that expected of the same codeword."""
    # sum of E[bit | a] E[bit | b], with the mean 0 for independent bits
    product = np.tanh(a / 2) * np.tanh(b / 2)
    spread = float(np.sqrt((product**2).sum()))
    return float(product.sum()) / max(spread, TINY), spread


def is_consistent(llr: Floats, signs: Floats) -> bool:
    """Return True if LLRs agree with a codeword as if sent.

    A codeword decoded with LLRs of earlier packets may differ from this packet's in some bits.
    """
    soft = np.tanh(llr / 2)
    # E[soft * sign] = soft^2 for the codeword that was sent; 0 for another one, with the variance sum soft^2
    expected = float((soft**2).sum())
    spread = float(np.sqrt((soft**2 * (1 - soft**2)).sum()))
    # 0.6 if a fifth of the bits differ; 0.13 % of sent codewords are off by more than 3 standard deviations;
    # a support of 4 comes by chance with 3e-5
    return float(soft @ signs) > max(0.6 * expected - 3.0 * spread, 4.0 * expected**0.5)


def _total(measured: Floats, expected: Floats) -> float:
    """Agreement of codewords together, weighted by the expected agreement of each."""
    return float(measured @ expected / np.sqrt(max(float(expected @ expected), TINY)))
