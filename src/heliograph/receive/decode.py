"""Luminances of a packet's pairs to codewords: FHWT, LLR, turbo decoder, CRC."""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.packets import Codeword
from heliograph.receive.settings import DecodeSettings
from heliograph.signal.block import check, unpack
from heliograph.signal.packet import PacketFormat
from heliograph.signal.turbo import TurboCode

Decoded = tuple[NDArray[np.uint8], int, float]
"""Information bits, iterations, mean magnitude of the LLRs."""

ERASED = 255

LARGEST_LLR = 50.0


def decode_packet(
    luminances: NDArray[np.float64],
    seen: NDArray[np.bool_],
    form: PacketFormat,
    identity: int,
    settings: DecodeSettings,
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet.

    Parameters
    ----------
    luminances
        (pairs, n, n) difference of pattern and inverse at each LED, any scale.
    seen
        (pairs,) pairs in which the array was seen; the others are erased.
    form
        The packet's format.
    identity
        The array's; a block of another array is a mismatch.
    settings
        The turbo decoder.

    Returns
    -------
    Codewords by layer.
    """
    soft = form.split(form.soft_data(luminances))
    llrs = {name: soft_to_llr(values, seen) for name, values in soft.items()}
    received = {name: form.layers[name].deinterleave(values) for name, values in llrs.items()}
    decoded = _decode_alike(received, form, settings)
    return {
        name: tuple(codeword_of(decoded[name, i], llr, identity, name) for i, llr in enumerate(rows))
        for name, rows in received.items()
    }


def soft_to_llr(soft: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """LLR = ln P(b=0)/P(b=1) of soft data +-a + Gaussian noise, a and noise from the data's own moments.

    Parameters
    ----------
    soft
        (pairs, cells).
    seen
        (pairs,); the LLRs of the others are 0.
    """
    known = soft[seen]
    if not known.size:
        return np.zeros_like(soft)
    # with m2 = a^2 + s^2 and m4 = a^4 + 6 a^2 s^2 + 3 s^4: a^4 = (3 m2^2 - m4) / 2
    m2, m4 = float(np.mean(known**2)), float(np.mean(known**4))
    a2 = min(np.sqrt(max((3 * m2**2 - m4) / 2, 1e-4 * m2**2)), 0.999 * m2)
    # LLR = 2 a y / s^2
    llr = 2 * np.sqrt(a2) / max(m2 - a2, 1e-12) * soft
    return np.clip(np.where(seen[:, None], llr, 0.0), -LARGEST_LLR, LARGEST_LLR)


def _decode_alike(
    received: Mapping[str, NDArray[np.float64]], form: PacketFormat, settings: DecodeSettings
) -> dict[tuple[str, int], Decoded]:
    """Decode codewords of equal codes in one call: {(layer, number): (bits, iterations, margin)}."""
    groups: dict[TurboCode, list[tuple[str, int]]] = defaultdict(list)
    for name, rows in received.items():
        groups[form.layers[name].code] += [(name, i) for i in range(len(rows))]
    return {
        key: result
        for code, keys in groups.items()
        for key, result in zip(keys, _decode_group(code, keys, received, settings), strict=True)
    }


def _decode_group(
    code: TurboCode,
    keys: list[tuple[str, int]],
    received: Mapping[str, NDArray[np.float64]],
    settings: DecodeSettings,
) -> list[Decoded]:
    llrs = np.stack([received[name][i] for name, i in keys])
    result = code.decode(llrs, algorithm=settings.algorithm, iterations=settings.iterations, stop="crc", check=check)
    margins = np.abs(result.llr).mean(-1)
    return [(result.bits[i], int(result.iterations[i]), float(margins[i])) for i in range(len(keys))]


def codeword_of(decoded: Decoded, llr: NDArray[np.float64], identity: int, layer: str) -> Codeword:
    """A codeword of an array and layer as the turbo decoder left it, with the LLRs (E,) it began from."""
    bits, iterations, margin = decoded
    block = unpack(bits)
    raw = hard(llr)
    if block is None:
        return Codeword("crc_fail", None, bits, raw, iterations, margin)
    if (block.identity, block.layer) != (identity, layer):
        return Codeword("mismatch", None, bits, raw, iterations, margin)
    return Codeword("ok", block, bits, raw, iterations, margin)


def hard(llr: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Decisions on LLRs, `ERASED` where nothing is known."""
    return np.where(llr == 0, ERASED, llr < 0).astype(np.uint8)
