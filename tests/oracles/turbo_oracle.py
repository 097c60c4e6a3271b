"""The turbo decoder written for reading: plain NumPy in double precision, all blocks at once.

Tests compare the kernel with it, and it with the enumeration of all codewords of a toy code. Source of the algorithm:
Bahl, Cocke, Jelinek, Raviv, IEEE Trans. Inf. Theory 20 (1974) 284; Robertson, Villebrun, Hoeher, ICC 1995.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.signal.code import Algorithm, Check
from heliograph.signal.turbo import DecoderOptions

G0 = np.array([1, 0, 1, 1])
"""Feedback of the constituent code, 1 + D^2 + D^3 (TS 36.212, section 5.1.3.2.1)."""

G1 = np.array([1, 1, 0, 1])
"""Feed-forward, 1 + D + D^3."""

TAIL_BITS = 6
"""Coded bits that terminate one constituent code: three steps of x and z."""


def _step(register: NDArray[np.int64], x: int) -> tuple[NDArray[np.int64], int]:
    """Return the register after the bit x, the newest first, and the parity bit z, independently of the package."""
    # g0: a_k = x_k + sum_(i > 0) g0_i a_(k-i);  g1: z_k = sum_i g1_i a_(k-i)
    a = np.array([(x + G0[1:] @ register) % 2, *register])
    return a[:-1], int(G1 @ a) % 2


def _tail(register: NDArray[np.int64]) -> list[int]:
    """Return the bits x, z, x, z, x, z that lead to the register 0, 0, 0: each x cancels the feedback."""
    bits: list[int] = []
    while len(bits) < TAIL_BITS:
        x = int(G0[1:] @ register) % 2
        register, z = _step(register, x)
        bits += [x, z]
    return bits


_REGISTERS = np.array(list(np.ndindex(2, 2, 2)))
"""Shape (8, 3): the register in each state, the newest bit first; state 0 is the empty one."""

STATES = len(_REGISTERS)

_STEPS = [[_step(register, x) for x in (0, 1)] for register in _REGISTERS]

NEXT_STATE = np.array([[int(np.ravel_multi_index(tuple(after), (2, 2, 2))) for after, _ in row] for row in _STEPS])
"""Shape (8, 2): state after each bit."""

PARITY = np.array([[z for _, z in row] for row in _STEPS])
"""Shape (8, 2): parity bit of each bit."""

TAIL = np.array([_tail(register) for register in _REGISTERS])
"""Shape (8, 6): tail bits of each final state."""

_INTO = np.argsort(NEXT_STATE.ravel(), kind="stable").reshape(STATES, 2)
"""Shape (8, 2): the two branches, by the flat index 2 state + bit, that end in each state."""


class ConstituentLlrs(NamedTuple):
    """A-posteriori LLRs of one constituent code.

    Attributes
    ----------
    info : ndarray of float64, shape (B, K)
        Of the information bits, in the order of this trellis.
    parity : ndarray of float64, shape (B, K)
        Of the parity bits.
    tail : ndarray of float64, shape (B, 6)
        Of the termination x, z, x, z, x, z.
    """

    info: Floats
    parity: Floats
    tail: Floats


class ReferenceResult(NamedTuple):
    """Results of B blocks.

    Attributes
    ----------
    llr : ndarray of float64, shape (B, K)
        A-posteriori LLRs of the information bits.
    mother_llr : ndarray of float64, shape (B, 3 K + 12)
        A-posteriori LLRs of the mother codeword.
    iterations : ndarray of int32, shape (B,)
        Full iterations that each block took, at least 1.
    stopped : ndarray of bool, shape (B,)
        Whether the stopping rule was met.
    """

    llr: Floats
    mother_llr: Floats
    iterations: NDArray[np.int32]
    stopped: NDArray[np.bool_]


def siso(info: Floats, parity: Floats, tail: Floats, algorithm: Algorithm) -> ConstituentLlrs:
    """Decode one constituent code, soft-in soft-out.

    Parameters
    ----------
    info : ndarray of float64, shape (B, K)
        Channel and a-priori LLRs of the information bits, in the order of this trellis.
    parity : ndarray of float64, shape (B, K)
        LLRs of the parity bits.
    tail : ndarray of float64, shape (B, 6)
        LLRs of the termination x, z, x, z, x, z.
    algorithm : {"max-log", "log-map"}
        How the paths through a state are added.

    Returns
    -------
    ConstituentLlrs
        LLRs of every bit given all inputs, of the inputs' shapes.
    """
    add = np.max if algorithm == "max-log" else np.logaddexp.reduce
    blocks, k = info.shape
    # gamma = ln P(branch) = (1 - u) L_u + (1 - z) L_z, up to a constant; shape (K, B, 8, 2)
    zero_bit = np.array([1.0, 0.0])
    gamma = info.T[:, :, None, None] * zero_bit + parity.T[:, :, None, None] * (1 - PARITY)

    # alpha'(s') = ln sum over s -> s' of exp(alpha(s) + gamma)
    alpha = np.full((k + 1, blocks, STATES), -np.inf)
    alpha[0, :, 0] = 0.0
    for step in range(k):
        branches = (alpha[step][:, :, None] + gamma[step]).reshape(blocks, -1)
        alpha[step + 1] = _centred(add(branches[:, _INTO], axis=-1))

    # beta(s) = ln sum over s -> s' of exp(gamma + beta'(s')); the tail ends in state 0
    beta = np.empty_like(alpha)
    beta[k] = tail @ (1.0 - TAIL.T)
    for step in reversed(range(k)):
        beta[step] = _centred(add(beta[step + 1][:, NEXT_STATE] + gamma[step], axis=-1))

    # L(b) = ln sum over branches with b = 0 of alpha gamma beta, less the same with b = 1
    joint = alpha[:-1, :, :, None] + gamma + beta[1:][:, :, NEXT_STATE]
    final = alpha[k] + beta[k]
    return ConstituentLlrs(
        info=(add(joint[..., 0], axis=-1) - add(joint[..., 1], axis=-1)).T,
        parity=(add(joint[:, :, PARITY == 0], axis=-1) - add(joint[:, :, PARITY == 1], axis=-1)).T,
        tail=np.stack([add(final[:, bit == 0], axis=-1) - add(final[:, bit == 1], axis=-1) for bit in TAIL.T], axis=-1),
    )


def _centred(metrics: Floats) -> Floats:
    """Subtract the largest metric: only differences matter, and the sums stay small."""
    centred: Floats = metrics - np.max(metrics, axis=-1, keepdims=True)
    return centred


def decode(
    mother_llr: Floats,
    order: NDArray[np.int64],
    options: DecoderOptions,
    check: Check | None = None,
) -> ReferenceResult:
    """Decode mother codewords by passing extrinsic LLRs between the two constituent decoders.

    Parameters
    ----------
    mother_llr : ndarray of float64, shape (B, 3 K + 12)
        LLRs in the order of `encode_mother`.
    order : ndarray of int, shape (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    options : DecoderOptions
        Algorithm, iterations, scale, stopping rule.
    check : callable, optional
        The check of ``stop="crc"``.

    Returns
    -------
    ReferenceResult
        The parity and tail LLRs come from one more pass of both decoders over the final extrinsic LLRs.
    """
    blocks, k = len(mother_llr), len(order)
    info_nat = mother_llr[:, : 3 * k : 3]
    inputs = [
        (mother_llr[:, 1 : 3 * k : 3], mother_llr[:, 3 * k : 3 * k + TAIL_BITS]),
        (mother_llr[:, 2 : 3 * k : 3], mother_llr[:, 3 * k + TAIL_BITS :]),
    ]
    orders = [np.arange(k), order]
    extrinsic_nat = np.zeros((blocks, k))
    llr_nat = np.zeros((blocks, k))
    iterations = np.zeros(blocks, dtype=np.int32)
    stopped = np.zeros(blocks, dtype=np.bool_)
    for _ in range(options.iterations):
        active = ~stopped
        halves = []
        for half_order, (parity, tail) in zip(orders, inputs, strict=True):
            lu_nat = info_nat + extrinsic_nat
            posterior = siso(lu_nat[:, half_order], parity, tail, options.algorithm)
            half_nat = np.empty_like(lu_nat)
            half_nat[:, half_order] = posterior.info
            extrinsic_nat[active] = (options.factor * (half_nat - lu_nat))[active]
            halves.append(half_nat)
        llr_nat[active] = halves[1][active]
        iterations += active
        stopped |= _may_stop(halves, options, check)
        if stopped.all():
            break
    mother = _mother_posterior(llr_nat, extrinsic_nat, info_nat, inputs, orders, options)
    return ReferenceResult(llr_nat, mother, iterations, stopped)


def _may_stop(halves: list[Floats], options: DecoderOptions, check: Check | None) -> NDArray[np.bool_]:
    decisions = [half < 0 for half in halves]
    if options.stop == "agreement":
        agree: NDArray[np.bool_] = (decisions[0] == decisions[1]).all(axis=-1)
        return agree
    if options.stop == "crc" and check is not None:
        return check(decisions[1].astype(np.uint8))
    return np.zeros(len(halves[0]), dtype=np.bool_)


def _mother_posterior(
    llr_nat: Floats,
    extrinsic_nat: Floats,
    info_nat: Floats,
    inputs: list[tuple[Floats, Floats]],
    orders: list[NDArray[np.int64]],
    options: DecoderOptions,
) -> Floats:
    """Run both decoders once more, for the LLRs of the parity and tail bits."""
    k = llr_nat.shape[-1]
    mother = np.empty((len(llr_nat), 3 * k + 2 * TAIL_BITS))
    mother[:, : 3 * k : 3] = llr_nat
    for code, (order, (parity, tail)) in enumerate(zip(orders, inputs, strict=True)):
        lu_nat = info_nat + extrinsic_nat
        posterior = siso(lu_nat[:, order], parity, tail, options.algorithm)
        mother[:, 1 + code : 3 * k : 3] = posterior.parity
        mother[:, 3 * k + code * TAIL_BITS :][:, :TAIL_BITS] = posterior.tail
        extrinsic_nat = np.empty_like(lu_nat)
        extrinsic_nat[:, order] = options.factor * (posterior.info - lu_nat[:, order])
    return mother
