"""The eight-state trellis of one constituent code: feedback 13, feed-forward 15 (octal).

A state is ``4 a1 + 2 a2 + a3``, where a1 is the newest bit of the shift register. Source: 3GPP TS
36.212, section 5.1.3.2.1, figure 5.1.3-2.
"""

import numpy as np
from numpy.typing import NDArray

STATES = 8
"""States of the shift register, 2^`MEMORY`."""

MEMORY = 3
"""Bits of the shift register (TS 36.212, figure 5.1.3-2), and steps of the trellis termination."""

TAIL_BITS = 2 * MEMORY
"""Coded bits that terminate one constituent code: x and z of each step, in this order."""


def _step(state: int, bit: int) -> tuple[int, int]:
    """Return the next state and the parity bit."""
    a1, a2, a3 = state >> 2, state >> 1 & 1, state & 1
    # g0(D) = 1 + D^2 + D^3: a = c + a2 + a3
    a = bit ^ a2 ^ a3
    # g1(D) = 1 + D + D^3: z = a + a1 + a3
    return 4 * a + 2 * a1 + a2, a ^ a1 ^ a3


def _tail(state: int) -> list[int]:
    """Return the bits x, z, x, z, x, z that lead from `state` to state 0."""
    bits: list[int] = []
    for _ in range(MEMORY):
        # 5.1.3.2.2: the switch to the lower position feeds the register's own feedback, so that a = 0
        x = (state >> 1 & 1) ^ (state & 1)
        state, z = _step(state, x)
        bits += [x, z]
    return bits


_STEPS = np.array([[_step(state, bit) for bit in (0, 1)] for state in range(STATES)])
"""Shape (8, 2, 2): next state and parity bit by state and bit."""

NEXT_STATE: NDArray[np.int64] = _STEPS[..., 0]
"""Shape (8, 2): state after `bit` from `state`."""

PARITY: NDArray[np.int64] = _STEPS[..., 1]
"""Shape (8, 2): parity bit of `bit` from `state`."""

TAIL: NDArray[np.uint8] = np.array([_tail(state) for state in range(STATES)], dtype=np.uint8)
"""Shape (8, 6): tail bits x, z, x, z, x, z of each final state."""
