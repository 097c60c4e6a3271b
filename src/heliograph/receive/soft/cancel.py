"""From looks to codewords: what is decoded is subtracted, what is not is fed back softly, until nothing changes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.decode import LARGEST_LLR, codeword_of
from heliograph.receive.packets import Codeword
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft import squares
from heliograph.receive.soft.equalise import KNOWN, Estimate, equalise
from heliograph.receive.soft.look import LEAST_NOISE, Look
from heliograph.receive.soft.mix import Mix
from heliograph.signal.block import check
from heliograph.signal.packet import LayerFormat, PacketFormat

Floats = NDArray[np.float64]

PROGRESS = 0.003
"""A round that lowers the variance of no open codeword by more is the last."""


@dataclass(slots=True)
class Light:
    """Gain and noise of a packet's looks; the gain is estimated anew along with the cells.

    Attributes
    ----------
    gain
        Gray levels of a wide array with all LEDs on.
    noise
        Variance of a pixel of a difference.
    """

    gain: float
    noise: float

    def update(self, moments: Floats, mixed: bool) -> None:
        """Maximise the likelihood of the gain by the moments of `_moments`, summed over looks.

        Of `mixed` looks that of the noise too: their sums are no even light, by which it could be told beforehand.
        """
        match, norm, power, pixels = moments
        if norm > 0:
            # g = <d, B m + o> / E|B c + o|^2
            self.gain = match / norm
        if mixed:
            self.noise = max((power - 2 * self.gain * match + self.gain**2 * norm) / pixels, LEAST_NOISE)


@dataclass(slots=True)
class _Layer:
    """What is known of a layer's codewords.

    Attributes
    ----------
    form
        Its format.
    llr
        (codewords, E) of the equaliser's last round.
    soft
        (codewords, E) mean of each coded bit, 1 for 0 and -1 for 1.
    variance
        (codewords, E) variance of each.
    words
        The codewords by the last decoding.
    """

    form: LayerFormat
    llr: Floats
    soft: Floats
    variance: Floats
    words: list[Codeword]

    @classmethod
    def unknown(cls, form: LayerFormat) -> "_Layer":
        shape = form.codewords, form.code.length
        return cls(form, np.zeros(shape), np.zeros(shape), np.ones(shape), [])

    def mean(self) -> Floats:
        """(pairs, cells) mean of each cell."""
        return self.form.interleave(self.soft * (1.0 - 2.0 * self.form.chips))

    def variances(self) -> Floats:
        """(pairs, cells) variance of each cell."""
        return self.form.interleave(self.variance)


def decode_looks(
    looks: Sequence[Look | None], light: Light, form: PacketFormat, identity: int, settings: ReceiveSettings
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet.

    Parameters
    ----------
    looks
        One a data pair; None where the array was not seen.
    light
        First guess of gain and noise; refined in place.
    form
        The packet's format.
    identity
        The array's; a block of another array is a mismatch.
    settings
        The receiver's.

    Returns
    -------
    Codewords by layer.
    """
    layers = {name: _Layer.unknown(layer) for name, layer in form.layers.items()}
    header = form.header_pattern(identity) > 0
    for _ in range(settings.soft.rounds):
        before = _open(layers)
        _equalise_all(looks, light, layers, header)
        for name, layer in layers.items():
            _decode_layer(layer, name, identity, settings)
        if not _open(layers).any() or (before - _open(layers)).max() < PROGRESS:
            break
    return {name: tuple(layer.words) for name, layer in layers.items()}


def _open(layers: dict[str, _Layer]) -> Floats:
    """Variance of each codeword, 0 where it is decoded."""
    return np.concatenate([layer.variance.mean(1) for layer in layers.values()])


def _equalise_all(
    looks: Sequence[Look | None], light: Light, layers: dict[str, _Layer], header: NDArray[np.bool_]
) -> None:
    """Equalise every look with what is known now; then the gain by expectation and maximisation."""
    mean = np.concatenate([layer.mean() for layer in layers.values()], axis=1)
    variance = np.concatenate([layer.variances() for layer in layers.values()], axis=1)
    llr, moments = np.zeros_like(mean), np.zeros(4)
    for number, look in enumerate(looks):
        if look is None:
            continue
        if look.mix is None:
            estimate = equalise(look, light.gain, light.noise, mean[number], variance[number])
            llr[number] = estimate.llr
        else:
            around = [mean[k] if 0 <= k < len(mean) else None for k in (number - 1, number + 1)]
            llr[number], estimate = _equalise_mixed(look, look.mix, light, mean[number], around, header)
        moments += _moments(look, estimate)
    light.update(moments, any(look is not None and look.mix is not None for look in looks))
    edges = np.cumsum([layer.form.cells for layer in layers.values()])[:-1]
    for layer, part in zip(layers.values(), np.split(llr, edges, axis=1), strict=True):
        layer.llr = layer.form.deinterleave(np.clip(part, -LARGEST_LLR, LARGEST_LLR))


def _equalise_mixed(
    look: Look, mix: Mix, light: Light, mean: Floats, around: Sequence[Floats | None], header: NDArray[np.bool_]
) -> tuple[Floats, Estimate]:
    """LLRs of the cells of a pair combined of frames out of step.

    What is equalised is the cells as seen: functions of the four cells of a square, and what is seen of the pairs
    `around`, which are the header where they are None. From them the cells follow square by square.
    """
    seen, spread = squares.moments(mix.table, mean)
    leak, leak_spread = np.zeros_like(mean), np.zeros_like(mean)
    for table, slots, other, leaky in zip(mix.leaks, mix.slots[[0, 2]], around, mix.leaky, strict=True):
        if not leaky:
            continue
        if other is None:
            leak += squares.seen_of_levels(slots, header)
            continue
        part, more = squares.moments(table, other)
        leak, leak_spread = leak + part, leak_spread + more
    estimate = equalise(look, light.gain, light.noise, seen + leak, spread + leak_spread)
    precision = np.maximum(estimate.precision, 1e-6)
    measured = 0.5 * estimate.llr / precision - leak
    return squares.true_llrs(mix.table, measured, 1 / precision + leak_spread, mean), estimate


def _moments(look: Look, estimate: Estimate) -> Floats:
    """<d, B m + o>, E|B c + o|^2, |d|^2 and the number of pixels."""
    m = estimate.mean
    match = float(m @ look.seen) + look.cross
    norm = float(m @ (look.gram @ m)) + estimate.trace + 2 * float(m @ look.offset) + look.drift
    return np.array([match, norm, look.power, look.pixels])


def _decode_layer(layer: _Layer, name: str, identity: int, settings: ReceiveSettings) -> None:
    """Decode the codewords still open and tell what is known of their bits by now."""
    code, words = layer.form.code, []
    for i, llr in enumerate(layer.llr):
        if layer.words and layer.words[i].status != "crc_fail":
            words.append(layer.words[i])
            continue
        result = code.decode(
            llr[None],
            algorithm=settings.soft.algorithm,
            iterations=settings.decode.iterations,
            stop="crc",
            check=check,
            coded_output=True,
        )
        assert result.coded_llr is not None  # it was asked for
        margin = float(np.abs(result.llr).mean())
        word = codeword_of((result.bits[0], int(result.iterations[0]), margin), llr, identity, name)
        words.append(word)
        if word.status == "crc_fail":
            layer.soft[i] = np.tanh(0.5 * np.clip(result.coded_llr[0], -LARGEST_LLR, LARGEST_LLR))
            layer.variance[i] = np.maximum(1 - layer.soft[i] ** 2, 2 * KNOWN)
        else:
            layer.soft[i], layer.variance[i] = 1.0 - 2.0 * code.encode(word.bits), 0.0
    layer.words = words
