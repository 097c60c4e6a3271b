"""Observations of a packet's data, kept until its end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from heliograph.base.arrays import Floats
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.sync.pairing import UnpairedFrame
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.track import Track, mask_occluded_retroactively
from heliograph.receive.track.unpaired_frames import unpaired_cutout

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PacketBuffer:
    """Observed data of a packet, by number of the pair."""

    # Cut-outs of pairs, in the single mode by number of the pattern
    cutouts: Mapping[int, Cutout] = field(default_factory=dict)
    # Complete pairs in step
    seen: Mapping[int, tuple[PoseState, Cutout]] = field(default_factory=dict)
    # Remaining frames of incomplete pairs
    lone: Mapping[int, UnpairedFrame] = field(default_factory=dict)

    def with_pair(self, place: int, cutout: Cutout, track: Track, in_step: bool) -> "PacketBuffer":
        """Add a pair; mask LEDs in the pairs before that were hidden already."""
        cutouts = {**self.cutouts, place: cutout}
        if not track.all_visible:
            cutouts |= mask_occluded_retroactively(cutouts, place, track.visible)
        seen = {**self.seen, place: (track.state, cutout)} if in_step else self.seen
        return PacketBuffer(cutouts, seen, self.lone)

    def with_patterns(self, place: int, cutouts: Sequence[Cutout]) -> "PacketBuffer":
        """Add the two patterns of a pair in the single mode, which has no inverses."""
        patterns = dict(enumerate(cutouts, len(cutouts) * place))
        return replace(self, cutouts={**self.cutouts, **patterns})

    def with_lone(self, place: int, lone: UnpairedFrame) -> "PacketBuffer":
        """Add the remaining frame of a pair."""
        return replace(self, lone={**self.lone, place: lone})

    def renumbered(self, place: int, pairs: int) -> "PacketBuffer":
        """Return the data with a lost pair: it and later pairs move to the next number."""
        cutouts, seen = renumbered(self.cutouts, place, pairs), renumbered(self.seen, place, pairs)
        return PacketBuffer(cutouts, seen, renumbered(self.lone, place, pairs))

    @property
    def trimmed(self) -> "PacketBuffer":
        """The data less complete pairs if no frame is unpaired: the decoder does not use them."""
        return self if self.lone else replace(self, seen={})

    def in_order(self, count: int) -> list[Cutout | None]:
        """Cut-outs of all pairs, in the single mode of all patterns; None for missing pairs."""
        return [self.cutouts.get(k) for k in range(count)]

    def lone_cutouts(self, late_s: float, gain: float, led_gains: Floats) -> dict[int, Cutout | None]:
        """Cut-outs estimated from unpaired frames, by number of the pair; None if impossible."""
        return {
            place: unpaired_cutout(lone, place, self.seen, late_s, gain, led_gains) for place, lone in self.lone.items()
        }


def renumbered(items: Mapping[int, T], place: int, pairs: int) -> dict[int, T]:
    """Move the items from a place on to the next number."""
    moved = {number + (number >= place): item for number, item in items.items()}
    return {number: item for number, item in moved.items() if number < pairs}
