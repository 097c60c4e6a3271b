"""Turbo encoder: two recursive systematic convolutional codes with termination, and rate matching.

Source: 3GPP TS 36.212, sections 5.1.3.2 and 5.1.4.1.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STREAMS = 3  # streams d0, d1, d2 in the rate 1/3 mother code (TS 36.212, 5.1.3.2.2)

STATES = 8
"""Trellis states: ``4 a1 + 2 a2 + a3``, where a1 is the newest of three bits in the shift register (figure 5.1.3-2)."""

TAIL_BITS = 6  # coded bits to terminate a constituent code: x and z for each of three steps, in this order

TERMINATION = 2 * TAIL_BITS
"""Coded bits to terminate a block, 12: the tails from both constituent codes (TS 36.212, 5.1.3.2.2)."""


def _tail(state: int) -> list[int]:
    """Return the bits x, z, x, z, x, z on the path from a state to state 0."""
    a1, a2, a3 = state >> 2, state >> 1 & 1, state & 1
    bits: list[int] = []
    for _ in range(3):
        # 5.1.3.2.2: x is the feedback, g0(D) = 1 + D^2 + D^3, so a = 0 enters; g1(D) = 1 + D + D^3
        bits += [a2 ^ a3, a1 ^ a3]
        a1, a2, a3 = 0, a1, a2
    return bits


TAIL: NDArray[np.uint8] = np.array([_tail(state) for state in range(STATES)], dtype=np.uint8)
"""Tail bits x, z, x, z, x, z for each final state, shape (8, 6)."""


def encode_mother(bits_nat: NDArray[np.uint8], order: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Encode (..., K) bits with the mother code: d0_0 d1_0 d2_0 d0_1 ..., then the tails (TS 36.212, 5.1.3.2)."""
    k = bits_nat.shape[-1]
    parity_1, tail_1 = encode_constituent(bits_nat)
    parity_2, tail_2 = encode_constituent(bits_nat[..., order])
    coded = np.empty((*bits_nat.shape[:-1], 3 * k + TERMINATION), dtype=np.uint8)
    coded[..., 0 : 3 * k : 3] = bits_nat
    coded[..., 1 : 3 * k : 3] = parity_1
    coded[..., 2 : 3 * k : 3] = parity_2
    # 5.1.3.2.2 spreads the tail over d0, d1, d2 in the order x z x z x z x' z' x' z' x' z'
    coded[..., 3 * k :] = np.concatenate([tail_1, tail_2], axis=-1)
    return coded


def encode_constituent(bits: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Encode (..., K) bits with G(D) = [1, g1(D) / g0(D)]; return parity bits (..., K) and tail bits (..., 6)."""
    register = _divide_by_feedback(bits)
    # z = a + D a + D^3 a, g1(D) = 1 + D + D^3
    parity = register ^ _delay(register, 1) ^ _delay(register, 3)
    return parity, TAIL[4 * register[..., -1] + 2 * register[..., -2] + register[..., -3]]


def _divide_by_feedback(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the register input a = c / g0(D) by vector operations."""
    # 1 + D^7 = g0 (1 + D)(1 + D + D^3), hence 1 / g0 = (1 + D^2 + D^3 + D^4) / (1 + D^7):
    # four taps, then a running modulo-2 sum over every seventh bit
    taps = bits ^ _delay(bits, 2) ^ _delay(bits, 3) ^ _delay(bits, 4)
    k = bits.shape[-1]
    padded = np.zeros((*bits.shape[:-1], -(-k // 7) * 7), dtype=np.uint8)
    padded[..., :k] = taps
    columns = padded.reshape(*bits.shape[:-1], padded.shape[-1] // 7, 7)
    summed: NDArray[np.uint8] = np.bitwise_xor.accumulate(columns, axis=-2)
    return summed.reshape(padded.shape)[..., :k]


def _delay(bits: NDArray[np.uint8], steps: int) -> NDArray[np.uint8]:
    """Delay by some steps; zeros enter."""
    delayed = np.zeros_like(bits)
    delayed[..., steps:] = bits[..., :-steps]
    return delayed


COLUMNS = 32  # columns in the sub-block interleaver (TS 36.212, 5.1.4.1.1)


@lru_cache(maxsize=32)
def selection(stream_length: int, coded_bits: int) -> NDArray[np.int64]:
    """Return the mother codeword position for each sent bit, (coded_bits,), read-only (TS 36.212, 5.1.4.1.2).

    The positions cover sub-block interleavers, circular buffer and bit selection: the encoder gathers sent bits, and
    the decoder adds received LLRs, at these positions.

    Position ``3 t + j`` is bit t in stream j, 0 <= t < D = `stream_length`. Above 3 D bits the buffer repeats.
    """
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
