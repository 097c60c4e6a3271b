"""Messages to patterns, and luminances to messages, independent of camera and image."""

from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import HeliographError
from heliograph.receive.decode.codeword import Decoding, decode_packet
from heliograph.signal.header import IDENTITIES, header_levels
from heliograph.signal.message import Message, Reassembler
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings, check_signal
from heliograph.transmit import Transmitter


def encode(
    messages: Mapping[str, bytes], identity: int = 0, settings: SignalSettings | None = None
) -> NDArray[np.uint8]:
    """Encode messages as patterns, each sent once.

    Parameters
    ----------
    messages
        A message by layer: "high", "middle", "low".
    identity
        Number of the array, 0 to 29.
    settings
        Signal settings; the default is the reference link.

    Returns
    -------
    (patterns, n, n) uint8 levels 0 to 4, each pattern followed by the inverse. The longest message determines the
    number of packets.

    Raises
    ------
    HeliographError
        A layer or the identity is unknown, a message is no bytes or too long, or the settings are no `SignalSettings`.
    """
    if not isinstance(messages, Mapping):
        raise HeliographError(f'messages are bytes by layer, such as {{"high": b"..."}}, not {type(messages).__name__}')
    signal = SignalSettings() if settings is None else settings
    sender = Transmitter(signal, identity, {name: [data] for name, data in messages.items()})
    layers = sender.format.layers
    counts = [-(-len(data) // (layers[n].payload_bytes * layers[n].codewords)) for n, data in messages.items()]
    return np.concatenate(list(islice(sender.packets(), max([1, *counts]))))


def decode(luminances: ArrayLike, settings: SignalSettings | None = None) -> Iterator[Message]:
    """Decode messages from the luminances of all LEDs.

    Parameters
    ----------
    luminances
        (patterns, n, n) real numbers in any unit; the first pattern starts a packet. NaN, infinite values and values
        above 1e6 times the median luminance are erasures.
    settings
        Signal settings; the default is the reference link.

    Raises
    ------
    HeliographError
        The luminances are no real numbers or no complete packets, or the settings are no `SignalSettings`.
    """
    signal = SignalSettings() if settings is None else settings
    check_signal(signal)
    form = PacketFormat(signal)
    return _messages(_normalise(luminances, form.settings.side, form.settings.packet_patterns), form)


def _messages(x: NDArray[np.float64], form: PacketFormat) -> Iterator[Message]:
    reassembler = Reassembler()
    for packet in x.reshape(-1, form.settings.packet_patterns, *x.shape[1:]):
        change = packet[0::2] - packet[1::2]
        known = np.isfinite(change)
        # erased LEDs have a neutral value
        header, data = np.split(np.where(known, change, 0.0), [form.settings.header_pairs])
        received = known[form.settings.header_pairs :].any((1, 2))
        words = decode_packet(data, received, form, _identify(header), Decoding())
        blocks = [word.block for layer in words.values() for word in layer if word.block]
        yield from filter(None, map(reassembler.add, blocks))


def _normalise(luminances: ArrayLike, side: int, size: int) -> NDArray[np.float64]:
    """Return luminances scaled to at most 1, with NaN for erasures."""
    try:
        x = np.asarray(luminances)
        x = x.astype(np.float64, casting="same_kind" if x.dtype.kind != "O" else "unsafe")
    except (ValueError, TypeError, OverflowError):  # ragged lists, text, complex numbers
        raise HeliographError(f"luminances are real numbers of shape (patterns, {side}, {side})") from None
    if x.ndim != 3 or x.shape[1:] != (side, side) or not len(x) or len(x) % size:
        raise HeliographError(f"expected (patterns, {side}, {side}) with whole packets of {size}, not {x.shape}")
    sizes = np.where(np.isfinite(x), np.abs(x), 0.0)
    lit = sizes[sizes > 0]
    if lit.size:
        # cameras have at most 65536 levels: larger ratios are measurement faults
        median = np.partition(lit, lit.size // 2)[lit.size // 2]
        x = np.where(np.isfinite(x) & (sizes / 1e6 <= median), x, np.nan)
        x = x / np.nanmax(np.abs(x))  # avoids overflow in squares
    return np.where(np.isfinite(x), x, np.nan)


def _identify(header: NDArray[np.float64]) -> int:
    """Return the identity with the largest header correlation."""
    known = np.stack([header_levels(i, header.shape[-1]) for i in range(IDENTITIES)]).astype(np.float64)
    return int(np.argmax(np.tensordot(known - known.mean(), header.sum(0), 2)))
