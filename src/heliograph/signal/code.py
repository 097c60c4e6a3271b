"""Channel codes: code interface and registry.

The air interface uses the code "turbo". For research, there are codes of other standards, and programs may register
further codes; transmitter and receiver then set ``signal.code``.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.registry import Registry

Algorithm = Literal["max-log", "log-map"]  # addition of path metrics at a trellis state: by maximum, or by ln sum exp

Check = Callable[[NDArray[np.uint8]], NDArray[np.bool_]]
"""Check for decisions, uint8 (n, k); returns bool (n,), True for each correct block."""


class DecodedBlocks(Protocol):
    """Decoder output for n blocks. LLR = ln P(b=0)/P(b=1)."""

    @property
    def bits(self) -> NDArray[np.uint8]:
        """Decisions on the information bits, (n, k)."""

    @property
    def llr(self) -> NDArray[np.float32]:
        """A-posteriori LLRs for the information bits, (n, k)."""

    @property
    def iterations(self) -> NDArray[np.int32]:
        """Iterations per block, (n,)."""

    @property
    def coded_extrinsic(self) -> NDArray[np.float32] | None:
        """A-posteriori LLRs minus input LLRs for the coded bits, (n, length); None unless requested."""


class Code(Protocol):
    """Channel code with a fixed block size and rate. Codes must be hashable: equal codes are decoded together."""

    @property
    def k(self) -> int:
        """Information bits per block."""

    @property
    def length(self) -> int:
        """Coded bits per block."""

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """Mask (length,) for coded bits that look random even if codewords carry similar information bits.

        The soft receiver compares these bits to recognise repeated codewords; if all are False, the comparison is off.
        """

    def encode(self, bits: ArrayLike) -> NDArray[np.uint8]:
        """Encode blocks to coded bits 0 and 1, (..., length).

        Parameters
        ----------
        bits
            (..., k) information bits 0 and 1.
        """

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",
        iterations: int = 8,
        check: Check | None = None,
        coded_output: bool = False,
    ) -> DecodedBlocks:
        """Decode blocks.

        Parameters
        ----------
        llr
            (n, length) LLRs for the received bits, 0 for an erasure.
        algorithm
            The setting ``receive.decode.algorithm``; codes other than the turbo code may ignore the setting.
        iterations
            Maximum number of iterations, 1 or more.
        check
            Check for decisions; a decoder may stop a block once the check accepts.
        coded_output
            True to compute `DecodedBlocks.coded_extrinsic`.
        """


class CodePlan(NamedTuple):
    """Code plan for a layer.

    Attributes
    ----------
    codewords
        Number of equal-length codewords in the layer.
    code
        Code for each codeword.
    """

    codewords: int
    code: Code


CodeFamily = Callable[[int, float], CodePlan]
"""Function from coded bits and rate to a code plan.

The codewords fill the coded bits exactly: codewords * code.length equals the number of coded bits. If no plan exists,
the function raises a `ValueError` with the reason.
"""

CODES: Registry[CodeFamily] = Registry(
    "code",
    "heliograph.codes",
    {
        "turbo": "heliograph.signal.turbo.code:turbo_plan",
        "ldpc-nr": "heliograph.published.codes:ldpc_nr",
        "ldpc-wifi": "heliograph.published.codes:ldpc_wifi",
        "polar-nr": "heliograph.published.polar:polar_nr",
        "convolutional": "heliograph.published.codes:convolutional",
    },
)
"""Registry for the setting ``signal.code``."""


def register_code(name: str, family: CodeFamily) -> None:
    """Register a channel code.

    Parameters
    ----------
    name
        Value for ``signal.code``.
    family
        Function from coded bits and rate to a code plan.

    Raises
    ------
    SettingsError
        The name is invalid or belongs to a built-in code, or `family` is not callable.
    """
    CODES.register(name, family, family)


def list_codes() -> list[str]:
    """Return the names of all channel codes, those of the package first."""
    return CODES.names()
