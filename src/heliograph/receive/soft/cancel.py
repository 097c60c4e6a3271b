"""From looks to codewords: what is decoded is subtracted, what is not is fed back softly, until nothing changes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.decode import LARGEST_LLR, codeword_of
from heliograph.receive.packets import Codeword
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.cells import Cells
from heliograph.receive.soft.equalise import KNOWN, Estimate, equalise
from heliograph.receive.soft.look import Look
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

    def update(self, moments: Floats) -> None:
        """Maximise the likelihood of the gain by the moments of `_moments`, summed over looks."""
        match, norm = moments
        if norm > 0:
            # g = <d, B m + o> / E|B c + o|^2
            self.gain = match / norm


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
    cells = Cells(form)
    for _ in range(settings.soft.rounds):
        before = _open(layers)
        _equalise_all(looks, light, layers, cells)
        for name, layer in layers.items():
            _decode_layer(layer, name, identity, settings)
        if not _open(layers).any() or (before - _open(layers)).max() < PROGRESS:
            break
    return {name: tuple(layer.words) for name, layer in layers.items()}


def _open(layers: dict[str, _Layer]) -> Floats:
    """Variance of each codeword, 0 where it is decoded."""
    return np.concatenate([layer.variance.mean(1) for layer in layers.values()])


def _equalise_all(looks: Sequence[Look | None], light: Light, layers: dict[str, _Layer], cells: Cells) -> None:
    """Equalise every look with what is known now; then the gain by expectation and maximisation."""
    means = [layer.mean() for layer in layers.values()]
    mean, variance = cells.expected(means, [layer.variances() for layer in layers.values()])
    llr, moments = np.zeros_like(mean), np.zeros(2)
    for number, look in enumerate(looks):
        if look is not None:
            estimate = equalise(look, light.gain, light.noise, mean[number], variance[number])
            llr[number] = estimate.llr
            moments += _moments(look, estimate)
    light.update(moments)
    for layer, part in zip(layers.values(), cells.bits(llr, means), strict=True):
        layer.llr = layer.form.deinterleave(np.clip(part, -LARGEST_LLR, LARGEST_LLR))


def _moments(look: Look, estimate: Estimate) -> Floats:
    """<d, B m + o> and E|B c + o|^2."""
    m = estimate.mean
    match = float(m @ look.seen) + look.cross
    norm = float(m @ (look.gram @ m)) + estimate.trace + 2 * float(m @ look.offset) + look.drift
    return np.array([match, norm])


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
