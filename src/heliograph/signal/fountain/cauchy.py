"""Symbols of a file by a Cauchy matrix over GF(2^16): any k of 65536 reconstruct the k of the file (section 8.1)."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

POLYNOMIAL = 0b1_0001_0000_0000_1011
"""x^16 + x^12 + x^3 + x + 1 (section 8.1), primitive: the powers of x are all elements but 0."""

ORDER = (1 << 16) - 1
"""Elements but 0, and the exponent from which on the powers of x come again."""

ZERO = 2 * ORDER
"""Stands for the logarithm of 0: beyond the sum of any two others, so that a product with 0 is looked up as 0."""

Logs = NDArray[np.int32]
Words = NDArray[np.uint16]


@lru_cache(maxsize=1)
def _tables() -> tuple[Words, Logs]:
    """Powers of x by exponent, 0 from `ZERO` on; and the logarithm of each element."""
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
    """Return logarithms to the base x; `ZERO` for 0.

    Parameters
    ----------
    elements
        (...) elements, 0 to 65535.
    """
    return _tables()[1][elements]


def power(exponents: NDArray[np.integer]) -> Words:
    """Return powers of x; 0 if a logarithm in the sum is that of 0.

    Parameters
    ----------
    exponents
        (...) sums of up to two logarithms: 0 to twice `ZERO`.
    """
    return _tables()[0][exponents]


NUMBERS = 1 << 16
"""Symbols of a file: the elements of the field."""

WORD_BYTES = 2
"""Bytes of an element: symbols have an even number of bytes."""


class CauchyEncoder:
    """Symbols of a file.

    Parameters
    ----------
    data
        The file's bytes, not empty.
    size
        Bytes of a symbol, even; zeros fill the last symbol of the file.
    """

    def __init__(self, data: bytes, size: int):
        self.count = -(-len(data) // size)
        words = np.frombuffer(data.ljust(self.count * size, b"\0"), ">u2").reshape(self.count, -1)
        self._words = words.astype(np.uint16)
        self._logs: Logs | None = None

    def symbol(self, number: int) -> bytes:
        """Return a symbol's bytes.

        Parameters
        ----------
        number
            Number of the symbol, 0 to 65535; those below `count` are the file.
        """
        if number < self.count:
            return _bytes_of(self._words[number])
        if self._logs is None:
            self._logs = log(self._words)
        return _bytes_of(_sum(self._logs, number, np.arange(self.count)))


def decode(symbols: Mapping[int, bytes], count: int) -> bytes:
    """Return the consecutive symbols of a file from any `count` different symbols.

    Parameters
    ----------
    symbols
        Symbols by number, 0 to 65535, all of the same even length; at least `count`. Those of the file are used first.
    count
        Symbols of the file, k, at least 1.
    """
    own = np.array([n for n in range(count) if n in symbols], np.int64)
    lost = np.array([n for n in range(count) if n not in symbols], np.int64)
    repair = np.array(sorted(n for n in symbols if n >= count)[: len(lost)], np.int64)
    words = np.zeros((count, len(next(iter(symbols.values()))) // WORD_BYTES), np.uint16)
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
    """Sum over j of x_j / (number + j): rows of logarithms of x_j, and the j that they are."""
    # log(1 / a) = order - log(a)
    return np.bitwise_xor.reduce(power(logs + (ORDER - log(number ^ of))[:, None]), axis=0)


def _solved(sums: Words, numbers: NDArray[np.int64], lost: NDArray[np.int64]) -> Words:
    """The lost x_u of y_r = sum over u of x_u / (r + u), by the inverse of a Cauchy matrix.

    Its element in row u and column r is A_r B_u / ((r + u) C_r D_u) with the products A_r of all r + u' (over u'), B_u
    of all r' + u, C_r of all r + r' but r itself, D_u of all u + u' but u itself.
    """
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
