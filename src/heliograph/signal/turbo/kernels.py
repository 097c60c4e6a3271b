"""Numba kernel for max-log and log-MAP decoding of the constituent codes, block by block.

A tuple with eight metrics per step stays in registers during the recursions. The LLRs for all steps follow in a second
loop with independent iterations, which LLVM vectorises.

``u`` is the information bit in a step and ``z`` the parity bit, with the LLRs ``lu`` and ``lp``. ``exact`` is True for
log-MAP and None for max-log: Numba compiles a version for each and drops the unused branch. Arrays are float32.
`tests/oracles/turbo_oracle.py` contains a readable reference implementation.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.signal.turbo.encoder import STATES, TAIL, TAIL_BITS

IMPOSSIBLE = np.float32(-1e30)
"""Metric for an impossible state: below any sum of LLRs, and finite, so that no difference is NaN."""

_ALPHA, _BETA = np.int64(0), np.int64(STATES)
"""First of eight working memory rows: forward metrics before each step, backward metrics after each step. The type is
int64 because Numba would compile a version for each integer literal."""

_INFO, _PARITY, _EXTRINSIC = 2 * STATES, 2 * STATES + 1, 2 * STATES + 2
"""Working memory rows for L_u, L_z and the extrinsic LLR in each step, in trellis order."""

# "contract" and "nsz" preserve the addition order
_compile = compiled(fastmath={"contract", "nsz"})
_inlined = compiled(fastmath={"contract", "nsz"}, forceinline=True)


def allocate(k: int) -> NDArray[np.float32]:
    """Allocate working memory for blocks with K bits."""
    # a cache line of padding maps rows with K = 1024 to different cache sets
    return np.empty((2 * STATES + 3, k + 16), dtype=np.float32)


@_inlined
def add(a: Any, b: Any, exact: Any) -> Any:
    """Combine the metrics of two merging paths: ln(exp a + exp b), or the maximum for max-log."""
    larger = a if a > b else b
    if exact is None:
        return larger
    # max*(a, b) = max(a, b) + ln(1 + exp(-|a - b|)); ln(1 + exp(-x)) = max(0, q(x))^2 within 0.032, a minimax fit
    q = np.float32(0.81323412) - np.float32(0.22587585) * abs(a - b)
    q = q if q > np.float32(0.0) else np.float32(0.0)
    return larger + q * q


@_inlined
def _add4(a: Any, b: Any, c: Any, d: Any, exact: Any) -> Any:
    return add(add(a, b, exact), add(c, d, exact), exact)


@_inlined
def _normalise(metrics: Any) -> Any:
    """Subtract the largest of eight metrics, as only differences matter."""
    m0, m1, m2, m3, m4, m5, m6, m7 = metrics
    top = add(_add4(m0, m1, m2, m3, None), _add4(m4, m5, m6, m7, None), None)
    return m0 - top, m1 - top, m2 - top, m3 - top, m4 - top, m5 - top, m6 - top, m7 - top


@_inlined
def _step_forward(alpha: Any, lu: Any, lp: Any, exact: Any) -> Any:
    # alpha'(s') = ln sum over s -> s' of exp(alpha(s) + gamma); gamma = (1 - u) L_u + (1 - z) L_z
    a0, a1, a2, a3, a4, a5, a6, a7 = alpha
    both = lu + lp
    return (
        add(a0 + both, a1, exact),
        add(a2 + lp, a3 + lu, exact),
        add(a4 + lu, a5 + lp, exact),
        add(a6, a7 + both, exact),
        add(a0, a1 + both, exact),
        add(a2 + lu, a3 + lp, exact),
        add(a4 + lp, a5 + lu, exact),
        add(a6 + both, a7, exact),
    )


@_inlined
def _step_backward(beta: Any, lu: Any, lp: Any, exact: Any) -> Any:
    # beta(s) = ln sum over s -> s' of exp(gamma + beta'(s'))
    b0, b1, b2, b3, b4, b5, b6, b7 = beta
    both = lu + lp
    return (
        add(b0 + both, b4, exact),
        add(b0, b4 + both, exact),
        add(b1 + lp, b5 + lu, exact),
        add(b1 + lu, b5 + lp, exact),
        add(b2 + lu, b6 + lp, exact),
        add(b2 + lp, b6 + lu, exact),
        add(b3, b7 + both, exact),
        add(b3 + both, b7, exact),
    )


@_inlined
def _sum_branches(alpha: Any, beta: Any, exact: Any) -> Any:
    """Return ln sum exp(alpha(s) + beta'(s')) over the branches for each bit pair u z = 00, 01, 10, 11."""
    a0, a1, a2, a3, a4, a5, a6, a7 = alpha
    b0, b1, b2, b3, b4, b5, b6, b7 = beta
    return (
        _add4(a0 + b0, a1 + b4, a6 + b7, a7 + b3, exact),
        _add4(a2 + b5, a3 + b1, a4 + b2, a5 + b6, exact),
        _add4(a2 + b1, a3 + b5, a4 + b6, a5 + b2, exact),
        _add4(a0 + b4, a1 + b0, a6 + b3, a7 + b7, exact),
    )


@_inlined
def _rows(work: Any, i: int) -> Any:
    """Return eight working memory rows."""
    return work[i], work[i + 1], work[i + 2], work[i + 3], work[i + 4], work[i + 5], work[i + 6], work[i + 7]


@_inlined
def _read(rows: Any, k: int) -> Any:
    m0, m1, m2, m3, m4, m5, m6, m7 = rows
    return m0[k], m1[k], m2[k], m3[k], m4[k], m5[k], m6[k], m7[k]


@_inlined
def _write(rows: Any, k: int, metrics: Any) -> None:
    m0, m1, m2, m3, m4, m5, m6, m7 = rows
    m0[k], m1[k], m2[k], m3[k], m4[k], m5[k], m6[k], m7[k] = metrics


@_compile
def _fill_inputs(mother: Any, passed: Any, work: Any, order: Any, code: int) -> None:
    """Copy the LLRs for a constituent code to the working memory in trellis order."""
    info, parity = work[_INFO], work[_PARITY]
    for k in range(order.size):
        info[k] = mother[3 * order[k]] + passed[order[k]]
        parity[k] = mother[3 * k + code + 1]


@_compile
def _forward(work: Any, size: int, exact: Any) -> Any:
    """Write the metrics before each step; return the final metrics."""
    rows, info, parity = _rows(work, _ALPHA), work[_INFO], work[_PARITY]
    no = IMPOSSIBLE
    alpha = (np.float32(0.0), no, no, no, no, no, no, no)
    for k in range(size):
        _write(rows, k, alpha)
        alpha = _step_forward(alpha, info[k], parity[k], exact)
        if k % 8 == 0:  # keeps the metrics small in float32
            alpha = _normalise(alpha)
    return alpha


@_compile
def _backward(work: Any, size: int, end: Any, exact: Any) -> None:
    """Write the metrics after each step, from the last step to the first."""
    rows, info, parity = _rows(work, _BETA), work[_INFO], work[_PARITY]
    beta = end
    for k in range(size - 1, -1, -1):
        _write(rows, k, beta)
        beta = _step_backward(beta, info[k], parity[k], exact)
        if k % 8 == 0:
            beta = _normalise(beta)


@_compile
def _end_metrics(tail: Any) -> Any:
    """Return the final state metrics: each state has a single path to state 0, so tail LLRs add up."""
    beta = np.zeros(STATES, dtype=np.float32)
    for j in range(TAIL_BITS):
        for s in range(STATES):
            if TAIL[s, j] == 0:
                beta[s] += tail[j]
    return beta[0], beta[1], beta[2], beta[3], beta[4], beta[5], beta[6], beta[7]


@_compile
def _fill_extrinsic(work: Any, size: int, exact: Any) -> None:
    alpha, beta, parity, out = _rows(work, _ALPHA), _rows(work, _BETA), work[_PARITY], work[_EXTRINSIC]
    for k in range(size):
        # L_e(u) = ln sum over u = 0 - ln sum over u = 1
        u0z0, u0z1, u1z0, u1z1 = _sum_branches(_read(alpha, k), _read(beta, k), exact)
        out[k] = add(u0z0 + parity[k], u0z1, exact) - add(u1z0 + parity[k], u1z1, exact)


@_compile
def _store(work: Any, passed: Any, app: Any, order: Any, scale: Any) -> None:
    """Write the a-posteriori and scaled extrinsic LLRs in natural order."""
    info, extrinsic = work[_INFO], work[_EXTRINSIC]
    for k in range(order.size):
        app[order[k]] = info[k] + extrinsic[k]
        passed[order[k]] = scale * extrinsic[k]


@_compile
def _siso(mother: Any, passed: Any, work: Any, app: Any, order: Any, code: int, scale: Any, exact: Any) -> Any:
    """Run a constituent decoder on a block; return forward and backward metrics for the final states."""
    size = order.size
    first_tail = 3 * size + code * TAIL_BITS
    end = _end_metrics(mother[first_tail : first_tail + TAIL_BITS])
    _fill_inputs(mother, passed, work, order, code)
    final = _forward(work, size, exact)
    _backward(work, size, end, exact)
    _fill_extrinsic(work, size, exact)
    _store(work, passed, app, order, scale)
    return final, end


@_compile
def iterate(
    mother: Any, passed: Any, work: Any, app: Any, blocks: Any, orders: Any, iterations: int, scale: Any, exact: Any
) -> None:
    """Run full iterations on some blocks; update the scaled extrinsic LLRs `passed` and the a-posteriori LLRs `app`."""
    for b in blocks:
        for _ in range(iterations):
            for code in range(2):
                _siso(mother[b], passed[b], work, app[code, b], orders[code], code, scale, exact)


@_compile
def _fill_parity_posterior(work: Any, out: Any, code: int, size: int, exact: Any) -> None:
    alpha, beta, info, parity = _rows(work, _ALPHA), _rows(work, _BETA), work[_INFO], work[_PARITY]
    posterior = work[_EXTRINSIC]
    for k in range(size):
        # L(z) = L_z + ln sum over z = 0 - ln sum over z = 1
        u0z0, u0z1, u1z0, u1z1 = _sum_branches(_read(alpha, k), _read(beta, k), exact)
        posterior[k] = parity[k] + add(u0z0 + info[k], u1z0, exact) - add(u0z1 + info[k], u1z1, exact)
    for k in range(size):
        out[3 * k + code + 1] = posterior[k]


@_compile
def _fill_tail_posterior(final: Any, end: Any, out: Any, exact: Any) -> None:
    for j in range(TAIL_BITS):
        zero, one = IMPOSSIBLE, IMPOSSIBLE
        for s in range(STATES):
            metric = final[s] + end[s]
            if TAIL[s, j] == 0:
                zero = add(zero, metric, exact)
            else:
                one = add(one, metric, exact)
        out[j] = zero - one


@_compile
def mother_posterior(
    mother: Any, passed: Any, work: Any, app: Any, orders: Any, scale: Any, exact: Any, out: Any
) -> None:
    """Compute a-posteriori LLRs for all mother codewords, `out`, by another pass through both decoders."""
    size = orders.shape[1]
    unused = np.empty(size, dtype=np.float32)
    for b in range(mother.shape[0]):
        for k in range(size):
            out[b, 3 * k] = app[b, k]
        for code in range(2):
            first_tail = 3 * size + code * TAIL_BITS
            final, end = _siso(mother[b], passed[b], work, unused, orders[code], code, scale, exact)
            _fill_tail_posterior(final, end, out[b, first_tail : first_tail + TAIL_BITS], exact)
            _fill_parity_posterior(work, out[b], code, size, exact)
