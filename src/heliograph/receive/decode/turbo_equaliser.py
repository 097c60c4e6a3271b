"""Turbo equaliser: MMSE equaliser and channel decoder in turns, with parallel interference cancellation.

The light of decoded codewords is subtracted; soft values of the others are the equaliser's priors, until the codewords
converge. Gain and noise are estimated along with the symbols by expectation and maximisation.
"""

import logging
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.decode.codeword import Decoding, Layer, SymbolMapper, is_hopeless
from heliograph.receive.decode.combining import BufferedPacket, SoftBuffer
from heliograph.receive.equalise.lmmse import LEAST_PRECISION, ExpectationPropagation, equalise
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import EqualiseEvent, ignore
from heliograph.receive.observe.cutout import LEAST_NOISE
from heliograph.receive.packet import Words, with_raw
from heliograph.receive.sync.combine import UnsynchronisedPacket
from heliograph.signal.pwm import SLOTS

LOG = logging.getLogger(__name__)

MAX_REFINEMENTS = 6  # maximum number of refinements of a packet's poses


def decode_iteratively(
    observed: ObservedPacket,
    gain: float,
    identity: int,
    options: Decoding,
    buffer: SoftBuffer | None = None,
    observe: Callable[[EqualiseEvent], None] = ignore,
    known: Words | None = None,
) -> "TurboEqualiser":
    """Decode all layers of a packet of the gain in gray levels."""
    packet = TurboEqualiser(observed, gain, observed.noise.lit, identity, options, known)
    packet.run(buffer, observe)
    if packet.repeated is not None and packet.is_open.any():
        # the earlier packet may differ and disturb by light; poses stay refined
        alone = TurboEqualiser(observed, packet.gain, packet.noise, identity, options, known)
        alone.run(None, observe)
        if alone.is_open.sum() < packet.is_open.sum():
            if buffer is not None:
                buffer = buffer.without(packet.repeated).with_packet(packet.repeated)
            alone.words = with_raw(alone.words, packet.words)
            packet = alone
    packet.mean, packet.variance = packet.expected()
    packet.buffer = None if buffer is None else packet.added_to(buffer)
    return packet


class TurboEqualiser:
    """State of a packet between iterations, and the result."""

    def __init__(
        self, observed: ObservedPacket, gain: float, noise: float, identity: int, options: Decoding, known: Words | None
    ):
        self.observed, self._identity, self._options, form = observed, identity, options, observed.form
        # gray levels of the array with all LEDs on, at most that of the sensor; variance of a pixel of a difference
        self.gain, self.noise = min(gain, observed.max_level), noise
        # codewords by layer, decoded or not
        self.words: Words = {}
        # (patterns, symbols) mean, -1 to 1, and variance, 0 to 1, of each symbol after the last iteration
        self.mean = self.variance = np.empty((0, 0))
        # the same packet as received before, and the buffer of the array with this packet; None if unused
        self.repeated: BufferedPacket | None = None
        self.buffer: SoftBuffer | None = None
        self._layers = [Layer(layer, identity, (known or {}).get(name)) for name, layer in form.layers.items()]
        self._mapper, self._statistics = SymbolMapper(form), observed.statistics
        # (codewords,) bit per coded bit in the LLRs of the last iteration
        self._information = np.zeros(sum(layer.codewords for layer in form.layers.values()))
        # responses of pairs out of step; None in step
        self._unsynchronised: UnsynchronisedPacket | None = None
        # sites of the symbols; None if symbols are taken as Gaussian
        self._propagation: ExpectationPropagation | None = None
        combinations = [None if pair is None else pair.combination for pair in self._statistics]
        if any(combinations):
            header = form.header_pattern(identity) > SLOTS // 2
            self._unsynchronised = UnsynchronisedPacket.of(combinations, header)
        elif options.feedback == "propagation":
            # not for combined pairs, where observed symbols are products with more than two values
            self._propagation = ExpectationPropagation((len(combinations), form.settings.side**2))

    @property
    def is_open(self) -> NDArray[np.bool_]:
        """(codewords,) True if not decoded."""
        return np.concatenate([layer.is_open for layer in self._layers])

    def expected(self) -> tuple[Floats, Floats]:
        """Mean and variance of all symbols, (patterns, symbols)."""
        means = [layer.mean() for layer in self._layers]
        return self._mapper.expected(means, [layer.variances() for layer in self._layers])

    def run(self, buffer: SoftBuffer | None, observe: Callable[[EqualiseEvent], None]) -> None:
        """Iterate between equaliser and decoder."""
        feedback, observed = self._options.feedback, self.observed
        # poses of combined pairs are not refined
        refinements = MAX_REFINEMENTS if feedback != "none" and self._unsynchronised is None else 0
        due, moved = not self.is_open.all(), False
        # at 150 m packets take four to seven iterations
        for number in range(24):
            before, was_open, noise = self._information, self.is_open, self.noise
            self._equalise()
            if number == 0 and buffer is not None:
                self._add_earlier(buffer)
            observe(EqualiseEvent(self._identity, number, {layer.form.name: layer.llr for layer in self._layers}))
            for layer in self._layers:
                layer.decode(self._options)
                if self.repeated is not None:
                    # before the bits help to decode the rest
                    layer.reject_inconsistent()
            left = self.is_open
            parts = [layer.information for layer in self._layers]
            self._information = np.concatenate(parts)
            if not left.any() or feedback == "none":
                break
            decoded = left.sum() < was_open.sum()
            # gain and noise of pairs out of step are first guesses
            guessed = self._unsynchronised is not None and number == 0
            due |= decoded
            vain = [is_hopeless(part, layer.form) for part, layer in zip(parts, self._layers, strict=True)]
            hopeless = bool(np.concatenate(vain)[left].all())
            # the codewords decoded just now may have been the only disturbance of the others
            promising = decoded and not hopeless
            # at least once, and until the poses stay: they may make a codeword seem hopeless
            is_first = refinements == MAX_REFINEMENTS
            if refinements and due and not promising and (is_first or moved or not hopeless):
                due = moved = observed.refine_poses(*self.expected(), self.gain, self.noise)
                refinements -= 1
                self._use_statistics()
                if moved:
                    self._drop_feedback()
            elif moved:
                # this iteration had no feedback: another iteration follows
                moved = False
            elif not (decoded or guessed) and (hopeless or self._gained_little(left, before, noise)):
                # this is the end, unless LEDs differ
                if not (refinements and observed.apply_brightness(*self.expected(), self.gain, self.noise)):
                    break
                moved, refinements = True, refinements - 1
                self._use_statistics()
                self._drop_feedback()
        self.words = {layer.form.name: layer.words for layer in self._layers}

    def added_to(self, buffer: SoftBuffer) -> SoftBuffer:
        """Return the buffer with the codewords that failed, or needed earlier packets.

        The packet is equalised once more with no feedback of failed codewords, which would count again with each
        repetition.
        """
        if self.repeated is not None:
            # now the newest, or part of this packet's sum
            buffer = buffer.without(self.repeated)
        if not self.is_open.any() or not any(self._statistics):
            return buffer if self.repeated is None else buffer.with_packet(self.repeated)
        self._drop_feedback()
        self._equalise()
        if self._unsynchronised is None:
            llrs = tuple(llr for layer in self._layers for llr in layer.known_llrs())
            packet = BufferedPacket(self.observed.form.format, llrs, tuple(self._statistics), self.gain, self.noise)
            buffer = buffer.with_packet(packet)
        if self.repeated is not None:
            # LLRs of a repeated packet would count again with each repetition
            return buffer
        for layer in self._layers:
            for is_open, llr, earlier in zip(layer.is_open, layer.llr, layer.earlier, strict=True):
                if is_open or earlier.any():
                    buffer = buffer.with_codeword((layer.form.name, layer.form.code), llr, earlier)
        return buffer

    def _gained_little(self, left: NDArray[np.bool_], before: Floats, noise: float) -> bool:
        """Return True if an iteration added little information, and the noise of pairs out of step is estimated."""
        settled = self._unsynchronised is None or abs(self.noise - noise) < 0.01 * noise
        return settled and bool((self._information - before)[left].max() < 0.002)

    def _use_statistics(self) -> None:
        """Use the statistics of the observed pairs, and those of earlier repetitions."""
        self._statistics = self.observed.statistics
        if self.repeated is not None:
            self._statistics = self.repeated.joined(self._statistics, self.gain, self.noise)

    def _drop_feedback(self) -> None:
        """Drop the feedback of undecoded codewords."""
        for layer in self._layers:
            layer.drop_feedback()
        if self._propagation:
            self._propagation.forget()

    def _add_earlier(self, buffer: SoftBuffer) -> None:
        """Add the same packet from the buffer, otherwise the same codewords."""
        for layer in self._layers:
            layer.keep_own()
        if self._unsynchronised is None:
            own = [llr for layer in self._layers for llr in layer.own]
            self.repeated = buffer.same_packet(self.observed.form.format, own)
        if self.repeated is not None:
            self._use_statistics()
            if self._propagation:
                self._propagation.forget()
            self._equalise()
            return
        for layer in self._layers:
            kind = layer.form.name, layer.form.code
            layer.earlier = np.stack([buffer.same_codeword(kind, own) for own in layer.own])

    def _equalise(self) -> None:
        """Equalise every pair with the present priors, then estimate the gain, and out of step the noise."""
        mean, variance = self.expected()
        llr, moments, unsynchronised = np.zeros_like(mean), np.zeros(4), self._unsynchronised
        priors = self._propagation.priors(mean, variance) if self._propagation else (mean, variance)
        if unsynchronised is not None:
            # observed symbols: functions of the four symbols of a square, and light of the neighbouring pairs
            own, leak = unsynchronised.expected(mean)
            priors = own[0] + leak[0], own[1] + leak[1]
        precision, weighted = np.zeros((2, *mean.shape))
        for number, pair in enumerate(self._statistics):
            if pair is None:
                continue
            try:
                estimate = equalise(pair, self.gain, self.noise, priors[0][number], priors[1][number])
                if unsynchronised is not None:
                    precision[number], weighted[number] = estimate.extrinsic
                else:
                    llr[number] = self._propagation.take(number, estimate) if self._propagation else estimate.llr
            except np.linalg.LinAlgError as error:
                LOG.info("array %d: pair %d is left out: %s", self._identity, number, error)
                continue
            m = estimate.mean
            light = m @ (pair.gram @ m.astype(np.float32)) + estimate.trace + 2 * m @ pair.offset + pair.offset_power
            moments += np.array([m @ pair.matched + pair.cross, light, pair.power, pair.pixels])
        if unsynchronised is not None:
            # the symbols follow square by square
            bounded = np.maximum(precision, LEAST_PRECISION)
            squares = unsynchronised.llrs(weighted / bounded, 1 / bounded, leak, mean)
            llr = np.where(precision.any(1)[:, None], squares, 0.0)
        combined = unsynchronised is not None
        self.gain, self.noise = update_channel(self.gain, self.noise, moments, self.observed.max_level, combined)
        parts = self._mapper.bits(llr, [layer.mean() for layer in self._layers])
        for layer, part in zip(self._layers, parts, strict=True):
            layer.equalise(part)


def update_channel(
    gain: float, noise: float, moments: Floats, full_scale: float = math.inf, combined: bool = False
) -> tuple[float, float]:
    """Maximise the expected likelihood by the gain, of combined pairs also by the noise (expectation maximisation)."""
    match, light, power, pixels = moments.tolist()
    # g = <d, B m + o> / E|B c + o|^2; of pairs that do not show the array it may be anything
    if match > 0 and light > 0:
        gain = min(match / light, full_scale)
    if combined and pixels:
        # s^2 = E|d - g (B c + o)|^2 / pixels
        noise = max((power - 2 * gain * match + gain**2 * light) / pixels, LEAST_NOISE)
    return gain, noise
