"""Channel codes: the interface of a code, and codes by name.

The code of the air interface is "turbo". Research may register further codes; transmitter and receiver then set
``signal.code``.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.registry import Registry

Algorithm = Literal["max-log", "log-map"]
"""How the metrics of the paths through a trellis state are added: by their maximum, or by ln sum exp."""

Check = Callable[[NDArray[np.uint8]], NDArray[np.bool_]]
"""Takes decisions, uint8 of shape (n, k); returns True for each of the n blocks that is right."""


class DecodedBlocks(Protocol):
    """What a decoder says of n blocks. LLR = ln P(b=0)/P(b=1)."""

    @property
    def bits(self) -> NDArray[np.uint8]:
        """(n, k) decisions on the information bits."""

    @property
    def llr(self) -> NDArray[np.float32]:
        """(n, k) a-posteriori LLRs of the information bits."""

    @property
    def iterations(self) -> NDArray[np.int32]:
        """(n,) iterations used."""

    @property
    def coded_extrinsic(self) -> NDArray[np.float32] | None:
        """(n, length) a-posteriori LLRs of the coded bits less the input LLRs; None where not asked for."""


class Code(Protocol):
    """A channel code of one block size and rate. It must be hashable: equal codes are decoded together."""

    @property
    def k(self) -> int:
        """Information bits per block."""

    @property
    def length(self) -> int:
        """Coded bits per block."""

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """(length,) coded bits that differ by chance in different codewords, however alike their information bits.

        The soft receiver compares these bits to recognise a codeword that comes again; all False switches that off.
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
            (n, length) LLRs of the received bits, 0 for an erasure.
        algorithm
            The setting ``receive.decode.algorithm``; other codes than the turbo code may leave it aside.
        iterations
            Most iterations, 1 or more.
        check
            Tells right decisions; a decoder may stop a block once it is right.
        coded_output
            Whether `DecodedBlocks.coded_extrinsic` is asked for.
        """


class CodePlan(NamedTuple):
    """How a layer is coded.

    Attributes
    ----------
    codewords
        Codewords of equal length that share the layer's bits.
    code
        Code of each codeword.
    """

    codewords: int
    code: Code


CodeFamily = Callable[[int, float], CodePlan]
"""Plans the code for a number of coded bits and a rate.

The codewords fill the coded bits exactly: codewords * code.length is their number. A `ValueError` says why they cannot.
"""

CODES: Registry[CodeFamily] = Registry("code", "heliograph.codes", {"turbo": "heliograph.signal.turbo.code:turbo_plan"})
"""Code families by the name of the setting ``signal.code``."""


def register_code(name: str, family: CodeFamily) -> None:
    """Register a channel code.

    Parameters
    ----------
    name
        What ``signal.code`` calls it.
    family
        Plans a code for a number of bits and a rate.

    Raises
    ------
    SettingsError
        The name is taken by a code of the package, or is no name; or `family` is no function.
    """
    CODES.register(name, family, family)
