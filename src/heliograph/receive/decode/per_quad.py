"""Cut-outs read at the LEDs' positions, round by round: what is decoded tells what it leaves of its light elsewhere.

The Haar transform of the light at a square's LEDs is, for each of its four observed symbols,

    y = a (z + l) + sum_j b_j x_j + n.

z is a function of the square's own symbols, in step the symbol itself, and l light of the pairs before and after. The
blur leaves less of a fine symbol than of a coarse one: a and the variance of n are those of a kind of symbol, by
expectation and maximisation. x_j is the light of the square's other symbols and of the eight squares around, as far as
these are decoded; the b_j follow by least squares. No pose, no blur and no gain need be known for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.codeword import Decoding, Layer, decode_layer
from heliograph.receive.decode.per_led import at_leds, normalised
from heliograph.receive.equalise.symbols import SymbolMapper
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Words
from heliograph.receive.sync.combine import ObservedSymbols, UnsynchronisedPacket
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS

ROUNDS, IDLE_ROUNDS = 8, 3
"""Most readings of a packet, each with what the one before has decoded; and how many may decode nothing new in a row.

Chosen: the first bounds the time. A round that decodes nothing new still knows its symbols better than the one before,
unless all that is open is hopeless.
"""

FIRST_NOISE = 0.1
"""Variance of n at first, where the symbols are +-1. Chosen: expectation and maximisation go on from it."""

EM_STEPS, EM_STRIDE = 2, 4
"""Steps of expectation and maximisation in each round, and pairs of which one is asked.

Chosen: twelve pairs have 768 squares, which tell an amplitude to a few percent.
"""

LEAST_SYMBOL_AMPLITUDE, LEAST_SYMBOL_VARIANCE = 1e-3, 1e-4
"""Least a and least variance of n, the light of all LEDs being 1.

Tolerances: the first keeps quotients finite where blur leaves nothing of a symbol; without the second symbols that fit
by chance would be certain.
"""


RIDGE = 1e-3
"""Weight of the squares of the b_j in least squares, the light of a symbol being 1: what is not known has none.

A tolerance: light of a variance of 1 is taken for less by a thousandth.
"""

AROUND = 1
"""Squares around one whose light is looked for in it, each way. Chosen: with 2 no more was read."""


@dataclass(frozen=True, slots=True)
class _Scale:
    """Amplitude and noise of each kind of symbol."""

    # amplitude, noise: a and the variance of n, (symbols,), alike in all squares
    amplitude: Floats
    noise: Floats

    @classmethod
    def fitted(
        cls,
        symbols: Floats,
        packet: UnsynchronisedPacket,
        expected: ObservedSymbols,
        mean: Floats,
        asked: NDArray[np.intp],
    ) -> "_Scale":
        """Amplitude and noise by some pairs' observed symbols y, (pairs, symbols) as all others."""
        y, prior = symbols[asked], mean[asked]
        leak, leak_variance = expected.leak[asked], expected.leak_variance[asked]
        scale = cls(np.ones(y.shape[1]), np.full(y.shape[1], FIRST_NOISE))
        for _ in range(EM_STEPS):
            a, found, error = scale.amplitude, y / scale.amplitude - leak, scale.relative_noise + leak_variance
            first, second = packet.posterior_moments(asked, found, error, prior)
            # of z + l
            first, second = first + leak, second + (2 * first + leak) * leak
            # a = <y, z + l> / E|z + l|^2, var n = E|y - a (z + l)|^2 - a^2 var l
            weight = 1 / (a**2 * error)
            a = _alike(weight * y * first) / np.maximum(_alike(weight * second), TINY)
            noise = _alike(y**2 - 2 * a * y * first + a**2 * (second - leak_variance))
            scale = cls(np.maximum(a, LEAST_SYMBOL_AMPLITUDE), np.maximum(noise, LEAST_SYMBOL_VARIANCE))
        return scale

    @property
    def relative_noise(self) -> Floats:
        """Variance of n / a, (symbols,)."""
        return self.noise / self.amplitude**2


def read_square_by_square(
    cutouts: Sequence[Cutout | None],
    gain: float,
    form: PacketFormat,
    identity: int,
    options: Decoding,
    known: Words | None = None,
    soft: bool = True,
    glance: bool = False,
) -> Words | None:
    """Codewords by the light at each LED's position alone, of frames in step or out of it."""
    if form.single or form.settings.modulation != "haar":
        return None
    header = form.header_pattern(identity) > SLOTS // 2
    packet = UnsynchronisedPacket.of([None if cutout is None else cutout.combination for cutout in cutouts], header)
    seen = np.array([cutout is not None for cutout in cutouts])
    symbols, mapper = _observed_symbols(cutouts, gain, form), SymbolMapper(form)
    layers = {name: Layer.unknown(layer) for name, layer in form.layers.items()}
    if known is not None:
        layers = {name: layer.with_known(known[name]) for name, layer in layers.items()}
    idle = 0
    for _ in range(ROUNDS):
        before = [layer.open for layer in layers.values()]
        means = [layer.mean() for layer in layers.values()]
        mean, _ = mapper.expected(means, [layer.variances() for layer in layers.values()])
        expected = packet.expected(mean)
        alone = _without_others(symbols, np.where(seen[:, None], expected.mean + expected.leak, 0.0))
        scale = _Scale.fitted(alone, packet, expected, mean, np.flatnonzero(seen)[::EM_STRIDE])
        llrs = packet.llrs(alone / scale.amplitude, scale.relative_noise, expected, mean)
        parts = mapper.bits(np.where(seen[:, None], llrs, 0.0), means)
        layers = {
            name: decode_layer(layer.equalised(part), name, identity, options, soft)
            for (name, layer), part in zip(layers.items(), parts, strict=True)
        }
        after = [layer.open for layer in layers.values()]
        idle = idle + 1 if after == before else 0
        if glance and not idle:
            break
        if not any(after) or idle == IDLE_ROUNDS or (idle and all(layer.hopeless for layer in layers.values())):
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


def _without_others(symbols: Floats, light: Floats) -> Floats:
    """Observed symbols y, (pairs, symbols), less what the light x of others leaves in them, as far as it is known."""
    if not light.any():
        return symbols
    side = round((symbols.shape[1] // 4) ** 0.5)
    rim = np.pad(light.reshape(-1, 4, side, side), ((0, 0), (0, 0), (AROUND, AROUND), (AROUND, AROUND)))
    places = range(2 * AROUND + 1)
    # (kinds x places, squares of all pairs): the light of each kind of symbol at each place around
    x = np.stack([rim[:, k, i : i + side, j : j + side].ravel() for k in range(4) for i in places for j in places])
    y = symbols.reshape(len(symbols), 4, -1).transpose(1, 0, 2).reshape(4, -1)
    # b = (x x^T + lambda)^-1 x y^T
    b = np.linalg.solve(x @ x.T + RIDGE * x.shape[1] * np.eye(len(x)), x @ y.T)
    middle = np.arange(4) * len(places) ** 2 + len(places) ** 2 // 2
    b[middle, np.arange(4)] = 0.0  # a symbol's own light stays
    left = (y - b.T @ x).reshape(4, len(symbols), -1)
    return np.asarray(left.transpose(1, 0, 2).reshape(symbols.shape))


def _alike(values: Floats) -> Floats:
    """Mean over the squares of all pairs (pairs, symbols), given to each square, (symbols,)."""
    kinds = values.reshape(len(values), 4, -1).mean((0, 2))
    return np.repeat(kinds, values.shape[1] // 4)
