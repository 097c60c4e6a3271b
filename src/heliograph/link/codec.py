"""Messages to patterns and luminances back to messages, without camera or image."""

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

ABSURD = 1e6
"""Multiple of the median luminance beyond which one is a fault of what measured it. Chosen: cameras of 16 bits tell
65536 levels apart. A single one of 1e308 would leave nothing of the others beside it."""


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

    Raises
    ------
    HeliographError
        A layer or the identity is unknown, a message is no bytes or too long, or the settings are no `SignalSettings`.
    """
    if not isinstance(messages, Mapping):
        raise HeliographError(f'messages are bytes by layer, such as {{"high": b"..."}}, not {type(messages).__name__}')
    listed = {name: [data] for name, data in messages.items()}
    sender = Transmitter(_signal(settings), identity, listed)
    layers = sender.format.layers
    needed = [-(-len(data) // (layers[n].payload_bytes * layers[n].codewords)) for n, data in messages.items()]
    return np.concatenate(list(islice(sender.packets(), max([1, *needed]))))


def decode(luminances: ArrayLike, settings: SignalSettings | None = None) -> Iterator[Message]:
    """Messages in the luminances of all LEDs, pattern after pattern.

    Parameters
    ----------
    luminances
        (patterns, n, n) real numbers in any unit, noisy or not; the first is the first of a packet. NaN and infinite
        ones are erasures: nothing is known of that LED in that pattern. So are those `ABSURD` times as large as most.
    settings
        The signal; the default is the reference link's.

    Raises
    ------
    HeliographError
        The luminances are no real numbers, or have another shape than whole packets have; or the settings are no
        `SignalSettings`.
    """
    form = PacketFormat(_signal(settings))
    side, size = form.settings.side, form.settings.packet_patterns
    return _messages(_numbers(luminances, side, size).reshape(-1, size, side, side), form)


def _messages(packets: NDArray[np.float64], form: PacketFormat) -> Iterator[Message]:
    reassembler = Reassembler()
    for packet in packets:
        change = packet[0::2] - packet[1::2]
        known = np.isfinite(change)
        # an LED of which nothing is known is as likely brighter as darker
        header, data = np.split(np.where(known, change, 0.0), [form.settings.header_pairs])
        seen = known[form.settings.header_pairs :].any((1, 2))
        words = decode_packet(data, seen, form, _identity_of(header), Decoding())
        blocks = [word.block for layer in words.values() for word in layer if word.block]
        yield from filter(None, map(reassembler.add, blocks))


def _signal(settings: SignalSettings | None) -> SignalSettings:
    if settings is None:
        return SignalSettings()
    check_signal(settings)
    return settings


def _numbers(luminances: ArrayLike, side: int, size: int) -> NDArray[np.float64]:
    """Luminances as numbers of at most 1, erased ones as NaN."""
    try:
        x = np.asarray(luminances)
        x = x.astype(np.float64, casting="same_kind" if x.dtype.kind != "O" else "unsafe")
    except (ValueError, TypeError, OverflowError):  # of ragged lists, text, complex numbers
        raise HeliographError(f"luminances are real numbers of shape (patterns, {side}, {side})") from None
    if x.ndim != 3 or x.shape[1:] != (side, side) or not len(x) or len(x) % size:
        raise HeliographError(f"expected (patterns, {side}, {side}) with whole packets of {size}, not {x.shape}")
    known = np.isfinite(x)
    known &= _credible(np.abs(x, where=known, out=np.zeros_like(x)))
    largest = np.abs(x, where=known, out=np.zeros_like(x)).max()
    # nothing but their ratios counts, and the squares of very large ones would be infinite
    return np.where(known, x, np.nan) / (largest or 1.0)


def _credible(sizes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a luminance is none that is absurd beside the others, by the median of those that are not 0."""
    lit = sizes[sizes > 0]
    if not lit.size:
        return np.ones(sizes.shape, bool)
    middle = np.partition(lit, lit.size // 2)[lit.size // 2]
    return sizes / ABSURD <= middle  # a quotient, as the product may be infinite


def _identity_of(header: NDArray[np.float64]) -> int:
    """The identity whose header correlates best."""
    known = np.stack([header_levels(i, header.shape[-1]) for i in range(IDENTITIES)]).astype(np.float64)
    return int(np.argmax(np.tensordot(known - known.mean(), header.sum(0), 2)))
