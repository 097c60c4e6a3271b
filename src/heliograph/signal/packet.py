"""Packets: header pairs, then data pairs whose layers carry the codewords (sections 3, 5, 9.1 and 11)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal import haar, ook, pwm
from heliograph.signal.block import MIN_BITS, AnyBlock, pack, payload_bytes
from heliograph.signal.code import CODES, Code, CodeFamily
from heliograph.signal.formats import AGREED, SHORT_PAIRS, Format
from heliograph.signal.header import all_on_levels, header_levels, signalling_levels
from heliograph.signal.polarity import balance
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings
from heliograph.signal.whitening import whitening

Value = TypeVar("Value", bound=np.generic)

SYMBOL_STEP = 23
"""Symbols by which the interleaver turns from pair to pair (section 11), which spreads each part of a codeword over the
array.

Chosen, a prime that divides the number of symbols of a single layer. A D11 symbol then carries 0.94 to 1.12 times the
mean number of bits of each third of a codeword in the default high layer; with 11 or 46 it is 0.88 to 1.12, with 0 it
is 0 to 3."""


@dataclass(frozen=True)
class LayerFormat:
    """How a layer fills a packet. A symbol is an element of the data matrix D.

    Attributes
    ----------
    name
        "high", "middle" or "low".
    codewords
        Codewords in a packet, W of section 9.1, at least 1.
    code
        Their turbo code: K information bits to E coded bits.
    pairs
        Data pairs of a packet, in the single mode its data patterns.
    symbols
        Symbols of the layer in each, C of section 5.
    """

    name: str
    codewords: int
    code: Code
    pairs: int
    symbols: int

    @property
    def payload_bytes(self) -> int:
        """Bytes of payload in a codeword."""
        return payload_bytes(self.code.k)

    @cached_property
    def places(self) -> NDArray[np.intp]:
        """Interleaver (section 11): index in (pairs, symbols), flattened, of bit j of all codewords in order."""
        j = np.arange(self.pairs * self.symbols)
        # pair p = j mod P, symbol c = (j div P + 23 p) mod C
        pair = j % self.pairs
        return pair * self.symbols + (j // self.pairs + SYMBOL_STEP * pair) % self.symbols

    def encode(self, blocks: Sequence[AnyBlock]) -> NDArray[np.uint8]:
        """Return the layer's bits 0 and 1 of a packet, (pairs, symbols) uint8.

        Parameters
        ----------
        blocks
            One block per codeword, in the order of the codewords.
        """
        info = np.stack([pack(block, self.code.k) for block in blocks])
        return self.interleave(self.code.encode(info) ^ self.chips)

    @cached_property
    def chips(self) -> NDArray[np.uint8]:
        """Whitening of the layer's codewords, (codewords, E) uint8 chips 0 and 1."""
        return np.stack([whitening(self.code.length, self.name, i) for i in range(self.codewords)])

    def interleave(self, coded: NDArray[Value]) -> NDArray[Value]:
        """Return values of coded bits by symbol: (pairs, symbols).

        Parameters
        ----------
        coded
            (codewords, E) coded bits, or any other value of each.
        """
        out = np.empty(self.pairs * self.symbols, dtype=coded.dtype)
        out[self.places] = coded.reshape(-1)
        return out.reshape(self.pairs, self.symbols)

    def deinterleave(self, soft: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return soft values by coded bit before whitening: (codewords, E).

        Parameters
        ----------
        soft
            (pairs, symbols) soft values, such as LLRs, of the bits as they were sent; positive for bit 0.
        """
        return soft.reshape(-1)[self.places].reshape(self.codewords, -1) * (1.0 - 2.0 * self.chips)


@dataclass(frozen=True)
class PacketFormat:
    """Everything that follows from the settings and a packet's format: codewords, places, patterns.

    Attributes
    ----------
    settings
        Settings of the signal, as both ends have agreed on them.
    format
        Format that the packet's header signals; format 0 for what both ends have agreed on.

    Raises
    ------
    SettingsError
        The header cannot signal the format, the single mode is asked for without the hierarchical code, or the short
        mode with another number of data pairs.
    """

    settings: SignalSettings
    format: Format = AGREED

    def __post_init__(self) -> None:
        if self.format != AGREED and (self.settings.header_pairs < 2 or self.settings.header == "all_on"):
            raise SettingsError(
                "a format is named by the second header pair: set signal.header_pairs to 2 or more and "
                'signal.header to "m_sequence"'
            )
        if self.single and self.settings.modulation != "haar":
            raise SettingsError('the single mode is one of signal.modulation = "haar"')
        if self.format.mode == "short" and self.settings.data_pairs != SHORT_PAIRS:
            raise SettingsError(
                f"a packet of the short mode has {SHORT_PAIRS} data pairs, not {self.settings.data_pairs}: set "
                f"signal.data_pairs to {SHORT_PAIRS}, or transmit another mode"
            )

    @cached_property
    def layers(self) -> dict[str, LayerFormat]:
        """How each layer fills the packet, by the layer's name in the order of priority.

        Raises
        ------
        SettingsError
            The packet is too short for a codeword of some layer.
        """
        rates = self.format.rates(self.settings.rate)
        half, pairs = self.settings.side // 2, self.settings.data_pairs
        quarters = [half * half] * len(LAYERS)
        if self.single:
            # twice the patterns, and a column of D11 keeps their light even (section 6.3)
            quarters[0], pairs = half * (half - 1), 2 * pairs
        plans = zip(LAYERS, MULTIPLICITY, quarters, rates, strict=True)
        family = CODES[self.settings.code]
        return {name: _plan(name, count, quarter, pairs, rate, family) for name, count, quarter, rate in plans}

    @property
    def single(self) -> bool:
        """Whether the packet is of the single mode: no inverses follow the data patterns."""
        return self.format.mode == "single"

    def data_patterns(self, blocks: Mapping[str, Sequence[AnyBlock]], ahead: int = 0) -> NDArray[np.uint8]:
        """Return the data patterns of a packet, inverses excluded.

        Parameters
        ----------
        blocks
            A block per codeword for each layer.
        ahead
            Sum of all D11 sent before, for the balance of the single mode; ignored otherwise.

        Returns
        -------
        (pairs, n, n) uint8 levels 0 to 4.
        """
        symbols = [1 - 2 * self.layers[name].encode(blocks[name]).astype(np.int8) for name in LAYERS]
        if self.single:
            half = self.settings.side // 2
            symbols[0] = balance(symbols[0].reshape(-1, half, half - 1), ahead).reshape(-1, half * half)
        d = self.join(np.concatenate(symbols, axis=1))
        return haar.encode(d) if self.settings.modulation == "haar" else ook.encode(d)

    def patterns(self, identity: int, blocks: Mapping[str, Sequence[AnyBlock]], ahead: int = 0) -> NDArray[np.uint8]:
        """Return all patterns of a packet in the order of time.

        Parameters
        ----------
        identity
            Number of the array, 0 to 29.
        blocks
            A block per codeword for each layer.
        ahead
            Sum of all D11 sent before, for the balance of the single mode; ignored otherwise.

        Returns
        -------
        (patterns, n, n) uint8 levels 0 to 4.
        """
        head = np.stack([self.header_pattern(identity, pair) for pair in range(self.settings.header_pairs)])
        if self.single:
            return np.concatenate([with_inverses(head), self.data_patterns(blocks, ahead)])
        return with_inverses(np.concatenate([head, self.data_patterns(blocks)]))

    def header_pattern(self, identity: int, pair: int = 0) -> NDArray[np.uint8]:
        """Return the pattern of a header pair; with the header "all_on" it is the same for all identities.

        Parameters
        ----------
        identity
            Number of the array, 0 to 29.
        pair
            Number of the pair in the packet, from 0; the first signals no format.

        Returns
        -------
        (n, n) uint8 levels 0 to 4.
        """
        side = self.settings.side
        if self.settings.header == "all_on":
            return all_on_levels(side)
        return signalling_levels(identity, self.format.number, side) if pair else header_levels(identity, side)

    def soft_data(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return soft data of received luminances by the modulation, (..., n, n); positive for bit 0.

        Parameters
        ----------
        x
            (..., n, n) luminances x' = level - 2, times any gain.
        """
        return haar.decode(x) if self.settings.modulation == "haar" else ook.decode(x)

    def join(self, symbols: NDArray[np.int8]) -> NDArray[np.int8]:
        """Return the data matrices D, (pairs, n, n).

        Parameters
        ----------
        symbols
            (pairs, n * n) elements of D, -1 to 1, in the order high, middle, low (section 5).
        """
        h = self.settings.side // 2
        d11, d12, d21, d22 = (q.reshape(-1, h, h) for q in np.split(symbols, 4, axis=1))
        return np.block([[d11, d12], [d21, d22]])

    def split(self, d: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the data of each layer, (pairs, symbols); the inverse of `join`.

        Parameters
        ----------
        d
            (pairs, n, n) data matrices D, soft or decided.
        """
        h = self.settings.side // 2
        q = [part.reshape(len(d), -1) for part in (d[:, :h, :h], d[:, :h, h:], d[:, h:, :h], d[:, h:, h:])]
        return {"high": q[0], "middle": np.concatenate(q[1:3], axis=1), "low": q[3]}


def with_inverses(patterns: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return patterns, each followed by its inverse: (2 k, n, n).

    Parameters
    ----------
    patterns
        (k, n, n) uint8 levels 0 to 4, in the order of time.
    """
    return np.stack([patterns, pwm.invert(patterns)], axis=1).reshape(-1, *patterns.shape[1:])


@lru_cache(maxsize=64)  # each packet asks for its layers again, and their interleavers
def _plan(name: str, count: int, quarter: int, pairs: int, rate: float, family: CodeFamily) -> LayerFormat:
    """Plan a layer of `count` quarters of the data matrix, each coded by itself."""
    bits = quarter * pairs
    few = (
        f"{name} layer: {pairs} data pairs give {bits} bits at rate {rate:.3g}, too few for a block of {MIN_BITS} "
        f"bits; raise signal.data_pairs or the rate, or take a larger signal.side"
    )
    try:
        plan = family(bits, rate)
    except ValueError as error:
        raise SettingsError(f"{few} ({error})") from None
    if plan.codewords * plan.code.length != bits:
        raise SettingsError(
            f"{name} layer: {plan.codewords} codewords of {plan.code.length} bits do not fill {bits} bits; "
            f"a code's plan must fill them exactly"
        )
    if plan.code.k < MIN_BITS:
        raise SettingsError(few)
    return LayerFormat(name, count * plan.codewords, plan.code, pairs, count * quarter)
