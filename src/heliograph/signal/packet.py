"""Packets: header pairs, then data pairs with a codeword set for each layer (sections 3, 5, 9.1, 10 and 11)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal import haar, ook, pwm
from heliograph.signal.block import MIN_BITS, AnyBlock, pack, payload_bytes
from heliograph.signal.code import CODES, Code, CodeFamily
from heliograph.signal.formats import AGREED, SHORT_PAIRS, Format
from heliograph.signal.header import header_levels, signalling_levels
from heliograph.signal.m_sequence import WHITENING_POLYNOMIAL, m_sequence
from heliograph.signal.polarity import balance
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings

Value = TypeVar("Value", bound=np.generic)


@cache
def _period() -> NDArray[np.uint8]:
    """Return the 32767 chips of the whitening, starting with 15 ones."""
    chips = m_sequence(WHITENING_POLYNOMIAL, (1 << 15) - 1)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Return whitening chips 0 and 1 for a codeword with `e` coded bits, (e,) uint8, to add modulo 2 (section 10).

    Whitened patterns for repeated bytes look random.
    """
    # g((8192 l + 509 i + j) mod 32767): first codewords up to 8192 bits share no chips between layers
    start = 8192 * LAYERS.index(layer) + 509 * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]


@dataclass(frozen=True)
class LayerFormat:
    """Layer layout in a packet. A symbol is an element of the data matrix D."""

    # "high", "middle" or "low"
    name: str
    # Codewords per packet, W in section 9.1, at least 1
    codewords: int
    # Channel code with K information bits and E coded bits per codeword
    code: Code
    # Data pairs per packet; data patterns in single mode
    pairs: int
    # Symbols per pair or pattern, C in section 5
    symbols: int

    @property
    def payload_bytes(self) -> int:
        """Payload bytes per codeword."""
        return payload_bytes(self.code.k)

    @cached_property
    def places(self) -> NDArray[np.intp]:
        """Interleaver (section 11): flat index in (pairs, symbols) for bit j in the concatenated codewords."""
        j = np.arange(self.pairs * self.symbols)
        # pair p = j mod P, symbol c = (j div P + 23 p) mod C: the shift spreads each codeword over the array
        pair = j % self.pairs
        return pair * self.symbols + (j // self.pairs + 23 * pair) % self.symbols

    def encode(self, blocks: Sequence[AnyBlock]) -> NDArray[np.uint8]:
        """Encode a block per codeword to layer bits 0 and 1, (pairs, symbols) uint8."""
        info = np.stack([pack(block, self.code.k) for block in blocks])
        return self.interleave(self.code.encode(info) ^ self.chips)

    @cached_property
    def chips(self) -> NDArray[np.uint8]:
        """Whitening chips 0 and 1, (codewords, E) uint8."""
        return np.stack([whitening(self.code.length, self.name, i) for i in range(self.codewords)])

    def interleave(self, coded: NDArray[Value]) -> NDArray[Value]:
        """Interleave a value per coded bit: (codewords, E) to (pairs, symbols)."""
        out = np.empty(self.pairs * self.symbols, dtype=coded.dtype)
        out[self.places] = coded.reshape(-1)
        return out.reshape(self.pairs, self.symbols)

    def deinterleave(self, soft: NDArray[np.float64]) -> NDArray[np.float64]:
        """Deinterleave and unwhiten soft values, such as LLRs: (pairs, symbols) to (codewords, E)."""
        return soft.reshape(-1)[self.places].reshape(self.codewords, -1) * (1.0 - 2.0 * self.chips)


@dataclass(frozen=True)
class PacketFormat:
    """Packet layout for given settings and format: codewords, symbol positions, patterns."""

    settings: SignalSettings
    # Format in the header; format 0 selects the agreed mode and rates
    format: Format = AGREED

    def __post_init__(self) -> None:
        if self.format != AGREED and (self.settings.header_pairs < 2 or self.settings.header == "all_on"):
            cure = 'set signal.header_pairs to 2 or more and signal.header to "m_sequence"'
            raise SettingsError(f"the second header pair signals a format: {cure}")
        if self.single and self.settings.modulation != "haar":
            raise SettingsError('the single mode is one of signal.modulation = "haar"')
        if self.format.mode == "short" and self.settings.data_pairs != SHORT_PAIRS:
            raise SettingsError(f"short mode needs signal.data_pairs = {SHORT_PAIRS}, not {self.settings.data_pairs}")

    @cached_property
    def layers(self) -> dict[str, LayerFormat]:
        """Layer layouts by name in priority order; a SettingsError if the packet is too short for a codeword."""
        rates = self.format.rates(self.settings.rate)
        half, pairs = self.settings.side // 2, self.settings.data_pairs
        quarters = [half * half] * len(LAYERS)
        if self.single:
            # twice the patterns, and a D11 column for balance (section 6.3)
            quarters[0], pairs = half * (half - 1), 2 * pairs
        plans = zip(LAYERS, MULTIPLICITY, quarters, rates, strict=True)
        family = CODES[self.settings.code]
        return {name: _plan(name, count, quarter, pairs, rate, family) for name, count, quarter, rate in plans}

    @property
    def single(self) -> bool:
        """True in single mode: no inverse follows a data pattern."""
        return self.format.mode == "single"

    def data_patterns(self, blocks: Mapping[str, Sequence[AnyBlock]], ahead: int = 0) -> NDArray[np.uint8]:
        """Return the data patterns of a packet, excluding inverses; `ahead` is the sum of all previous D11."""
        symbols = [1 - 2 * self.layers[name].encode(blocks[name]).astype(np.int8) for name in LAYERS]
        if self.single:
            half = self.settings.side // 2
            symbols[0] = balance(symbols[0].reshape(-1, half, half - 1), ahead).reshape(-1, half * half)
        d = self.join(np.concatenate(symbols, axis=1))
        return haar.encode(d) if self.settings.modulation == "haar" else ook.encode(d)

    def patterns(self, identity: int, blocks: Mapping[str, Sequence[AnyBlock]], ahead: int = 0) -> NDArray[np.uint8]:
        """Return all patterns of a packet in time order, (patterns, n, n) uint8; see `data_patterns`."""
        head = np.stack([self.header_pattern(identity, pair) for pair in range(self.settings.header_pairs)])
        if self.single:
            return np.concatenate([with_inverses(head), self.data_patterns(blocks, ahead)])
        return with_inverses(np.concatenate([head, self.data_patterns(blocks)]))

    def header_pattern(self, identity: int, pair: int = 0) -> NDArray[np.uint8]:
        """Return the pattern for a header pair, (n, n) uint8; pair 0 signals no format."""
        side = self.settings.side
        if self.settings.header == "all_on":
            return np.full((side, side), pwm.SLOTS, np.uint8)
        return signalling_levels(identity, self.format.number, side) if pair else header_levels(identity, side)

    def soft_data(self, x: ArrayLike) -> NDArray[np.float64]:
        """Demodulate luminances x' = level - 2, (..., n, n), to soft data; positive for bit 0."""
        return haar.decode(x) if self.settings.modulation == "haar" else ook.decode(x)

    def luminances(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """Modulate soft data, (..., n, n), to luminances x' = level - 2; the inverse of `soft_data`."""
        return haar.inverse_transform(d) if self.settings.modulation == "haar" else 2 * d

    def join(self, symbols: NDArray[np.int8]) -> NDArray[np.int8]:
        """Join symbols, (pairs, n * n) in the order high, middle, low, to data matrices, (pairs, n, n) (section 5)."""
        h = self.settings.side // 2
        d11, d12, d21, d22 = (q.reshape(-1, h, h) for q in np.split(symbols, 4, axis=1))
        return np.block([[d11, d12], [d21, d22]])

    def split(self, d: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Split data matrices, (pairs, n, n), into layers, (pairs, symbols); the inverse of `join`."""
        h = self.settings.side // 2
        q = [part.reshape(len(d), -1) for part in (d[:, :h, :h], d[:, :h, h:], d[:, h:, :h], d[:, h:, h:])]
        return {"high": q[0], "middle": np.concatenate(q[1:3], axis=1), "low": q[3]}


def with_inverses(patterns: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Insert the inverse after each pattern: (k, n, n) to (2 k, n, n)."""
    return np.stack([patterns, pwm.invert(patterns)], axis=1).reshape(-1, *patterns.shape[1:])


@lru_cache(maxsize=64)  # caches layers and interleavers across packets
def _plan(name: str, count: int, quarter: int, pairs: int, rate: float, family: CodeFamily) -> LayerFormat:
    """Plan a layer with `count` quarters of the data matrix; each quarter has separate codewords."""
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
        words = f"{plan.codewords} codewords of {plan.code.length} bits"
        raise SettingsError(f"{name} layer: {words} do not fill {bits} bits; a code's plan must fill them exactly")
    if plan.code.k < MIN_BITS:
        raise SettingsError(few)
    return LayerFormat(name, count * plan.codewords, plan.code, pairs, count * quarter)
