"""Packets of which a whole pair is lost without a gap: which one it was, is found by decoding.

All sums after a lost pair are even, so nothing shows it until the next header comes in the place of the last pair. The
pairs from the lost one on have then the number of the one before. A code stands some wrong numbers: the packet is
decoded as if the pair were lost at each of a few places.
"""

import numpy as np

from heliograph.receive.events import Observer
from heliograph.receive.packets import Words
from heliograph.receive.reader_protocol import Decoded, TakenPacket

PLACES = 6
"""Places at which a pair is taken for lost.

Of 48 pairs of data, four at most have then a wrong number, and half of their bits are right all the same: 4 % are
wrong. A code of rate 1/3 corrects about 17 %.
"""


def decode_renumbered(taken: TakenPacket, pairs: int, observe: Observer) -> tuple[TakenPacket, Decoded]:
    """Decode a packet that lacks a pair nobody knows of."""
    best: tuple[TakenPacket, Decoded] | None = None
    # each in the middle of a part of the packet
    for place in np.unique((np.arange(PLACES) + 0.5) * pairs / PLACES).astype(int).tolist():
        one = taken.renumbered(place)
        decoded = one.decode(observe)
        if best is None or _right(decoded.words) > _right(best[1].words):
            best = one, decoded
        if _right(decoded.words) == sum(map(len, decoded.words.values())):
            break
    assert best is not None  # PLACES is at least one
    return best


def _right(words: Words) -> int:
    return sum(word.status == "ok" for layer in words.values() for word in layer)
