"""Text or a file as packets of patterns for page Transmit, and the link of a screen and a phone."""

import secrets
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.file_store import safe_name
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.signal.block import Block, SymbolBlock
from heliograph.signal.fountain.files import LONGEST_NAME, NOTICE_TURNS, SentFile
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Transmitter

LEAST_RATE_HZ, MOST_RATE_HZ = 0.5, 240.0
"""Patterns a second that the pages take: from remote desktops to the fastest displays."""

SMALL_SIDE, SMALL_RATE = 8, 3 / 4
"""Rate of packets of 8 x 8 cells: at 1/2 a codeword holds four bytes of a file, at 3/4 ten. Chosen: of a screen nearby
the cells' noise is small."""


def screen_settings(side: int, rate_hz: float) -> LinkSettings:
    """Return the settings of a screen's light, and of the receiver of its films."""
    signal: dict[str, Any] = {"side": side, "pattern_period_s": 1 / rate_hz}
    over: dict[str, Mapping[str, Any]] = {"signal": signal}
    if side == SMALL_SIDE:
        over["transmit"] = {"formats": [{"mode": "short", **dict.fromkeys(LAYERS, SMALL_RATE)}]}
    return load_settings("phone", over)


MOST_SENT = 256 << 10
"""Most bytes of a text or file: at the rates of screens it takes an hour, and its code less than 2 s to be made."""

MOST_KEPT = 16
"""Most sendings that a server knows. The one that was asked for longest ago is forgotten first. Chosen."""

MOST_PACKETS = 16
"""Most packets that are handed out at once: 0.5 MB of 32 x 32 cells."""

LED_PX, MARGIN = 32, 2
"""Of a film: pixels of a side of a cell, and cells of dark margin."""


@dataclass(frozen=True)
class Sending:
    """What is sent, as an endless row of packets."""

    # Makes them
    transmitter: Transmitter
    # Patterns a second
    rate_hz: float
    # Bytes of the text or file
    size: int
    # Whether it is sent by symbols of which any that are enough will do
    as_file: bool
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def side(self) -> int:
        """Cells in a row and in a column."""
        return self.transmitter.format.settings.side

    @property
    def packet_patterns(self) -> int:
        """Patterns of a packet."""
        return self.transmitter.format.settings.packet_patterns

    def packets(self, first: int, count: int) -> NDArray[np.uint8]:
        """Return some packets. Returns (patterns, n, n) levels 0 to 4, in the order of time."""
        with self._lock:
            return np.concatenate([self._packet(number) for number in range(first, first + count)])

    def frames(self, seconds: float, gamma: float) -> Iterator[Frame]:
        """Yield a film's frames, one for each pattern, with a dark margin."""
        pixels = np.rint(255 * (np.arange(SLOTS + 1) / SLOTS) ** (1 / gamma)).astype(np.uint8)
        block = np.ones((LED_PX, LED_PX), np.uint8)
        whole = max(1, round(seconds * self.rate_hz / self.packet_patterns))
        for number in range(whole):
            for k, levels in enumerate(self.packets(number, 1)):
                index = number * self.packet_patterns + k
                picture = np.pad(np.kron(pixels[levels], block), MARGIN * LED_PX)
                yield Frame(index, index / self.rate_hz, picture)

    def facts(self) -> Mapping[str, Any]:
        """Return what a page tells of it, as plain values."""
        layers = self.transmitter.format.layers
        turns = [self.transmitter.blocks(number) for number in range(NOTICE_TURNS)]
        blocks = [one for turn in turns for layer in turn.values() for one in layer if not isinstance(one, Block)]
        # small blocks tell what the file is now and then
        room = sum(len(one.payload) for one in blocks) / len(turns) or max(
            one.payload_bytes * one.codewords for one in layers.values()
        )
        length = next((one.length for one in blocks if not isinstance(one, SymbolBlock)), self.size)
        packet_s = self.packet_patterns / self.rate_hz
        needed = ceil(length / room) or 1
        return {
            "side": self.side, "rate_hz": self.rate_hz, "packet_patterns": self.packet_patterns, "packet_s": packet_s,
            "bytes": self.size, "as_file": self.as_file, "packet_bytes": int(room), "packets": needed,
            "seconds": needed * packet_s, "bits_per_s": 8 * room / packet_s,
        }  # fmt: skip

    def _packet(self, number: int) -> NDArray[np.uint8]:
        form = self.transmitter.format_of(number)
        return form.patterns(self.transmitter.identity, self.transmitter.blocks(number), 0)


def sending_of(data: bytes, name: str | None, side: int, rate_hz: float) -> Sending:
    """Return what sends a text or a file."""
    if not data and name is None:
        raise MediaError("there is nothing to send: write a text, or choose a file")
    if len(data) > MOST_SENT:
        raise MediaError(f"a screen sends at most {MOST_SENT >> 10} kB, not {len(data) / 1024:.0f} kB: make it smaller")
    settings = screen_settings(side, rate_hz)
    formats = settings.transmit.formats
    bare = Transmitter(settings.signal, 0, {}, formats).format
    most = max(layer.payload_bytes * layer.codewords for layer in bare.layers.values())
    # Most packets that a text may need in its largest layer to be sent as a message. Longer ones are sent as a file: of
    # a file any packets will do, while a message waits a whole turn for one that was lost. Chosen
    if name is None and len(data) <= 4 * most:
        content: Any = {layer: [data] for layer in LAYERS}
    else:
        # name of a text that is sent as a file
        file = SentFile(_short(safe_name(name or "text.txt")), data)
        content = {layer: [file] for layer in LAYERS}
    as_file = isinstance(content["high"][0], SentFile)
    return Sending(Transmitter(settings.signal, 0, content, formats), rate_hz, len(data), as_file)


def _short(name: str) -> str:
    return name[-LONGEST_NAME:]


class Sendings:
    """The sendings that a server knows, by names of its own."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, Sending] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, sending: Sending) -> str:
        """Keep a sending, and return the name by which it is asked for."""
        name = secrets.token_hex(8)
        with self._lock:
            self._known[name] = sending
            while len(self._known) > MOST_KEPT:
                self._known.popitem(last=False)
        return name

    def of(self, name: str) -> Sending:
        """Return a sending."""
        with self._lock:
            if name not in self._known:
                raise SettingsError("that text or file is not here any more: give it again")
            self._known.move_to_end(name)
            return self._known[name]
