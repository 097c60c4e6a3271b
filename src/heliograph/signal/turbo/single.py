"""The decoder of few blocks, as receivers have them: Numba, one block after the other.

The metrics go step by step, and stay in registers meanwhile. The LLRs of all steps then do not depend on one another,
and LLVM puts them side by side in vectors. The steps are those of `kernel`, with the same order of additions, so that
both find the same values; `reference` holds them written for reading.

Arrays are those of `kernel` with one lane: float32 of shape (B, rows, 1). Working memory has a row of K values for each
of the places below.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.signal.turbo import steps
from heliograph.signal.turbo.steps import FAST_MATH, IMPOSSIBLE, NORMALISE_EVERY
from heliograph.signal.turbo.trellis import STATES, TAIL, TAIL_BITS

_ALPHA, _BETA = np.int64(0), np.int64(STATES)
"""First of eight rows with the forward metrics before, with the backward metrics after each step. Of plain numbers
Numba would compile a function for each: of these, and of the codes below."""

_INFO, _PARITY, _EXTRINSIC = 2 * STATES, 2 * STATES + 1, 2 * STATES + 2
"""Rows of L_u, L_z and the extrinsic LLR of each step, in the order of the trellis."""

_ROWS = 2 * STATES + 3

_FIRST, _SECOND = np.int64(0), np.int64(1)
"""Constituent codes."""

_PADDING = 16
"""Values between two rows: a cache line, so that rows of K = 1024 do not share the same places of the cache."""

_compile = compiled(error_model="numpy", fastmath=set(FAST_MATH))
_inlined = compiled(error_model="numpy", fastmath=set(FAST_MATH), forceinline=True)


def working_memory(k: int) -> NDArray[np.float32]:
    """Return the working memory that a block needs.

    Parameters
    ----------
    k : int
        Information bits of each block, K.
    """
    return np.empty((_ROWS, k + _PADDING), dtype=np.float32)


@_inlined
def _rows(work: Any, first: int) -> Any:
    """Return eight rows of working memory."""
    return (
        work[first],
        work[first + 1],
        work[first + 2],
        work[first + 3],
        work[first + 4],
        work[first + 5],
        work[first + 6],
        work[first + 7],
    )


@_inlined
def _metrics(rows: Any, k: int) -> Any:
    """Read the metrics of a step."""
    m0, m1, m2, m3, m4, m5, m6, m7 = rows
    return m0[k], m1[k], m2[k], m3[k], m4[k], m5[k], m6[k], m7[k]


@_inlined
def _write(rows: Any, k: int, metrics: Any) -> None:
    """Write the metrics of a step."""
    m0, m1, m2, m3, m4, m5, m6, m7 = rows
    m0[k], m1[k], m2[k], m3[k], m4[k], m5[k], m6[k], m7[k] = metrics


@_compile
def _inputs(mother: Any, passed: Any, work: Any, order: Any, code: int) -> None:
    """Put the LLRs of a constituent code in the order of its trellis."""
    info, parity = work[_INFO], work[_PARITY]
    for k in range(order.size):
        info[k] = mother[3 * order[k]] + passed[order[k]]
        parity[k] = mother[3 * k + code + 1]


@_compile
def _forward(work: Any, size: int, exact: Any) -> Any:
    """Write the metrics before each step; return those after the last."""
    rows, info, parity = _rows(work, _ALPHA), work[_INFO], work[_PARITY]
    no = IMPOSSIBLE
    alpha = (np.float32(0.0), no, no, no, no, no, no, no)
    for k in range(size):
        _write(rows, k, alpha)
        alpha = steps.forward(alpha, info[k], parity[k], exact)
        if k % NORMALISE_EVERY == 0:
            alpha = steps.normalised(alpha)
    return alpha


@_compile
def _backward(work: Any, size: int, end: Any, exact: Any) -> None:
    """Write the metrics after each step, those after the last given."""
    rows, info, parity = _rows(work, _BETA), work[_INFO], work[_PARITY]
    beta = end
    for k in range(size - 1, -1, -1):
        _write(rows, k, beta)
        beta = steps.backward(beta, info[k], parity[k], exact)
        if k % NORMALISE_EVERY == 0:
            beta = steps.normalised(beta)


@_compile
def _end_metrics(tail: Any) -> Any:
    """Compute the metrics of the final states: each has one path to state 0, so its tail bits' LLRs add up."""
    beta = np.zeros(STATES, dtype=np.float32)
    for j in range(TAIL_BITS):
        for s in range(STATES):
            if TAIL[s, j] == 0:
                beta[s] += tail[j]
    return beta[0], beta[1], beta[2], beta[3], beta[4], beta[5], beta[6], beta[7]


@_compile
def _extrinsic(work: Any, size: int, exact: Any) -> None:
    alpha, beta, parity, out = _rows(work, _ALPHA), _rows(work, _BETA), work[_PARITY], work[_EXTRINSIC]
    for k in range(size):
        out[k] = steps.extrinsic(_metrics(alpha, k), _metrics(beta, k), parity[k], exact)


@_compile
def _deliver(work: Any, passed: Any, app: Any, order: Any, scale: Any) -> None:
    """Write the a-posteriori and scaled extrinsic LLRs in the natural order."""
    info, extrinsic = work[_INFO], work[_EXTRINSIC]
    for k in range(order.size):
        app[order[k]] = info[k] + extrinsic[k]
        passed[order[k]] = scale * extrinsic[k]


@_compile
def _siso(mother: Any, passed: Any, work: Any, app: Any, order: Any, code: int, scale: Any, exact: Any) -> Any:
    """Run one constituent decoder on one block; return the metrics of the final states, forward and backward."""
    size = order.size
    first_tail = 3 * size + code * TAIL_BITS
    end = _end_metrics(mother[first_tail : first_tail + TAIL_BITS])
    _inputs(mother, passed, work, order, code)
    final = _forward(work, size, exact)
    _backward(work, size, end, exact)
    _extrinsic(work, size, exact)
    _deliver(work, passed, app, order, scale)
    return final, end


@_compile
def iterate(
    mother: Any, passed: Any, work: Any, app_1: Any, app_2: Any, order: Any, iterations: int, scale: Any, exact: Any
) -> None:
    """Run full iterations on every block.

    Parameters
    ----------
    mother : float32 (B, 3 K + 12, 1)
        Input LLRs, a-priori LLRs already added to the systematic ones.
    passed : float32 (B, K, 1)
        Scaled extrinsic LLRs of the second decoder, natural order; changed.
    work : float32 (19, K + 16)
        Working memory, as `working_memory` gives it.
    app_1, app_2 : float32 (B, K, 1)
        Written: a-posteriori LLRs after each half iteration, natural order. May be one array.
    order : int64 (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    iterations : int
        Full iterations to run, at least 1.
    scale : float32
        Factor on extrinsic LLRs, above 0 and at most 1.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    size = order.size
    straight = np.arange(size)
    for b in range(mother.shape[0]):
        llr, extrinsic = mother[b].reshape(mother.shape[1]), passed[b].reshape(size)
        first, second = app_1[b].reshape(size), app_2[b].reshape(size)
        for _ in range(iterations):
            _siso(llr, extrinsic, work, first, straight, _FIRST, scale, exact)
            _siso(llr, extrinsic, work, second, order, _SECOND, scale, exact)


@_compile
def _parity_posterior(work: Any, out: Any, code: int, size: int, exact: Any) -> None:
    alpha, beta, info, parity = _rows(work, _ALPHA), _rows(work, _BETA), work[_INFO], work[_PARITY]
    posterior = work[_EXTRINSIC]
    for k in range(size):
        posterior[k] = steps.parity_posterior(_metrics(alpha, k), _metrics(beta, k), info[k], parity[k], exact)
    for k in range(size):
        out[3 * k + code + 1] = posterior[k]


@_compile
def _tail_posterior(final: Any, end: Any, out: Any, exact: Any) -> None:
    for j in range(TAIL_BITS):
        zero, one = IMPOSSIBLE, IMPOSSIBLE
        for s in range(STATES):
            metric = final[s] + end[s]
            if TAIL[s, j] == 0:
                zero = steps.add(zero, metric, exact)
            else:
                one = steps.add(one, metric, exact)
        out[j] = zero - one


@_compile
def mother_posterior(mother: Any, passed: Any, app: Any, order: Any, scale: Any, out: Any, exact: Any) -> None:
    """Compute a-posteriori LLRs of the whole mother codeword by one more pass of both constituent decoders.

    Parameters
    ----------
    mother : float32 (B, 3 K + 12, 1)
        Input LLRs, as for `iterate`.
    passed : float32 (B, K, 1)
        Scaled extrinsic LLRs of the second decoder, natural order; changed.
    app : float32 (B, K, 1)
        A-posteriori LLRs of the information bits, which become theirs in `out`.
    order : int64 (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    scale : float32
        Factor on extrinsic LLRs, above 0 and at most 1.
    out : float32 (B, 3 K + 12, 1)
        Written: a-posteriori LLRs of each mother codeword, in the order of `mother`.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    size = order.size
    straight = np.arange(size)
    work = np.empty((_ROWS, size + _PADDING), dtype=np.float32)
    unused = np.empty(size, dtype=np.float32)
    for b in range(mother.shape[0]):
        llr, extrinsic = mother[b].reshape(mother.shape[1]), passed[b].reshape(size)
        posterior = out[b].reshape(mother.shape[1])
        for k in range(size):
            posterior[3 * k] = app[b, k, 0]
        for code in range(2):
            walk = order if code == 1 else straight
            first_tail = 3 * size + code * TAIL_BITS
            final, end = _siso(llr, extrinsic, work, unused, walk, code, scale, exact)
            _tail_posterior(final, end, posterior[first_tail : first_tail + TAIL_BITS], exact)
            _parity_posterior(work, posterior, code, size, exact)
