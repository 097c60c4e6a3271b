"""Messages to patterns and luminances back to messages, without camera or image."""

from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.signal.header import IDENTITIES, header_levels
from heliograph.signal.message import Message, Reassembler
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings
from heliograph.transmit import Transmitter


def encode(
    messages: Mapping[str, bytes], identity: int = 0, settings: SignalSettings | None = None
) -> NDArray[np.uint8]:
    """Patterns that send messages once.

    Parameters
    ----------
    messages
        A message by layer: "high", "middle", "low".
    identity
        Number of the array, 0 to 29.
    settings
        The signal; the default is the reference link's.

    Returns
    -------
    (patterns, n, n) uint8 levels 0 to 4, each pattern followed by its inverse: as many whole packets as the longest
    message takes.
    """
    sender = Transmitter(settings or SignalSettings(), identity, {name: [data] for name, data in messages.items()})
    layers = sender.format.layers
    needed = [-(-len(data) // (layers[n].payload_bytes * layers[n].codewords)) for n, data in messages.items()]
    return np.concatenate(list(islice(sender.packets(), max([1, *needed]))))


def decode(luminances: ArrayLike, settings: SignalSettings | None = None) -> Iterator[Message]:
    """Messages in the luminances of all LEDs, pattern after pattern.

    Parameters
    ----------
    luminances
        (patterns, n, n) in any unit, noisy or not; the first is the first of a packet.
    settings
        The signal; the default is the reference link's.

    Raises
    ------
    ValueError
        The array has another shape than whole packets have.
    """
    form = PacketFormat(settings or SignalSettings())
    side, size = form.settings.side, form.settings.packet_patterns
    x = np.asarray(luminances, dtype=np.float64)
    if x.ndim != 3 or x.shape[1:] != (side, side) or not len(x) or len(x) % size:
        raise ValueError(f"expected (patterns, {side}, {side}) with whole packets of {size}, not {x.shape}")
    reassembler = Reassembler()
    for packet in x.reshape(-1, size, side, side):
        change = packet[0::2] - packet[1::2]
        header, data = np.split(change, [form.settings.header_pairs])
        words = decode_packet(data, np.ones(len(data), bool), form, _identity_of(header), Decoding())
        blocks = [word.block for layer in words.values() for word in layer if word.block]
        yield from filter(None, map(reassembler.add, blocks))


def _identity_of(header: NDArray[np.float64]) -> int:
    """The identity whose header correlates best."""
    known = np.stack([header_levels(i, header.shape[-1]) for i in range(IDENTITIES)]).astype(np.float64)
    return int(np.argmax(np.tensordot(known - known.mean(), header.sum(0), 2)))
