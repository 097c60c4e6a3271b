"""Codeword whitening (section 10), which makes patterns for repeated bytes look random."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.settings import LAYERS


@cache
def _period() -> NDArray[np.uint8]:
    """Return the 32767 chips of the primitive polynomial x^15 + x^14 + 1, starting with 15 ones."""
    chips = m_sequence(0b1100_0000_0000_0001, (1 << 15) - 1)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Return whitening chips 0 and 1 for a codeword with `e` coded bits, (e,) uint8, to add modulo 2 (section 10)."""
    # g((8192 l + 509 i + j) mod 32767): first codewords up to 8192 bits share no chips between layers
    start = 8192 * LAYERS.index(layer) + 509 * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]
