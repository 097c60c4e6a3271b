"""Register a custom channel code: an LDPC code from the library `ldpc` in place of the turbo code.

Run `python examples/own_code.py`. The script prints codeword error rates for both codes over distance and plots the
rates in own_code.png. The script requires `pip install '.[analysis,examples]'` in a clone.
"""

import sys
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse
from ldpc import BpDecoder
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

import heliograph
from heliograph.signal.code import Algorithm, Check, CodePlan

WEIGHT = 4
"""Checks per information bit."""


@dataclass(frozen=True)
class Decoded:
    """Decoding results for n blocks; see `heliograph.signal.code.DecodedBlocks`."""

    bits: NDArray[np.uint8]
    llr: NDArray[np.float32]
    iterations: NDArray[np.int32]
    coded_extrinsic: NDArray[np.float32]


@dataclass(frozen=True)
class RepeatAccumulate:
    """A repeat-accumulate code: each parity bit is the sum of the previous parity bit and a few information bits."""

    k: int
    length: int

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """Mark bits that differ by chance between codewords: the parity bits."""
        return np.arange(self.length) >= self.k

    def encode(self, bits: ArrayLike) -> NDArray[np.uint8]:
        """Encode information bits (..., k) to (..., length)."""
        info = np.asarray(bits, np.uint8)
        sums = (_checks(self) @ info.reshape(-1, self.k).T.astype(np.int64)).T
        parity = np.cumsum(sums, axis=1) % 2
        return np.concatenate([info, parity.reshape(*info.shape[:-1], -1).astype(np.uint8)], axis=-1)

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",  # noqa: ARG002 - of the turbo code
        iterations: int = 8,
        check: Check | None = None,  # noqa: ARG002 - the parity checks end an iteration
        coded_output: bool = False,  # noqa: ARG002 - it costs nothing
    ) -> Decoded:
        """Decode LLRs (n, length) by belief propagation."""
        given = np.asarray(llr, np.float64)
        decoder = BpDecoder(_parity(self), error_rate=0.1, max_iter=5 * iterations, bp_method="product_sum",
                            input_vector_type="received_vector")  # fmt: skip
        after, used = np.empty_like(given), []
        for row, found in zip(given, after, strict=True):
            # the library takes hard decisions and error probabilities, and returns error LLRs
            decoder.update_channel_probs(np.clip(1 / (1 + np.exp(np.abs(row))), 1e-9, 0.5 - 1e-9))
            decoder.decode((row < 0).astype(np.uint8))
            found[:] = np.clip(np.array(decoder.log_prob_ratios), -50, 50) * np.where(row < 0, -1, 1)
            used.append(decoder.iter)
        info = after[:, : self.k].astype(np.float32)
        return Decoded((info < 0).astype(np.uint8), info, np.array(used, np.int32), (after - given).astype(np.float32))


@lru_cache
def _checks(code: RepeatAccumulate) -> scipy.sparse.csr_matrix:
    """Return information bits per check, (checks, k), identical in every process."""
    count, rng = code.length - code.k, np.random.default_rng([code.k, code.length])
    sockets = np.concatenate([rng.permutation(count) for _ in range(-(-WEIGHT * code.k // count))])[: WEIGHT * code.k]
    found = scipy.sparse.csr_matrix(
        (np.ones(len(sockets), np.uint8), (sockets, np.repeat(np.arange(code.k), WEIGHT))), (count, code.k)
    )
    found.data[:] = 1
    return found


@lru_cache
def _parity(code: RepeatAccumulate) -> scipy.sparse.csr_matrix:
    """Return the parity check matrix, (checks, length)."""
    count = code.length - code.k
    accumulate = scipy.sparse.diags([1, 1], [0, -1], (count, count), dtype=np.uint8)
    return scipy.sparse.hstack([_checks(code), accumulate]).tocsr().astype(np.uint8)


def plan(bits: int, rate: float) -> CodePlan:
    """Plan one codeword per quarter, with information in bytes."""
    return CodePlan(1, RepeatAccumulate(8 * int(bits * rate / 8), bits))


heliograph.register_code("repeat-accumulate", plan)


def main(few: bool) -> None:
    """Compare both codes."""
    data = heliograph.sweep(
        {
            "signal.code": ["turbo", "repeat-accumulate"],
            "channel.distance_m": [30, 60] if few else [66, 70, 74, 78, 82],
        },
        set={"signal.data_pairs": 16 if few else 48},
        min_errors=5 if few else 30,
        max_codewords=2 if few else 100,
    )
    figure = Figure(figsize=(7, 4))
    axes = figure.add_subplot(xlabel="distance (m)", ylabel="middle layer: codeword error rate", ylim=(-0.02, 1.02))
    for code in data["signal.code"].values:
        at = data.sel({"signal.code": code, "layer": "middle"})
        rate, low, high = at.fer.values, at.fer_low.values, at.fer_high.values
        axes.errorbar(at["channel.distance_m"], rate, [np.maximum(rate - low, 0), high - rate], label=code, capsize=3)
        print(code, {int(z): f"{int(e)}/{int(n)}" for z, e, n in
                     zip(at["channel.distance_m"], at.codeword_errors, at.codewords, strict=True)})  # fmt: skip
    axes.legend()
    figure.savefig("own_code.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
