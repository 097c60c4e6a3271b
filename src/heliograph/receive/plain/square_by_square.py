"""Cut-outs of frames out of step, read as `led_by_led` reads those in step: where LEDs are resolved, this is enough.

The Haar transform of the light at a square's LEDs is y = a (r + l) + n for each of its four observed symbols. r is a
function of the square's own symbols, l light of the pairs before and after, and the blur leaves less of a fine symbol
than of a coarse one: a and the variance of n are those of a kind of symbol, by expectation and maximisation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.layer import Layer, decode_layer
from heliograph.receive.equalise.polarity import SymbolMapper
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packets import Words
from heliograph.receive.plain.extract import at_leds, normalised
from heliograph.receive.timing import partial_exposure
from heliograph.receive.timing.out_of_step import ObservedSymbols, OutOfStep
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS

ROUNDS = 4
"""Most readings of a packet, each with what the one before has decoded.

Chosen: it bounds the time; there are three layers, and a round that decodes nothing is the last.
"""

FIRST_NOISE = 0.1
"""Variance of n at first, where the symbols are +-1. Chosen: expectation and maximisation go on from it."""

EM_STEPS, EM_STRIDE = 3, 4
"""Steps of expectation and maximisation in each round, and pairs of which one is asked.

Chosen: twelve pairs have 768 squares, which tell an amplitude to a few percent.
"""

LEAST_SYMBOL_AMPLITUDE, LEAST_SYMBOL_VARIANCE = 1e-3, 1e-4
"""Least a and least variance of n, the light of all LEDs being 1.

Tolerances: the first keeps quotients finite where blur leaves nothing of a symbol; without the second symbols that fit
by chance would be certain.
"""


@dataclass(frozen=True, slots=True)
class _Scale:
    """Amplitude and noise of each kind of symbol.

    Attributes
    ----------
    amplitude, noise
        a and the variance of n, (symbols,), alike in all squares.
    """

    amplitude: Floats
    noise: Floats

    @classmethod
    def unknown(cls, side: int) -> "_Scale":
        """Amplitude and noise before any symbol is known of an array of so many LEDs a row."""
        return cls(np.ones(side**2), np.full(side**2, FIRST_NOISE))

    @property
    def relative_noise(self) -> Floats:
        """Variance of n / a, (symbols,)."""
        return self.noise / self.amplitude**2

    def fitted(
        self, symbols: Floats, packet: OutOfStep, expected: ObservedSymbols, mean: Floats, asked: NDArray[np.intp]
    ) -> "_Scale":
        """Amplitude and noise by some pairs' observed symbols y, (pairs, symbols) as all others."""
        response, y, prior = packet.response[asked], symbols[asked], mean[asked]
        leak, leak_variance, scale = expected.leak[asked], expected.leak_variance[asked], self
        for _ in range(EM_STEPS):
            a, found, error = scale.amplitude, y / scale.amplitude - leak, scale.relative_noise + leak_variance
            first, second = partial_exposure.posterior_moments(response, found, error, prior)
            # of r + l
            first, second = first + leak, second + (2 * first + leak) * leak
            # a = <y, r + l> / E|r + l|^2, var n = E|y - a (r + l)|^2 - a^2 var l
            weight = 1 / (a**2 * error)
            a = _alike(weight * y * first) / np.maximum(_alike(weight * second), TINY)
            noise = _alike(y**2 - 2 * a * y * first + a**2 * (second - leak_variance))
            scale = _Scale(np.maximum(a, LEAST_SYMBOL_AMPLITUDE), np.maximum(noise, LEAST_SYMBOL_VARIANCE))
        return scale


def read_square_by_square(
    cutouts: Sequence[Cutout | None], gain: float, form: PacketFormat, identity: int, options: Decoding
) -> Words | None:
    """Codewords by the light at each LED's position alone, of frames in step or out of it.

    Parameters
    ----------
    cutouts
        One per pair, one at least; None where the array was not seen.
    gain
        Gray levels of the array with all LEDs on; it need not be exact.
    form
        Format of the packet: its mode, its layers and their codes.
    identity
        Number of the array, 0 to 29; a block of another array is a mismatch.
    options
        Algorithm of the channel decoder, and its most iterations.

    Returns
    -------
    Codewords by layer, decoded or not; None without inverses, and where data are on or off: it does not read these.
    """
    if form.single or form.settings.modulation != "haar":
        return None
    header = form.header_pattern(identity) > SLOTS // 2
    packet = OutOfStep.of([None if cutout is None else cutout.combination for cutout in cutouts], header)
    seen = np.array([cutout is not None for cutout in cutouts])
    symbols, scale = _observed_symbols(cutouts, gain, form), _Scale.unknown(form.settings.side)
    layers, mapper = {name: Layer.unknown(layer) for name, layer in form.layers.items()}, SymbolMapper(form)
    for _ in range(ROUNDS):
        before = [layer.open for layer in layers.values()]
        means = [layer.mean() for layer in layers.values()]
        mean, _ = mapper.expected(means, [layer.variances() for layer in layers.values()])
        expected = packet.expected(mean)
        scale = scale.fitted(symbols, packet, expected, mean, np.flatnonzero(seen)[::EM_STRIDE])
        llrs = packet.llrs(symbols / scale.amplitude, scale.relative_noise, expected, mean)
        parts = mapper.bits(np.where(seen[:, None], llrs, 0.0), means)
        layers = {
            name: decode_layer(layer.equalised(part), name, identity, options, feedback=True)
            for (name, layer), part in zip(layers.items(), parts, strict=True)
        }
        nothing_new = before == [layer.open for layer in layers.values()]
        if nothing_new or all(layer.hopeless for layer in layers.values()):
            break
    return {name: layer.words for name, layer in layers.items()}


def _observed_symbols(cutouts: Sequence[Cutout | None], gain: float, form: PacketFormat) -> Floats:
    """Haar transform of the light at the LEDs of each cut-out about its mean, (pairs, symbols); 0 of None."""
    side = form.settings.side
    light = np.zeros((len(cutouts), side, side))
    for place, cutout in enumerate(cutouts):
        if cutout is None:
            continue
        pattern, inverse = (0.5, 0.5) if cutout.combination is None else cutout.combination.levels
        shown = at_leds(cutout.difference, cutout.corner, cutout.middle, side)
        light[place] = normalised(shown - gain * (pattern - inverse), gain)
    return np.concatenate([*form.split(haar.decode(light)).values()], axis=1)


def _alike(values: Floats) -> Floats:
    """Mean over the squares of all pairs (pairs, symbols), given to each square, (symbols,)."""
    kinds = values.reshape(len(values), 4, -1).mean((0, 2))
    return np.repeat(kinds, values.shape[1] // 4)
