"""Channel codes of standards for comparison: LDPC codes of 5G NR and 802.11n, and the convolutional code of LTE.

Libraries decode: `ldpc` by belief propagation, `komm` by the BCJR algorithm (extra ``codes``). LDPC codes have the rate
matching of the standards with no bit interleaver, as packets interleave. The polar code is in another module.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import HeliographError
from heliograph.signal.code import Algorithm, Check, Code, CodePlan

Bits = NDArray[np.uint8]
Indices = NDArray[np.int64]

LARGEST_LLR = 30.0  # belief propagation takes error probabilities: above, 1 - p rounds
MEMORY = 6  # of the convolutional code


@dataclass(frozen=True)
class Decoded:
    """Decoding results for n blocks; see `heliograph.signal.code.DecodedBlocks`."""

    bits: Bits
    llr: NDArray[np.float32]
    iterations: NDArray[np.int32]
    coded_extrinsic: NDArray[np.float32]


@cache
def table(name: str) -> NDArray[np.int64]:
    """Return a table of a standard.

    "nr_base_graph_2" (row, column, shifts by set index): 3GPP TS 38.212, Table 5.3.2-3; "polar_order": Table 5.3.1.2-1.
    "wifi_1944", -1 for no connection: IEEE 802.11, Annex F, rate 1/2.
    """
    with np.load(Path(__file__).with_name("codes.npz")) as tables:
        return np.asarray(tables[name], np.int64)


class Lifted(NamedTuple):
    """Quasi-cyclic code: base matrix with cyclic shifts, -1 for no connection."""

    base: NDArray[np.int64]
    z: int  # lifting size
    core: int  # rows of the dual-diagonal part; each further row has a separate parity column
    known: Indices  # positions of filler zeros in a codeword
    order: Indices  # positions of the bits that rate matching sends, in order

    @property
    def info(self) -> int:
        """Information columns of the base matrix."""
        return self.base.shape[1] - self.base.shape[0]


@dataclass(frozen=True)
class LdpcCode:
    """LDPC code of 5G NR (base graph 2) or of 802.11n (1944 bits, rate 1/2), shortened, punctured or repeated."""

    standard: Literal["nr", "wifi"]
    k: int
    length: int

    @property
    def positions(self) -> Indices:
        """Position in the codeword for each sent bit."""
        order = _lift(self).order
        return order[np.arange(self.length) % len(order)]

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """Mask for parity bits."""
        lifted = _lift(self)
        return self.positions >= lifted.info * lifted.z

    def encode(self, bits: ArrayLike) -> Bits:
        """Encode blocks (..., k) to (..., length)."""
        info = np.asarray(bits, np.uint8)
        return encode_lifted(_lift(self), info.reshape(-1, self.k))[:, self.positions].reshape(*info.shape[:-1], -1)

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",  # noqa: ARG002 - of the turbo code
        iterations: int = 8,
        check: Check | None = None,  # noqa: ARG002 - the parity checks end the iterations
        coded_output: bool = False,  # noqa: ARG002 - it costs nothing
    ) -> Decoded:
        """Decode LLRs (n, length); an iteration of the turbo code counts as five of belief propagation."""
        received, positions = np.asarray(llr, np.float64), self.positions
        columns, decoder = _belief_propagation(self, 5 * iterations)
        total = np.zeros((len(received), _lift(self).base.shape[1] * _lift(self).z))
        np.add.at(total.T, positions, received.T)
        used = np.zeros(len(received), np.int32)
        for block, row in enumerate(total):
            # the library takes hard decisions and error probabilities, and returns LLRs of an error
            given = row[columns]
            decoder.update_channel_probs(1 / (1 + np.exp(np.minimum(np.abs(given), LARGEST_LLR))))
            decoder.decode((given < 0).astype(np.uint8))
            row[columns] = np.clip(decoder.log_prob_ratios, -100, 100) * np.where(given < 0, -1, 1)
            used[block] = decoder.iter
        info = total[:, : self.k].astype(np.float32)
        return Decoded((info < 0).astype(np.uint8), info, used, (total[:, positions] - received).astype(np.float32))


def encode_lifted(lifted: Lifted, bits: Bits) -> Bits:
    """Encode information bits (n, k) to codewords, filler zeros included."""
    base, z, core, *_ = lifted
    word = np.zeros((len(bits), base.shape[1], z), np.uint8)
    word.reshape(len(bits), -1)[:, : bits.shape[1]] = bits

    def parity(row: int) -> Bits:
        columns = np.flatnonzero(base[row] >= 0)
        return np.bitwise_xor.reduce([np.roll(word[:, c], -base[row, c], axis=1) for c in columns])

    # the sum of the core rows leaves a single shift of the first parity column
    shifts, counts = np.unique(base[:core, lifted.info], return_counts=True)
    (shift,) = shifts[(shifts >= 0) & (counts % 2 == 1)]
    word[:, lifted.info] = np.roll(np.bitwise_xor.reduce([parity(row) for row in range(core)]), shift, axis=1)
    for row in (*range(core - 1), *range(core, len(base))):
        word[:, lifted.info + row + (row < core)] = parity(row)
    return word.reshape(len(bits), -1)


def parity_matrix(lifted: Lifted) -> scipy.sparse.csr_matrix:
    """Return the parity check matrix, z rows for each row of the base matrix."""
    (rows, columns), z = np.nonzero(lifted.base >= 0), lifted.z
    cycle = np.arange(z)
    down = (rows[:, None] * z + cycle).ravel()
    across = (columns[:, None] * z + (lifted.base[rows, columns][:, None] + cycle) % z).ravel()
    return scipy.sparse.csr_matrix((np.ones(len(down), np.uint8), (down, across)), np.array(lifted.base.shape) * z)


@lru_cache
def _lift(code: LdpcCode) -> Lifted:
    """Return the quasi-cyclic code for a block size."""
    if code.standard == "wifi":
        return _rate_matched(table("wifi_1944"), 81, 12, code.k, punctured=0)
    # TS 38.212, section 5.2.2
    columns = 10 if code.k > 640 else 9 if code.k > 560 else 8 if code.k > 192 else 6
    factors = (2, 3, 5, 7, 9, 11, 13, 15)
    sizes = [(a << j, index) for index, a in enumerate(factors) for j in range(8) if a << j <= 384]
    z, index = min(size for size in sizes if columns * size[0] >= code.k)
    base = np.full((42, 52), -1)
    row, column, *shifts = table("nr_base_graph_2").T
    base[row, column] = shifts[index] % z
    return _rate_matched(base, z, 4, code.k, punctured=2 * z)


def _rate_matched(base: NDArray[np.int64], z: int, core: int, k: int, punctured: int) -> Lifted:
    info, total = (base.shape[1] - len(base)) * z, base.shape[1] * z
    return Lifted(base, z, core, np.arange(k, info), np.r_[punctured:k, info:total])


@lru_cache
def _belief_propagation(code: LdpcCode, iterations: int) -> tuple[Indices, Any]:
    """Return the codeword positions that the decoder takes, and the decoder."""
    try:
        from ldpc.bp_decoder import BpDecoder
    except ImportError:
        raise HeliographError(_missing("ldpc")) from None
    lifted = _lift(code)
    matrix, start = parity_matrix(lifted), (lifted.info + lifted.core) * lifted.z
    # an unsent bit of a single check carries no information, nor does its check
    unsent = np.setdiff1d(np.arange(start, matrix.shape[1]), code.positions)
    rows = np.setdiff1d(np.arange(matrix.shape[0]), unsent - lifted.info * lifted.z)
    columns = np.setdiff1d(np.arange(matrix.shape[1]), np.r_[lifted.known, unsent])
    decoder = BpDecoder(matrix[rows][:, columns], error_rate=0.1, max_iter=iterations, bp_method="product_sum",
                        input_vector_type="received_vector")  # fmt: skip
    return columns, decoder


@dataclass(frozen=True)
class ConvolutionalCode:
    """Convolutional code with the LTE polynomials 133, 171, 165 and six zeros as tail, punctured or repeated evenly."""

    k: int
    length: int

    @property
    def positions(self) -> Indices:
        """Position in the codeword for each sent bit."""
        total = 3 * (self.k + MEMORY)
        return np.arange(self.length) * total // self.length if self.length < total else np.arange(self.length) % total

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """No bits: similar information gives similar coded bits."""
        return np.zeros(self.length, bool)

    def encode(self, bits: ArrayLike) -> Bits:
        """Encode blocks (..., k) to (..., length)."""
        info = np.asarray(bits, np.uint8)
        word = np.asarray(_bcjr(self.k).code.encode(info.reshape(-1, self.k)), np.uint8)
        return word[:, self.positions].reshape(*info.shape[:-1], -1)

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",  # noqa: ARG002 - of the turbo code
        iterations: int = 8,  # noqa: ARG002 - of the turbo code
        check: Check | None = None,  # noqa: ARG002 - there are no iterations
        coded_output: bool = False,  # noqa: ARG002 - the library decodes information bits only
    ) -> Decoded:
        """Decode LLRs (n, length). The extrinsic LLRs of coded bits are 0."""
        received = np.asarray(llr, np.float64)
        total = np.zeros((len(received), 3 * (self.k + MEMORY)))
        np.add.at(total.T, self.positions, received.T)
        return decisions(np.asarray(_bcjr(self.k).decode(total), np.float32), received)


def decisions(llr: NDArray[np.float32], received: NDArray[Any]) -> Decoded:
    """Return decoding results with no extrinsic LLRs, after one iteration."""
    extrinsic = np.zeros(received.shape, np.float32)
    return Decoded((llr < 0).astype(np.uint8), llr, np.ones(len(llr), np.int32), extrinsic)


@lru_cache
def _bcjr(k: int) -> Any:
    try:
        import komm
    except ImportError:
        raise HeliographError(_missing("komm")) from None
    # the library takes the current bit as the lowest, the standard as the highest
    code = komm.ConvolutionalCode([[int(f"{polynomial:07b}"[::-1], 2) for polynomial in (0o133, 0o171, 0o165)]])
    return komm.BCJRDecoder(komm.TerminatedConvolutionalCode(code, k, mode="zero-termination"), output_type="soft")


def _missing(package: str) -> str:
    return f"the channel code needs the package {package}: pip install 'heliograph[codes]'"


def equal_codewords(bits: int, rate: float, longest: int, largest_k: int, make: Callable[[int, int], Code]) -> CodePlan:
    """Plan the fewest equal codewords with information in bytes, within the limits of a standard."""
    for count in range(1, bits + 1):
        length = bits // count
        k = 8 * int(length * rate / 8 + 1e-9)
        if bits % count == 0 and length <= longest and k <= largest_k:
            return CodePlan(count, make(k, length))
    raise ValueError(f"{bits} bits have no codeword of at most {longest} bits")


def _at_most(rate: float, highest: float, name: str) -> None:
    if rate > highest + 0.01:
        raise ValueError(f"{name} has rates up to {highest:.3g}, not {rate:.3g}")


def ldpc_nr(bits: int, rate: float) -> CodePlan:
    """Plan codewords with base graph 2 of 5G NR: at most 3824 information bits, rates up to 0.67."""
    _at_most(rate, 0.67, "base graph 2 of 5G NR")
    return equal_codewords(bits, rate, bits, 3824, lambda k, length: LdpcCode("nr", k, length))


def ldpc_wifi(bits: int, rate: float) -> CodePlan:
    """Plan codewords of 802.11n: 1944 bits, rate 1/2, at most 972 information bits."""
    _at_most(rate, 0.5, "the 802.11n code of rate 1/2")
    return equal_codewords(bits, rate, bits, 972, lambda k, length: LdpcCode("wifi", k, length))


def convolutional(bits: int, rate: float) -> CodePlan:
    """Plan one codeword; the tail takes 18 bits of the mother code."""
    k = 8 * int((bits * rate - (MEMORY if rate < 0.34 else 0)) / 8)
    return CodePlan(1, ConvolutionalCode(k, bits))
