"""One decoding of soft data: LLRs, channel decoder, CRC."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.equalise.llr import LARGEST_LLR
from heliograph.receive.packets import Codeword
from heliograph.signal.block import check, unpack
from heliograph.signal.code import Algorithm, Code
from heliograph.signal.packet import PacketFormat

ERASED = 255
"""Stands for a raw bit of which nothing was received."""

LEAST_POWER, MOST_POWER = 1e-4, 0.999
"""Bounds of the amplitude's part of the power of soft values: moments of few of them may fall outside."""


@dataclass(frozen=True, slots=True)
class Decoding:
    """How codewords are decoded."""

    # Of the turbo code: "max-log" with scaled extrinsic values, or "log-map"
    algorithm: Algorithm = "max-log"
    # Most iterations, 1 or more
    iterations: int = 8


@dataclass(frozen=True, slots=True)
class DecodedBlock:
    """A block as the decoder left it."""

    # (K,) uint8 decisions on the information bits
    bits: NDArray[np.uint8]
    # Iterations that the decoder used
    iterations: int
    # Mean magnitude of the LLRs of the information bits
    margin: float


def decode_packet(
    luminances: Floats, seen: NDArray[np.bool_], form: PacketFormat, identity: int, options: Decoding | None = None
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet."""
    options = options or Decoding()
    soft = form.split(form.soft_data(luminances))
    llrs = {name: soft_to_llr(values, seen) for name, values in soft.items()}
    received = {name: form.layers[name].deinterleave(values) for name, values in llrs.items()}
    decoded = _decode_alike(received, form, options)
    return {
        name: tuple(codeword_of(decoded[name, i], llr, identity, name) for i, llr in enumerate(rows))
        for name, rows in received.items()
    }


def unread(form: PacketFormat, identity: int) -> dict[str, tuple[Codeword, ...]]:
    """Codewords by layer of a packet of which nothing was received."""
    pairs, side = form.layers["high"].pairs, form.settings.side
    return decode_packet(np.zeros((pairs, side, side)), np.zeros(pairs, bool), form, identity, Decoding(iterations=1))


def soft_to_llr(soft: Floats, seen: NDArray[np.bool_]) -> Floats:
    """LLR = ln P(b=0)/P(b=1) of soft values +-a with Gaussian noise, by the values' own moments."""
    known = soft[seen]
    if not known.size:
        return np.zeros_like(soft)
    # with m2 = a^2 + s^2 and m4 = a^4 + 6 a^2 s^2 + 3 s^4: a^4 = (3 m2^2 - m4) / 2
    squared = known * known
    m2, m4 = float(squared.mean()), float((squared * squared).mean())
    a2 = min(np.sqrt(max((3 * m2**2 - m4) / 2, LEAST_POWER * m2**2)), MOST_POWER * m2)
    # LLR = 2 a y / s^2
    llr = 2 * np.sqrt(a2) / max(m2 - a2, TINY) * soft
    return np.clip(np.where(seen[:, None], llr, 0.0), -LARGEST_LLR, LARGEST_LLR)


def codeword_of(decoded: DecodedBlock, llr: Floats, identity: int, layer: str) -> Codeword:
    """Codeword of an array and layer."""
    block, raw = unpack(decoded.bits), hard(llr)
    if block is None:
        return Codeword("crc_fail", None, decoded.bits, raw, decoded.iterations, decoded.margin)
    if (block.identity, block.layer) != (identity, layer):
        return Codeword("mismatch", None, decoded.bits, raw, decoded.iterations, decoded.margin)
    return Codeword("ok", block, decoded.bits, raw, decoded.iterations, decoded.margin)


def hard(llr: Floats) -> NDArray[np.uint8]:
    """Decisions on LLRs, `ERASED` where an LLR is 0."""
    return np.where(llr == 0, ERASED, llr < 0).astype(np.uint8)


def _decode_alike(
    received: Mapping[str, Floats], form: PacketFormat, options: Decoding
) -> dict[tuple[str, int], DecodedBlock]:
    """Decode codewords of equal codes in one call: {(layer, number): block}."""
    groups: dict[Code, list[tuple[str, int]]] = defaultdict(list)
    for name, rows in received.items():
        groups[form.layers[name].code] += [(name, i) for i in range(len(rows))]
    return {
        key: block
        for code, keys in groups.items()
        for key, block in zip(keys, _decode_group(code, keys, received, options), strict=True)
    }


def _decode_group(
    code: Code, keys: list[tuple[str, int]], received: Mapping[str, Floats], options: Decoding
) -> list[DecodedBlock]:
    llrs = np.stack([received[name][i] for name, i in keys])
    result = code.decode(llrs, algorithm=options.algorithm, iterations=options.iterations, check=check)
    margins = np.abs(result.llr).mean(-1)
    return [DecodedBlock(result.bits[i], int(result.iterations[i]), float(margins[i])) for i in range(len(keys))]
