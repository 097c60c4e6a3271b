"""Transmission of texts and files by a screen: packets of patterns, and settings of the link."""

import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.file_store import safe_name
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.signal.block import Block, SymbolBlock
from heliograph.signal.fountain.files import LONGEST_NAME, NOTICE_TURNS, SentFile
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Transmitter

MIN_RATE_HZ, MAX_RATE_HZ = 0.5, 240.0
"""Patterns per second, from remote desktops to the fastest displays."""

MAX_BYTES = 256 << 10  # size of a text or file: at the rates of screens an hour, and less than 2 s of encoding

MAX_EDGE_PX, MARGIN = 1152, 2
"""Largest side in pixels and dark margin in cells, of a film of patterns."""


def screen_settings(side: int, rate_hz: float, inverses: bool = True) -> LinkSettings:
    """Return the settings of the link from a screen to a phone."""
    # rate 3/4 in place of 1/2: more bytes in a codeword, and the noise of near screens is low
    rates = dict.fromkeys(LAYERS, 3 / 4 if side == 8 or side > 32 else 1 / 2)
    changes: dict[str, Mapping[str, Any]] = {
        "signal": {"side": side, "pattern_period_s": 1 / rate_hz},
        "transmit": {"formats": [{"mode": "short" if inverses else "single", **rates}]},
    }
    return load_settings("phone", changes)


@dataclass(frozen=True)
class Sending:
    """Transmission of a text or file as an endless sequence of packets."""

    transmitter: Transmitter
    # Patterns per second
    rate_hz: float
    # Bytes of the text or file
    size: int
    # True for fountain-coded symbols, False for a message
    as_file: bool
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def side(self) -> int:
        """Cells in a row."""
        return self.transmitter.format.settings.side

    @property
    def cell_px(self) -> int:
        """Side of a cell in a film in pixels."""
        return min(MAX_EDGE_PX // (self.side + 2 * MARGIN), 32)

    @property
    def packet_patterns(self) -> int:
        """Patterns of a packet."""
        return self.transmitter.format.settings.packet_patterns

    def packets(self, first: int, count: int) -> NDArray[np.uint8]:
        """Return successive packets: levels 0 to 4, (patterns, n, n)."""
        sender = self.transmitter
        with self._lock:
            return np.concatenate([
                sender.format_of(number).patterns(sender.identity, sender.blocks(number), 0)
                for number in range(first, first + count)
            ])  # fmt: skip

    def frames(self, seconds: float, gamma: float) -> Iterator[Frame]:
        """Yield a frame for each pattern of a film, with a dark margin."""
        grays = np.rint(255 * (np.arange(SLOTS + 1) / SLOTS) ** (1 / gamma)).astype(np.uint8)
        cell = np.ones((self.cell_px, self.cell_px), np.uint8)
        for number in range(max(1, round(seconds * self.rate_hz / self.packet_patterns))):
            for index, levels in enumerate(self.packets(number, 1), number * self.packet_patterns):
                yield Frame(index, index / self.rate_hz, np.pad(np.kron(grays[levels], cell), MARGIN * self.cell_px))

    def facts(self) -> Mapping[str, Any]:
        """Return the properties of the transmission as plain values."""
        turns = [self.transmitter.blocks(number) for number in range(NOTICE_TURNS)]
        blocks = [block for turn in turns for layer in turn.values() for block in layer if not isinstance(block, Block)]
        # packets of small arrays have notices of the file in place of some symbols
        packet_bytes = sum(len(block.payload) for block in blocks) / len(turns) or max(
            layer.payload_bytes * layer.codewords for layer in self.transmitter.format.layers.values()
        )
        length = next((block.length for block in blocks if not isinstance(block, SymbolBlock)), self.size)
        packet_s = self.packet_patterns / self.rate_hz
        packets = ceil(length / packet_bytes) or 1
        return {
            "side": self.side, "rate_hz": self.rate_hz, "packet_patterns": self.packet_patterns, "packet_s": packet_s,
            "bytes": self.size, "as_file": self.as_file, "packet_bytes": int(packet_bytes), "packets": packets,
            "seconds": packets * packet_s, "bits_per_s": 8 * packet_bytes / packet_s,
        }  # fmt: skip


def check_size(size: int) -> None:
    """Raise a MediaError if a text or file has too many bytes."""
    if size > MAX_BYTES:
        raise MediaError(f"a screen sends at most {MAX_BYTES >> 10} kB: choose a smaller file")


def sending_of(data: bytes, name: str | None, side: int, rate_hz: float, inverses: bool = True) -> Sending:
    """Return the transmission of a text, or of a file with a name."""
    if not data and name is None:
        raise MediaError("the text is empty: write a text, or choose a file")
    check_size(len(data))
    settings = screen_settings(side, rate_hz, inverses)
    formats = settings.transmit.formats
    layers = Transmitter(settings.signal, 0, {}, formats).format.layers.values()
    # A text of at most 4 packets is a message. A lost packet of a message costs a full repetition, while any packets
    # of a file will do
    is_message = name is None and len(data) <= 4 * max(layer.payload_bytes * layer.codewords for layer in layers)
    content: Any = data if is_message else SentFile(safe_name(name or "text.txt")[-LONGEST_NAME:], data)
    transmitter = Transmitter(settings.signal, 0, {layer: [content] for layer in LAYERS}, formats)
    return Sending(transmitter, rate_hz, len(data), not is_message)
