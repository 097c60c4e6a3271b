"""From looks to codewords: what is decoded is subtracted, what is not is fed back softly, until nothing changes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.decode import LARGEST_LLR
from heliograph.receive.packets import Codeword, Observer, ignore
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft import squares
from heliograph.receive.soft.cells import Cells
from heliograph.receive.soft.codewords import HOPELESS, Layer, decode_layer, information
from heliograph.receive.soft.equalise import Estimate, equalise
from heliograph.receive.soft.look import Look
from heliograph.receive.soft.memory import Memory, SeenPacket
from heliograph.receive.soft.mix import Mix
from heliograph.receive.soft.noise import LEAST_NOISE
from heliograph.receive.soft.sites import Sites
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS

Floats = NDArray[np.float64]

PROGRESS = 0.002
"""A round in which nothing is decoded, and the LLRs tell of no open codeword's bits this much more, in bit each, or too
little of all, is the last, but for those that begin with no guesses."""

STEPS = 6
"""Most times that a packet's poses are sharpened: until they stay once a layer is decoded, and after each further one
while something may come of the others."""


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
            # s^2 = E|d - g (B c + o)|^2 / pixels
            self.noise = max((power - 2 * self.gain * match + self.gain**2 * norm) / pixels, LEAST_NOISE)


LookAgain = Callable[[Floats, Floats, Light], tuple[Sequence[Look | None], bool]]
"""Mean and variance of the cells (pairs, cells) and the light -> looks with better poses; whether any is another."""


def decode_looks(
    looks: Sequence[Look | None],
    light: Light,
    form: PacketFormat,
    identity: int,
    settings: ReceiveSettings,
    memory: Memory,
    again: LookAgain,
    observe: Observer = ignore,
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet.

    Parameters
    ----------
    looks
        One a data pair, in the single mode one a pattern; None where the array was not seen.
    light
        First guess of gain and noise; refined in place.
    form
        The packet's format.
    identity
        The array's; a block of another array is a mismatch.
    settings
        The receiver's.
    memory
        Earlier looks at codewords of this array; what cannot be decoded is kept there.
    again
        Looks anew once something is decoded.
    observe
        Gets the LLRs of each round, stage "equalise".

    Returns
    -------
    Codewords by layer.
    """
    # an empty memory recalls nothing
    memory = memory if settings.soft.looks else Memory()
    packet = _Packet.begun(looks, light, form, identity, settings)
    packet.decode(memory, again, observe)
    if packet.earlier is not None and packet.open.any():
        # what it was taken for may be another packet, which stands in its way; poses that were sharpened stay
        alone = _Packet.begun(looks, light, form, identity, settings)
        alone.decode(Memory(), again, observe)
        if alone.open.sum() < packet.open.sum():
            memory.keep_packet(packet.earlier)
            packet = alone
    if settings.soft.looks:
        packet.remember(memory)
    return {name: tuple(layer.words) for name, layer in packet.layers.items()}


@dataclass(slots=True)
class _Packet:
    """A packet while it is decoded.

    Attributes
    ----------
    form
        Its format.
    identity
        The array's.
    settings
        The receiver's.
    looks
        What is seen of its pairs, in earlier looks too.
    light
        Their gain and noise.
    layers
        What is known of its codewords.
    cells
        Passes between the layers' bits and the cells.
    header
        (n, n) LEDs that are lit in its header, as if none were dimmed.
    told
        (codewords,) bits of information in the LLRs of the last round.
    sites
        What cells being +-1 adds; None if they are taken as Gaussian.
    earlier
        Earlier looks at the whole packet.
    """

    form: PacketFormat
    identity: int
    settings: ReceiveSettings
    looks: Sequence[Look | None]
    light: Light
    layers: dict[str, Layer]
    cells: Cells
    header: NDArray[np.bool_]
    told: Floats
    sites: Sites | None = None
    earlier: SeenPacket | None = None

    @classmethod
    def begun(
        cls,
        looks: Sequence[Look | None],
        light: Light,
        form: PacketFormat,
        identity: int,
        settings: ReceiveSettings,
    ) -> "_Packet":
        """A packet of which nothing is known."""
        layers = {name: Layer.unknown(layer) for name, layer in form.layers.items()}
        header = form.header_pattern(identity) > SLOTS // 2
        codewords = sum(layer.codewords for layer in form.layers.values())
        packet = cls(form, identity, settings, looks, light, layers, Cells(form), header, np.zeros(codewords))
        if settings.soft.propagate and not packet.mixed:
            # a combined pair's cells are seen through products, which are more than two values
            packet.sites = Sites.begun((len(looks), form.settings.side**2))
        return packet

    def decode(self, memory: Memory, again: LookAgain, observe: Observer) -> None:
        """Rounds between equaliser and decoder; see `decode_looks`."""
        # of a combined pair poses are not sharpened
        steps = STEPS if self.settings.soft.sharpen and not self.mixed else 0
        due = moved = False
        for number in range(self.settings.soft.rounds):
            before, open_ = self.told, self.open
            self.equalise()
            if number == 0:
                self.recall(memory)
            llr = {name: layer.llr for name, layer in self.layers.items()}
            observe("equalise", {"identity": self.identity, "llr": llr})
            for name, layer in self.layers.items():
                decode_layer(layer, name, self.identity, self.settings)
            still = self.open
            self.told = np.concatenate([information(layer.llr + layer.recalled) for layer in self.layers.values()])
            if not still.any() or self.settings.soft.feedback == "none":
                break
            decoded = still.sum() < open_.sum()
            due |= decoded
            # at least once and until they stay: what seems hopeless may be so by its pose
            if steps and due and (steps == STEPS or moved or not self.hopeless[still].all()):
                looks, moved = again(*self.known(), self.light)
                self.look(looks)
                if moved:
                    self.forget_guesses()
                due, steps = moved, steps - 1
            elif moved:
                # nothing was guessed in this round
                moved = False
            elif not decoded and ((self.told - before)[still].max() < PROGRESS or self.hopeless[still].all()):
                break
        self.doubt()

    @property
    def open(self) -> NDArray[np.bool_]:
        """Which codewords are not decoded."""
        words = [word for layer in self.layers.values() for word in layer.words]
        return np.array([word.status == "crc_fail" for word in words] or [True] * len(self.told))

    @property
    def hopeless(self) -> NDArray[np.bool_]:
        """Which codewords the LLRs of the last round tell too little of."""
        rates = [layer.form.code.rate for layer in self.layers.values() for _ in layer.llr]
        return self.told < HOPELESS * np.array(rates)

    @property
    def llrs(self) -> list[Floats]:
        """LLRs (E,) of each codeword; see `Layer.sure_llrs`."""
        return [llr for layer in self.layers.values() for llr in layer.sure_llrs()]

    @property
    def mixed(self) -> bool:
        """Whether any pair was combined of frames out of step."""
        return any(look is not None and look.mix is not None for look in self.looks)

    def known(self) -> tuple[Floats, Floats]:
        """Mean and variance of all cells, (patterns, cells)."""
        values = self.layers.values()
        return self.cells.expected([layer.mean() for layer in values], [layer.variances() for layer in values])

    def look(self, looks: Sequence[Look | None]) -> None:
        """Take looks in place of those there were, beside the earlier ones."""
        self.looks = looks if self.earlier is None else self.earlier.joined(looks, self.light.gain, self.light.noise)

    def forget_guesses(self) -> None:
        """Know nothing any more of the codewords, and cells, that are not decoded."""
        for layer in self.layers.values():
            layer.forget_guesses()
        if self.sites:
            self.sites.forget()

    def recall(self, memory: Memory) -> None:
        """Add what was seen earlier, of the packet as a whole or else of each of its codewords."""
        for layer in self.layers.values():
            layer.own = np.where(layer.telling, layer.llr, 0.0)
        if not self.mixed:
            self.earlier = memory.recall_packet(
                self.form.format, [own for by in self.layers.values() for own in by.own]
            )
        if self.earlier is not None:
            self.look(self.looks)
            if self.sites:
                self.sites.forget()
            self.equalise()
            return
        for name, layer in self.layers.items():
            layer.recalled = np.stack([memory.recall((name, layer.form.code), own) for own in layer.own])

    def doubt(self) -> None:
        """Take nothing for this packet's own that only earlier looks speak for: they may be of another."""
        if self.earlier is not None:
            for layer in self.layers.values():
                layer.doubt()

    def remember(self, memory: Memory) -> None:
        """Keep what this look says of the codewords that it alone did not give.

        The looks are equalised anew with the decoded codewords known and no guess of the others: a guess fed back would
        be counted as often as its codeword is seen. Of a codeword that is known by now nothing is added.
        """
        if not self.open.any() or all(look is None for look in self.looks):
            if self.earlier is not None:
                memory.keep_packet(self.earlier)
            return
        self.forget_guesses()
        self.equalise()
        if not self.mixed:
            light = self.light.gain, self.light.noise
            memory.keep_packet(SeenPacket(self.form.format, tuple(self.llrs), tuple(self.looks), *light))
        if self.earlier is not None:
            # LLRs of several looks at the packet would be counted again with each
            return
        for name, layer in self.layers.items():
            for i in range(len(layer.words)):
                if layer.unsure(i):
                    memory.keep((name, layer.form.code), layer.llr[i], layer.recalled[i])

    def equalise(self) -> None:
        """Equalise every look with what is known now; then the gain by expectation and maximisation."""
        light, (mean, variance) = self.light, self.known()
        llr, moments = np.zeros_like(mean), np.zeros(4)
        priors = self.sites.priors(mean, variance) if self.sites else (mean, variance)
        for number, look in enumerate(self.looks):
            if look is None:
                continue
            if look.mix is None:
                estimate = equalise(look, light.gain, light.noise, priors[0][number], priors[1][number])
                llr[number] = self.sites.take(number, estimate) if self.sites else estimate.llr
            else:
                around = [mean[k] if 0 <= k < len(mean) else None for k in (number - 1, number + 1)]
                llr[number], estimate = _equalise_mixed(look, look.mix, light, mean[number], around, self.header)
            moments += _moments(look, estimate)
        light.update(moments, self.mixed)
        parts = self.cells.bits(llr, [layer.mean() for layer in self.layers.values()])
        for layer, part in zip(self.layers.values(), parts, strict=True):
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
    prior = seen + leak, spread + leak_spread
    estimate = equalise(look, light.gain, light.noise, *prior)
    precision, weighted = estimate.added
    precision = np.maximum(precision, 1e-6)
    return squares.true_llrs(mix.table, weighted / precision - leak, 1 / precision + leak_spread, mean), estimate


def _moments(look: Look, estimate: Estimate) -> Floats:
    """<d, B m + o>, E|B c + o|^2, |d|^2 and the number of pixels."""
    m = estimate.mean
    match = float(m @ look.seen) + look.cross
    norm = float(m @ (look.gram @ m.astype(np.float32))) + estimate.trace + 2 * float(m @ look.offset) + look.drift
    return np.array([match, norm, look.power, look.pixels])
