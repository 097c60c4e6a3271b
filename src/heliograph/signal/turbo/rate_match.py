"""Rate matching: sub-block interleavers, circular buffer, bit selection.

A list of positions, made once for each size and rate, does all of it: the encoder gathers sent bits by it, the decoder
adds received LLRs by it. Source: 3GPP TS 36.212, section 5.1.4.1.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal.turbo.qpp import CACHED

COLUMNS = 32
"""Columns of the sub-block interleaver (TS 36.212, 5.1.4.1.1)."""

STREAMS = 3
"""Streams d0, d1, d2 of the mother code of rate 1/3 (TS 36.212, 5.1.3.2.2)."""

_NULL = -1
"""Stands for an empty place of the circular buffer."""

_COLUMN_ORDER = np.array([int(f"{column:05b}"[::-1], 2) for column in range(COLUMNS)])
"""Table 5.1.4-1: column c of the output is column P(c) of the input, P(c) the five bits of c read backwards."""


@lru_cache(maxsize=CACHED)
def selection(stream_length: int, coded_bits: int) -> NDArray[np.int64]:
    """Return the position in the mother codeword of each sent bit, of redundancy version 0 (TS 36.212, 5.1.4.1.2).

    Parameters
    ----------
    stream_length : int
        D, the length of each of the streams d0, d1, d2: K + 4 for a turbo code block.
    coded_bits : int
        E, the number of bits to send; above 3 D the buffer is read again from the start.

    Returns
    -------
    ndarray of int64, shape (coded_bits,)
        Read-only; ``3 t + j`` stands for bit t of stream j, so ``sent = mother[..., positions]`` with the
        mother codeword in the order d0_0 d1_0 d2_0 d0_1 ...

    Raises
    ------
    SettingsError
        A length is below 1.
    """
    if min(stream_length, coded_bits) < 1:
        raise SettingsError(f"lengths must be at least 1, not D = {stream_length} and E = {coded_bits}")
    buffer = _circular_buffer(stream_length)
    rows = -(-stream_length // COLUMNS)
    # k0 = R (2 ceil(Ncb / (8 R)) rv + 2) with rv = 0
    turned = np.roll(buffer, -2 * rows)
    positions = np.resize(turned[turned != _NULL], coded_bits)
    positions.setflags(write=False)
    return positions


def _circular_buffer(stream_length: int) -> NDArray[np.int64]:
    """Return positions in the order of the circular buffer w, NULL where the rectangle was padded (5.1.4.1.2)."""
    size = -(-stream_length // COLUMNS) * COLUMNS
    # <NULL> bits fill the front of the first row, then y_k = d_(k - ND)
    padded = np.arange(size) - (size - stream_length)
    v0, v1, v2 = (
        _positions(padded[reading], stream)
        for stream, reading in enumerate((_read_01(size), _read_01(size), _read_2(size)))
    )
    # w_k = v0_k, w_(Kpi + 2k) = v1_k, w_(Kpi + 2k + 1) = v2_k
    return np.concatenate([v0, np.stack([v1, v2], axis=-1).ravel()])


def _positions(times: NDArray[np.int64], stream: int) -> NDArray[np.int64]:
    return np.where(times < 0, _NULL, STREAMS * times + stream)


def _read_01(size: int) -> NDArray[np.int64]:
    """Streams 0 and 1: written row by row, columns permuted, read column by column (5.1.4.1.1)."""
    return np.arange(size).reshape(-1, COLUMNS)[:, _COLUMN_ORDER].T.ravel()


def _read_2(size: int) -> NDArray[np.int64]:
    """Stream 2: the same reading, a bit later."""
    # pi(k) = (P(floor(k / R)) + C (k mod R) + 1) mod Kpi
    return (_read_01(size) + 1) % size
