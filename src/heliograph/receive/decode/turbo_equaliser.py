"""Gain and noise of a packet by expectation and maximisation, along with its symbols.

What the iterations begin with and end with: a packet's pairs as they were observed, and the packet once decoded.

Pairs out of step of whose squares of 2 x 2 LEDs at most one symbol is open: what is observed lies on lines.

A square's observed symbols are a function of its four symbols. With three of them known they are start + direction u,
u being the open symbol, and the light of the pairs before and after is the same in these pairs' open symbols. So the
equaliser has a quarter of the unknowns for each kind of pair, and knows how the observed symbols of a square belong
together.

Iterative receiver: MMSE equaliser with parallel interference cancellation through the decoder.

The light of decoded codewords is subtracted; soft values of the others are fed back as the equaliser's priors, until
nothing changes any more.
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
    """What a pair says of gain and noise."""
    m = estimate.mean
    match = float(m @ pair.matched) + pair.cross
    norm = (
        float(m @ (pair.gram @ m.astype(np.float32))) + estimate.trace + 2 * float(m @ pair.offset) + pair.offset_power
    )
    return np.array([match, norm, pair.power, pair.pixels])


class Observed(Protocol):
    """The pairs of a packet as they were observed; see `pose_refinement.ObservedPacket`."""

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        """Statistics of each pair, in the single mode of each pattern; None where the array was not seen."""

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with its poses refined by what is known of the symbols; itself where none moves."""

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> Self:
        """Return the packet with the LEDs' brightness learnt by what is decoded; itself where it hardly changes."""


ObservedT = TypeVar("ObservedT", bound=Observed)


@dataclass(frozen=True, slots=True)
class DecodedPacket(Generic[ObservedT]):
    """A packet once it is decoded."""

    # Its codewords by layer, decoded or not
    words: Words
    # Its pairs as they were seen at last
    observed: ObservedT
    # mean, variance: (pairs, n^2) mean, -1 to 1, and variance, 0 to 1, of each symbol; in the single mode by pattern
    mean: Floats
    variance: Floats
    # Gain in gray levels and noise, as they were estimated at last
    channel: GainAndNoise
    # What was seen of this array's codewords, this packet included; None where none was given
    buffer: SoftBuffer | None


@dataclass(frozen=True, slots=True)
class Lines:
    """Observed symbols of a packet's pairs by the open symbols u."""

    # (pairs, squares) number of the open symbol of each square among its pair's; of a square without one any of its own
    open: NDArray[np.intp]
    # (pairs, symbols) observed symbols where all u of their pair are 0, and the light along their lines that is not
    # theirs
    start: Floats
    # (pairs, symbols) their slopes by the pair's own u
    slope: Floats
    # mean, variance: (pairs, squares) mean and variance of u
    mean: Floats
    variance: Floats
    # leak, leak_variance: (pairs, squares) mean and variance of the light of the pairs around, in units of u
    leak: Floats
    leak_variance: Floats

    @classmethod
    def of(cls, packet: UnsynchronisedPacket, mean: Floats, variance: Floats) -> "Lines | None":
        """Lines of a packet's pairs; None where any square has more than one open symbol."""
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
        for there, others, response in ((later, earlier, packet.before), (earlier, later, packet.after)):
            begin, leaks = _line(response[there], mean[others], which[others])
            part = _product(leaks, slope[there]) / power[there]
            # of what is not along the pair's own line the mean is known; its variance is left out
            aside = leaks - np.tile(part, 4) * slope[there]
            start[there] += begin + aside * np.tile(u[others], 4)
            leak[there] += part * u[others]
            leak_variance[there] += part**2 * spread[others]
        return cls(open_, start, slope, u, spread, leak, leak_variance)

    def equalised(self, number: int, pair: PairStatistics, channel: GainAndNoise) -> tuple[Floats, Floats]:
        """Equalise a pair along its lines."""
        along = pair.along(self.start[number], self.slope[number])
        leak, leak_variance = self.leak[number], self.leak_variance[number]
        estimate = equalise(
            along, channel.gain, channel.noise, self.mean[number] + leak, self.variance[number] + leak_variance
        )
        precision, weighted = estimate.extrinsic
        # of u and the leak together; 1 / precision + its variance is that of u
        alone = precision / (1 + precision * leak_variance)
        llr = np.zeros_like(self.start[number])
        llr[self.open[number]] = llr_of(alone, alone * (weighted / np.maximum(precision, TINY) - leak))
        return llr, moments_of(along, estimate)


def _line(response: Floats, mean: Floats, which: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Observed symbols half way between both values of each square's open symbol, and from there to its value +1.

    response (pairs, 16, 4) by the values of a square's symbols, mean (pairs, symbols) of these, which (pairs, squares)
    is open of the four; (pairs, symbols) each.
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


def _product(one: Floats, other: Floats) -> Floats:
    """Inner products of what is observed of each square, (pairs, squares), of (pairs, symbols)."""
    return np.asarray((one * other).reshape(len(one), 4, -1).sum(1))


LOG = logging.getLogger(__name__)

ITERATIONS = 24
"""Most iterations between equaliser and decoder.

Chosen: it bounds the time of a packet that gains a little in each; at 150 m packets take four to seven. With 12 and 48
none of 192 codewords is lost.
"""

PROGRESS = 0.002
"""Least gain of information, in bit per coded bit, of an iteration that decodes nothing, for another one to follow.

Even all `ITERATIONS` at this pace gain 0.05 bit, a ninth of what a code of rate 1/3 needs.
"""

SETTLED_NOISE = 0.01
"""Change of the noise of pairs out of step, as a fraction, below which it counts as estimated.

While it rises LLRs shrink, so that information seems to be lost. Chosen: four to six iterations.
"""

REFINEMENTS = 6
"""Most times that a packet's poses are refined; refining ends by itself when no pose moves any more.

Chosen: it bounds the time of a packet whose poses keep moving. With 3 and 12 none of 192 codewords is lost.
"""


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
        # the earlier packet may be another one, whose light stands in the way; poses stay refined
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
    """A packet while it is decoded."""

    # form, identity, options, feedback: see `decode_iteratively`
    form: PacketFormat
    identity: int
    options: Decoding
    feedback: Feedback
    # Of its pairs, earlier times it was seen included
    statistics: Sequence[PairStatistics | None]
    # Gain and noise
    channel: GainAndNoise
    # What is known of its codewords
    layers: dict[str, Layer]
    # Passes between the layers' bits and the symbols
    mapper: SymbolMapper
    # (codewords,) bit per coded bit in the LLRs of the last iteration
    information: Floats
    # How pairs combined of frames out of step show their symbols; None where all are in step
    out_of_step: UnsynchronisedPacket | None = None
    # Sites of the symbols; None where these are taken as Gaussian
    propagation: ExpectationPropagation | None = None
    # The same packet as seen before
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
        """A packet of which nothing is decoded but what is known."""
        layers = {name: Layer.unknown(layer) for name, layer in form.layers.items()}
        if known is not None:
            layers = {name: layer.with_known(known[name]) for name, layer in layers.items()}
        codewords = sum(layer.codewords for layer in form.layers.values())
        mapper, none = SymbolMapper(form), np.zeros(codewords)
        packet = cls(form, identity, options, feedback, statistics, channel, layers, mapper, none)
        combinations = [None if one is None else one.combination for one in statistics]
        if any(one is not None for one in combinations):
            packet.out_of_step = UnsynchronisedPacket.of(combinations, form.header_pattern(identity) > SLOTS // 2)
        elif feedback == "propagation":
            # an observed symbol of a combined pair holds products, and so has more than two values
            packet.propagation = ExpectationPropagation.begin((len(statistics), form.settings.side**2))
        return packet

    def decode(
        self, observed: ObservedT, buffer: SoftBuffer | None, observe: Callable[[EqualiseEvent], None]
    ) -> ObservedT:
        """Iterate between equaliser and decoder; return the pairs as they are seen with refined poses."""
        # poses of combined pairs are not refined
        refinements = REFINEMENTS if self.feedback != "none" and not self.combined else 0
        due, moved = not self.open.all(), False
        for number in range(ITERATIONS):
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
            self.doubt()
            left = self.open
            self.information = np.concatenate([layer.information for layer in self.layers.values()])
            if not left.any() or self.feedback == "none":
                break
            decoded = left.sum() < open_.sum()
            # gain and noise of pairs out of step, that is
            guessed = self.combined and number == 0
            due |= decoded
            hopeless = bool(self.hopeless[left].all())
            # what was decoded just now may be all that stood in the others' way
            promising = decoded and not hopeless
            # at least once, and until they stay: a codeword may seem hopeless because of its poses
            if refinements and due and not promising and (refinements == REFINEMENTS or moved or not hopeless):
                refined = observed.refined(*self.expected(), self.channel.gain, self.channel.noise)
                moved, observed = refined is not observed, refined
                self.replace(observed.statistics)
                if moved:
                    self.forget_guesses()
                due, refinements = moved, refinements - 1
            elif moved:
                # this iteration began without guesses: another one follows
                moved = False
            elif not (decoded or guessed) and (hopeless or self.gained_little(left, before, noise)):
                # as far as this goes, unless LEDs differ
                with_led_brightness = observed.with_led_brightness(
                    *self.expected(), self.channel.gain, self.channel.noise
                )
                if with_led_brightness is observed or not refinements:
                    break
                observed, moved, refinements = with_led_brightness, True, refinements - 1
                self.replace(observed.statistics)
                self.forget_guesses()
        return observed

    @property
    def words(self) -> Words:
        """Its codewords by layer, as last decoded."""
        return {name: layer.words for name, layer in self.layers.items()}

    @property
    def open(self) -> NDArray[np.bool_]:
        """(codewords,) which are not decoded."""
        words = [word for layer in self.layers.values() for word in layer.words]
        return np.array([word.status == "crc_fail" for word in words] or [True] * len(self.information))

    def gained_little(self, left: NDArray[np.bool_], before: Floats, noise: float) -> bool:
        """Whether an iteration has added little information, and not for noise that is still being estimated."""
        settled = not self.combined or abs(self.channel.noise - noise) < SETTLED_NOISE * noise
        return settled and bool((self.information - before)[left].max() < PROGRESS)

    @property
    def hopeless(self) -> NDArray[np.bool_]:
        """(codewords,) which have too little information to be decoded."""
        codes = [layer.form.code for layer in self.layers.values() for _ in layer.llr]
        return self.information < HOPELESS * np.array([code.k / code.length for code in codes])

    @property
    def combined(self) -> bool:
        """Whether any pair was combined of frames out of step."""
        return self.out_of_step is not None

    def expected(self) -> tuple[Floats, Floats]:
        """Mean and variance of all symbols, (patterns, symbols)."""
        values = self.layers.values()
        return self.mapper.expected([layer.mean() for layer in values], [layer.variances() for layer in values])

    def replace(self, statistics: Sequence[PairStatistics | None]) -> None:
        """Take other statistics of the packet, and add those of earlier times."""
        earlier, channel = self.earlier, self.channel
        self.statistics = statistics if earlier is None else earlier.joined(statistics, channel.gain, channel.noise)

    def forget_guesses(self) -> None:
        """Drop what is fed back of codewords that are not decoded."""
        self.layers = {name: layer.without_guesses() for name, layer in self.layers.items()}
        if self.propagation:
            self.propagation.forget()

    def add_earlier(self, buffer: SoftBuffer) -> None:
        """Add what was seen earlier: of the packet as a whole, or else of each of its codewords."""
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

    def doubt(self) -> None:
        """Reject codewords that only earlier packets support, before their bits serve to decode the rest."""
        if self.earlier is not None:
            self.layers = {name: layer.doubted() for name, layer in self.layers.items()}

    def added_to(self, buffer: SoftBuffer) -> SoftBuffer:
        """The buffer with what this packet shows of the codewords that it alone did not give.

        It is equalised once more with the decoded codewords known and no guess of the others: a guess fed back would
        count once more each time its codeword is seen. To a codeword that is decoded nothing is added.
        """
        if self.earlier is not None:
            # it is the newest now, or part of this packet's sum
            buffer = buffer.without(self.earlier)
        if not self.open.any() or all(one is None for one in self.statistics):
            return buffer if self.earlier is None else buffer.with_packet(self.earlier)
        self.forget_guesses()
        self.equalise()
        if not self.combined:
            llrs = tuple(llr for layer in self.layers.values() for llr in layer.known_llrs())
            statistics, channel = tuple(self.statistics), self.channel
            packet = BufferedPacket(self.form.format, llrs, statistics, channel.gain, channel.noise)
            buffer = buffer.with_packet(packet)
        if self.earlier is not None:
            # LLRs of one packet seen several times would count again with each
            return buffer
        for name, layer in self.layers.items():
            for i in range(len(layer.words)):
                if layer.unsure(i):
                    buffer = buffer.with_codeword((name, layer.form.code), layer.llr[i], layer.earlier_llr[i])
        return buffer

    def equalise(self) -> None:
        """Equalise every pair with what is known now, then estimate the gain again."""
        channel, (mean, variance) = self.channel, self.expected()
        llr, moments = np.zeros_like(mean), np.zeros(4)
        priors = self.propagation.priors(mean, variance) if self.propagation else (mean, variance)
        lines = None if self.out_of_step is None else Lines.of(self.out_of_step, mean, variance)
        shown = None if self.out_of_step is None or lines is not None else self.out_of_step.expected(mean)
        precision, weighted = np.zeros((2, *mean.shape))
        for number, pair in enumerate(self.statistics):
            if pair is None:
                continue
            try:
                if pair.combination is None:
                    estimate = equalise(pair, channel.gain, channel.noise, priors[0][number], priors[1][number])
                    llr[number] = self.propagation.take(number, estimate) if self.propagation else estimate.llr
                elif shown is None:
                    assert lines is not None  # it is a pair out of step
                    llr[number], said = lines.equalised(number, pair, channel)
                    moments += said
                    continue
                else:
                    # the observed symbols: functions of the four symbols of a square, and light of the pairs around
                    light = shown.mean[number] + shown.leak[number]
                    spread = shown.variance[number] + shown.leak_variance[number]
                    estimate = equalise(pair, channel.gain, channel.noise, light, spread)
                    precision[number], weighted[number] = estimate.extrinsic
            except np.linalg.LinAlgError as error:
                LOG.info("array %d: pair %d is left out: %s", self.identity, number, error)
                continue
            moments += moments_of(pair, estimate)
        if self.out_of_step is not None and shown is not None:
            # from them the symbols follow square by square
            found = np.maximum(precision, LEAST_PRECISION)
            squares = self.out_of_step.llrs(weighted / found, 1 / found, shown, mean)
            llr = np.where(precision.any(1)[:, None], squares, llr)
        self.channel = channel.updated(moments, self.combined)
        parts = self.mapper.bits(llr, [layer.mean() for layer in self.layers.values()])
        pairs = zip(self.layers.items(), parts, strict=True)
        self.layers = {name: layer.equalised(part) for (name, layer), part in pairs}
