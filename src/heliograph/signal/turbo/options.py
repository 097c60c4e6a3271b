"""How to decode, and what comes out."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError

Algorithm = Literal["max-log", "log-map"]
Stop = Literal["none", "agreement", "crc"]
Check = Callable[[NDArray[np.uint8]], NDArray[np.bool_]]
"""Takes decisions, uint8 of shape (n, K); returns True for each of the n blocks that is right."""

LLR_LIMIT = 1e4
"""Magnitude to which input LLRs are clipped: surer than any channel, and single precision still tells
an LLR of 0.01 beside it."""

_DEFAULT_SCALE: dict[str, float] = {"max-log": 0.7, "log-map": 1.0}
_STOPS = ("none", "agreement", "crc")


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Settings of the iterative decoder.

    Parameters
    ----------
    algorithm : {"max-log", "log-map"}
        Exact a-posteriori LLRs of each constituent code, or the maximum in place of each sum.
    iterations : int
        Most full iterations (both constituent decoders), at least 1.
    scale : float, optional
        Factor on the extrinsic LLRs passed on, in (0, 1]; 0.7 for max-log, which overrates them, else 1.
    stop : {"none", "agreement", "crc"}
        When a block stops early: never; when the hard decisions of the two half iterations are the same; when the
        caller's check says so.

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
        """The scale in force."""
        return _DEFAULT_SCALE[self.algorithm] if self.scale is None else self.scale


@dataclass(frozen=True, kw_only=True)
class TurboResult:
    """What the decoder says of each block. LLR = ln P(b=0)/P(b=1).

    Attributes
    ----------
    bits : ndarray of uint8, shape (..., K)
        Hard decisions.
    llr : ndarray of float32, shape (..., K)
        A-posteriori LLRs of the information bits.
    extrinsic : ndarray of float32, shape (..., K)
        What the code adds: `llr` less the channel's LLRs of the same bits and less the a-priori LLRs.
    iterations : ndarray of int32, shape (...)
        Full iterations used.
    stopped : ndarray of bool, shape (...)
        Whether the stopping rule was met; False everywhere for ``stop="none"``.
    coded_llr : ndarray of float32, shape (..., E), or None
        A-posteriori LLRs of the coded bits, where asked for.
    coded_extrinsic : ndarray of float32, shape (..., E), or None
        `coded_llr` less the input LLRs: what an equaliser takes back as its a-priori LLRs.
    """

    bits: NDArray[np.uint8]
    llr: NDArray[np.float32]
    extrinsic: NDArray[np.float32]
    iterations: NDArray[np.int32]
    stopped: NDArray[np.bool_]
    coded_llr: NDArray[np.float32] | None = None
    coded_extrinsic: NDArray[np.float32] | None = None

    def mapped(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> "TurboResult":
        """The same result with every array changed alike."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        changed: dict[str, Any] = {name: None if array is None else change(array) for name, array in arrays.items()}
        return TurboResult(**changed)
