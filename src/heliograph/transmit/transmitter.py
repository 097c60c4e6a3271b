"""Byte streams by priority to an endless sequence of LED patterns."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from heliograph.base.config import CONFIG
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, Format
from heliograph.signal.header import IDENTITIES
from heliograph.signal.header import identity as identity_of
from heliograph.signal.message import Carousel
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS, SignalSettings


@checked(frozen=True, kw_only=True, config=CONFIG)
class TransmitSettings:
    """Who transmits.

    Attributes
    ----------
    identities
        Identity of each array, in the order of the arrays of the scene; all different.
    formats
        Modes and rates of the packets, taken in turn and named in their headers; none for what ``signal`` agrees on.
    """

    identities: tuple[Annotated[int, Field(ge=0, lt=IDENTITIES)], ...] = (0,)
    formats: tuple[Format, ...] = ()


@dataclass(frozen=True, slots=True)
class TimedPattern:
    """A pattern and when it is shown.

    Attributes
    ----------
    index
        Number of the pattern from the start of the transmission.
    time_s
        When it appears; it stays for T_b.
    part
        "header" or "data".
    inverted
        Whether it is the inverse of the pattern before.
    levels
        (n, n) uint8 levels 0 to 4.
    """

    index: int
    time_s: float
    part: Literal["header", "data"]
    inverted: bool
    levels: NDArray[np.uint8]


class Transmitter:
    """One array's light, without end.

    Parameters
    ----------
    settings
        The signal.
    identity
        Number of the array, 0 to 29.
    messages
        Messages by layer, repeated as a carousel; a layer without any sends idle blocks.
    formats
        Formats of the packets, taken in turn; none for pairs at the agreed rates.
    """

    def __init__(
        self,
        settings: SignalSettings,
        identity: int,
        messages: Mapping[str, Sequence[bytes]],
        formats: Sequence[Format] = (),
    ):
        unknown = set(messages) - set(LAYERS)
        if unknown:
            raise ValueError(f"layers are {', '.join(LAYERS)}, not {', '.join(sorted(unknown))}")
        self.formats = tuple(PacketFormat(settings, named) for named in formats or (AGREED,))
        self.identity = identity_of(identity).number
        # where packets differ in the size of their blocks, each size has a carousel of its own
        self._carousels = {
            (name, layer.payload_bytes): Carousel(identity, name, messages.get(name, ()), layer.payload_bytes)
            for form in self.formats
            for name, layer in form.layers.items()
        }

    @property
    def format(self) -> PacketFormat:
        """Format of packet 0."""
        return self.formats[0]

    def format_of(self, packet: int) -> PacketFormat:
        """Format of packet number `packet`."""
        return self.formats[packet % len(self.formats)]

    def blocks(self, packet: int) -> dict[str, list[Block]]:
        """Blocks that packet number `packet` carries, one a codeword, by layer."""
        return {
            name: [
                self._carousels[name, layer.payload_bytes].block(self._sent_before(packet, name) + i)
                for i in range(layer.codewords)
            ]
            for name, layer in self.format_of(packet).layers.items()
        }

    def _sent_before(self, packet: int, name: str) -> int:
        """Codewords of a layer, as large as those of packet number `packet`, that were sent before it."""
        size = self.format_of(packet).layers[name].payload_bytes
        layers = [form.layers[name] for form in self.formats]
        counts = [layer.codewords if layer.payload_bytes == size else 0 for layer in layers]
        cycles, place = divmod(packet, len(counts))
        return cycles * sum(counts) + sum(counts[:place])

    def packets(self) -> Iterator[NDArray[np.uint8]]:
        """Endless packets, each (patterns, n, n) uint8 levels in the order of time."""
        ahead = 0
        for number in count():
            packet = self.format_of(number).patterns(self.identity, self.blocks(number), ahead)
            # a cell of D11 changes 4 LEDs by half a level
            ahead += (int(packet.sum(dtype=np.int64)) - packet.size * SLOTS // 2) // 2
            yield packet

    def levels(self) -> Iterator[NDArray[np.uint8]]:
        """Endless patterns, each (n, n) uint8 levels."""
        for packet in self.packets():
            yield from packet

    def patterns(self) -> Iterator[TimedPattern]:
        """Endless patterns with their times and parts."""
        settings = self.format.settings
        for index, levels in enumerate(self.levels()):
            place = index % settings.packet_patterns
            part: Literal["header", "data"] = "header" if place < 2 * settings.header_pairs else "data"
            single = part == "data" and self.format_of(index // settings.packet_patterns).single
            inverted = bool(index % 2) and not single
            yield TimedPattern(index, index * settings.pattern_period_s, part, inverted, levels)
