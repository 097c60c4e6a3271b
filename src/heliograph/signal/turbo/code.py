"""Turbo code for a block size and rate, decoding with early stopping, and codeword plan for a layer (section 9.1)."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from heliograph.base.config import CONFIG, clear_errors
from heliograph.base.errors import SettingsError
from heliograph.signal.code import Algorithm, Check, CodePlan
from heliograph.signal.turbo.encoder import STREAMS, TERMINATION, encode_mother, selection
from heliograph.signal.turbo.qpp import QPP_SIZES, coefficients, interleaver

HIGHEST_RATE = (9, 10)  # maximum rate as a fraction (section 9.1), at which noiseless blocks decode at every size


Stop = Literal["none", "agreement", "crc"]  # stopping rule for a block

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


@dataclass(frozen=True, kw_only=True)
class TurboCode:
    """Turbo code from 3GPP TS 36.212 (sections 5.1.3.2 and 5.1.4.1) for a block size and rate.

    Attributes
    ----------
    k : int
        Information bits per block, an element of `QPP_SIZES`.
    coded_bits : int, optional
        Sent bits per block, E, at least 10 k / 9: rate matching punctures or repeats mother bits to send exactly E bits
        (redundancy version 0). None disables rate matching: the 3 k + 12 mother bits follow in the order
        d0_0 d1_0 d2_0 d0_1 ...

    Raises
    ------
    SettingsError
        `k` is not an interleaver size, or the rate is above 9/10.

    Examples
    --------
    >>> code = TurboCode(k=40, coded_bits=80)
    >>> coded = code.encode(np.ones(40, dtype=np.uint8))
    >>> result = code.decode(10.0 * (1 - 2.0 * coded))
    >>> int(result.bits.sum())
    40
    """

    k: int
    coded_bits: int | None = None

    def __post_init__(self) -> None:
        coefficients(self.k)
        if self.coded_bits is None:
            return
        top, bottom = HIGHEST_RATE
        if top * self.coded_bits < bottom * self.k:
            least = -(-bottom * self.k // top)
            raise SettingsError(
                f"k = {self.k} at rate 9/10 or below needs coded_bits >= {least}, not {self.coded_bits}"
            )

    @property
    def length(self) -> int:
        """Sent bits per block, E: `coded_bits`, or 3 k + 12 with no rate matching."""
        return STREAMS * self.k + TERMINATION if self.coded_bits is None else self.coded_bits

    @property
    def rate(self) -> float:
        """Information bits per sent bit, k / E, including the tail."""
        return self.k / self.length

    @property
    def positions(self) -> NDArray[np.int64]:
        """Position in the mother codeword for each sent bit, shape (E,), 0 to 3 k + 11."""
        if self.coded_bits is None:
            return np.arange(self.length)
        return selection(self.k + TERMINATION // STREAMS, self.coded_bits)

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """Mask for coded bits from the second encoder, shape (E,), which encodes the interleaved information bits.

        Blocks with similar text or padding have similar bits from the first encoder.
        """
        return np.asarray(self.positions % STREAMS == STREAMS - 1)

    def encode(self, bits: ArrayLike) -> NDArray[np.uint8]:
        """Encode blocks.

        Parameters
        ----------
        bits : array_like of int or bool, shape (..., k)
            Information bits, 0 or 1.

        Returns
        -------
        ndarray of uint8, shape (..., E)
            Coded bits, 0 or 1.

        Raises
        ------
        ValueError
            The last axis does not have length k, or a value is neither 0 nor 1.
        """
        array = np.asarray(bits)
        self._check_shape("bits", array, self.k)
        if array.dtype.kind not in "biu" or (array.dtype.kind != "b" and np.any((array != 0) & (array != 1))):
            raise ValueError(f"bits must be integers 0 or 1, not {array.dtype} up to {array.max(initial=0)}")
        mother = encode_mother(array.astype(np.uint8), interleaver(self.k))
        return mother if self.coded_bits is None else mother[..., self.positions]

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",
        iterations: int = 8,
        scale: float | None = None,
        stop: Stop | None = None,
        check: Check | None = None,
        coded_output: bool = False,
    ) -> TurboResult:
        """Decode blocks.

        Parameters
        ----------
        llr : array_like of float, shape (..., E)
            LLR = ln P(b=0)/P(b=1) for each received bit. Magnitudes above 1e4, including infinity, are clipped to 1e4.
        algorithm : {"max-log", "log-map"}
            See `DecoderOptions`.
        iterations : int
            Maximum number of full iterations, at least 1.
        scale : float, optional
            Factor on extrinsic LLRs, above 0 and at most 1; None for the algorithm default.
        stop : {"none", "agreement", "crc"}, optional
            Stopping rule; by default "crc" with `check`, otherwise "agreement".
        check : callable, optional
            Check for ``stop="crc"``: maps decisions, uint8 (n, k), to bool (n,), True for each correct block.
        coded_output : bool
            True to compute `coded_extrinsic`, which costs an iteration.

        Returns
        -------
        TurboResult
            Arrays with leading shape (...). Blocks are decoded independently.

        Raises
        ------
        ValueError
            A shape is wrong, or an LLR is NaN.
        SettingsError
            An option is unknown or out of range, or `check` and `stop` are incompatible.
        """
        stop = stop or ("agreement" if check is None else "crc")
        options = DecoderOptions(algorithm=algorithm, iterations=iterations, scale=scale, stop=stop)
        if (check is None) == (stop == "crc"):
            raise SettingsError(f'check goes with stop="crc" and only with it; stop is "{stop}" and check is {check}')
        received = self._clip_llrs(np.asarray(llr))
        leading, flat = received.shape[:-1], received.reshape(-1, self.length)
        result = decode_blocks(flat, self.positions, interleaver(self.k), options, check, coded_output)
        arrays: dict[str, Any] = {
            name: None if array is None else array.reshape((*leading, *array.shape[1:]))
            for name, array in vars(result).items()
        }
        return TurboResult(**arrays)

    def _clip_llrs(self, llr: NDArray[Any]) -> NDArray[np.float32]:
        self._check_shape("llr", llr, self.length)
        if wrong := int(np.isnan(llr).sum()):
            raise ValueError(f"llr must not hold NaN; {wrong} of {llr.size} values are NaN")
        return np.clip(llr, -1e4, 1e4).astype(np.float32)  # float32 resolves 0.001 there

    def _check_shape(self, name: str, array: NDArray[Any], size: int) -> None:
        if array.ndim == 0 or array.shape[-1] != size:
            raise ValueError(f"{name} must have {size} values a block (last axis), not shape {array.shape}")


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
    from heliograph.signal.turbo import kernels

    blocks, k = len(llr), len(order)
    scale, exact = np.float32(options.factor), None if options.algorithm == "max-log" else True
    mother = _accumulate(llr, positions, 3 * k + TERMINATION)
    orders, work = np.stack([np.arange(k), order]), kernels.allocate(k)
    passed, app = np.zeros((blocks, k), np.float32), np.zeros((2, blocks, k), np.float32)
    iterations, stopped = np.zeros(blocks, np.int32), np.zeros(blocks, np.bool_)
    active, step = np.arange(blocks), options.iterations if options.stop == "none" else 1
    for iteration in range(step, options.iterations + 1, step):
        if not active.size:
            break
        kernels.iterate(mother, passed, work, app, active, orders, step, scale, exact)
        iterations[active] = iteration
        if check is not None:
            stopped[active] = check((app[1, active] < 0).astype(np.uint8))
        elif options.stop == "agreement":
            stopped[active] = ((app[0, active] < 0) == (app[1, active] < 0)).all(axis=1)
        active = active[~stopped[active]]
    extrinsic = None
    if coded_output:
        posterior = np.empty_like(mother)
        kernels.mother_posterior(mother, passed, work, app[1], orders, scale, exact, posterior)
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


def turbo_plan(bits: int, rate: float) -> CodePlan:
    """Plan the fewest equal codewords with an interleaver size K near rate * E (section 9.1)."""
    most, of = HIGHEST_RATE
    for split in range(1, bits + 1):
        e = bits // split
        # r E may exceed the largest size by 32, half the step between the largest sizes (section 9.1)
        if bits % split == 0 and rate * e <= QPP_SIZES[-1] + 32:
            break
    k = min((k for k in QPP_SIZES if of * k <= most * e), key=lambda k: abs(k - rate * e), default=0)
    if not k:
        raise ValueError(f"{e} bits a codeword hold no block of {QPP_SIZES[0]} bits at rate {most}/{of}")
    return CodePlan(split, TurboCode(k=k, coded_bits=e))
