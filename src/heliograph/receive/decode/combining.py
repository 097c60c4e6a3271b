"""Soft combining: what could not be decoded is kept, and added to when it is sent again.

A whole packet that is sent again, as the only one of a carousel is, is kept as the statistics of its pairs; their sum
is one better observation, equalised as a whole. Of a codeword that is sent again beside others its LLRs are kept.
LLRs of one and the same packet would not add: the light of its other layers disturbs them alike each time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.signal.code import Code
from heliograph.signal.formats import Format

Kind = tuple[str, Code]
"""Layer and code: only codewords of one kind can be the same."""

CODEWORDS_KEPT = 32
"""Codewords kept of each kind: 0.8 MB of 3072 LLRs; a carousel of more goes round before one comes again."""

PACKETS_KEPT = 4
"""Packets whose statistics are kept: 13 MB each of 48 pairs of 16 x 16 LEDs, twice that without inverses."""

SAME = 5.5
"""Standard deviations of agreement from which two codewords are taken for the same.

By chance 2e-8 of different codewords agree as far, in coded bits that differ by chance.
"""

ALIKE = 0.5
"""Agreement of two packets from which on they may be the same, as a fraction of what is expected if they are.

The mean is 1 for the same packet and 0 for another one; this is the middle.
"""

CONTRADICTION = 2.0
"""Standard deviations by which the agreement of a codeword must fall below `ALIKE` of what is expected, to contradict.

The same codeword falls by 2 below all of what is expected in 2 % of cases, and more rarely below half of it.
"""

CONSISTENT = 0.6
"""Least agreement of LLRs with their codeword, as a fraction of the agreement expected, less `CONSISTENT_SPREADS`.

The mean is 1 for the codeword that was sent, and 0.6 for one that differs from it in a fifth of the bits.
"""

CONSISTENT_SPREADS = 3.0
"""Standard deviations by which LLRs may agree less with their codeword than `CONSISTENT` asks.

The codeword that was sent falls by 3 below all of what is expected in 0.13 % of cases, and more rarely below 0.6 of it.
"""

SUPPORT = 4.0
"""Least agreement of LLRs with their codeword in standard deviations of another codeword's: 3e-5 by chance."""


@dataclass(frozen=True, slots=True)
class BufferedPacket:
    """A packet that was not decoded as a whole, or not by itself."""

    # Its mode and code rates
    format: Format
    # (E,) of each codeword, layer by layer; those of decoded ones are the largest there are
    llrs: tuple[Floats, ...]
    # Of each pair, over all times it was seen; None for a pair never seen
    statistics: tuple[PairStatistics | None, ...]
    # Gray levels of the array with all LEDs on, in whose unit the statistics are
    gain: float = 1.0
    # Variance of a pixel of a difference in squared gray levels, likewise
    noise: float = 1.0

    def joined(
        self, statistics: Sequence[PairStatistics | None], gain: float, noise: float
    ) -> list[PairStatistics | None]:
        """Add the statistics of the packet seen again."""
        # B g_0 = (B g_0 / g) g, and weights are in units of the noise
        weight, dimmer = noise / self.noise, self.gain / gain
        kept = (None if one is None else one.scaled(weight, dimmer) for one in self.statistics)
        return [a.plus(b) if a and b else a or b for a, b in zip(statistics, kept, strict=True)]

    def likeness(self, llrs: Sequence[Floats]) -> float:
        """Agreement in standard deviations with the codewords of another packet; 0 where they contradict."""
        found, expected = np.array([agreement(a, b) for a, b in zip(llrs, self.llrs, strict=True)]).T
        # packets of a carousel may share a codeword that is decoded: then the others must agree
        open_ = np.array([bool((np.abs(llr) < LARGEST_LLR).any()) for llr in self.llrs])
        least = ALIKE * float(np.linalg.norm(expected[open_]))
        if (found < ALIKE * expected - CONTRADICTION).any() or _along(found[open_], expected[open_]) < least:
            return 0.0
        return _along(found, expected)


@dataclass(frozen=True, slots=True)
class SoftBuffer:
    """Codewords and packets of one array that were seen but not decoded."""

    # Packets not decoded as a whole, the oldest first; their statistics are summed over all times they were seen
    packets: tuple[BufferedPacket, ...] = ()
    # LLRs (E,) of codewords by layer and code, the oldest first; each is summed over all times it was seen
    codewords: Mapping[Kind, tuple[Floats, ...]] = field(default_factory=dict)

    def same_packet(self, form: Format, llrs: Sequence[Floats]) -> BufferedPacket | None:
        """Find the packet that is seen again."""
        alike = [(packet.likeness(llrs), packet) for packet in self.packets if packet.format == form]
        best, found = max(alike, key=lambda one: one[0], default=(0.0, None))
        return None if best < SAME else found

    def same_codeword(self, kind: Kind, llr: Floats) -> Floats:
        """Sum of the LLRs (E,) of earlier times a codeword was seen; zeros where there are none."""
        kept = self.codewords.get(kind, ())
        agreements = [agreement(llr, other)[0] for other in kept]
        best = int(np.argmax(agreements)) if agreements else -1
        if best < 0 or agreements[best] < SAME:
            return np.zeros_like(llr)
        return kept[best]

    def without(self, packet: BufferedPacket) -> "SoftBuffer":
        """The buffer less a packet."""
        return replace(self, packets=tuple(other for other in self.packets if other is not packet))

    def with_packet(self, packet: BufferedPacket) -> "SoftBuffer":
        """The buffer and a packet, which takes the place of the oldest where there is no room."""
        return replace(self, packets=(*self.packets, packet)[-PACKETS_KEPT:])

    def with_codeword(self, kind: Kind, llr: Floats, earlier: Floats) -> "SoftBuffer":
        """Add a codeword that this packet did not give, in place of the oldest where there is no room."""
        rest = (other for other in self.codewords.get(kind, ()) if not np.array_equal(other, earlier))
        kept = (*rest, llr + earlier)[-CODEWORDS_KEPT:]
        return replace(self, codewords={**self.codewords, kind: kept})


def agreement(a: Floats, b: Floats) -> tuple[float, float]:
    """Agreement of two sets of LLRs."""
    # sum of E[bit | a] E[bit | b]; its mean is 0 for bits that have nothing to do with each other
    product = np.tanh(a / 2) * np.tanh(b / 2)
    spread = float(np.sqrt((product**2).sum()))
    return float(product.sum()) / max(spread, TINY), spread


def consistent(llr: Floats, signs: Floats) -> bool:
    """Whether LLRs agree with a codeword as far as their own codeword would.

    A codeword decoded with the help of earlier packets might be theirs alone, and this packet's differ in some bits.
    """
    soft = np.tanh(llr / 2)
    # E[soft * sign] = soft^2 where the LLRs are calibrated, and 0 of another codeword, with the variance sum soft^2
    expected = float((soft**2).sum())
    spread = float(np.sqrt((soft**2 * (1 - soft**2)).sum()))
    return float(soft @ signs) > max(CONSISTENT * expected - CONSISTENT_SPREADS * spread, SUPPORT * expected**0.5)


def _along(found: Floats, expected: Floats) -> float:
    """Agreement of codewords together, weighted by what is expected of each."""
    return float(found @ expected / np.sqrt(max(float(expected @ expected), TINY)))
