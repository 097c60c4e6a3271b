"""Packets: a header of M-sequence pairs, then data pairs whose layers carry the codewords."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal import haar, ook, pwm
from heliograph.signal.block import MIN_BITS, Block, pack, payload_bytes, whitening
from heliograph.signal.formats import AGREED, Format
from heliograph.signal.header import all_on_levels, header_levels, named_levels
from heliograph.signal.polarity import balance
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings
from heliograph.signal.turbo import QPP_SIZES, TurboCode

Value = TypeVar("Value", bound=np.generic)

SYMBOL_STEP = 23
"""Symbols by which consecutive pairs are turned, so that no part of the array holds one part of a codeword."""


@dataclass(frozen=True)
class LayerFormat:
    """How a layer fills a packet.

    Attributes
    ----------
    name
        "high", "middle" or "low".
    codewords
        Codewords in a packet.
    code
        Their turbo code: K information bits to E transmitted ones.
    pairs, symbols
        Data pairs of a packet, in the single mode its data patterns, and bits of the layer in each.
    """

    name: str
    codewords: int
    code: TurboCode
    pairs: int
    symbols: int

    @property
    def payload_bytes(self) -> int:
        """Bytes of payload in a codeword."""
        return payload_bytes(self.code.k)

    @cached_property
    def places(self) -> NDArray[np.intp]:
        """Where bit j of the layer's codewords, one after the other, lies in (pairs, symbols) flattened."""
        j = np.arange(self.pairs * self.symbols)
        # pair p = j mod P, symbol c = (j div P + 23 p) mod C
        pair = j % self.pairs
        return pair * self.symbols + (j // self.pairs + SYMBOL_STEP * pair) % self.symbols

    def encode(self, blocks: Sequence[Block]) -> NDArray[np.uint8]:
        """Bits of the layer by pair and symbol, (pairs, symbols) uint8, for one block a codeword."""
        info = np.stack([pack(block, self.code.k) for block in blocks])
        return self.interleave(self.code.encode(info) ^ self.chips)

    @cached_property
    def chips(self) -> NDArray[np.uint8]:
        """Whitening of the layer's codewords, (codewords, E) uint8."""
        return np.stack([whitening(self.code.length, self.name, i) for i in range(self.codewords)])

    def interleave(self, coded: NDArray[Value]) -> NDArray[Value]:
        """(codewords, E) coded bits, or values of theirs, to (pairs, symbols)."""
        out = np.empty(self.pairs * self.symbols, dtype=coded.dtype)
        out[self.places] = coded.reshape(-1)
        return out.reshape(self.pairs, self.symbols)

    def deinterleave(self, soft: NDArray[np.float64]) -> NDArray[np.float64]:
        """(pairs, symbols) soft values, positive for 0, to those of the (codewords, E) coded bits, whitening undone."""
        return soft.reshape(-1)[self.places].reshape(self.codewords, -1) * (1.0 - 2.0 * self.chips)


@dataclass(frozen=True)
class PacketFormat:
    """Everything that follows from the settings and a packet's format: codewords, places, patterns.

    Attributes
    ----------
    settings
        The signal's settings.
    named
        What the packet's header names.

    Raises
    ------
    SettingsError
        The settings leave no room to name a format.
    """

    settings: SignalSettings
    named: Format = AGREED

    def __post_init__(self) -> None:
        if self.named != AGREED and (self.settings.header_pairs < 2 or self.settings.header == "all_on"):
            raise SettingsError(
                "a format is named by the second header pair: set signal.header_pairs to 2 or more and "
                'signal.header to "m_sequence"'
            )
        if self.single and self.settings.modulation != "haar":
            raise SettingsError('the single mode is one of signal.modulation = "haar"')

    @cached_property
    def layers(self) -> dict[str, LayerFormat]:
        """Formats by layer, in the order of priority."""
        rates = self.named.rates(self.settings.rate)
        half, pairs = self.settings.side // 2, self.settings.data_pairs
        quarters = [half * half] * len(LAYERS)
        if self.single:
            # twice the patterns, and a column of D11 for their balance
            quarters[0], pairs = half * (half - 1), 2 * pairs
        plans = zip(LAYERS, MULTIPLICITY, quarters, rates, strict=True)
        return {name: _plan(name, count, quarter, pairs, rate) for name, count, quarter, rate in plans}

    @property
    def single(self) -> bool:
        """Whether no inverses follow the data patterns."""
        return self.named.mode == "single"

    def data_patterns(self, blocks: Mapping[str, Sequence[Block]], ahead: int = 0) -> NDArray[np.uint8]:
        """Data patterns of a packet, (pairs, n, n) levels, without the inverted ones; `ahead` as in `patterns`."""
        symbols = [1 - 2 * self.layers[name].encode(blocks[name]).astype(np.int8) for name in LAYERS]
        if self.single:
            half = self.settings.side // 2
            symbols[0] = balance(symbols[0].reshape(-1, half, half - 1), ahead).reshape(-1, half * half)
        d = self.join(np.concatenate(symbols, axis=1))
        return haar.encode(d) if self.settings.modulation == "haar" else ook.encode(d)

    def patterns(self, identity: int, blocks: Mapping[str, Sequence[Block]], ahead: int = 0) -> NDArray[np.uint8]:
        """All patterns of a packet in the order of time, (patterns, n, n) levels.

        Parameters
        ----------
        identity
            Number of the array.
        blocks
            For each layer one block a codeword.
        ahead
            How much light was given before beyond the mean, in symbols of D11; only the single mode asks.
        """
        head = np.stack([self.header_pattern(identity, pair) for pair in range(self.settings.header_pairs)])
        if self.single:
            return np.concatenate([with_inverses(head), self.data_patterns(blocks, ahead)])
        return with_inverses(np.concatenate([head, self.data_patterns(blocks)]))

    def header_pattern(self, identity: int, pair: int = 0) -> NDArray[np.uint8]:
        """Pattern of a header pair, (n, n) levels; that of "all_on" is the same for all identities."""
        side = self.settings.side
        if self.settings.header == "all_on":
            return all_on_levels(side)
        return named_levels(identity, self.named.number, side) if pair else header_levels(identity, side)

    def soft_data(self, x: ArrayLike) -> NDArray[np.float64]:
        """Soft D of received luminances about their mean, (..., n, n), by the modulation's decoder."""
        return haar.decode(x) if self.settings.modulation == "haar" else ook.decode(x)

    def join(self, symbols: NDArray[np.int8]) -> NDArray[np.int8]:
        """(pairs, n * n) data by layer (high, middle, low) to matrices D, (pairs, n, n)."""
        h = self.settings.side // 2
        d11, d12, d21, d22 = (q.reshape(-1, h, h) for q in np.split(symbols, 4, axis=1))
        return np.block([[d11, d12], [d21, d22]])

    def split(self, d: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Matrices D (pairs, n, n), soft or hard, to (pairs, symbols) by layer, the inverse of `join`."""
        h = self.settings.side // 2
        q = [part.reshape(len(d), -1) for part in (d[:, :h, :h], d[:, :h, h:], d[:, h:, :h], d[:, h:, h:])]
        return {"high": q[0], "middle": np.concatenate(q[1:3], axis=1), "low": q[3]}


def with_inverses(patterns: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Follow each of (k, n, n) patterns by its inverse: (2 k, n, n)."""
    return np.stack([patterns, pwm.invert(patterns)], axis=1).reshape(-1, *patterns.shape[1:])


def _plan(name: str, count: int, quarter: int, pairs: int, rate: float) -> LayerFormat:
    """Fewest codewords, equal in size, that keep K within the interleavers of the code."""
    bits = quarter * pairs
    for split in range(1, bits + 1):
        e = bits // split
        if bits % split == 0 and rate * e <= QPP_SIZES[-1] + 32:
            break
    k = min((k for k in QPP_SIZES if 10 * k <= 9 * e), key=lambda k: abs(k - rate * e), default=0)
    if k < MIN_BITS:
        raise SettingsError(
            f"{name} layer: {pairs} data pairs give {e} bits a codeword at rate {rate:.3g}, "
            f"too few for a block of {MIN_BITS} bits; raise signal.data_pairs or the rate"
        )
    return LayerFormat(name, count * split, TurboCode(k=k, coded_bits=e), pairs, count * quarter)
