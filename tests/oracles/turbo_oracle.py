"""Reference turbo decoder in plain double-precision NumPy, all blocks at once.

Tests compare the kernel with this reference, and the reference with exhaustive enumeration for a toy code.
Algorithm: Bahl, Cocke, Jelinek, Raviv, IEEE Trans. Inf. Theory 20 (1974) 284; Robertson, Villebrun, Hoeher, ICC 1995.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.signal.code import Algorithm, Check
from heliograph.signal.turbo import DecoderOptions

G0 = np.array([1, 0, 1, 1])
"""Feedback polynomial 1 + D^2 + D^3 (TS 36.212, section 5.1.3.2.1)."""

G1 = np.array([1, 1, 0, 1])
"""Feed-forward polynomial 1 + D + D^3."""

TAIL_BITS = 6
"""Termination bits per constituent code: three steps with x and z."""


def _step(register: NDArray[np.int64], x: int) -> tuple[NDArray[np.int64], int]:
    """Return the next register (newest bit first) and parity bit z, implemented separately from the package."""
    # g0: a_k = x_k + sum_(i > 0) g0_i a_(k-i);  g1: z_k = sum_i g1_i a_(k-i)
    a = np.array([(x + G0[1:] @ register) % 2, *register])
    return a[:-1], int(G1 @ a) % 2


def _tail(register: NDArray[np.int64]) -> list[int]:
    """Return termination bits x, z, x, z, x, z; each x cancels the feedback."""
    bits: list[int] = []
    while len(bits) < TAIL_BITS:
        x = int(G0[1:] @ register) % 2
        register, z = _step(register, x)
        bits += [x, z]
    return bits


_REGISTERS = np.array(list(np.ndindex(2, 2, 2)))
"""Shape (8, 3): register per state, newest bit first; state 0 is empty."""

STATES = len(_REGISTERS)

_STEPS = [[_step(register, x) for x in (0, 1)] for register in _REGISTERS]

NEXT_STATE = np.array([[int(np.ravel_multi_index(tuple(after), (2, 2, 2))) for after, _ in row] for row in _STEPS])
"""Shape (8, 2): next state per bit."""

PARITY = np.array([[z for _, z in row] for row in _STEPS])
"""Shape (8, 2): parity bit per bit."""

TAIL = np.array([_tail(register) for register in _REGISTERS])
"""Shape (8, 6): tail bits per final state."""

_INTO = np.argsort(NEXT_STATE.ravel(), kind="stable").reshape(STATES, 2)
"""Shape (8, 2): branches 2 state + bit ending in each state."""


class ConstituentLlrs(NamedTuple):
    """A-posteriori LLRs from one constituent code: info (B, K), parity (B, K), tail (B, 6)."""

    info: Floats
    parity: Floats
    tail: Floats


class ReferenceResult(NamedTuple):
    """Results for B blocks: info LLRs (B, K), mother code LLRs (B, 3 K + 12), iterations and stop flags (B,)."""

    llr: Floats
    mother_llr: Floats
    iterations: NDArray[np.int32]
    stopped: NDArray[np.bool_]


def siso(info: Floats, parity: Floats, tail: Floats, algorithm: Algorithm) -> ConstituentLlrs:
    """Decode one constituent code, soft-in soft-out.

    Inputs are LLRs in trellis order: info and parity (B, K), tail (B, 6) as x, z, x, z, x, z. `algorithm` selects how
    paths through a state are added. The a-posteriori LLRs have the same shapes.
    """
    add = np.max if algorithm == "max-log" else np.logaddexp.reduce
    blocks, k = info.shape
    # gamma = ln P(branch) = (1 - u) L_u + (1 - z) L_z + constant; shape (K, B, 8, 2)
    zero_bit = np.array([1.0, 0.0])
    gamma = info.T[:, :, None, None] * zero_bit + parity.T[:, :, None, None] * (1 - PARITY)

    # alpha'(s') = ln sum over s -> s' of exp(alpha(s) + gamma)
    alpha = np.full((k + 1, blocks, STATES), -np.inf)
    alpha[0, :, 0] = 0.0
    for step in range(k):
        branches = (alpha[step][:, :, None] + gamma[step]).reshape(blocks, -1)
        metrics = add(branches[:, _INTO], axis=-1)
        # the largest metric is subtracted to keep sums bounded
        alpha[step + 1] = metrics - metrics.max(axis=-1, keepdims=True)

    # beta(s) = ln sum over s -> s' of exp(gamma + beta'(s')); the tail ends in state 0
    beta = np.empty_like(alpha)
    beta[k] = tail @ (1.0 - TAIL.T)
    for step in reversed(range(k)):
        metrics = add(beta[step + 1][:, NEXT_STATE] + gamma[step], axis=-1)
        beta[step] = metrics - metrics.max(axis=-1, keepdims=True)

    # L(b) = ln sum over branches with b = 0 of alpha gamma beta, less the same with b = 1
    joint = alpha[:-1, :, :, None] + gamma + beta[1:][:, :, NEXT_STATE]
    final = alpha[k] + beta[k]
    return ConstituentLlrs(
        info=(add(joint[..., 0], axis=-1) - add(joint[..., 1], axis=-1)).T,
        parity=(add(joint[:, :, PARITY == 0], axis=-1) - add(joint[:, :, PARITY == 1], axis=-1)).T,
        tail=np.stack([add(final[:, bit == 0], axis=-1) - add(final[:, bit == 1], axis=-1) for bit in TAIL.T], axis=-1),
    )


def decode(
    mother_llr: Floats, order: NDArray[np.int64], options: DecoderOptions, check: Check | None = None
) -> ReferenceResult:
    """Decode mother codewords by exchanging extrinsic LLRs between both constituent decoders.

    LLRs (B, 3 K + 12) follow `encode_mother`; the interleaver is ``x_itl = x_nat[order]``. Parity and tail LLRs come
    from a final pass over the extrinsic LLRs. ``stop="crc"`` requires `check`.
    """
    blocks, k = len(mother_llr), len(order)
    info_nat = mother_llr[:, : 3 * k : 3]
    inputs = [
        (mother_llr[:, 1 : 3 * k : 3], mother_llr[:, 3 * k : 3 * k + TAIL_BITS]),
        (mother_llr[:, 2 : 3 * k : 3], mother_llr[:, 3 * k + TAIL_BITS :]),
    ]
    orders = [np.arange(k), order]
    extrinsic_nat, llr_nat = np.zeros((blocks, k)), np.zeros((blocks, k))

    def decode_half(code: int) -> tuple[ConstituentLlrs, Floats]:
        """Run a constituent decoder; return its LLRs and the information LLRs in natural order."""
        posterior = siso((info_nat + extrinsic_nat)[:, orders[code]], *inputs[code], options.algorithm)
        half_nat = np.empty((blocks, k))
        half_nat[:, orders[code]] = posterior.info
        return posterior, half_nat

    iterations, stopped = np.zeros(blocks, dtype=np.int32), np.zeros(blocks, dtype=np.bool_)
    for _ in range(options.iterations):
        active, halves = ~stopped, []
        for code in (0, 1):
            _, half_nat = decode_half(code)
            extrinsic_nat[active] = (options.factor * (half_nat - info_nat - extrinsic_nat))[active]
            halves.append(half_nat)
        llr_nat[active] = halves[1][active]
        iterations += active
        if options.stop == "agreement":
            stopped |= ((halves[0] < 0) == (halves[1] < 0)).all(axis=-1)
        elif options.stop == "crc" and check is not None:
            stopped |= check((halves[1] < 0).astype(np.uint8))
        if stopped.all():
            break
    # both decoders run again for parity and tail LLRs
    mother = np.empty((blocks, 3 * k + 2 * TAIL_BITS))
    mother[:, : 3 * k : 3] = llr_nat
    for code in (0, 1):
        posterior, half_nat = decode_half(code)
        mother[:, 1 + code : 3 * k : 3] = posterior.parity
        mother[:, 3 * k + code * TAIL_BITS :][:, :TAIL_BITS] = posterior.tail
        extrinsic_nat = options.factor * (half_nat - info_nat - extrinsic_nat)
    return ReferenceResult(llr_nat, mother, iterations, stopped)
