"""What the iterations begin with and end with: a packet's pairs as they were observed, and the packet once decoded."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from heliograph.base.arrays import Floats
from heliograph.receive.decode.gain_and_noise import GainAndNoise
from heliograph.receive.decode.soft_combining import SoftBuffer
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packets import Words


class Observed(Protocol):
    """The pairs of a packet as they were observed; see `pose_refinement.ObservedPacket`."""

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair, in the single mode of each pattern; None where the array was not seen."""

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with its poses refined by what is known of the symbols; itself where none moves."""

    def relit(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with the LEDs' brightness learnt by what is decoded; itself where it hardly changes."""


ObservedT = TypeVar("ObservedT", bound=Observed)


@dataclass(frozen=True, slots=True)
class DecodedPacket(Generic[ObservedT]):
    """A packet once it is decoded."""

    # Its codewords by layer, decoded or not
    words: Words
    # Its pairs as they were seen at last
    observed: ObservedT
    # mean, variance: (pairs, n^2) mean, -1 to 1, and variance, 0 to 1, of each symbol; in the single mode by pattern
    mean: Floats
    variance: Floats
    # Gain in gray levels and noise, as they were estimated at last
    channel: GainAndNoise
    # What was seen of this array's codewords, this packet included; None where none was given
    buffer: SoftBuffer | None
