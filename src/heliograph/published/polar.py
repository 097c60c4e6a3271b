"""Polar code of 5G NR (3GPP TS 38.212, sections 5.2.1, 5.3.1 and 5.4.1) with the CRC of 11 bits and list decoding.

The rules are those of uplink control information with no channel interleaver, as packets interleave.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.published.codes import Bits, Decoded, Indices, decisions, equal_codewords, table
from heliograph.signal.code import Algorithm, Check, CodePlan

CRC_POLYNOMIAL, CRC_BITS = 0b111000100001, 11  # D^11 + D^10 + D^9 + D^5 + 1
PATHS = 8  # of list decoding
LARGEST_LLR = np.float32(1e4)

SUB_BLOCKS = (0, 1, 2, 4, 3, 5, 6, 7, 8, 16, 9, 17, 10, 18, 11, 19, 12, 20, 13, 21, 14, 22, 15, 23, 24, 25, 26, 28, 27,
              29, 30, 31)  # fmt: skip
"""Sub-block interleaver (Table 5.4.1.1-1)."""


@dataclass(frozen=True)
class Segment:
    """Polar codeword of k bits and a CRC, `length` bits long after rate matching."""

    k: int
    length: int

    @property
    def size(self) -> int:
        """Length of the mother code, N."""
        n, total = int(np.ceil(np.log2(self.length))), self.k + CRC_BITS
        if 8 * self.length <= 9 * 2 ** (n - 1) and 16 * total < 9 * self.length:
            n -= 1
        return 1 << max(5, min(n, int(np.ceil(np.log2(8 * total))), 10))

    @cached_property
    def positions(self) -> Indices:
        """Position in the mother codeword for each sent bit."""
        order, n, e = self._interleaver, self.size, self.length
        return order[n - e :] if self._punctured else order[np.arange(e) % n]

    @cached_property
    def frozen(self) -> NDArray[np.bool_]:
        """Mask (N,) for frozen bits."""
        order, n, e = self._interleaver, self.size, self.length
        frozen = np.zeros(n, bool)
        if self._punctured:
            frozen[order[: n - e]] = True
            frozen[: -(-3 * n // 4) - e // 2 if 4 * e >= 3 * n else -(-(9 * n - 4 * e) // 16)] = True
        else:
            frozen[order[e:]] = True
        reliable = table("polar_order")
        free = reliable[(reliable < n)]
        free = free[~frozen[free]]
        frozen[free[: len(free) - self.k - CRC_BITS]] = True
        return frozen

    @property
    def _interleaver(self) -> Indices:
        part = self.size // 32
        return (np.array(SUB_BLOCKS)[:, None] * part + np.arange(part)).ravel()

    @property
    def _punctured(self) -> bool:
        return self.length < self.size and 16 * (self.k + CRC_BITS) <= 7 * self.length

    def encode(self, bits: Bits) -> Bits:
        """Encode (n, k) to (n, length)."""
        word = np.zeros((len(bits), self.size), np.uint8)
        word[:, ~self.frozen] = np.concatenate([bits, crc(bits)], axis=1)
        half = 1
        while half < self.size:
            pairs = word.reshape(len(bits), -1, 2, half)
            pairs[:, :, 0] ^= pairs[:, :, 1]
            half *= 2
        return word[:, self.positions]

    def decode(self, llr: NDArray[np.float32]) -> Bits:
        """Decode LLRs (n, length): the best path with a correct CRC, or else the best path."""
        from heliograph.published.polar_kernels import decode_lists

        shortened = self.length < self.size and not self._punctured
        total = np.full((len(llr), self.size), LARGEST_LLR if shortened else 0, np.float32)
        total[:, self.positions] = 0
        np.add.at(total.T, self.positions, llr.T)
        paths = decode_lists(total, self.frozen, PATHS)[:, :, ~self.frozen]
        right = (crc(paths[..., : self.k]) == paths[..., self.k :]).all(axis=-1)
        return np.asarray(paths[np.arange(len(paths)), right.argmax(axis=1), : self.k])


def crc(bits: Bits) -> Bits:
    """Return the CRC (..., 11) of bits (..., k)."""
    remainder = np.zeros(bits.shape[:-1], np.int64)
    for place in range(bits.shape[-1]):
        remainder = (remainder << 1) ^ (bits[..., place].astype(np.int64) << CRC_BITS)
        remainder ^= np.where(remainder >> CRC_BITS & 1, CRC_POLYNOMIAL, 0)
    return (remainder[..., None] >> np.arange(CRC_BITS)[::-1] & 1).astype(np.uint8)


@dataclass(frozen=True)
class PolarCode:
    """Polar code with one or two segments."""

    k: int
    length: int

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Segments of equal length; an odd bit stays empty."""
        count = 2 if (self.k >= 360 and self.length >= 1088) or self.k >= 1013 else 1
        return (Segment(self.k // count, self.length // count),) * count

    @property
    def distinguishing(self) -> NDArray[np.bool_]:
        """No bits: the code is not systematic, and similar blocks may share coded bits."""
        return np.zeros(self.length, bool)

    def encode(self, bits: ArrayLike) -> Bits:
        """Encode blocks (..., k) to (..., length)."""
        info = np.asarray(bits, np.uint8)
        segments = self.segments
        segment = segments[0]
        parts = segment.encode(info.reshape(-1, segment.k)).reshape(*info.shape[:-1], len(segments) * segment.length)
        return np.pad(parts, [(0, 0)] * (info.ndim - 1) + [(0, self.length - parts.shape[-1])])

    def decode(
        self,
        llr: ArrayLike,
        *,
        algorithm: Algorithm = "max-log",  # noqa: ARG002 - of the turbo code
        iterations: int = 8,  # noqa: ARG002 - of the turbo code
        check: Check | None = None,  # noqa: ARG002 - the CRC of the standard selects the path
        coded_output: bool = False,  # noqa: ARG002 - list decoding gives decisions only
    ) -> Decoded:
        """Decode LLRs (n, length) to decisions: LLRs of 1 and -1, and extrinsic LLRs of 0."""
        received, segment = np.asarray(llr, np.float32), self.segments[0]
        sent = received[:, : len(self.segments) * segment.length]
        bits = segment.decode(sent.reshape(-1, segment.length)).reshape(len(received), self.k)
        return decisions(1 - 2 * bits.astype(np.float32), received)


def polar_nr(bits: int, rate: float) -> CodePlan:
    """Plan codewords of at most two segments of 1024 bits."""
    return equal_codewords(bits, rate, 2048, bits, PolarCode)
