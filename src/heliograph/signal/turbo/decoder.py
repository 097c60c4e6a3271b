"""Iterative block decoding: options, result, and decoding loop with early stopping."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal.code import Algorithm, Check
from heliograph.signal.turbo.encoder import TERMINATION

Stop = Literal["none", "agreement", "crc"]
"""Stopping rule for a block."""

_DEFAULT_SCALE: dict[str, float] = {"max-log": 0.7, "log-map": 1.0}
"""Default factor on extrinsic LLRs, which max-log overestimates (docs/decisions.md)."""


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Settings for the iterative decoder."""

    # "log-map" computes a-posteriori LLRs for each constituent code, with ln(1 + exp(-x)) exact to 0.032; "max-log"
    # replaces each sum by the maximum
    algorithm: Algorithm = "max-log"
    # Maximum number of full iterations (both constituent decoders), at least 1
    iterations: int = 8
    # Factor on the extrinsic LLRs between decoders, above 0 and at most 1; None for 0.7 with max-log, 1 with log-map
    scale: float | None = None
    # Stopping rule: never; when both half iterations agree on all bits; or when the check accepts the decisions
    stop: Stop = "agreement"

    def __post_init__(self) -> None:
        if self.algorithm not in _DEFAULT_SCALE:
            raise SettingsError(f"algorithm must be one of {', '.join(_DEFAULT_SCALE)}, not {self.algorithm!r}")
        if self.stop not in get_args(Stop):
            raise SettingsError(f"stop must be one of {', '.join(get_args(Stop))}, not {self.stop!r}")
        if self.iterations < 1:
            raise SettingsError(f"iterations must be at least 1, not {self.iterations}")
        if self.scale is not None and not 0 < self.scale <= 1:
            raise SettingsError(f"scale must be above 0 and at most 1, not {self.scale}")

    @property
    def factor(self) -> float:
        """Factor on the extrinsic LLRs: `scale`, or the algorithm default."""
        return _DEFAULT_SCALE[self.algorithm] if self.scale is None else self.scale


@dataclass(frozen=True, kw_only=True)
class TurboResult:
    """Decisions and LLRs for decoded blocks. LLR = ln P(b=0)/P(b=1)."""

    # Decisions on the information bits, (..., K)
    bits: NDArray[np.uint8]
    # A-posteriori LLRs for the information bits, (..., K)
    llr: NDArray[np.float32]
    # `llr` minus the channel LLRs for the same bits
    extrinsic: NDArray[np.float32]
    # Full iterations per block, at least 1, (...)
    iterations: NDArray[np.int32]
    # True if the block met the stopping rule, (...)
    stopped: NDArray[np.bool_]
    # A-posteriori LLRs for the coded bits, (..., E); None unless requested
    coded_llr: NDArray[np.float32] | None = None
    # `coded_llr` minus the input LLRs: a-priori LLRs for an equaliser; None unless requested
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
    """Decode LLRs (B, E) with the Numba kernel; the caller checks the shapes.

    `positions` maps received bits to mother bits and covers all 3 K + 12 before repeating; ``x_itl = x_nat[order]``.
    """
    # deferred, as importing Numba takes half a second
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
    """Add received LLRs at the mother codeword positions: punctured bits stay 0, repeated bits add up."""
    mother = np.zeros((len(llr), length), np.float32)
    for start in range(0, len(positions), length):
        mother[:, positions[start : start + length]] += llr[:, start : start + length]
    return mother


def _call_check(check: Check, decisions: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Call the check; raise a ValueError unless the result is a bool per block."""
    verdict = np.asarray(check(decisions))
    if verdict.shape != (len(decisions),) or verdict.dtype != np.bool_:
        raise ValueError(
            f"check must return {len(decisions)} bools, one a block, not {verdict.dtype} of shape {verdict.shape}"
        )
    return verdict
