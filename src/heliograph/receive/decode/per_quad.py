"""Successive cancellation per quad of 2 x 2 LEDs, from samples at the LEDs.

The Haar transform of the light at the LEDs of a quad is, for each of the four observed symbols,

    y = a (z + l) + sum_j b_j x_j + n.

z is a function of the quad's symbols, in step the symbol itself, and l light of the pairs before and after. Blur
weakens fine symbols more than coarse symbols: expectation and maximisation estimate a and the variance of n for each
kind. x_j is the light of the quad's other symbols and of the eight quads around, as far as decoded; the b_j follow by
least squares. Neither pose, blur nor gain is needed.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.codeword import Decoding, Layer, SymbolMapper, is_hopeless
from heliograph.receive.decode.per_led import normalised, sample_differences
from heliograph.receive.observe.cutout import Cutouts
from heliograph.receive.packet import Words
from heliograph.receive.sync.combine import Moments, UnsynchronisedPacket
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS


def decode_per_quad(
    cutouts: Cutouts,
    gain: float,
    form: PacketFormat,
    identity: int,
    options: Decoding,
    known: Words | None = None,
    quick: bool = False,
) -> Words | None:
    """Decode samples at the LEDs, in step or out of step; None if the format has no quads."""
    if form.single or form.settings.modulation != "haar":
        return None
    combinations = [None if cutout is None else cutout.combination for cutout in cutouts]
    packet = UnsynchronisedPacket.of(combinations, form.header_pattern(identity) > SLOTS // 2)
    seen = np.array([cutout is not None for cutout in cutouts])
    # Haar transform of the light at the LEDs of each cut-out about the mean, (pairs, symbols); 0 for None
    levels = np.array([(0.5, 0.5) if combination is None else combination.levels for combination in combinations])
    mean_light = gain * (levels[:, 0] - levels[:, 1])[:, None, None]
    light = normalised(sample_differences(cutouts, form.settings.side) - mean_light, gain)
    symbols, mapper = np.concatenate([*form.split(haar.decode(light)).values()], axis=1), SymbolMapper(form)
    layers = [Layer(layer, identity, (known or {}).get(name)) for name, layer in form.layers.items()]
    idle = 0
    for _ in range(8):
        before = np.concatenate([layer.is_open for layer in layers])
        means = [layer.mean() for layer in layers]
        mean, _ = mapper.expected(means, [layer.variances() for layer in layers])
        own, leak = packet.expected(mean)
        cleaned = _cancel_neighbours(symbols, np.where(seen[:, None], own[0] + leak[0], 0.0))
        # twelve pairs show an amplitude to a few percent
        pairs = np.flatnonzero(seen)[::4]
        amplitude, noise = _estimate_scale(cleaned, packet, leak, mean, pairs)
        llrs = packet.llrs(cleaned / amplitude, noise / amplitude**2, leak, mean)
        parts = mapper.bits(np.where(seen[:, None], llrs, 0.0), means)
        for layer, part in zip(layers, parts, strict=True):
            layer.equalise(part)
            layer.decode(options)
        after = np.concatenate([layer.is_open for layer in layers])
        idle = idle + 1 if np.array_equal(after, before) else 0
        hopeless = np.concatenate([is_hopeless(layer.information, layer.form) for layer in layers])[after].all()
        # rounds that decode nothing still improve the symbols
        if (quick and not idle) or not after.any() or idle == 3 or (idle and hopeless):
            break
    return {layer.form.name: layer.words for layer in layers}


def _estimate_scale(
    symbols: Floats, packet: UnsynchronisedPacket, leaked: Moments, mean: Floats, pairs: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Amplitude a and variance of n by symbol, (symbols,), estimated from observed symbols y of some pairs."""
    y, prior = symbols[pairs], mean[pairs]
    leak, leak_variance = (moment[pairs] for moment in leaked)
    a, noise = np.ones(y.shape[1]), np.full(y.shape[1], 0.1)
    for _ in range(2):
        error = noise / a**2 + leak_variance
        first, second = packet.posterior_moments(pairs, y / a - leak, error, prior)
        # of z + l
        first, second = first + leak, second + (2 * first + leak) * leak
        # a = <y, z + l> / E|z + l|^2, var n = E|y - a (z + l)|^2 - a^2 var l
        weight = 1 / (a**2 * error)
        a = _mean_by_kind(weight * y * first) / np.maximum(_mean_by_kind(weight * second), TINY)
        noise = _mean_by_kind(y**2 - 2 * a * y * first + a**2 * (second - leak_variance))
        # finite quotients and LLRs
        a, noise = np.maximum(a, 1e-3), np.maximum(noise, 1e-4)
    return a, noise


def _cancel_neighbours(symbols: Floats, light: Floats) -> Floats:
    """Subtract the light x of other symbols, as far as it is known, from observed symbols y (pairs, symbols)."""
    if not light.any():
        return symbols
    side = round((symbols.shape[1] // 4) ** 0.5)
    padded = np.pad(light.reshape(-1, 4, side, side), ((0, 0), (0, 0), (1, 1), (1, 1)))
    # (kinds x 9, quads of all pairs): the light of each kind of symbol in the 3 x 3 quads around
    x = sliding_window_view(padded, (3, 3), (2, 3)).transpose(1, 4, 5, 0, 2, 3).reshape(36, -1)
    y = symbols.reshape(len(symbols), 4, -1).transpose(1, 0, 2).reshape(4, -1)
    # b = (x x^T + lambda)^-1 x y^T
    b = np.linalg.solve(x @ x.T + 1e-3 * x.shape[1] * np.eye(len(x)), x @ y.T)
    b[9 * np.arange(4) + 4, np.arange(4)] = 0.0  # the symbol itself stays
    return np.asarray((y - b.T @ x).reshape(4, len(symbols), -1).transpose(1, 0, 2).reshape(symbols.shape))


def _mean_by_kind(values: Floats) -> Floats:
    """Mean over the quads of all pairs (pairs, symbols), for each quad, (symbols,)."""
    return np.repeat(values.reshape(len(values), 4, -1).mean((0, 2)), values.shape[1] // 4)
