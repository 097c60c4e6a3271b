"""Several looks: what could not be decoded is kept, and added to when it comes again.

A whole packet that comes again, as the only one of a carousel does, is kept as its looks: added up they are one better
look, equalised together. A codeword that comes again in other company is kept as its LLRs. LLRs of one and the same
packet would not add: the light of its other layers disturbs them alike each time.
"""

from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.decode import LARGEST_LLR
from heliograph.receive.soft.look import Look
from heliograph.signal.formats import Format
from heliograph.signal.turbo import TurboCode

Floats = NDArray[np.float64]

Kind = tuple[str, TurboCode]
"""Layer and code: only codewords of one kind can be the same."""

KEPT = 32
"""Codewords kept of each kind."""

LIKENESS = 5.5
"""Standard deviations of agreement from which two codewords are taken for the same: 2e-8 by chance, in coded bits that
differ by chance."""

FAITHFUL = 0.6
"""Share of the agreement to be expected that a look shows at least with what is its codeword."""

SPOKEN = 4.0
"""Standard deviations of agreement with another codeword that it shows at least: 3e-5 by chance."""

KEPT_PACKETS = 4
"""Packets of which the looks are kept: 13 MB each of 48 pairs, twice that without inverses."""


@dataclass(frozen=True, slots=True)
class SeenPacket:
    """A packet that was not decoded as a whole, or not by one look.

    Attributes
    ----------
    named
        Its format.
    llrs
        (E,) of each codeword, layer by layer; those of decoded ones without doubt.
    looks
        What was seen of each pair in all of its looks together; None for nothing.
    gain, noise
        Of the looks; see `cancel.Light`.
    """

    named: Format
    llrs: tuple[Floats, ...]
    looks: tuple[Look | None, ...]
    gain: float = 1.0
    noise: float = 1.0

    def joined(self, looks: Sequence[Look | None], gain: float, noise: float) -> list[Look | None]:
        """Further looks at its pairs, of a gain and noise, and these as if they were of the same."""
        # B g_0 = (B g_0 / g) g, and weights are in units of the noise
        weight, dimmer = noise / self.noise, self.gain / gain
        kept = (None if look is None else look.scaled(weight, dimmer) for look in self.looks)
        return [a.plus(b) if a and b else a or b for a, b in zip(looks, kept, strict=True)]

    def likeness(self, llrs: Sequence[Floats]) -> float:
        """How far another look's codewords (E,) agree with these beyond chance; 0 where they contradict.

        Packets of a carousel may share a codeword that is decoded: then it is the others that tell.
        """
        found, expected = np.array([agreement(a, b) for a, b in zip(llrs, self.llrs, strict=True)]).T
        open_ = np.array([bool((np.abs(llr) < LARGEST_LLR).any()) for llr in self.llrs])
        least = 0.5 * float(np.linalg.norm(expected[open_]))
        if (found < 0.5 * expected - 2).any() or _along(found[open_], expected[open_]) < least:
            return 0.0
        return _along(found, expected)


class Memory:
    """Codewords and packets of one array that were seen but not decoded."""

    def __init__(self) -> None:
        self._kept: dict[Kind, deque[Floats]] = defaultdict(lambda: deque(maxlen=KEPT))
        self._packets: deque[SeenPacket] = deque(maxlen=KEPT_PACKETS)

    def recall_packet(self, named: Format, llrs: Sequence[Floats]) -> SeenPacket | None:
        """The packet of a format that a look with these LLRs shows again; it is not kept any more."""
        alike = [(packet.likeness(llrs), packet) for packet in self._packets if packet.named == named]
        best, found = max(alike, key=lambda one: one[0], default=(0.0, None))
        if found is None or best < LIKENESS:
            return None
        others = [packet for packet in self._packets if packet is not found]
        self._packets.clear()
        self._packets.extend(others)
        return found

    def copy(self) -> "Memory":
        """A memory of the same that goes its own way."""
        other = Memory()
        other.become(self)
        return other

    def become(self, other: "Memory") -> None:
        """Remember what another one does, and nothing else."""
        self._packets = other._packets.copy()
        self._kept.clear()
        self._kept.update({kind: kept.copy() for kind, kept in other._kept.items()})

    def keep_packet(self, packet: SeenPacket) -> None:
        """Keep a packet, in place of the oldest."""
        self._packets.append(packet)

    def recall(self, kind: Kind, llr: Floats) -> Floats:
        """Sum of the LLRs (E,) of earlier looks at the codeword that a look with `llr` shows; zeros without any."""
        kept = self._kept[kind]
        agreements = [agreement(llr, other)[0] for other in kept]
        best = int(np.argmax(agreements)) if agreements else -1
        if best < 0 or agreements[best] < LIKENESS:
            return np.zeros_like(llr)
        return kept[best]

    def keep(self, kind: Kind, llr: Floats, recalled: Floats) -> None:
        """Keep what is known of a codeword that this look alone did not give, in place of what was recalled."""
        kept = self._kept[kind]
        rest = [other for other in kept if not np.array_equal(other, recalled)]
        kept.clear()
        kept.extend([*rest, llr + recalled])


def _along(found: Floats, expected: Floats) -> float:
    """Agreement of codewords together, those weighing most that may agree most."""
    return float(found @ expected / np.sqrt(max(float(expected @ expected), 1e-24)))


def agreement(a: Floats, b: Floats) -> tuple[float, float]:
    """How far two looks (E,) agree beyond chance, and how far they would on the same codeword.

    Both in standard deviations of looks at different codewords.
    """
    # sum of E[bit | a] E[bit | b]; for bits that have nothing to do with each other of mean 0
    product = np.tanh(a / 2) * np.tanh(b / 2)
    spread = float(np.sqrt((product**2).sum()))
    return float(product.sum()) / max(spread, 1e-12), spread


def faithful(llr: Floats, signs: Floats) -> bool:
    """Whether a look (E,) alone speaks for a codeword's bits, 1 for 0 and -1 for 1.

    A codeword decoded with the help of earlier looks might be theirs alone, of which this one differs in some bits.
    """
    soft = np.tanh(llr / 2)
    # E[soft * sign] = soft^2 where the LLRs are right, and 0 of another codeword, whose variance is the sum of soft^2
    expected = float((soft**2).sum())
    spread = float(np.sqrt((soft**2 * (1 - soft**2)).sum()))
    return float(soft @ signs) > max(FAITHFUL * expected - 3 * spread, SPOKEN * expected**0.5)
