"""The decoder of many blocks: Numba, 16 of them side by side in the innermost, contiguous axis.

Arrays are tiles, float32 of shape (tiles, rows, 16). The loops over the 16 lanes hold a whole step of the trellis.
Each loop slices its rows itself (else their reference counts cost more than the arithmetic), indexes them with the
lane plus a constant (else LLVM sees gathers), and writes to few arrays (else LLVM gives up proving that they do not
overlap). `single` decodes few blocks and finds the same values; `reference` holds the steps written for reading.

``exact`` is None for max-log and True for log-MAP, as in `steps`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.signal.turbo import steps
from heliograph.signal.turbo.steps import FAST_MATH, IMPOSSIBLE, NORMALISE_EVERY
from heliograph.signal.turbo.tiles import LANES as L
from heliograph.signal.turbo.trellis import STATES, TAIL, TAIL_BITS

_ROW = (STATES + 1) * L
"""Values of a row of working memory: eight forward metrics, then L_u, of 16 lanes."""

_LU = STATES * L
"""Place of L_u in a row."""

_EXTRINSIC = 0
"""Place of the extrinsic LLR in a row, where it overwrites the first metric once that is used."""

_TAIL_IS_ZERO = np.ascontiguousarray(1 - TAIL, dtype=np.float32)
"""(8, 6) 1 where a tail bit of a final state is 0."""

_compile = compiled(error_model="numpy", fastmath=set(FAST_MATH))
_inlined = compiled(error_model="numpy", fastmath=set(FAST_MATH), forceinline=True)


def working_memory(k: int) -> NDArray[np.float32]:
    """Return the working memory that a tile needs.

    Parameters
    ----------
    k : int
        Information bits of each block, K.
    """
    return np.empty((k + 1) * _ROW, dtype=np.float32)


@_inlined
def _metrics(m: Any, i: int) -> Any:
    """Read the eight metrics of a lane."""
    return m[i], m[i + L], m[i + 2 * L], m[i + 3 * L], m[i + 4 * L], m[i + 5 * L], m[i + 6 * L], m[i + 7 * L]


@_inlined
def _write(m: Any, i: int, metrics: Any) -> None:
    """Write the eight metrics of a lane."""
    m[i], m[i + L], m[i + 2 * L], m[i + 3 * L], m[i + 4 * L], m[i + 5 * L], m[i + 6 * L], m[i + 7 * L] = metrics


@_compile
def _normalise(work: Any, first: int) -> None:
    m = work[first : first + STATES * L]
    for i in range(L):
        _write(m, i, steps.normalised(_metrics(m, i)))


@_compile
def _forward_step(mother: Any, passed: Any, work: Any, k: int, to: int, row: int, exact: Any) -> None:
    info, extrinsic, parity = mother[3 * to], passed[to], mother[row]
    w = work[k * _ROW : (k + 2) * _ROW]
    for i in range(L):
        lu = info[i] + extrinsic[i]
        w[i + _LU] = lu
        _write(w, i + _ROW, steps.forward(_metrics(w, i), lu, parity[i], exact))


@_compile
def _backward_step(mother: Any, work: Any, beta: Any, k: int, row: int, exact: Any) -> None:
    w, b, parity = work[k * _ROW : (k + 1) * _ROW], beta[: STATES * L], mother[row]
    for i in range(L):
        lu, lp = w[i + _LU], parity[i]
        after = _metrics(b, i)
        # it takes the place of alpha's first metric, used up
        w[i + _EXTRINSIC] = steps.extrinsic(_metrics(w, i), after, lp, exact)
        _write(b, i, steps.backward(after, lu, lp, exact))


@_compile
def _deliver(work: Any, passed: Any, app: Any, k: int, to: int, scale: Any) -> None:
    """Write a step's a-posteriori and scaled extrinsic LLRs in the natural order."""
    w, posterior, extrinsic = work[k * _ROW : (k + 1) * _ROW], app[to], passed[to]
    for i in range(L):
        posterior[i] = w[i + _LU] + w[i + _EXTRINSIC]
        extrinsic[i] = scale * w[i + _EXTRINSIC]


@_compile
def _parity_step(mother: Any, work: Any, beta: Any, posterior: Any, k: int, row: int, exact: Any) -> None:
    w, b, parity, out = work[k * _ROW : (k + 1) * _ROW], beta[: STATES * L], mother[row], posterior[row]
    for i in range(L):
        out[i] = steps.parity_posterior(_metrics(w, i), _metrics(b, i), w[i + _LU], parity[i], exact)


@_compile
def _forward(mother: Any, passed: Any, work: Any, order: Any, code: int, exact: Any) -> None:
    """Compute all forward metrics, and the LLRs of the information bits in the order of this trellis."""
    work[: STATES * L] = IMPOSSIBLE
    work[:L] = np.float32(0.0)
    for k in range(order.size):
        _forward_step(mother, passed, work, k, order[k], 3 * k + code + 1, exact)
        if k % NORMALISE_EVERY == 0:
            _normalise(work, (k + 1) * _ROW)


@_compile
def _end_metrics(mother: Any, first_tail: int, beta: Any) -> None:
    """Compute the metrics of the final states: each has one path to state 0, so its tail bits' LLRs add up."""
    beta[:] = np.float32(0.0)
    for j in range(TAIL_BITS):
        for s in range(STATES):
            for i in range(L):
                beta[s * L + i] += _TAIL_IS_ZERO[s, j] * mother[first_tail + j, i]


@_compile
def _siso(
    mother: Any, passed: Any, work: Any, beta: Any, app: Any, order: Any, code: int, scale: Any, exact: Any
) -> None:
    """Run one constituent decoder on one tile; `passed` holds scaled extrinsic LLRs before and after."""
    _forward(mother, passed, work, order, code, exact)
    _end_metrics(mother, 3 * order.size + code * TAIL_BITS, beta)
    for k in range(order.size - 1, -1, -1):
        _backward_step(mother, work, beta, k, 3 * k + code + 1, exact)
        _deliver(work, passed, app, k, order[k], scale)
        if k % NORMALISE_EVERY == 0:
            _normalise(beta, 0)


@_compile
def iterate(
    mother: Any, passed: Any, work: Any, app_1: Any, app_2: Any, order: Any, iterations: int, scale: Any, exact: Any
) -> None:
    """Run full iterations on every tile.

    Parameters
    ----------
    mother : float32 (tiles, 3 K + 12, 16)
        Input LLRs, a-priori LLRs already added to the systematic ones.
    passed : float32 (tiles, K, 16)
        Scaled extrinsic LLRs of the second decoder, natural order; changed.
    work : float32 (9 * 16 (K + 1),)
        `working_memory` of K, kept by the caller from call to call, since fresh pages cost as much as an iteration.
    app_1, app_2 : float32 (tiles, K, 16)
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
    straight = np.arange(order.size)
    beta = np.empty(STATES * L, dtype=np.float32)
    for t in range(mother.shape[0]):
        for _ in range(iterations):
            _siso(mother[t], passed[t], work, beta, app_1[t], straight, 0, scale, exact)
            _siso(mother[t], passed[t], work, beta, app_2[t], order, 1, scale, exact)


@_compile
def _tail_posterior(alpha: Any, beta: Any, first_tail: int, out: Any, exact: Any) -> None:
    for j in range(TAIL_BITS):
        for i in range(L):
            zero, one = IMPOSSIBLE, IMPOSSIBLE
            for s in range(STATES):
                metric = alpha[s * L + i] + beta[s * L + i]
                if _TAIL_IS_ZERO[s, j] > 0:
                    zero = steps.add(zero, metric, exact)
                else:
                    one = steps.add(one, metric, exact)
            out[first_tail + j, i] = zero - one


@_compile
def mother_posterior(mother: Any, passed: Any, app: Any, order: Any, scale: Any, out: Any, exact: Any) -> None:
    """Compute a-posteriori LLRs of the whole mother codeword by one more pass of both constituent decoders.

    Parameters
    ----------
    mother : float32 (tiles, 3 K + 12, 16)
        Input LLRs, as for `iterate`.
    passed : float32 (tiles, K, 16)
        Scaled extrinsic LLRs of the second decoder, natural order; changed.
    app : float32 (tiles, K, 16)
        A-posteriori LLRs of the information bits, which become theirs in `out`.
    order : int64 (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    scale : float32
        Factor on extrinsic LLRs, above 0 and at most 1.
    out : float32 (tiles, 3 K + 12, 16)
        Written: a-posteriori LLRs of each mother codeword, in the order of `mother`.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    size = order.size
    straight = np.arange(size)
    work = np.empty((size + 1) * _ROW, dtype=np.float32)
    beta = np.empty(STATES * L, dtype=np.float32)
    unused = np.empty((size, L), dtype=np.float32)
    for t in range(mother.shape[0]):
        for k in range(size):
            out[t, 3 * k] = app[t, k]
        for code in range(2):
            walk = order if code == 1 else straight
            first_tail = 3 * size + code * TAIL_BITS
            _forward(mother[t], passed[t], work, walk, code, exact)
            _end_metrics(mother[t], first_tail, beta)
            _tail_posterior(work[size * _ROW :], beta, first_tail, out[t], exact)
            for k in range(size - 1, -1, -1):
                row = 3 * k + code + 1
                _parity_step(mother[t], work, beta, out[t], k, row, exact)
                _backward_step(mother[t], work, beta, k, row, exact)
                _deliver(work, passed[t], unused, k, walk[k], scale)
                if k % NORMALISE_EVERY == 0:
                    _normalise(beta, 0)
