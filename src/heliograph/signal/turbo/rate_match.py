"""Rate matching: sub-block interleavers, circular buffer, bit selection.

A list of positions for each size and rate implements all steps: the encoder gathers sent bits, and the decoder adds
received LLRs, at these positions. Source: 3GPP TS 36.212, section 5.1.4.1.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError

COLUMNS = 32
"""Columns in the sub-block interleaver (TS 36.212, 5.1.4.1.1)."""

STREAMS = 3
"""Streams d0, d1, d2 in the rate 1/3 mother code (TS 36.212, 5.1.3.2.2)."""


@lru_cache(maxsize=32)
def selection(stream_length: int, coded_bits: int) -> NDArray[np.int64]:
    """Return the mother codeword position for each sent bit, (coded_bits,), read-only (TS 36.212, 5.1.4.1.2).

    Position ``3 t + j`` is bit t in stream j, 0 <= t < D = `stream_length`. Above 3 D bits the buffer repeats.
    """
    if min(stream_length, coded_bits) < 1:
        raise SettingsError(f"lengths must be at least 1, not D = {stream_length} and E = {coded_bits}")
    buffer = _circular_buffer(stream_length)
    rows = -(-stream_length // COLUMNS)
    # k0 = R (2 ceil(Ncb / (8 R)) rv + 2) with rv = 0
    turned = np.roll(buffer, -2 * rows)
    positions = np.resize(turned[turned >= 0], coded_bits)
    positions.setflags(write=False)
    return positions


def _circular_buffer(stream_length: int) -> NDArray[np.int64]:
    """Return positions in the order of the circular buffer w, negative for padding (5.1.4.1.2)."""
    size = -(-stream_length // COLUMNS) * COLUMNS
    # write row by row, permute columns, read column by column (5.1.4.1.1): P reverses the five bits of a column number
    order = [int(f"{column:05b}"[::-1], 2) for column in range(COLUMNS)]
    read = np.arange(size).reshape(-1, COLUMNS)[:, order].T.ravel()
    # stream 2 is shifted by a bit: pi(k) = (P(floor(k / R)) + C (k mod R) + 1) mod Kpi
    reads = np.stack([read, read, (read + 1) % size])
    # <NULL> bits pad the start of the first row, then y_k = d_(k - ND)
    v0, v1, v2 = STREAMS * (reads - (size - stream_length)) + np.arange(STREAMS)[:, None]
    # w_k = v0_k, w_(Kpi + 2k) = v1_k, w_(Kpi + 2k + 1) = v2_k
    return np.concatenate([v0, np.stack([v1, v2], axis=-1).ravel()])
