"""Whitening of codewords (section 10), which makes the patterns of runs of equal bytes look random."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.settings import LAYERS

WHITENER = 0b1100_0000_0000_0001
"""Polynomial of the whitening as bits: x^15 + x^14 + 1 (section 10), primitive, so the period is 32767 chips."""

WHITENER_START = (1 << 15) - 1
"""First 15 chips of the whitening: all ones (section 10)."""

LAYER_CHIPS = 8192
"""Chips between the starts of two layers' whitening (section 10): a quarter of the period, so that first
codewords of up to 8192 bits in the three layers have no chips in common. Twice the value
would start the low layer a chip after the high layer."""

CODEWORD_CHIPS = 509
"""Chips between the starts of two codewords' whitening in a layer (section 10). Chosen, a prime: any shift but 0 gives
chips that agree with the unshifted chips in 16383 of 32767 places, so half or twice the value would do as well."""


@lru_cache(maxsize=1)
def _period() -> NDArray[np.uint8]:
    chips = m_sequence(WHITENER, WHITENER_START)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Return the chips that whiten a codeword by addition modulo 2 (section 10).

    The chips are the M-sequence of x^15 + x^14 + 1 from the all-ones state.

    Parameters
    ----------
    e
        Coded bits of the codeword, at least 0.
    layer
        "high", "middle" or "low".
    codeword
        Number of the codeword in its layer and packet, from 0.

    Returns
    -------
    (e,) uint8 chips 0 and 1.
    """
    # g((8192 l + 509 i + j) mod 32767)
    start = LAYER_CHIPS * LAYERS.index(layer) + CODEWORD_CHIPS * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]
