"""Turbo equaliser: MMSE equaliser and channel decoder in turns, with parallel interference cancellation.

The light of decoded codewords is subtracted; soft values of the others are the equaliser's priors, until the codewords
converge. Gain and noise are estimated along with the symbols by expectation and maximisation.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.codeword import HOPELESS, Decoding, Layer, decode_layer
from heliograph.receive.decode.combining import BufferedPacket, SoftBuffer
from heliograph.receive.equalise.ep import LEAST_PRECISION, ExpectationPropagation
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, Estimate, equalise, llr_of
from heliograph.receive.equalise.symbols import SymbolMapper
from heliograph.receive.events import EqualiseEvent, ignore
from heliograph.receive.observe.noise import LEAST_NOISE
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Words, with_raw
from heliograph.receive.settings import Feedback
from heliograph.receive.sync.combine import UnsynchronisedPacket
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS


@dataclass(frozen=True, slots=True)
class GainAndNoise:
    """Gain and noise of a packet."""

    # Gray levels of the array with all LEDs on
    gain: float
    # Variance of a pixel of a difference in squared gray levels
    noise: float
    # Largest gain that the sensor can show, in gray levels
    full_scale: float = math.inf

    def updated(self, moments: Floats, combined: bool) -> "GainAndNoise":
        """Maximise the expected likelihood (a step of expectation and maximisation)."""
        match, norm, power, pixels = moments
        # g = <d, B m + o> / E|B c + o|^2; of pairs that do not show the array it may be anything
        gain = min(match / norm, self.full_scale) if match > 0 and norm > 0 else self.gain
        if not combined:
            return replace(self, gain=gain)
        # s^2 = E|d - g (B c + o)|^2 / pixels
        noise = (power - 2 * gain * match + gain**2 * norm) / pixels
        return replace(self, gain=gain, noise=max(noise, LEAST_NOISE))


def moments_of(pair: PairStatistics, estimate: Estimate) -> Floats:
    """Moments of a pair by which gain and noise are estimated."""
    m = estimate.mean
    match = float(m @ pair.matched) + pair.cross
    norm = (
        float(m @ (pair.gram @ m.astype(np.float32))) + estimate.trace + 2 * float(m @ pair.offset) + pair.offset_power
    )
    return np.array([match, norm, pair.power, pair.pixels])


class Observed(Protocol):
    """Observed pairs of a packet; see `pose_refinement.ObservedPacket`."""

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair, in the single mode of each pattern; None for missing pairs."""

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with its poses refined by the symbols; itself if no pose moves."""

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with the LED brightness by decoded symbols; itself if it hardly changes."""


ObservedT = TypeVar("ObservedT", bound=Observed)


@dataclass(frozen=True, slots=True)
class DecodedPacket(Generic[ObservedT]):
    """Result of the iterations."""

    # Codewords by layer, decoded or not
    words: Words
    # Observed pairs with the last poses and LED gains
    observed: ObservedT
    # mean, variance: (pairs, n^2) mean, -1 to 1, and variance, 0 to 1, of each symbol; in the single mode by pattern
    mean: Floats
    variance: Floats
    # Last estimate of gain and noise
    channel: GainAndNoise
    # Buffer of the array with this packet; None if unused
    buffer: SoftBuffer | None


@dataclass(frozen=True, slots=True)
class Lines:
    """Observed symbols of pairs out of step, each square of 2 x 2 LEDs having a single open symbol u or none.

    The observed symbols of a square are start + slope u, and the pairs before and after depend on u in the same way. So
    the equaliser has a quarter of the unknowns, and uses the dependence of a square's observed symbols.
    """

    # (pairs, squares) number of the open symbol of each square in the pair; any symbol of a square with all known
    open: NDArray[np.intp]
    # (pairs, symbols) observed symbols if all u of the pair are 0, with the known light of other pairs
    start: Floats
    # (pairs, symbols) slopes of the observed symbols by u
    slope: Floats
    # mean, variance: (pairs, squares) mean and variance of u
    mean: Floats
    variance: Floats
    # leak, leak_variance: (pairs, squares) mean and variance of the light of neighbouring pairs, in units of u
    leak: Floats
    leak_variance: Floats

    @classmethod
    def of(cls, packet: UnsynchronisedPacket, mean: Floats, variance: Floats) -> "Lines | None":
        """Lines of a packet's pairs; None if a square has more than one open symbol."""
        kinds = variance.reshape(len(variance), 4, -1)
        if ((kinds >= KNOWN_VARIANCE).sum(1) > 1).any():
            return None
        which = kinds.argmax(1)
        open_ = which * kinds.shape[-1] + np.arange(kinds.shape[-1])
        u, spread = (np.take_along_axis(values, open_, 1) for values in (mean, variance))
        start, slope = _line(packet.response, mean, which)
        start += packet.headers
        power = np.maximum(_product(slope, slope), TINY)
        leak, leak_variance = np.zeros_like(u), np.zeros_like(u)
        later, earlier = slice(1, None), slice(-1)
        for pairs, others, response in ((later, earlier, packet.before), (earlier, later, packet.after)):
            begin, leaks = _line(response[pairs], mean[others], which[others])
            part = _product(leaks, slope[pairs]) / power[pairs]
            # of the light across the pair's line only the mean is used
            aside = leaks - np.tile(part, 4) * slope[pairs]
            start[pairs] += begin + aside * np.tile(u[others], 4)
            leak[pairs] += part * u[others]
            leak_variance[pairs] += part**2 * spread[others]
        return cls(open_, start, slope, u, spread, leak, leak_variance)

    def equalise(self, number: int, pair: PairStatistics, channel: GainAndNoise) -> tuple[Floats, Floats]:
        """Equalise a pair along the lines."""
        along = pair.along(self.start[number], self.slope[number])
        leak, leak_variance = self.leak[number], self.leak_variance[number]
        estimate = equalise(
            along, channel.gain, channel.noise, self.mean[number] + leak, self.variance[number] + leak_variance
        )
        precision, weighted = estimate.extrinsic
        # 1 / precision is the variance of u and the leak together
        of_symbol = precision / (1 + precision * leak_variance)
        llr = np.zeros_like(self.start[number])
        llr[self.open[number]] = llr_of(of_symbol, of_symbol * (weighted / np.maximum(precision, TINY) - leak))
        return llr, moments_of(along, estimate)


def _line(response: Floats, mean: Floats, which: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Observed symbols half way between both values of each square's open symbol, and from there to the value +1.

    response (pairs, 16, 4) by the values of a square's symbols; mean (pairs, symbols) of the symbols; which (pairs,
    squares) of the four is open.
    """
    bits = np.arange(4)[:, None]
    # bit i of a value's number: 1 where symbol i is -1
    negative = (mean.reshape(len(mean), 4, -1) < 0) & (bits != which[:, None])
    others = (negative << bits).sum(1)
    plus, minus = (
        np.swapaxes(np.take_along_axis(response, value[..., None], 1), 1, 2).reshape(mean.shape)
        for value in (others, others | (1 << which))
    )
    return 0.5 * (plus + minus), 0.5 * (plus - minus)


def _product(a: Floats, b: Floats) -> Floats:
    """Inner products (pairs, squares) of observed symbols (pairs, symbols)."""
    return np.asarray((a * b).reshape(len(a), 4, -1).sum(1))


LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class IterationParameters:
    """Limits of the iterations between equaliser and decoder."""

    # Maximum number of iterations: at 150 m packets take four to seven
    max_iterations: int = 24
    # Gain of information, in bit per coded bit, below which iterations end if no codeword decodes
    min_progress: float = 0.002
    # Relative change of the noise of pairs out of step below which it counts as estimated
    noise_tolerance: float = 0.01
    # Maximum number of refinements of the poses
    max_refinements: int = 6


PARAMETERS = IterationParameters()


def decode_iteratively(
    observed: ObservedT,
    channel: GainAndNoise,
    form: PacketFormat,
    identity: int,
    options: Decoding,
    buffer: SoftBuffer | None,
    feedback: Feedback = "propagation",
    observe: Callable[[EqualiseEvent], None] = ignore,
    known: Words | None = None,
) -> DecodedPacket[ObservedT]:
    """Decode all layers of a packet."""
    packet = _Packet.begin(observed.statistics, channel, form, identity, options, feedback, known)
    observed = packet.decode(observed, buffer, observe)
    words = packet.words
    if packet.earlier is not None and packet.open.any():
        # the earlier packet may differ and disturb by light; poses stay refined
        alone = _Packet.begin(observed.statistics, packet.channel, form, identity, options, feedback, known)
        observed = alone.decode(observed, None, observe)
        if alone.open.sum() < packet.open.sum():
            if buffer is not None:
                buffer = buffer.without(packet.earlier).with_packet(packet.earlier)
            packet, words = alone, with_raw(alone.words, words)
    (mean, variance), channel = packet.expected(), packet.channel
    after = None if buffer is None else packet.added_to(buffer)
    return DecodedPacket(words, observed, mean, variance, channel, after)


@dataclass(slots=True)
class _Packet:
    """State of a packet between iterations."""

    # form, identity, options, feedback: see `decode_iteratively`
    form: PacketFormat
    identity: int
    options: Decoding
    feedback: Feedback
    # Statistics of the pairs, with earlier repetitions
    statistics: Sequence[PairStatistics | None]
    # Gain and noise
    channel: GainAndNoise
    # Codewords and bits by layer
    layers: dict[str, Layer]
    # Mapping between the layers' bits and the symbols
    mapper: SymbolMapper
    # (codewords,) bit per coded bit in the LLRs of the last iteration
    information: Floats
    # Observed symbols of pairs out of step; None in step
    out_of_step: UnsynchronisedPacket | None = None
    # Sites of the symbols; None if symbols are taken as Gaussian
    propagation: ExpectationPropagation | None = None
    # The same packet as received before
    earlier: BufferedPacket | None = None

    @classmethod
    def begin(
        cls,
        statistics: Sequence[PairStatistics | None],
        channel: GainAndNoise,
        form: PacketFormat,
        identity: int,
        options: Decoding,
        feedback: Feedback,
        known: Words | None,
    ) -> "_Packet":
        """Packet before the first iteration, with some known codewords."""
        layers = {name: Layer.unknown(layer) for name, layer in form.layers.items()}
        if known is not None:
            layers = {name: layer.with_known(known[name]) for name, layer in layers.items()}
        codewords = sum(layer.codewords for layer in form.layers.values())
        mapper, none = SymbolMapper(form), np.zeros(codewords)
        packet = cls(form, identity, options, feedback, statistics, channel, layers, mapper, none)
        combinations = [None if pair is None else pair.combination for pair in statistics]
        if any(combination is not None for combination in combinations):
            packet.out_of_step = UnsynchronisedPacket.of(combinations, form.header_pattern(identity) > SLOTS // 2)
        elif feedback == "propagation":
            # not for combined pairs, where observed symbols are products with more than two values
            packet.propagation = ExpectationPropagation.begin((len(statistics), form.settings.side**2))
        return packet

    def decode(
        self, observed: ObservedT, buffer: SoftBuffer | None, observe: Callable[[EqualiseEvent], None]
    ) -> ObservedT:
        """Iterate between equaliser and decoder; return the pairs with refined poses."""
        # poses of combined pairs are not refined
        refinements = PARAMETERS.max_refinements if self.feedback != "none" and not self.combined else 0
        due, moved = not self.open.all(), False
        for number in range(PARAMETERS.max_iterations):
            before, open_, noise = self.information, self.open, self.channel.noise
            self.equalise()
            if number == 0 and buffer is not None:
                self.add_earlier(buffer)
            observe(EqualiseEvent(self.identity, number, {name: layer.llr for name, layer in self.layers.items()}))
            soft = self.feedback in ("soft", "propagation")
            self.layers = {
                name: decode_layer(layer, name, self.identity, self.options, soft)
                for name, layer in self.layers.items()
            }
            if self.earlier is not None:
                # before the bits help to decode the rest
                self.layers = {name: layer.reject_inconsistent() for name, layer in self.layers.items()}
            left = self.open
            self.information = np.concatenate([layer.information for layer in self.layers.values()])
            if not left.any() or self.feedback == "none":
                break
            decoded = left.sum() < open_.sum()
            # gain and noise of pairs out of step are first guesses
            guessed = self.combined and number == 0
            due |= decoded
            hopeless = bool(self.hopeless[left].all())
            # the codewords decoded just now may have been the only disturbance of the others
            promising = decoded and not hopeless
            # at least once, and until the poses stay: they may make a codeword seem hopeless
            is_first = refinements == PARAMETERS.max_refinements
            if refinements and due and not promising and (is_first or moved or not hopeless):
                refined = observed.refined(*self.expected(), self.channel.gain, self.channel.noise)
                moved, observed = refined is not observed, refined
                self.replace(observed.statistics)
                if moved:
                    self.drop_feedback()
                due, refinements = moved, refinements - 1
            elif moved:
                # this iteration had no feedback: another iteration follows
                moved = False
            elif not (decoded or guessed) and (hopeless or self.gained_little(left, before, noise)):
                # this is the end, unless LEDs differ
                corrected = observed.with_led_brightness(*self.expected(), self.channel.gain, self.channel.noise)
                if corrected is observed or not refinements:
                    break
                observed, moved, refinements = corrected, True, refinements - 1
                self.replace(observed.statistics)
                self.drop_feedback()
        return observed

    @property
    def words(self) -> Words:
        """Codewords by layer, as last decoded."""
        return {name: layer.words for name, layer in self.layers.items()}

    @property
    def open(self) -> NDArray[np.bool_]:
        """(codewords,) True if not decoded."""
        words = [word for layer in self.layers.values() for word in layer.words]
        return np.array([word.status == "crc_fail" for word in words] or [True] * len(self.information))

    def gained_little(self, left: NDArray[np.bool_], before: Floats, noise: float) -> bool:
        """Return True if an iteration added little information, and the noise is estimated."""
        settled = not self.combined or abs(self.channel.noise - noise) < PARAMETERS.noise_tolerance * noise
        return settled and bool((self.information - before)[left].max() < PARAMETERS.min_progress)

    @property
    def hopeless(self) -> NDArray[np.bool_]:
        """(codewords,) True if there is too little information to decode."""
        codes = [layer.form.code for layer in self.layers.values() for _ in layer.llr]
        return self.information < HOPELESS * np.array([code.k / code.length for code in codes])

    @property
    def combined(self) -> bool:
        """True if any pair was combined of frames out of step."""
        return self.out_of_step is not None

    def expected(self) -> tuple[Floats, Floats]:
        """Mean and variance of all symbols, (patterns, symbols)."""
        values = self.layers.values()
        return self.mapper.expected([layer.mean() for layer in values], [layer.variances() for layer in values])

    def replace(self, statistics: Sequence[PairStatistics | None]) -> None:
        """Replace the statistics, and add earlier repetitions."""
        earlier, channel = self.earlier, self.channel
        self.statistics = statistics if earlier is None else earlier.joined(statistics, channel.gain, channel.noise)

    def drop_feedback(self) -> None:
        """Drop the feedback of undecoded codewords."""
        self.layers = {name: layer.without_feedback() for name, layer in self.layers.items()}
        if self.propagation:
            self.propagation.forget()

    def add_earlier(self, buffer: SoftBuffer) -> None:
        """Add the same packet from the buffer, otherwise the same codewords."""
        self.layers = {name: layer.with_own() for name, layer in self.layers.items()}
        if not self.combined:
            own = [llr for layer in self.layers.values() for llr in layer.own]
            self.earlier = buffer.same_packet(self.form.format, own)
        if self.earlier is not None:
            self.replace(self.statistics)
            if self.propagation:
                self.propagation.forget()
            self.equalise()
            return
        self.layers = {
            name: layer.with_earlier(
                np.stack([buffer.same_codeword((name, layer.form.code), own) for own in layer.own])
            )
            for name, layer in self.layers.items()
        }

    def added_to(self, buffer: SoftBuffer) -> SoftBuffer:
        """Return the buffer with the codewords that failed, or needed earlier packets.

        The packet is equalised once more with no feedback of failed codewords, which would count again with each
        repetition.
        """
        if self.earlier is not None:
            # now the newest, or part of this packet's sum
            buffer = buffer.without(self.earlier)
        if not self.open.any() or all(pair is None for pair in self.statistics):
            return buffer if self.earlier is None else buffer.with_packet(self.earlier)
        self.drop_feedback()
        self.equalise()
        if not self.combined:
            llrs = tuple(llr for layer in self.layers.values() for llr in layer.known_llrs())
            statistics, channel = tuple(self.statistics), self.channel
            packet = BufferedPacket(self.form.format, llrs, statistics, channel.gain, channel.noise)
            buffer = buffer.with_packet(packet)
        if self.earlier is not None:
            # LLRs of a repeated packet would count again with each repetition
            return buffer
        for name, layer in self.layers.items():
            for i in range(len(layer.words)):
                if layer.needed_earlier(i):
                    buffer = buffer.with_codeword((name, layer.form.code), layer.llr[i], layer.earlier_llr[i])
        return buffer

    def equalise(self) -> None:
        """Equalise every pair with the present priors, then estimate the gain again."""
        channel, (mean, variance) = self.channel, self.expected()
        llr, moments = np.zeros_like(mean), np.zeros(4)
        priors = self.propagation.priors(mean, variance) if self.propagation else (mean, variance)
        lines = None if self.out_of_step is None else Lines.of(self.out_of_step, mean, variance)
        expected = None if self.out_of_step is None or lines is not None else self.out_of_step.expected(mean)
        precision, weighted = np.zeros((2, *mean.shape))
        for number, pair in enumerate(self.statistics):
            if pair is None:
                continue
            try:
                if pair.combination is None:
                    estimate = equalise(pair, channel.gain, channel.noise, priors[0][number], priors[1][number])
                    llr[number] = self.propagation.take(number, estimate) if self.propagation else estimate.llr
                elif expected is None:
                    assert lines is not None  # for a pair out of step
                    llr[number], pair_moments = lines.equalise(number, pair, channel)
                    moments += pair_moments
                    continue
                else:
                    # observed symbols: functions of the four symbols of a square, and light of the neighbouring pairs
                    light = expected.mean[number] + expected.leak[number]
                    spread = expected.variance[number] + expected.leak_variance[number]
                    estimate = equalise(pair, channel.gain, channel.noise, light, spread)
                    precision[number], weighted[number] = estimate.extrinsic
            except np.linalg.LinAlgError as error:
                LOG.info("array %d: pair %d is left out: %s", self.identity, number, error)
                continue
            moments += moments_of(pair, estimate)
        if self.out_of_step is not None and expected is not None:
            # the symbols follow square by square
            bounded = np.maximum(precision, LEAST_PRECISION)
            squares = self.out_of_step.llrs(weighted / bounded, 1 / bounded, expected, mean)
            llr = np.where(precision.any(1)[:, None], squares, llr)
        self.channel = channel.updated(moments, self.combined)
        parts = self.mapper.bits(llr, [layer.mean() for layer in self.layers.values()])
        pairs = zip(self.layers.items(), parts, strict=True)
        self.layers = {name: layer.equalised(part) for (name, layer), part in pairs}
