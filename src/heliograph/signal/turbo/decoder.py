"""Iterative decoding of blocks: options, result, and the loop that stops each block."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal.code import Algorithm, Check
from heliograph.signal.turbo.encoder import TERMINATION

Stop = Literal["none", "agreement", "crc"]
"""When a block stops before the last iteration."""

LLR_LIMIT = 1e4
"""Magnitude to which input LLRs are clipped: far above that of any channel, and float32 resolves 0.001 at it."""

_DEFAULT_SCALE: dict[str, float] = {"max-log": 0.7, "log-map": 1.0}
"""Default factor on extrinsic LLRs. Log-MAP needs none. For max-log, which overrates them, 0.7 left 3384 of 20,480
blocks of K = 1024 at 0.5 dB in error, the usual 0.75 left 3500 (docs/decisions.md)."""

_STOPS = ("none", "agreement", "crc")


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Settings of the iterative decoder.

    Attributes
    ----------
    algorithm : {"max-log", "log-map"}
        "log-map" gives the a-posteriori LLRs of each constituent code, with ln(1 + exp(-x)) exact to 0.032;
        "max-log" takes the maximum in place of each sum.
    iterations : int
        Maximum number of full iterations (of both constituent decoders), at least 1.
    scale : float, optional
        Factor on the extrinsic LLRs passed on, above 0 and at most 1; None for 0.7 with max-log, 1 with log-map.
    stop : {"none", "agreement", "crc"}
        When a block stops early: never; when both half iterations decide all bits alike; when the check of the caller
        accepts the decisions.

    Raises
    ------
    SettingsError
        A setting is unknown or out of range.
    """

    algorithm: Algorithm = "max-log"
    iterations: int = 8
    scale: float | None = None
    stop: Stop = "agreement"

    def __post_init__(self) -> None:
        if self.algorithm not in _DEFAULT_SCALE:
            raise SettingsError(f"algorithm must be one of {', '.join(_DEFAULT_SCALE)}, not {self.algorithm!r}")
        if self.stop not in _STOPS:
            raise SettingsError(f"stop must be one of {', '.join(_STOPS)}, not {self.stop!r}")
        if self.iterations < 1:
            raise SettingsError(f"iterations must be at least 1, not {self.iterations}")
        if self.scale is not None and not 0 < self.scale <= 1:
            raise SettingsError(f"scale must be above 0 and at most 1, not {self.scale}")

    @property
    def factor(self) -> float:
        """Factor on the extrinsic LLRs: `scale`, or the default of the algorithm."""
        return _DEFAULT_SCALE[self.algorithm] if self.scale is None else self.scale


@dataclass(frozen=True, kw_only=True)
class TurboResult:
    """Decisions and LLRs of decoded blocks. LLR = ln P(b=0)/P(b=1).

    Attributes
    ----------
    bits : ndarray of uint8, shape (..., K)
        Decisions on the information bits, 0 or 1.
    llr : ndarray of float32, shape (..., K)
        A-posteriori LLRs of the information bits.
    extrinsic : ndarray of float32, shape (..., K)
        Contribution of the code: `llr` less the LLRs of the channel for the same bits.
    iterations : ndarray of int32, shape (...)
        Full iterations that each block took, at least 1.
    stopped : ndarray of bool, shape (...)
        True if the stopping rule was met; False everywhere for ``stop="none"``.
    coded_llr : ndarray of float32, shape (..., E), or None
        A-posteriori LLRs of the coded bits; None unless requested.
    coded_extrinsic : ndarray of float32, shape (..., E), or None
        `coded_llr` less the input LLRs: a-priori LLRs for an equaliser; None unless requested.
    """

    bits: NDArray[np.uint8]
    llr: NDArray[np.float32]
    extrinsic: NDArray[np.float32]
    iterations: NDArray[np.int32]
    stopped: NDArray[np.bool_]
    coded_llr: NDArray[np.float32] | None = None
    coded_extrinsic: NDArray[np.float32] | None = None


def decode_blocks(
    llr: NDArray[np.float32],
    positions: NDArray[np.int64],
    order: NDArray[np.int64],
    options: DecoderOptions,
    *,
    check: Check | None = None,
    coded_output: bool = False,
) -> TurboResult:
    """Decode blocks with the Numba kernel; the caller has checked the shapes.

    Parameters
    ----------
    llr : ndarray of float32, shape (B, E)
        Received LLRs, at most `LLR_LIMIT` in magnitude.
    positions : ndarray of int64, shape (E,)
        Position of each received bit in the mother codeword; all 3 K + 12 differ before any repeats.
    order : ndarray of int64, shape (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    options : DecoderOptions
        Algorithm, iterations, scale, stopping rule.
    check : callable, optional
        The check of ``stop="crc"``.
    coded_output : bool
        True to compute the LLRs of the coded bits too.

    Returns
    -------
    TurboResult
        Arrays of leading shape (B,). The result of a block does not depend on the other blocks.
    """
    # imported at the first decoding: Numba takes half a second
    from heliograph.signal.turbo import kernel

    blocks, k = len(llr), len(order)
    scale, exact = np.float32(options.factor), None if options.algorithm == "max-log" else True
    mother = _accumulate(llr, positions, 3 * k + TERMINATION)
    orders, work = np.stack([np.arange(k), order]), kernel.allocate(k)
    passed, app = np.zeros((blocks, k), np.float32), np.zeros((2, blocks, k), np.float32)
    iterations, stopped = np.zeros(blocks, np.int32), np.zeros(blocks, np.bool_)
    active, step = np.arange(blocks), options.iterations if options.stop == "none" else 1
    for iteration in range(step, options.iterations + 1, step):
        if not active.size:
            break
        kernel.iterate(mother, passed, work, app, active, orders, step, scale, exact)
        iterations[active] = iteration
        if check is not None:
            stopped[active] = _call_check(check, (app[1, active] < 0).astype(np.uint8))
        elif options.stop == "agreement":
            stopped[active] = ((app[0, active] < 0) == (app[1, active] < 0)).all(axis=1)
        active = active[~stopped[active]]
    coded = None
    if coded_output:
        posterior = np.empty_like(mother)
        kernel.mother_posterior(mother, passed, work, app[1], orders, scale, exact, posterior)
        coded = posterior[:, positions]
    return TurboResult(
        bits=(app[1] < 0).astype(np.uint8),
        llr=app[1],
        extrinsic=app[1] - mother[:, : 3 * k : 3],
        iterations=iterations,
        stopped=stopped,
        coded_llr=coded,
        coded_extrinsic=None if coded is None else coded - llr,
    )


def _accumulate(llr: NDArray[np.float32], positions: NDArray[np.int64], length: int) -> NDArray[np.float32]:
    """Add received LLRs at the positions in the mother codeword: punctured bits keep 0, repeated bits add up."""
    mother = np.zeros((len(llr), length), np.float32)
    for start in range(0, len(positions), length):
        mother[:, positions[start : start + length]] += llr[:, start : start + length]
    return mother


def _call_check(check: Check, decisions: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the verdicts of the caller after a check that each block has a bool."""
    verdict = np.asarray(check(decisions))
    if verdict.shape != (len(decisions),) or verdict.dtype != np.bool_:
        raise ValueError(
            f"check must return {len(decisions)} bools, one a block, not {verdict.dtype} of shape {verdict.shape}"
        )
    return verdict
