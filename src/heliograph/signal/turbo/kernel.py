"""The decoder written for speed: Numba, 16 blocks side by side in the innermost, contiguous axis.

Arrays are tiles, float32 of shape (tiles, rows, 16). The loops over the 16 lanes hold the whole unrolled
trellis. Each loop slices its rows itself (else their reference counts cost more than the arithmetic), indexes
them with the lane plus a constant (else LLVM sees gathers), and writes to few arrays (else LLVM gives up
proving that they do not overlap). `reference` holds the same steps, written for reading.

In these loops ``exact`` is None for max-log and True for log-MAP; Numba compiles one version for each and
drops the branch not taken.
"""

from typing import Any

import numpy as np

from heliograph.base.compiled import compiled
from heliograph.signal.turbo.tiles import LANES as L
from heliograph.signal.turbo.trellis import STATES, TAIL, TAIL_BITS

_ROW = (STATES + 1) * L
"""Values of a row of working memory: eight forward metrics, then L_u, of 16 lanes."""

_LU = STATES * L
"""Place of L_u in a row."""

_EXTRINSIC = 0
"""Place of the extrinsic LLR in a row, where it overwrites the first metric once that is used."""

_NORMALISE_EVERY = 8
"""Steps of the trellis between two subtractions of the largest metric, which keep the metrics small in float32. Chosen:
the largest error of an LLR of max-log against `reference` (64 blocks of K = 1024 at 1 dB, 8 iterations) is 5e-5; at 4
steps 3e-5, at 16 steps 1e-4, without any 5e-3. Their speeds differ by less than the noise of measuring them."""

_IMPOSSIBLE = np.float32(-1e30)
"""Metric of an impossible state: below any sum of LLRs, and finite, so that no difference is NaN."""

_TAIL_IS_ZERO = np.ascontiguousarray(1 - TAIL, dtype=np.float32)
"""(8, 6) 1 where a tail bit of a final state is 0."""

# "contract" alone: additions keep their order, so a block's result does not depend on its lane
_compile = compiled(error_model="numpy", fastmath={"contract", "nsz"})

# ln(1 + exp(-x)) = q(x)^4 on 0 <= x <= 8 within 2.7e-3, q = _Q0 + _Q1 x + _Q2 x^2 fitted by minimax; the fourth root
# keeps the polynomial short, as it falls only to exp(-2) at x = 8. At 5e-5, with a polynomial of the fifth degree, as
# many blocks are wrong, and log-MAP takes 1.8 times as long as max-log, now 1.4 times
_LARGEST_X = np.float32(8.0)
"""End of the fit of q. Beyond, the correction keeps its value there, 2e-5."""

_Q0, _Q1, _Q2 = np.float32(0.91332227), np.float32(-0.17360270), np.float32(0.0084177786)
"""Coefficients of q."""


def work_size(k: int) -> int:
    """Return the number of float32 values of working memory that a tile needs.

    Parameters
    ----------
    k : int
        Information bits of each block, K.
    """
    return (k + 1) * _ROW


@_compile
def _add(a: Any, b: Any, exact: Any) -> Any:
    """Return ln(exp a + exp b), or for max-log the larger."""
    larger = a if a > b else b
    if exact is None:
        return larger
    # max*(a, b) = max(a, b) + ln(1 + exp(-|a - b|))
    x = abs(a - b)
    x = x if x < _LARGEST_X else _LARGEST_X
    q = (_Q2 * x + _Q1) * x + _Q0
    q = q * q
    return larger + q * q


@_compile
def _add4(a: Any, b: Any, c: Any, d: Any, exact: Any) -> Any:
    return _add(_add(a, b, exact), _add(c, d, exact), exact)


@_compile
def _normalise(work: Any, first: int) -> None:
    """Subtract the largest of eight metrics, as only differences matter."""
    m = work[first : first + STATES * L]
    for i in range(L):
        top = m[i]
        for s in range(1, STATES):
            value = m[i + s * L]
            top = value if value > top else top
        for s in range(STATES):
            m[i + s * L] -= top


@_compile
def _forward_step(mother: Any, passed: Any, work: Any, k: int, to: int, row: int, exact: Any) -> None:
    # alpha'(s') = ln sum over s -> s' of exp(alpha(s) + gamma); gamma = (1 - u) L_u + (1 - z) L_z
    info, extrinsic, parity = mother[3 * to], passed[to], mother[row]
    w = work[k * _ROW : (k + 2) * _ROW]
    for i in range(L):
        lu, lp = info[i] + extrinsic[i], parity[i]
        both = lu + lp
        a0, a1, a2, a3 = w[i], w[i + L], w[i + 2 * L], w[i + 3 * L]
        a4, a5, a6, a7 = w[i + 4 * L], w[i + 5 * L], w[i + 6 * L], w[i + 7 * L]
        w[i + _LU] = lu
        w[i + _ROW] = _add(a0 + both, a1, exact)
        w[i + _ROW + L] = _add(a2 + lp, a3 + lu, exact)
        w[i + _ROW + 2 * L] = _add(a4 + lu, a5 + lp, exact)
        w[i + _ROW + 3 * L] = _add(a6, a7 + both, exact)
        w[i + _ROW + 4 * L] = _add(a0, a1 + both, exact)
        w[i + _ROW + 5 * L] = _add(a2 + lu, a3 + lp, exact)
        w[i + _ROW + 6 * L] = _add(a4 + lp, a5 + lu, exact)
        w[i + _ROW + 7 * L] = _add(a6 + both, a7, exact)


@_compile
def _backward_step(mother: Any, work: Any, beta: Any, k: int, row: int, exact: Any) -> None:
    # beta(s) = ln sum over s -> s' of exp(gamma + beta'(s')), in place
    w, b, parity = work[k * _ROW : (k + 1) * _ROW], beta[: STATES * L], mother[row]
    for i in range(L):
        lu, lp = w[i + _LU], parity[i]
        both = lu + lp
        a0, a1, a2, a3 = w[i], w[i + L], w[i + 2 * L], w[i + 3 * L]
        a4, a5, a6, a7 = w[i + 4 * L], w[i + 5 * L], w[i + 6 * L], w[i + 7 * L]
        b0, b1, b2, b3 = b[i], b[i + L], b[i + 2 * L], b[i + 3 * L]
        b4, b5, b6, b7 = b[i + 4 * L], b[i + 5 * L], b[i + 6 * L], b[i + 7 * L]
        u0z0 = _add4(a0 + b0, a1 + b4, a6 + b7, a7 + b3, exact)
        u0z1 = _add4(a2 + b5, a3 + b1, a4 + b2, a5 + b6, exact)
        u1z0 = _add4(a2 + b1, a3 + b5, a4 + b6, a5 + b2, exact)
        u1z1 = _add4(a0 + b4, a1 + b0, a6 + b3, a7 + b7, exact)
        # L_e(u) = ln sum over u = 0 less the same over u = 1; it takes the place of alpha's first metric, used up
        w[i + _EXTRINSIC] = _add(u0z0 + lp, u0z1, exact) - _add(u1z0 + lp, u1z1, exact)
        b[i] = _add(b0 + both, b4, exact)
        b[i + L] = _add(b0, b4 + both, exact)
        b[i + 2 * L] = _add(b1 + lp, b5 + lu, exact)
        b[i + 3 * L] = _add(b1 + lu, b5 + lp, exact)
        b[i + 4 * L] = _add(b2 + lu, b6 + lp, exact)
        b[i + 5 * L] = _add(b2 + lp, b6 + lu, exact)
        b[i + 6 * L] = _add(b3, b7 + both, exact)
        b[i + 7 * L] = _add(b3 + both, b7, exact)


@_compile
def _deliver(work: Any, passed: Any, app: Any, k: int, to: int, scale: Any) -> None:
    """Write a step's a-posteriori and scaled extrinsic LLRs in the natural order."""
    w, posterior, extrinsic = work[k * _ROW : (k + 1) * _ROW], app[to], passed[to]
    for i in range(L):
        posterior[i] = w[i + _LU] + w[i + _EXTRINSIC]
        extrinsic[i] = scale * w[i + _EXTRINSIC]


@_compile
def _parity_step(mother: Any, work: Any, beta: Any, posterior: Any, k: int, row: int, exact: Any) -> None:
    # L(z) = L_z + ln sum over z = 0 less the same over z = 1
    w, b, parity, out = work[k * _ROW : (k + 1) * _ROW], beta[: STATES * L], mother[row], posterior[row]
    for i in range(L):
        lu = w[i + _LU]
        a0, a1, a2, a3 = w[i], w[i + L], w[i + 2 * L], w[i + 3 * L]
        a4, a5, a6, a7 = w[i + 4 * L], w[i + 5 * L], w[i + 6 * L], w[i + 7 * L]
        b0, b1, b2, b3 = b[i], b[i + L], b[i + 2 * L], b[i + 3 * L]
        b4, b5, b6, b7 = b[i + 4 * L], b[i + 5 * L], b[i + 6 * L], b[i + 7 * L]
        u0z0 = _add4(a0 + b0, a1 + b4, a6 + b7, a7 + b3, exact)
        u0z1 = _add4(a2 + b5, a3 + b1, a4 + b2, a5 + b6, exact)
        u1z0 = _add4(a2 + b1, a3 + b5, a4 + b6, a5 + b2, exact)
        u1z1 = _add4(a0 + b4, a1 + b0, a6 + b3, a7 + b7, exact)
        out[i] = parity[i] + _add(u0z0 + lu, u1z0, exact) - _add(u0z1 + lu, u1z1, exact)


@_compile
def _forward(mother: Any, passed: Any, work: Any, order: Any, code: int, exact: Any) -> None:
    """Compute all forward metrics, and the LLRs of the information bits in the order of this trellis."""
    work[: STATES * L] = _IMPOSSIBLE
    work[:L] = np.float32(0.0)
    for k in range(order.size):
        _forward_step(mother, passed, work, k, order[k], 3 * k + code + 1, exact)
        if k % _NORMALISE_EVERY == 0:
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
        if k % _NORMALISE_EVERY == 0:
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
    work : float32 (work_size(K),)
        Working memory, kept by the caller from call to call, since fresh pages cost as much as an iteration.
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
            zero, one = _IMPOSSIBLE, _IMPOSSIBLE
            for s in range(STATES):
                metric = alpha[s * L + i] + beta[s * L + i]
                if _TAIL_IS_ZERO[s, j] > 0:
                    zero = _add(zero, metric, exact)
                else:
                    one = _add(one, metric, exact)
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
                if k % _NORMALISE_EVERY == 0:
                    _normalise(beta, 0)
