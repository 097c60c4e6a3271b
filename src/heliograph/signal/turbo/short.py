"""The decoder of many blocks in 16 bit: Numba, 32 of them side by side, max-log alone.

Steps and tiles are those of `kernel`, in whole numbers of 1/16 of an LLR. Nothing rounds but the input and the scaled
extrinsic LLRs, and nothing overflows: both are clipped, so a step changes a metric by at most 1400, and those of two
states differ by three such steps, from which each state is reached. `reference.decode_whole` finds the very same
numbers in double precision.

Casts stand wherever two numbers are added: Numba adds in 64 bit, and LLVM turns the sums back only where they are cut.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.signal.turbo.options import FACTOR_BITS, MOST_EXTRINSIC, MOST_INPUT, PER_LLR
from heliograph.signal.turbo.trellis import STATES, TAIL, TAIL_BITS

LANES = L = 32
"""Blocks side by side in a tile: two registers of 256 bit, as the 16 of `kernel`. With 16 lanes it was no faster than
`kernel`, with 64 as fast as with 32."""

IMPOSSIBLE = np.int16(-8500)
"""Metric of an impossible state: below that of any other by more than the three steps until all can be reached."""

_NORMALISE_EVERY = 4
"""Steps of the trellis between two subtractions of the largest metric: the most that the range allows."""

_ROW = (STATES + 1) * L
_LU = STATES * L
_EXTRINSIC = 0
"""Row of working memory and its parts, as those of `kernel`."""

_TAIL_IS_ZERO = np.ascontiguousarray(1 - TAIL, dtype=np.int16)
"""(8, 6) 1 where a tail bit of a final state is 0."""

_HALF = np.int32(1 << FACTOR_BITS - 1)
_PLACES = np.int32(FACTOR_BITS)
_MOST, _LEAST = np.int16(MOST_EXTRINSIC), np.int16(-MOST_EXTRINSIC)

_compile = compiled()
_inlined = compiled(forceinline=True)
_short = np.int16


def working_memory(k: int) -> NDArray[np.int16]:
    """Return the working memory that a tile needs.

    Parameters
    ----------
    k : int
        Information bits of each block, K.
    """
    return np.empty((k + 1) * _ROW, dtype=np.int16)


def quantised(llr: NDArray[np.float32]) -> NDArray[np.int16]:
    """Return LLRs in whole numbers, clipped.

    Parameters
    ----------
    llr : ndarray of float32, shape (tiles, 3 K + 12, 32)
        LLRs of mother codewords.

    Returns
    -------
    ndarray of int16, of the same shape
    """
    return np.clip(np.rint(llr * np.float32(PER_LLR)), -MOST_INPUT, MOST_INPUT).astype(np.int16)


def factor_of(scale: float) -> np.int32:
    """Return a factor on extrinsic LLRs as a whole number of `FACTOR_BITS` binary places.

    Parameters
    ----------
    scale : float
        The factor, above 0 and at most 1.

    Returns
    -------
    int32, 1 to 2^16
    """
    return np.int32(round(scale * 2**FACTOR_BITS))


@_inlined
def _max(a: Any, b: Any) -> Any:
    return a if a > b else b


@_inlined
def _max4(a: Any, b: Any, c: Any, d: Any) -> Any:
    return _max(_max(a, b), _max(c, d))


@_inlined
def _metrics(m: Any, i: int) -> Any:
    """Read the eight metrics of a lane."""
    return m[i], m[i + L], m[i + 2 * L], m[i + 3 * L], m[i + 4 * L], m[i + 5 * L], m[i + 6 * L], m[i + 7 * L]


@_inlined
def _write(m: Any, i: int, metrics: Any) -> None:
    """Write the eight metrics of a lane."""
    m[i], m[i + L], m[i + 2 * L], m[i + 3 * L], m[i + 4 * L], m[i + 5 * L], m[i + 6 * L], m[i + 7 * L] = metrics


@_inlined
def _forward_metrics(alpha: Any, lu: Any, lp: Any) -> Any:
    """The forward metrics a step later, as `steps.forward`."""
    a0, a1, a2, a3, a4, a5, a6, a7 = alpha
    both = _short(lu + lp)
    return (
        _max(_short(a0 + both), a1),
        _max(_short(a2 + lp), _short(a3 + lu)),
        _max(_short(a4 + lu), _short(a5 + lp)),
        _max(a6, _short(a7 + both)),
        _max(a0, _short(a1 + both)),
        _max(_short(a2 + lu), _short(a3 + lp)),
        _max(_short(a4 + lp), _short(a5 + lu)),
        _max(_short(a6 + both), a7),
    )


@_inlined
def _backward_metrics(beta: Any, lu: Any, lp: Any) -> Any:
    """The backward metrics a step earlier, as `steps.backward`."""
    b0, b1, b2, b3, b4, b5, b6, b7 = beta
    both = _short(lu + lp)
    return (
        _max(_short(b0 + both), b4),
        _max(b0, _short(b4 + both)),
        _max(_short(b1 + lp), _short(b5 + lu)),
        _max(_short(b1 + lu), _short(b5 + lp)),
        _max(_short(b2 + lu), _short(b6 + lp)),
        _max(_short(b2 + lp), _short(b6 + lu)),
        _max(b3, _short(b7 + both)),
        _max(_short(b3 + both), b7),
    )


@_inlined
def _extrinsic_llr(alpha: Any, beta: Any, lp: Any) -> Any:
    """The LLR of a step's information bit, its own input left out, as `steps.extrinsic`."""
    a0, a1, a2, a3, a4, a5, a6, a7 = alpha
    b0, b1, b2, b3, b4, b5, b6, b7 = beta
    u0z0 = _max4(_short(a0 + b0), _short(a1 + b4), _short(a6 + b7), _short(a7 + b3))
    u0z1 = _max4(_short(a2 + b5), _short(a3 + b1), _short(a4 + b2), _short(a5 + b6))
    u1z0 = _max4(_short(a2 + b1), _short(a3 + b5), _short(a4 + b6), _short(a5 + b2))
    u1z1 = _max4(_short(a0 + b4), _short(a1 + b0), _short(a6 + b3), _short(a7 + b7))
    return _short(_max(_short(u0z0 + lp), u0z1) - _max(_short(u1z0 + lp), u1z1))


@_compile
def _normalise(work: Any, first: int) -> None:
    m = work[first : first + STATES * L]
    for i in range(L):
        m0, m1, m2, m3, m4, m5, m6, m7 = _metrics(m, i)
        top = _max(_max4(m0, m1, m2, m3), _max4(m4, m5, m6, m7))
        low = (_short(m0 - top), _short(m1 - top), _short(m2 - top), _short(m3 - top))
        _write(m, i, (*low, _short(m4 - top), _short(m5 - top), _short(m6 - top), _short(m7 - top)))


@_compile
def _forward_step(mother: Any, passed: Any, work: Any, k: int, to: int, row: int) -> None:
    info, extrinsic, parity = mother[3 * to], passed[to], mother[row]
    w = work[k * _ROW : (k + 2) * _ROW]
    for i in range(L):
        lu = _short(info[i] + extrinsic[i])
        w[i + _LU] = lu
        _write(w, i + _ROW, _forward_metrics(_metrics(w, i), lu, parity[i]))


@_compile
def _backward_step(mother: Any, work: Any, beta: Any, k: int, row: int) -> None:
    w, b, parity = work[k * _ROW : (k + 1) * _ROW], beta[: STATES * L], mother[row]
    for i in range(L):
        lu, lp = w[i + _LU], parity[i]
        after = _metrics(b, i)
        # it takes the place of alpha's first metric, used up
        w[i + _EXTRINSIC] = _extrinsic_llr(_metrics(w, i), after, lp)
        _write(b, i, _backward_metrics(after, lu, lp))


@_compile
def _deliver(work: Any, passed: Any, app: Any, k: int, to: int, factor: Any) -> None:
    """Write a step's a-posteriori and scaled extrinsic LLRs in the natural order."""
    w, posterior, extrinsic = work[k * _ROW : (k + 1) * _ROW], app[to], passed[to]
    for i in range(L):
        found = w[i + _EXTRINSIC]
        posterior[i] = _short(w[i + _LU] + found)
        # rounded: cut off, the LLRs would all be half a unit too low, and 2 % more blocks wrong
        scaled = _short((np.int32(found) * factor + _HALF) >> _PLACES)
        extrinsic[i] = max(min(scaled, _MOST), _LEAST)


@_compile
def _siso(mother: Any, passed: Any, work: Any, beta: Any, app: Any, order: Any, code: int, factor: Any) -> None:
    """Run one constituent decoder on one tile; `passed` holds scaled extrinsic LLRs before and after."""
    size, first_tail = order.size, 3 * order.size + code * TAIL_BITS
    work[: STATES * L] = IMPOSSIBLE
    work[:L] = 0
    for k in range(size):
        _forward_step(mother, passed, work, k, order[k], 3 * k + code + 1)
        if k % _NORMALISE_EVERY == 0:
            _normalise(work, (k + 1) * _ROW)
    # each final state has one path to state 0, so its tail bits' LLRs add up
    beta[:] = 0
    for j in range(TAIL_BITS):
        for s in range(STATES):
            for i in range(L):
                beta[s * L + i] += _TAIL_IS_ZERO[s, j] * mother[first_tail + j, i]
    _normalise(beta, 0)
    for k in range(size - 1, -1, -1):
        _backward_step(mother, work, beta, k, 3 * k + code + 1)
        _deliver(work, passed, app, k, order[k], factor)
        if k % _NORMALISE_EVERY == 0:
            _normalise(beta, 0)


@_compile
def iterate(
    mother: Any, passed: Any, work: Any, app_1: Any, app_2: Any, order: Any, iterations: int, factor: Any, _: Any
) -> None:
    """Run full iterations on every tile.

    Parameters
    ----------
    mother : int16 (tiles, 3 K + 12, 32)
        Input LLRs, a-priori LLRs already added to the systematic ones, as `quantised` gives them.
    passed : int16 (tiles, K, 32)
        Scaled extrinsic LLRs of the second decoder, natural order; changed.
    work : int16 (9 * 32 (K + 1),)
        Working memory, as `working_memory` gives it; kept by the caller from call to call.
    app_1, app_2 : int16 (tiles, K, 32)
        Written: a-posteriori LLRs after each half iteration, natural order. May be one array.
    order : int64 (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    iterations : int
        Full iterations to run, at least 1.
    factor : int32
        Factor on extrinsic LLRs, of `factor_of`.
    _ : None
        For max-log, as with `kernel`.
    """
    straight = np.arange(order.size)
    beta = np.empty(STATES * L, dtype=np.int16)
    for t in range(mother.shape[0]):
        for _number in range(iterations):
            _siso(mother[t], passed[t], work, beta, app_1[t], straight, 0, factor)
            _siso(mother[t], passed[t], work, beta, app_2[t], order, 1, factor)
