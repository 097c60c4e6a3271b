"""Transmitter: messages by layer to an infinite sequence of timed LED patterns (section 12 of the air interface)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from heliograph.base.config import CONFIG, clear_errors
from heliograph.base.errors import SettingsError, shown
from heliograph.signal.block import AnyBlock
from heliograph.signal.formats import AGREED, Format
from heliograph.signal.fountain.cauchy import NUMBERS
from heliograph.signal.fountain.files import FileCarousel, SentFile
from heliograph.signal.header import IDENTITIES
from heliograph.signal.message import Carousel, Updates
from heliograph.signal.packet import LayerFormat, PacketFormat
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS, SignalSettings, check_signal

Content = bytes | Updates | SentFile  # content of a layer

Messages = Mapping[str, Sequence[Content]]  # messages by layer


@clear_errors
@checked(frozen=True, kw_only=True, config=CONFIG)
class TransmitSettings:
    """Settings of the transmitters: array identities and packet formats.

    Attributes
    ----------
    identities
        Distinct identities of the arrays, 0 to 29, in the order of ``channel.arrays``; no effect on range or rate.
    formats
        Packet formats, mode and code rates, in cyclic order and signalled in the headers; by default, paired packets at
        the rates of ``signal.rate``. Signalled formats need the receiver "soft".
    """

    identities: tuple[Annotated[int, Field(ge=0, lt=IDENTITIES)], ...] = (0,)
    formats: tuple[Format, ...] = ()


@dataclass(frozen=True, slots=True)
class TimedPattern:
    """Pattern with the display time."""

    # Number of the pattern, from 0 at the start of the transmission
    index: int
    # Start in s from the start of the transmission; the duration is T_b
    time_s: float
    # Part of the packet, "header" or "data"
    part: Literal["header", "data"]
    # True for the inverse of the previous pattern
    inverted: bool
    # (n, n) uint8 levels 0 to 4
    levels: NDArray[np.uint8]


class Transmitter:
    """Infinite pattern sequence of an array.

    Parameters
    ----------
    settings
        Signal settings, shared with the receiver.
    identity
        Number of the array, 0 to 29.
    messages
        Messages by layer ("high", "middle", "low"), at most 256 per layer, repeated as a carousel; an empty layer
        sends idle blocks. A message is bytes, or `Updates` with changing content. A `SentFile` is sent as fountain
        code symbols; a layer with messages and files alternates between both.
    formats
        Packet formats in cyclic order; by default, data pairs at the agreed rates.

    Attributes
    ----------
    formats
        (formats,) layout of a packet of each format, in the order of use.
    identity
        Number of the array, 0 to 29.

    Raises
    ------
    SettingsError
        The settings are no `SignalSettings`, a layer or the identity is unknown, messages are no bytes, too many or too
        long, or a format is incompatible with the signal settings.
    """

    def __init__(
        self,
        settings: SignalSettings,
        identity: int,
        messages: Mapping[str, Sequence[Content]],
        formats: Sequence[Format] = (),
    ):
        check_signal(settings)
        _check_messages(messages)
        if not isinstance(formats, Sequence) or not all(isinstance(form, Format) for form in formats):
            raise SettingsError(f"formats are a list of heliograph.signal.formats.Format, not {shown(formats)}")
        self.formats = tuple(PacketFormat(settings, form) for form in formats or (AGREED,))
        if not isinstance(identity, (int, np.integer)) or not 0 <= identity < IDENTITIES:
            raise SettingsError(f"an identity is a whole number, 0 to {IDENTITIES - 1}, not {shown(identity)}")
        self.identity = int(identity)
        layers = {name: [form.layers[name] for form in self.formats] for name in LAYERS}
        self._carousels: dict[tuple[str, int], Carousel] = {}  # for each block size (section 8)
        self._files: dict[str, FileCarousel] = {}
        self._mixed = set[str]()  # layers with messages and files
        for number, (name, formed) in enumerate(layers.items()):
            listed = messages.get(name, ())
            files = [message for message in listed if isinstance(message, SentFile)]
            others = [m if isinstance(m, Updates) else bytes(m) for m in listed if not isinstance(m, SentFile)]
            try:
                for room in {layer.payload_bytes for layer in formed}:
                    self._carousels[name, room] = Carousel(self.identity, name, others, room)
                if files:
                    bits, first = [layer.code.k for layer in formed], number * (NUMBERS // len(LAYERS))
                    self._files[name] = FileCarousel(self.identity, name, files, bits, first)
            except ValueError as error:
                cure = "send less, or cut it up, or raise signal.data_pairs"
                raise SettingsError(f"array {self.identity}, {name} layer: {error}; {cure}") from None
            if files and others:
                self._mixed.add(name)

    @property
    def format(self) -> PacketFormat:
        """Layout of packet 0."""
        return self.formats[0]

    def format_of(self, packet: int) -> PacketFormat:
        """Return the layout of a packet.

        Parameters
        ----------
        packet
            Number of the packet, from 0 at the start of the transmission.
        """
        return self.formats[packet % len(self.formats)]

    def blocks(self, packet: int) -> dict[str, list[AnyBlock]]:
        """Return the blocks in a packet by layer, a block per codeword.

        Parameters
        ----------
        packet
            Number of the packet, from 0 at the start of the transmission.
        """
        return {
            name: [self._block(packet, name, layer, i) for i in range(layer.codewords)]
            for name, layer in self.format_of(packet).layers.items()
        }

    def _block(self, packet: int, name: str, layer: LayerFormat, codeword: int) -> AnyBlock:
        """Return a block of a layer; messages and files alternate."""
        number = self._sent_before(packet, name, layer.payload_bytes) + codeword
        turns = 2 if name in self._mixed else 1
        if name in self._files and (turns == 1 or number % 2):
            sizes = {form.layers[name].code.k: form.layers[name].payload_bytes for form in self.formats}
            others = [self._sent_before(packet, name, size) for k, size in sizes.items() if k != layer.code.k]
            return self._files[name].block(sum(sent // turns for sent in (*others, number)), layer.code.k)
        time_s = packet * self.format.settings.packet_s + 1e-7  # 1e-7: rounding
        return self._carousels[name, layer.payload_bytes].block(number // turns, time_s)

    def _sent_before(self, packet: int, name: str, size: int) -> int:
        """Return the number of codewords of a layer with blocks of `size` bytes before a packet."""
        layers = [form.layers[name] for form in self.formats]
        counts = [layer.codewords if layer.payload_bytes == size else 0 for layer in layers]
        cycles, index = divmod(packet, len(counts))
        return cycles * sum(counts) + sum(counts[:index])

    def packets(self) -> Iterator[NDArray[np.uint8]]:
        """Yield an infinite sequence of packets, each (patterns, n, n) uint8 levels 0 to 4 in temporal order."""
        ahead = 0
        for number in count():
            packet = self.format_of(number).patterns(self.identity, self.blocks(number), ahead)
            # a D11 symbol changes 4 LEDs by half a level
            ahead += (int(packet.sum(dtype=np.int64)) - packet.size * SLOTS // 2) // 2
            yield packet

    def levels(self) -> Iterator[NDArray[np.uint8]]:
        """Yield an infinite sequence of patterns, each (n, n) uint8 levels 0 to 4."""
        for packet in self.packets():
            yield from packet

    def patterns(self) -> Iterator[TimedPattern]:
        """Yield an infinite sequence of patterns with times and parts."""
        settings = self.format.settings
        for index, levels in enumerate(self.levels()):
            place = index % settings.packet_patterns
            part: Literal["header", "data"] = "header" if place < 2 * settings.header_pairs else "data"
            single = part == "data" and self.format_of(index // settings.packet_patterns).single
            inverted = bool(index % 2) and not single
            yield TimedPattern(index, index * settings.pattern_period_s, part, inverted, levels)


def _check_messages(messages: Any) -> None:
    if not isinstance(messages, Mapping):
        example = '{"high": [b"..."]}'
        raise SettingsError(f"messages are lists of bytes by layer, such as {example}, not {shown(messages)}")
    for name, listed in messages.items():
        if name not in LAYERS:
            raise SettingsError(f"layers are {', '.join(LAYERS)}, not {name!s:.60}")
        if isinstance(listed, (str, bytes, bytearray)) or not isinstance(listed, Sequence):
            raise SettingsError(f"the {name} layer has a list of messages, not {type(listed).__name__}; write [b'...']")
        for data in listed:
            if isinstance(data, Updates):
                times = [time_s for time_s, _ in data.contents]
                is_bytes = all(isinstance(content, bytes) for _, content in data.contents)
                if not times or times != sorted(times) or not is_bytes:
                    raise SettingsError(f"updates of the {name} layer are times in s, in order, each with bytes")
            elif not isinstance(data, (bytes, bytearray, memoryview, SentFile)):
                kind = type(data).__name__
                raise SettingsError(f"a message of the {name} layer is bytes, not {kind}; text.encode() makes them")
