"""Codeword whitening (section 10), which makes patterns for repeated bytes look random."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.settings import LAYERS

WHITENER = 0b1100_0000_0000_0001
"""Whitening polynomial as bits: x^15 + x^14 + 1 (section 10), primitive with a period of 32767 chips."""

WHITENER_START = (1 << 15) - 1
"""First 15 whitening chips, all 1 (section 10)."""

LAYER_CHIPS = 8192
"""Chip offset between layers (section 10): a quarter of the period, so that first codewords up to 8192 bits share no
chips between layers. With twice the value, the low layer would start a chip after the high layer."""

CODEWORD_CHIPS = 509
"""Chip offset between codewords in a layer (section 10), a prime. Any shift but 0 gives chips that agree with the
unshifted chips in 16383 out of 32767 positions, so half or twice the value would also work."""


@lru_cache(maxsize=1)
def _period() -> NDArray[np.uint8]:
    chips = m_sequence(WHITENER, WHITENER_START)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Return whitening chips 0 and 1 for a codeword with `e` coded bits, (e,) uint8, to add modulo 2 (section 10)."""
    # g((8192 l + 509 i + j) mod 32767)
    start = LAYER_CHIPS * LAYERS.index(layer) + CODEWORD_CHIPS * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]
