"""Iterative block decoding: options, result, and decoding loop with early stopping."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from heliograph.base.config import CONFIG, clear_errors
from heliograph.signal.code import Algorithm, Check
from heliograph.signal.turbo.encoder import TERMINATION

Stop = Literal["none", "agreement", "crc"]
"""Stopping rule for a block."""

_DEFAULT_SCALE: dict[str, float] = {"max-log": 0.7, "log-map": 1.0}
"""Default factor on extrinsic LLRs, which max-log overestimates (docs/decisions.md)."""


@clear_errors
@checked(frozen=True, kw_only=True, config=CONFIG)
class DecoderOptions:
    """Settings for the iterative decoder."""

    # "log-map" computes a-posteriori LLRs for each constituent code, with ln(1 + exp(-x)) exact to 0.032; "max-log"
    # replaces each sum by the maximum
    algorithm: Algorithm = "max-log"
    # Maximum number of full iterations (both constituent decoders), at least 1
    iterations: Annotated[int, Field(ge=1)] = 8
    # Factor on the extrinsic LLRs between decoders, above 0 and at most 1; None for 0.7 with max-log, 1 with log-map
    scale: Annotated[float, Field(gt=0, le=1)] | None = None
    # Stopping rule: never; when both half iterations agree on all bits; or when the check accepts the decisions
    stop: Stop = "agreement"

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
    # Full iterations per block, at least 1, (...)
    iterations: NDArray[np.int32]
    # True if the block met the stopping rule, (...)
    stopped: NDArray[np.bool_]
    # A-posteriori minus input LLRs for the coded bits, (..., E): a-priori LLRs for an equaliser; None unless requested
    coded_extrinsic: NDArray[np.float32] | None = None


def decode_blocks(
    llr: NDArray[np.float32],
    positions: NDArray[np.int64],
    order: NDArray[np.int64],
    options: DecoderOptions,
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
            stopped[active] = check((app[1, active] < 0).astype(np.uint8))
        elif options.stop == "agreement":
            stopped[active] = ((app[0, active] < 0) == (app[1, active] < 0)).all(axis=1)
        active = active[~stopped[active]]
    extrinsic = None
    if coded_output:
        posterior = np.empty_like(mother)
        kernel.mother_posterior(mother, passed, work, app[1], orders, scale, exact, posterior)
        extrinsic = posterior[:, positions] - llr
    return TurboResult(
        bits=(app[1] < 0).astype(np.uint8),
        llr=app[1],
        iterations=iterations,
        stopped=stopped,
        coded_extrinsic=extrinsic,
    )


def _accumulate(llr: NDArray[np.float32], positions: NDArray[np.int64], length: int) -> NDArray[np.float32]:
    """Add received LLRs at the mother codeword positions: punctured bits stay 0, repeated bits add up."""
    mother = np.zeros((len(llr), length), np.float32)
    for start in range(0, len(positions), length):
        mother[:, positions[start : start + length]] += llr[:, start : start + length]
    return mother
