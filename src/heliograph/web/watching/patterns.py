"""Light of a packet for display: luminances, and histograms of soft values by layer."""

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.packet import Words
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat

CodedBits = Mapping[str, NDArray[np.bool_]]  # coded bits by layer, (codewords, E)


def encode(form: PacketFormat, words: Words) -> CodedBits:
    """Encode the decided bits of a packet again."""
    return {
        name: layer.code.encode(np.stack([word.bits for word in words[name]])).astype(bool)
        for name, layer in form.layers.items()
    }


def soft_by_layer(form: PacketFormat, luminances: Floats) -> dict[str, Floats]:
    """Return soft values of coded bits by layer, (codewords, E), positive for bit 0."""
    soft = form.split(form.soft_data(luminances))
    return {name: layer.deinterleave(soft[name]) for name, layer in form.layers.items()}


def equalised_by(
    form: PacketFormat, llr: Mapping[str, Floats], soft_by_led: Mapping[str, Floats], coded: CodedBits
) -> tuple[dict[str, Floats], Floats]:
    """Return soft values by layer and luminances (pairs, n, n) of an equaliser.

    The equaliser treats codewords decoded per LED as known and returns zero LLRs. For known codewords, use the soft
    values of the LEDs, and the luminances of the decoded bits.
    """
    soft, bits = dict[str, Floats](), dict[str, Floats]()
    for name in coded:
        known = ~llr[name].any(axis=1, keepdims=True)
        soft[name] = np.where(known, soft_by_led[name], llr[name])
        bits[name] = np.where(known, np.where(coded[name], -1.0, 1.0), np.tanh(llr[name] / 2))
    return soft, expected(form, bits)


def expected(form: PacketFormat, bits: Mapping[str, Floats]) -> Floats:
    """Return luminances x' = level - 2, (pairs, n, n), from expected coded bits, -1 to 1."""
    parts = [layer.interleave(bits[name] * (1.0 - 2.0 * layer.chips)) for name, layer in form.layers.items()]
    symbols: Any = np.concatenate(parts, axis=1)  # any real values
    d = np.asarray(form.join(symbols), np.float64)
    return haar.inverse_transform(d) if form.settings.modulation == "haar" else 2.0 * d


def histograms(soft: Mapping[str, Floats], coded: CodedBits, words: Words) -> dict[str, Any]:
    """Return histograms of soft values by layer as plain values."""
    layers = {}
    for name, values in soft.items():
        scale = max(float(np.percentile(np.abs(values), 99)), TINY)
        valid, ones = values != 0, coded[name]
        known = valid & np.array([word.status == "ok" for word in words[name]])[:, None]
        parts = {"zeros": known & ~ones, "ones": known & ones, "open": valid & ~known}
        layers[name] = {
            "scale": round(scale, 3),
            **{part: _counts(values[mask], scale) for part, mask in parts.items()},
            "known": int(known.sum()),
            "wrong": int((known & ((values < 0) != ones)).sum()),
        }
    return layers


def _counts(values: Floats, scale: float) -> list[int]:
    # an odd number of bins: the middle bin contains 0
    counts: list[int] = np.histogram(np.clip(values, -scale, scale), 31, (-scale, scale))[0].tolist()
    return counts


def grey(levels: Floats, low: float, high: float) -> dict[str, Any]:
    """Return levels as a small picture: `rows`, `columns`, and `data`, values 0 to 255 row by row in Base64."""
    data = np.clip((levels - low) * (255.0 / max(high - low, TINY)), 0, 255).astype(np.uint8).tobytes()
    return {"rows": levels.shape[0], "columns": levels.shape[1], "data": b64encode(data).decode("ascii")}
