"""One step of the trellis in machine code: what the kernels `kernel` and `single` have in common.

Metrics are tuples of eight, one of each state. ``u`` is the information bit, ``z`` the parity bit; ``lu`` and ``lp``
are their LLRs. The functions are inlined, so that LLVM turns the loops about them into vector code.

``exact`` is None for max-log and True for log-MAP; Numba compiles one version for each and drops the branch not taken.
"""

from typing import Any

import numpy as np

from heliograph.base.compiled import compiled

NORMALISE_EVERY = 8
"""Steps of the trellis between two subtractions of the largest metric, which keep the metrics small in float32. Chosen:
the largest error of an LLR of max-log against `reference` (64 blocks of K = 1024 at 1 dB, 8 iterations) is 5e-5; at 4
steps 3e-5, at 16 steps 1e-4, without any 5e-3. Their speeds differ by less than the noise of measuring them."""

IMPOSSIBLE = np.float32(-1e30)
"""Metric of an impossible state: below any sum of LLRs, and finite, so that no difference is NaN."""

# "contract" alone: additions keep their order, so both kernels find the same values, and so does each lane
FAST_MATH = frozenset({"contract", "nsz"})
"""What LLVM may change in the arithmetic."""

_inlined = compiled(error_model="numpy", fastmath=set(FAST_MATH), forceinline=True)

# ln(1 + exp(-x)) = max(0, q(x))^2 within 0.032, q = _Q0 - _Q1 x fitted by minimax. A parabola's fourth power, good to
# 2.7e-3, made as many blocks wrong, and log-MAP took 1.9 times max-log's time, now 1.6 times (docs/decisions.md)
_Q0, _Q1 = np.float32(0.81323412), np.float32(0.22587585)
"""Coefficients of q."""


@_inlined
def add(a: Any, b: Any, exact: Any) -> Any:
    """Return ln(exp a + exp b), or for max-log the larger.

    Parameters
    ----------
    a, b : float32
        Metrics of two paths that meet.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    larger = a if a > b else b
    if exact is None:
        return larger
    # max*(a, b) = max(a, b) + ln(1 + exp(-|a - b|))
    q = _Q0 - _Q1 * abs(a - b)
    q = q if q > np.float32(0.0) else np.float32(0.0)
    return larger + q * q


@_inlined
def _add4(a: Any, b: Any, c: Any, d: Any, exact: Any) -> Any:
    return add(add(a, b, exact), add(c, d, exact), exact)


@_inlined
def normalised(metrics: Any) -> Any:
    """Subtract the largest of eight metrics, as only differences matter.

    Parameters
    ----------
    metrics : tuple of eight float32
        Forward or backward metrics, by state.
    """
    m0, m1, m2, m3, m4, m5, m6, m7 = metrics
    top = add(_add4(m0, m1, m2, m3, None), _add4(m4, m5, m6, m7, None), None)
    return m0 - top, m1 - top, m2 - top, m3 - top, m4 - top, m5 - top, m6 - top, m7 - top


@_inlined
def forward(alpha: Any, lu: Any, lp: Any, exact: Any) -> Any:
    """Return the forward metrics a step later.

    Parameters
    ----------
    alpha : tuple of eight float32
        Forward metrics before the step.
    lu, lp : float32
        LLRs of the step's information bit and parity bit.
    exact : True or None
        True for log-MAP, None for max-log.
    """
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
def backward(beta: Any, lu: Any, lp: Any, exact: Any) -> Any:
    """Return the backward metrics a step earlier.

    Parameters
    ----------
    beta : tuple of eight float32
        Backward metrics after the step.
    lu, lp : float32
        LLRs of the step's information bit and parity bit.
    exact : True or None
        True for log-MAP, None for max-log.
    """
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
def _branches(alpha: Any, beta: Any, exact: Any) -> Any:
    """Return ln sum of exp(alpha(s) + beta'(s')) over the branches of each pair of bits: u z = 00, 01, 10, 11."""
    a0, a1, a2, a3, a4, a5, a6, a7 = alpha
    b0, b1, b2, b3, b4, b5, b6, b7 = beta
    return (
        _add4(a0 + b0, a1 + b4, a6 + b7, a7 + b3, exact),
        _add4(a2 + b5, a3 + b1, a4 + b2, a5 + b6, exact),
        _add4(a2 + b1, a3 + b5, a4 + b6, a5 + b2, exact),
        _add4(a0 + b4, a1 + b0, a6 + b3, a7 + b7, exact),
    )


@_inlined
def extrinsic(alpha: Any, beta: Any, lp: Any, exact: Any) -> Any:
    """Return the LLR of a step's information bit, its own input left out.

    Parameters
    ----------
    alpha, beta : tuple of eight float32
        Forward metrics before the step, backward metrics after it.
    lp : float32
        LLR of the step's parity bit.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    # L_e(u) = ln sum over u = 0 less the same over u = 1
    u0z0, u0z1, u1z0, u1z1 = _branches(alpha, beta, exact)
    return add(u0z0 + lp, u0z1, exact) - add(u1z0 + lp, u1z1, exact)


@_inlined
def parity_posterior(alpha: Any, beta: Any, lu: Any, lp: Any, exact: Any) -> Any:
    """Return the a-posteriori LLR of a step's parity bit.

    Parameters
    ----------
    alpha, beta : tuple of eight float32
        Forward metrics before the step, backward metrics after it.
    lu, lp : float32
        LLRs of the step's information bit and parity bit.
    exact : True or None
        True for log-MAP, None for max-log.
    """
    # L(z) = L_z + ln sum over z = 0 less the same over z = 1
    u0z0, u0z1, u1z0, u1z1 = _branches(alpha, beta, exact)
    return lp + add(u0z0 + lu, u1z0, exact) - add(u0z1 + lu, u1z1, exact)
