"""What a packet's light was, as received, as equalised and as decided; its soft values by layer."""

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.per_led import at_leds
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Words
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat


def luminances_of(cutouts: tuple[Cutout | None, ...], side: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Read cut-outs LED by LED."""
    out = np.zeros((len(cutouts), side, side))
    for place, one in enumerate(cutouts):
        if one is not None:
            out[place] = at_leds(one.difference, one.corner, one.middle, side)
    return out, np.array([one is not None for one in cutouts], dtype=bool)


def soft_by_layer(form: PacketFormat, luminances: Floats) -> dict[str, Floats]:
    """Soft values of the coded bits by layer, (codewords, E), positive for bit 0."""
    soft = form.split(form.soft_data(luminances))
    return {name: layer.deinterleave(soft[name]) for name, layer in form.layers.items()}


def decided(form: PacketFormat, words: Words) -> Floats | None:
    """Luminances x' = level - 2 of the patterns that a packet's decided bits make, right or not: (pairs, n, n).

    None in the single mode, whose patterns depend on those before the packet.
    """
    if form.single:
        return None
    soft = {
        name: 1.0 - 2.0 * layer.code.encode(np.stack([word.bits for word in words[name]])).astype(np.float64)
        for name, layer in form.layers.items()
    }
    return expected(form, soft)


def equalised_by(
    form: PacketFormat, llr: Mapping[str, Floats], led_by_led: Mapping[str, Floats], words: Words
) -> tuple[dict[str, Floats], Floats]:
    """Soft values by layer, and luminances (pairs, n, n), as an equaliser has them.

    Codewords that the LEDs gave by themselves it takes for known, and gives no LLRs: of these the soft values are those
    of the LEDs, and the luminances those of their bits.
    """
    soft, bits = dict[str, Floats](), dict[str, Floats]()
    for name, values in llr.items():
        coded = form.layers[name].code.encode(np.stack([word.bits for word in words[name]]))
        known = ~values.any(axis=1, keepdims=True)
        soft[name] = np.where(known, led_by_led[name], values)
        bits[name] = np.where(known, 1.0 - 2.0 * coded, np.tanh(values / 2))
    return soft, expected(form, bits)


def expected(form: PacketFormat, bits: Mapping[str, Floats]) -> Floats:
    """Luminances x' = level - 2 by the expected values of the coded bits: (pairs, n, n)."""
    parts = [layer.interleave(bits[name] * (1.0 - 2.0 * layer.chips)) for name, layer in form.layers.items()]
    symbols: Any = np.concatenate(parts, axis=1)  # of any real values
    d = np.asarray(form.join(symbols), np.float64)
    return haar.inverse_transform(d) if form.settings.modulation == "haar" else 2.0 * d


def histograms(form: PacketFormat, soft: Mapping[str, Floats], words: Words) -> dict[str, Any]:
    """Soft values by layer as histograms, as plain values."""
    out = {}
    for name, values in soft.items():
        read = np.array([word.status == "ok" for word in words[name]])
        sent = form.layers[name].code.encode(np.stack([word.bits for word in words[name]])).astype(bool)
        scale = max(float(np.percentile(np.abs(values), 99)), TINY)
        known, got = np.broadcast_to(read[:, None], values.shape), values != 0
        out[name] = {
            "scale": round(scale, 3),
            "zeros": _bars(values[known & got & ~sent], scale),
            "ones": _bars(values[known & got & sent], scale),
            "open": _bars(values[~known & got], scale),
            "known": int((known & got).sum()),
            "wrong": int((known & got & ((values < 0) != sent)).sum()),
        }
    return out


def _bars(values: Floats, scale: float) -> list[int]:
    # Bars of a histogram of soft values, the middle one about 0. Chosen
    counts, _ = np.histogram(np.clip(values, -scale, scale), 31, (-scale, scale))
    return [int(one) for one in counts]


def grey(levels: Floats, low: float, high: float) -> dict[str, Any]:
    """Levels as a small gray picture: `rows`, `columns`, and `data`, values 0 to 255 row by row in Base64."""
    scaled = (levels - low) * (255.0 / max(high - low, TINY))
    data = np.clip(scaled, 0, 255).astype(np.uint8).tobytes()
    return {"rows": levels.shape[0], "columns": levels.shape[1], "data": b64encode(data).decode("ascii")}
