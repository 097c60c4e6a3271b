"""The turbo encoder: two recursive systematic convolutional codes and the termination.

Source: 3GPP TS 36.212, section 5.1.3.2.
"""

import numpy as np
from numpy.typing import NDArray

MEMORY = 3
"""Bits of the shift register (TS 36.212, figure 5.1.3-2), and steps of the trellis termination."""

STATES = 2**MEMORY
"""States of the trellis: ``4 a1 + 2 a2 + a3``, where a1 is the newest bit of the shift register."""

TAIL_BITS = 2 * MEMORY
"""Coded bits that terminate a constituent code: x and z of each step, in this order."""

TERMINATION = 2 * TAIL_BITS
"""Coded bits that end a block, 12: the tails of both constituent codes (TS 36.212, 5.1.3.2.2)."""

_PERIOD = 7
"""Period of 1 / g0(D): g0 = 1 + D^2 + D^3 is primitive of degree 3, so it divides 1 + D^7."""


def _tail(state: int) -> list[int]:
    """Return the bits x, z, x, z, x, z that lead from a state to state 0."""
    a1, a2, a3 = state >> 2, state >> 1 & 1, state & 1
    bits: list[int] = []
    for _ in range(MEMORY):
        # 5.1.3.2.2: x is the feedback, g0(D) = 1 + D^2 + D^3, so that a = 0 enters; g1(D) = 1 + D + D^3
        bits += [a2 ^ a3, a1 ^ a3]
        a1, a2, a3 = 0, a1, a2
    return bits


TAIL: NDArray[np.uint8] = np.array([_tail(state) for state in range(STATES)], dtype=np.uint8)
"""Shape (8, 6): tail bits x, z, x, z, x, z of each final state."""


def encode_mother(bits_nat: NDArray[np.uint8], order: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Encode blocks with the rate 1/3 mother code (TS 36.212, 5.1.3.2.1 and 5.1.3.2.2).

    Parameters
    ----------
    bits_nat : ndarray of uint8, shape (..., K)
        Information bits, 0 or 1.
    order : ndarray of int, shape (K,)
        Interleaver, ``bits_itl = bits_nat[order]``; any permutation.

    Returns
    -------
    ndarray of uint8, shape (..., 3 K + 12)
        ``d0_0 d1_0 d2_0 d0_1 ...``: systematic, first and second parity bit of each step, then the tails.
    """
    k = bits_nat.shape[-1]
    parity_1, tail_1 = encode_constituent(bits_nat)
    parity_2, tail_2 = encode_constituent(bits_nat[..., order])
    coded = np.empty((*bits_nat.shape[:-1], 3 * k + TERMINATION), dtype=np.uint8)
    coded[..., 0 : 3 * k : 3] = bits_nat
    coded[..., 1 : 3 * k : 3] = parity_1
    coded[..., 2 : 3 * k : 3] = parity_2
    # 5.1.3.2.2 spreads the tail over d0, d1, d2, so that the order is x z x z x z x' z' x' z' x' z'
    coded[..., 3 * k :] = np.concatenate([tail_1, tail_2], axis=-1)
    return coded


def encode_constituent(bits: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Encode blocks with a constituent code, G(D) = [1, g1(D) / g0(D)].

    Parameters
    ----------
    bits : ndarray of uint8, shape (..., K)
        Information bits, 0 or 1, in the order of this trellis.

    Returns
    -------
    parity : ndarray of uint8, shape (..., K)
        Parity bit z of each step.
    tail : ndarray of uint8, shape (..., 6)
        Termination bits x, z, x, z, x, z.
    """
    register = _divide_by_feedback(bits)
    # z = a + D a + D^3 a, g1(D) = 1 + D + D^3
    parity = register ^ _delay(register, 1) ^ _delay(register, 3)
    a1, a2, a3 = (register[..., -delay] for delay in range(1, MEMORY + 1))
    state = (4 * a1 + 2 * a2 + a3) % STATES
    return parity, TAIL[state]


def _divide_by_feedback(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the register's input a = c / g0(D) by vector operations."""
    # 1 + D^7 = g0 (1 + D)(1 + D + D^3), hence 1 / g0 = (1 + D^2 + D^3 + D^4) / (1 + D^7):
    # four taps, then a running sum modulo 2 over every seventh bit
    taps = bits ^ _delay(bits, 2) ^ _delay(bits, 3) ^ _delay(bits, 4)
    k = bits.shape[-1]
    padded = np.zeros((*bits.shape[:-1], -(-k // _PERIOD) * _PERIOD), dtype=np.uint8)
    padded[..., :k] = taps
    columns = padded.reshape(*bits.shape[:-1], padded.shape[-1] // _PERIOD, _PERIOD)
    summed: NDArray[np.uint8] = np.bitwise_xor.accumulate(columns, axis=-2)
    return summed.reshape(padded.shape)[..., :k]


def _delay(bits: NDArray[np.uint8], steps: int) -> NDArray[np.uint8]:
    """Shift towards later bits; zeros enter."""
    delayed = np.zeros_like(bits)
    delayed[..., steps:] = bits[..., :-steps]
    return delayed
