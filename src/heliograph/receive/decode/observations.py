"""What a reader keeps of a packet's data until its end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from heliograph.base.arrays import Floats
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.sync.pairing import UnpairedFrame
from heliograph.receive.track.track import Track, mask_occluded_retroactively
from heliograph.receive.track.unpaired_frames import CompletePair, unpaired_cutout

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PacketBuffer:
    """What was kept of a packet's data, by number of the pair."""

    # Cut-outs of pairs, in the single mode by number of the pattern
    cutouts: Mapping[int, Cutout] = field(default_factory=dict)
    # Pairs in step of which both frames are there
    seen: Mapping[int, CompletePair] = field(default_factory=dict)
    # What is left of the others
    lone: Mapping[int, UnpairedFrame] = field(default_factory=dict)

    def with_pair(self, place: int, cutout: Cutout, track: Track, in_step: bool) -> "PacketBuffer":
        """A further pair, and of the pairs before it the cut-outs without LEDs that were hidden already."""
        cutouts = {**self.cutouts, place: cutout}
        if not track.all_visible:
            cutouts |= mask_occluded_retroactively(cutouts, place, track.visible)
        seen = {**self.seen, place: CompletePair(track.state, cutout)} if in_step else self.seen
        return PacketBuffer(cutouts, seen, self.lone)

    def with_patterns(self, place: int, cutouts: Sequence[Cutout]) -> "PacketBuffer":
        """A further pair in the single mode, where both frames are patterns and neither is an inverse."""
        patterns = dict(enumerate(cutouts, len(cutouts) * place))
        return replace(self, cutouts={**self.cutouts, **patterns})

    def with_lone(self, place: int, lone: UnpairedFrame) -> "PacketBuffer":
        """A further pair, of which a frame is lost."""
        return replace(self, lone={**self.lone, place: lone})

    def renumbered(self, place: int, pairs: int) -> "PacketBuffer":
        """The same with the pairs from one on moved to the next number."""
        cutouts, seen = renumbered(self.cutouts, place, pairs), renumbered(self.seen, place, pairs)
        return PacketBuffer(cutouts, seen, renumbered(self.lone, place, pairs))

    def rather(self, cutouts: Sequence[Cutout | None]) -> "PacketBuffer":
        """The same with other cut-outs."""
        return replace(self, cutouts={k: one for k, one in enumerate(cutouts) if one is not None})

    @property
    def to_decode(self) -> "PacketBuffer":
        """What decoding asks for: where the array was, only where a frame's other half is lost."""
        return self if self.lone else replace(self, seen={})

    def in_order(self, count: int) -> list[Cutout | None]:
        """The cut-outs of all pairs, in the single mode of all patterns; None where the array was not seen."""
        return [self.cutouts.get(k) for k in range(count)]

    def lone_cutouts(self, late_s: float, gain: float, led_gains: Floats) -> dict[int, Cutout | None]:
        """What the frames whose other half is lost show, by number of the pair; None where that is nothing."""
        return {
            place: unpaired_cutout(lone, place, self.seen, late_s, gain, led_gains) for place, lone in self.lone.items()
        }


def renumbered(items: Mapping[int, T], place: int, pairs: int) -> dict[int, T]:
    """What is kept by number of the pair, those from one on moved to the next number."""
    moved = {number + (number >= place): item for number, item in items.items()}
    return {number: item for number, item in moved.items() if number < pairs}
