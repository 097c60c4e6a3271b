"""Options and results of the decoder."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal.code import Algorithm

Stop = Literal["none", "agreement", "crc"]
"""When a block stops before its last iteration."""

Metrics = Literal["float32", "int16"]
"""Numbers in which a decoder adds up its paths."""

LLR_LIMIT = 1e4
"""Magnitude to which input LLRs are clipped: far above that of any channel, and small enough that float32 resolves
0.001 beside it (2^-10 at 1e4)."""

PER_LLR = 16
"""Whole numbers to 1 of an LLR, where metrics are int16. Of 10,240 blocks of K = 1024 at 0.5 dB, with the same noise,
8 left 1664 wrong, 16 left 1651, 24 left 1645, and float32 1613; of 20,480 at 0.8 dB 268, 256, 255 and 257."""

MOST_INPUT, MOST_EXTRINSIC = 400, 600
"""Largest input and extrinsic LLR in these numbers, 25 and 37.5: metrics stay within 16 bit by a fifth."""

FACTOR_BITS = 16
"""Binary places of their factor on extrinsic LLRs."""

_DEFAULT_SCALE: dict[str, float] = {"max-log": 0.7, "log-map": 1.0}
"""Default factor on extrinsic LLRs. Log-MAP needs none. For max-log, which overrates them, 0.7 left 3384 of 20,480
blocks of K = 1024 at 0.5 dB in error, the usual 0.75 left 3500 (docs/decisions.md)."""

_STOPS = ("none", "agreement", "crc")
_METRICS = ("float32", "int16")


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Settings of the iterative decoder.

    Attributes
    ----------
    algorithm : {"max-log", "log-map"}
        "log-map" gives the a-posteriori LLRs of each constituent code, where ln(1 + exp(-x)) is taken good to 0.032;
        "max-log" takes the maximum in place of each sum.
    iterations : int
        Most full iterations (of both constituent decoders), at least 1.
    scale : float, optional
        Factor on the extrinsic LLRs passed on, above 0 and at most 1; None for 0.7 with max-log, 1 with log-map.
    stop : {"none", "agreement", "crc"}
        When a block stops early: never; when both half iterations decide all bits alike; when the caller's check finds
        the decisions right.
    metrics : {"float32", "int16"}
        "int16" is for max-log alone. It decodes 64 blocks in 0.6 of the time, with input LLRs in steps of 1/16
        up to 25; one takes as long as 32.

    Raises
    ------
    SettingsError
        A setting is unknown or out of range, or "int16" goes with log-MAP.
    """

    algorithm: Algorithm = "max-log"
    iterations: int = 8
    scale: float | None = None
    stop: Stop = "agreement"
    metrics: Metrics = "float32"

    def __post_init__(self) -> None:
        if self.algorithm not in _DEFAULT_SCALE:
            raise SettingsError(f"algorithm must be one of {', '.join(_DEFAULT_SCALE)}, not {self.algorithm!r}")
        if self.stop not in _STOPS:
            raise SettingsError(f"stop must be one of {', '.join(_STOPS)}, not {self.stop!r}")
        if self.metrics not in _METRICS:
            raise SettingsError(f"metrics must be one of {', '.join(_METRICS)}, not {self.metrics!r}")
        if self.metrics == "int16" and self.algorithm != "max-log":
            raise SettingsError('metrics="int16" goes with algorithm="max-log" alone: choose one or the other')
        if self.iterations < 1:
            raise SettingsError(f"iterations must be at least 1, not {self.iterations}")
        if self.scale is not None and not 0 < self.scale <= 1:
            raise SettingsError(f"scale must be above 0 and at most 1, not {self.scale}")

    @property
    def factor(self) -> float:
        """Factor on the extrinsic LLRs: `scale`, or the algorithm's default."""
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
        What the code adds: `llr` less the channel's LLRs of the same bits, less the a-priori LLRs.
    iterations : ndarray of int32, shape (...)
        Full iterations that each block took, at least 1.
    stopped : ndarray of bool, shape (...)
        Whether the stopping rule was met; False everywhere for ``stop="none"``.
    coded_llr : ndarray of float32, shape (..., E), or None
        A-posteriori LLRs of the coded bits; None where not asked for.
    coded_extrinsic : ndarray of float32, shape (..., E), or None
        `coded_llr` less the input LLRs: a-priori LLRs for an equaliser; None where not asked for.
    """

    bits: NDArray[np.uint8]
    llr: NDArray[np.float32]
    extrinsic: NDArray[np.float32]
    iterations: NDArray[np.int32]
    stopped: NDArray[np.bool_]
    coded_llr: NDArray[np.float32] | None = None
    coded_extrinsic: NDArray[np.float32] | None = None

    def mapped(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> "TurboResult":
        """Return the result with each of its arrays changed.

        Parameters
        ----------
        change : callable
            Takes an array and returns the one in its place; not called where an array is None.
        """
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        changed: dict[str, Any] = {name: None if array is None else change(array) for name, array in arrays.items()}
        return TurboResult(**changed)
