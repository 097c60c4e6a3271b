"""File symbols from a Cauchy matrix over GF(2^16): any k symbols reconstruct k source symbols (section 8.1)."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

POLYNOMIAL = 0b1_0001_0000_0000_1011
"""Field polynomial x^16 + x^12 + x^3 + x + 1 (section 8.1), primitive: x generates all nonzero elements."""

ORDER = (1 << 16) - 1  # number of nonzero elements, and the period of the powers of x

ZERO = 2 * ORDER
"""Logarithm of 0, larger than any sum of two other logarithms: the power table returns 0 for products with 0."""

Logs = NDArray[np.int32]
Words = NDArray[np.uint16]


@lru_cache(maxsize=1)
def _tables() -> tuple[Words, Logs]:
    """Return powers of x by exponent, 0 from `ZERO` on, and the logarithm of each element."""
    powers = np.zeros(2 * ZERO + 1, np.uint16)
    logs = np.full(ORDER + 1, ZERO, np.int32)
    element = 1
    for exponent in range(ORDER):
        powers[exponent] = element
        logs[element] = exponent
        element <<= 1
        if element > ORDER:
            element ^= POLYNOMIAL
    powers[ORDER:ZERO] = powers[:ORDER]
    for table in (powers, logs):
        table.setflags(write=False)
    return powers, logs


def log(elements: NDArray[np.integer]) -> Logs:
    """Return logarithms to base x for elements 0 to 65535; `ZERO` for 0."""
    return _tables()[1][elements]


def power(exponents: NDArray[np.integer]) -> Words:
    """Return powers of x for sums of up to two logarithms; 0 if a summand is `ZERO`."""
    return _tables()[0][exponents]


NUMBERS = 1 << 16  # symbol numbers: the field elements


class CauchyEncoder:
    """Symbol encoder for a file; zeros pad the last source symbol."""

    numbers = NUMBERS

    def __init__(self, data: bytes, size: int):
        self.count = -(-len(data) // size)
        words = np.frombuffer(data.ljust(self.count * size, b"\0"), ">u2").reshape(self.count, -1)
        self._words = words.astype(np.uint16)
        self._logs: Logs | None = None

    def symbol(self, number: int) -> bytes:
        """Return the symbol with a number from 0 to 65535; numbers below `count` are source symbols."""
        if number < self.count:
            return _bytes_of(self._words[number])
        if self._logs is None:
            self._logs = log(self._words)
        return _bytes_of(_sum(self._logs, number, np.arange(self.count)))


def decode(symbols: Mapping[int, bytes], count: int) -> bytes:
    """Return the source symbols from `count` or more symbols with equal size; received source symbols come first."""
    own = np.array([n for n in range(count) if n in symbols], np.int64)
    lost = np.array([n for n in range(count) if n not in symbols], np.int64)
    repair = np.array(sorted(n for n in symbols if n >= count)[: len(lost)], np.int64)
    words = np.zeros((count, len(next(iter(symbols.values()))) // 2), np.uint16)
    if own.size:
        words[own] = _words_of(symbols, own)
    if lost.size:
        left = _words_of(symbols, repair)
        if own.size:
            logs = log(words[own])
            left = np.stack([row ^ _sum(logs, int(number), own) for row, number in zip(left, repair, strict=True)])
        words[lost] = _solved(left, repair, lost)
    return _bytes_of(words)


def _sum(logs: Logs, number: int, of: NDArray[np.int64]) -> Words:
    """Return sum over j of x_j / (number + j) from logarithms of x_j (rows) and the indices j."""
    # log(1 / a) = order - log(a)
    return np.bitwise_xor.reduce(power(logs + (ORDER - log(number ^ of))[:, None]), axis=0)


def _solved(sums: Words, numbers: NDArray[np.int64], lost: NDArray[np.int64]) -> Words:
    """Solve y_r = sum over u of x_u / (r + u) for the lost x_u by the inverse Cauchy matrix."""
    # the element in row u and column r is A_r B_u / ((r + u) C_r D_u): A_r is the product of r + u' over all u', B_u of
    # r' + u over all r', C_r of r + r' over r' != r, and D_u of u + u' over u' != u
    rows = [_log_product(r ^ lost) - _log_product((r ^ numbers)[numbers != r]) for r in numbers]
    columns = np.array([_log_product(u ^ numbers) - _log_product((u ^ lost)[lost != u]) for u in lost])
    out = np.zeros((len(lost), sums.shape[1]), np.uint16)
    for r, row, known in zip(numbers, rows, log(sums), strict=True):
        factor = (row + columns - log(r ^ lost)) % ORDER
        out ^= power(factor[:, None] + known)
    return out


def _log_product(elements: NDArray[np.int64]) -> int:
    return int(log(elements).sum(dtype=np.int64) % ORDER)


def _words_of(symbols: Mapping[int, bytes], numbers: NDArray[np.int64]) -> Words:
    data = b"".join(symbols[int(n)] for n in numbers)
    return np.frombuffer(data, ">u2").reshape(len(numbers), -1).astype(np.uint16)


def _bytes_of(words: Words) -> bytes:
    return words.astype(">u2").tobytes()
