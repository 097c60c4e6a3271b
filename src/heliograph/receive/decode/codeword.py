"""One decoding of soft data: LLRs, channel decoder, CRC.

A layer's codewords while their packet is decoded: what is known of their bits, and what the decoder adds.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.combining import consistent
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, LARGEST_LLR, information
from heliograph.receive.packet import Codeword
from heliograph.signal.block import check, unpack
from heliograph.signal.code import Algorithm, Code
from heliograph.signal.packet import LayerFormat, PacketFormat

ERASED = 255
"""Stands for a raw bit of which nothing was received."""

LEAST_POWER, MOST_POWER = 1e-4, 0.999
"""Bounds of the amplitude's part of the power of soft values: moments of few of them may fall outside."""


@dataclass(frozen=True, slots=True)
class Decoding:
    """How codewords are decoded."""

    # Of the turbo code: "max-log" with scaled extrinsic values, or "log-map"
    algorithm: Algorithm = "max-log"
    # Most iterations, 1 or more
    iterations: int = 8


@dataclass(frozen=True, slots=True)
class DecodedBlock:
    """A block as the decoder left it."""

    # (K,) uint8 decisions on the information bits
    bits: NDArray[np.uint8]
    # Iterations that the decoder used
    iterations: int
    # Mean magnitude of the LLRs of the information bits
    margin: float


def decode_packet(
    luminances: Floats, seen: NDArray[np.bool_], form: PacketFormat, identity: int, options: Decoding | None = None
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet."""
    options = options or Decoding()
    soft = form.split(form.soft_data(luminances))
    llrs = {name: soft_to_llr(values, seen) for name, values in soft.items()}
    received = {name: form.layers[name].deinterleave(values) for name, values in llrs.items()}
    decoded = _decode_alike(received, form, options)
    return {
        name: tuple(codeword_of(decoded[name, i], llr, identity, name) for i, llr in enumerate(rows))
        for name, rows in received.items()
    }


def unread(form: PacketFormat, identity: int) -> dict[str, tuple[Codeword, ...]]:
    """Codewords by layer of a packet of which nothing was received."""
    pairs, side = form.layers["high"].pairs, form.settings.side
    return decode_packet(np.zeros((pairs, side, side)), np.zeros(pairs, bool), form, identity, Decoding(iterations=1))


def soft_to_llr(soft: Floats, seen: NDArray[np.bool_]) -> Floats:
    """LLR = ln P(b=0)/P(b=1) of soft values +-a with Gaussian noise, by the values' own moments."""
    known = soft[seen]
    if not known.size:
        return np.zeros_like(soft)
    # with m2 = a^2 + s^2 and m4 = a^4 + 6 a^2 s^2 + 3 s^4: a^4 = (3 m2^2 - m4) / 2
    squared = known * known
    m2, m4 = float(squared.mean()), float((squared * squared).mean())
    a2 = min(np.sqrt(max((3 * m2**2 - m4) / 2, LEAST_POWER * m2**2)), MOST_POWER * m2)
    # LLR = 2 a y / s^2
    llr = 2 * np.sqrt(a2) / max(m2 - a2, TINY) * soft
    return np.clip(np.where(seen[:, None], llr, 0.0), -LARGEST_LLR, LARGEST_LLR)


def codeword_of(decoded: DecodedBlock, llr: Floats, identity: int, layer: str) -> Codeword:
    """Return the codeword of an array and layer."""
    block, status = unpack(decoded.bits), "crc_fail"
    if block is not None:
        status = "ok" if (block.identity, block.layer) == (identity, layer) else "mismatch"
    return Codeword(
        status,  # type: ignore[arg-type]
        block if status == "ok" else None,
        decoded.bits,
        hard(llr),
        decoded.iterations,
        decoded.margin,
        information=float(information(llr)),
    )


def hard(llr: Floats) -> NDArray[np.uint8]:
    """Decisions on LLRs, `ERASED` where an LLR is 0."""
    return np.where(llr == 0, ERASED, llr < 0).astype(np.uint8)


def _decode_alike(
    received: Mapping[str, Floats], form: PacketFormat, options: Decoding
) -> dict[tuple[str, int], DecodedBlock]:
    """Decode codewords of equal codes in one call: {(layer, number): block}."""
    groups: dict[Code, list[tuple[str, int]]] = defaultdict(list)
    for name, rows in received.items():
        groups[form.layers[name].code] += [(name, i) for i in range(len(rows))]
    return {
        key: block
        for code, keys in groups.items()
        for key, block in zip(keys, _decode_group(code, keys, received, options), strict=True)
    }


def _decode_group(
    code: Code, keys: list[tuple[str, int]], received: Mapping[str, Floats], options: Decoding
) -> list[DecodedBlock]:
    llrs = np.stack([received[name][i] for name, i in keys])
    result = code.decode(llrs, algorithm=options.algorithm, iterations=options.iterations, check=check)
    margins = np.abs(result.llr).mean(-1)
    return [DecodedBlock(result.bits[i], int(result.iterations[i]), float(margins[i])) for i in range(len(keys))]


TRUST = 0.85
"""Factor on a failed codeword's extrinsic LLRs that are fed back: the decoder's errors come from the same noise.

At 150 m 16 of 120 codewords of the middle layer were lost with 0.85 or 0.9, 18 with 0.8, 22 with 1 and 40 with 0.65.
"""

HOPELESS = 0.3
"""Information in LLRs, as a fraction of a code's rate, below which a codeword cannot be decoded in this iteration.

The turbo code of rate 1/3 and 1000 bits needs 0.43 bit per bit, 1.3 times its rate: four times this threshold. It saves
time and decides nothing: where all open codewords are below it, the decoder runs once instead of to its end, and a
packet of which such an iteration decodes nothing is given up. A codeword that begins below it is often decoded later,
when other layers are known (105 of 685 that began below it, at rest from 105 to 240 m). Of the 772 codewords of these
350 packets the threshold lost none, nor would 0.6 have; it saved 73 of 1639 iterations.
"""


@dataclass(frozen=True, slots=True)
class Layer:
    """What is known of a layer's codewords."""

    # How the layer fills its packet: code, codewords and interleaver
    form: LayerFormat
    # (codewords, E) LLRs by the last equalisation, whitening undone
    llr: Floats
    # (codewords, E) mean of each coded bit, 1 for 0 and -1 for 1
    soft: Floats
    # (codewords, E) variance of each
    variance: Floats
    # (codewords, E) LLRs of this packet alone that tell one codeword from another: 0 but for distinguishing bits
    own: Floats
    # (codewords, E) LLRs of earlier packets with the same codeword
    earlier_llr: Floats
    # The codewords as last decoded; empty before the first decoding
    words: tuple[Codeword, ...]
    # (codewords,) True for codewords that another reading of this packet alone has decoded
    alone: NDArray[np.bool_]
    # (codewords, E) uint8 coded bits as decided by the first equalisation; None before it
    raw: NDArray[np.uint8] | None = None

    @classmethod
    def unknown(cls, form: LayerFormat) -> "Layer":
        """A layer of which nothing is known."""
        shape = form.codewords, form.code.length
        none = np.zeros(form.codewords, bool)
        return cls(form, np.zeros(shape), np.zeros(shape), np.ones(shape), np.zeros(shape), np.zeros(shape), (), none)

    def with_known(self, words: tuple[Codeword, ...]) -> "Layer":
        """The layer with codewords that another reading gave; those that it could not decode stay unknown."""
        soft, variance = self.soft.copy(), self.variance.copy()
        alone = np.array([word.status != "crc_fail" for word in words])
        for i in np.flatnonzero(alone):
            soft[i], variance[i] = coded_signs(self.form.code, words[i]), 0.0
        raw = np.stack([word.raw for word in words])
        return replace(self, soft=soft, variance=variance, words=words, alone=alone, raw=raw)

    @property
    def open(self) -> list[int]:
        """Numbers of the codewords that are not decoded."""
        return [i for i in range(len(self.llr)) if not self.words or self.words[i].status == "crc_fail"]

    @property
    def information(self) -> Floats:
        """(codewords,) bit per coded bit in the LLRs of the last equalisation, those of earlier packets included."""
        return information(self.llr + self.earlier_llr)

    @property
    def hopeless(self) -> bool:
        """Whether all codewords that are not decoded have too little information to be decoded."""
        return bool((self.information[self.open] < HOPELESS * self.form.code.k / self.form.code.length).all())

    def equalised(self, sent: Floats) -> "Layer":
        """The layer with the LLRs of a new equalisation."""
        llr = self.form.deinterleave(np.clip(sent, -LARGEST_LLR, LARGEST_LLR))
        return replace(self, llr=llr, raw=hard(llr) if self.raw is None else self.raw)

    def with_earlier(self, earlier: Floats) -> "Layer":
        """The layer with the LLRs of earlier packets of the same codewords."""
        return replace(self, earlier_llr=earlier)

    def with_own(self) -> "Layer":
        """The layer whose present LLRs, those of the first equalisation, tell its codewords from others."""
        return replace(self, own=np.where(self.form.code.distinguishing, self.llr, 0.0))

    def doubted(self) -> "Layer":
        """Reject codewords that disagree with this packet's own LLRs; their bits are unknown again."""
        words, soft, variance = list(self.words), self.soft.copy(), self.variance.copy()
        for i, (word, own, alone) in enumerate(zip(self.words, self.own, self.alone, strict=True)):
            if word.status != "crc_fail" and not alone and not consistent(own, coded_signs(self.form.code, word)):
                words[i], soft[i], variance[i] = replace(word, status="crc_fail", block=None), 0.0, 1.0
        return replace(self, words=tuple(words), soft=soft, variance=variance)

    def unsure(self, number: int) -> bool:
        """Whether a codeword is not decoded, or only with the help of earlier packets."""
        return self.words[number].status == "crc_fail" or bool(self.earlier_llr[number].any())

    def known_llrs(self) -> list[Floats]:
        """LLRs (E,) of each codeword; those of a decoded one are the largest there are."""
        known = self.variance.max(1) == 0
        return [LARGEST_LLR * soft if sure else llr for llr, soft, sure in zip(self.llr, self.soft, known, strict=True)]

    def without_guesses(self) -> "Layer":
        """The layer without what is fed back of the codewords that are not decoded."""
        failed = [i for i, word in enumerate(self.words) if word.status == "crc_fail"]
        soft, variance = self.soft.copy(), self.variance.copy()
        soft[failed], variance[failed] = 0.0, 1.0
        return replace(self, soft=soft, variance=variance)

    def mean(self) -> Floats:
        """(pairs, symbols) mean of each bit as it was sent."""
        return self.form.interleave(self.soft * (1.0 - 2.0 * self.form.chips))

    def variances(self) -> Floats:
        """(pairs, symbols) variance of each bit."""
        return self.form.interleave(self.variance)


def decode_layer(layer: Layer, name: str, identity: int, options: Decoding, feedback: bool) -> Layer:
    """Decode the codewords still open."""
    code, words = layer.form.code, dict(enumerate(layer.words))
    soft, variance, earlier = layer.soft.copy(), layer.variance.copy(), layer.earlier_llr.copy()
    assert layer.raw is not None  # it is equalised
    for i, attempt in _attempts(layer, name, identity, options).items():
        words[i] = replace(attempt.word, raw=layer.raw[i], final_raw=hard(layer.llr[i]))
        if attempt.alone:
            earlier[i] = 0.0
        if words[i].status != "crc_fail":
            soft[i], variance[i] = coded_signs(code, words[i]), 0.0
        elif not feedback:
            soft[i], variance[i] = 0.0, 1.0
        else:
            soft[i] = np.tanh(0.5 * TRUST * attempt.extrinsic)
            variance[i] = np.maximum(1 - soft[i] ** 2, 2 * KNOWN_VARIANCE)
    known = tuple(words[i] for i in range(len(layer.llr)))
    return replace(layer, soft=soft, variance=variance, earlier_llr=earlier, words=known)


def coded_signs(code: Code, word: Codeword) -> Floats:
    """Coded bits (E,) of a codeword, 1 for 0 and -1 for 1."""
    return np.asarray(1.0 - 2.0 * code.encode(word.bits))


@dataclass(frozen=True, slots=True)
class _Attempt:
    """What the decoder made of a codeword."""

    # The codeword
    word: Codeword
    # (E,) extrinsic LLRs of its coded bits
    extrinsic: Floats
    # Whether LLRs of earlier packets were left out that there were
    alone: bool = False


def _attempts(layer: Layer, name: str, identity: int, options: Decoding) -> dict[int, _Attempt]:
    """Attempts at the open codewords, by number."""
    code, open_ = layer.form.code, layer.open
    tried = _decode(code, (layer.llr + layer.earlier_llr)[open_], identity, name, options)
    found = dict(zip(open_, tried, strict=True))
    doubtful = [i for i, one in found.items() if _doubtful(layer, i, one.word)]
    for i, one in zip(doubtful, _decode(code, layer.llr[doubtful], identity, name, options), strict=True):
        # the earlier packets' codeword may be another one than this
        if found[i].word.status != "crc_fail" or one.word.status != "crc_fail":
            found[i] = replace(one, alone=True)
    return found


def _doubtful(layer: Layer, number: int, word: Codeword) -> bool:
    """Whether earlier packets' LLRs were added, and did not help or decide alone."""
    if not layer.earlier_llr[number].any():
        return False
    return word.status == "crc_fail" or not consistent(layer.own[number], coded_signs(layer.form.code, word))


def _decode(code: Code, llr: Floats, identity: int, name: str, options: Decoding) -> list[_Attempt]:
    """Attempts at codewords of LLRs (codewords, E).

    They are decoded together, which takes no longer than one of them; where all are hopeless, one iteration must do.
    """
    if not len(llr):
        return []
    few = (information(llr) < HOPELESS * code.k / code.length).all()
    result = code.decode(
        llr,
        algorithm=options.algorithm,
        iterations=1 if few else options.iterations,
        check=check,
        coded_output=True,
    )
    assert result.coded_extrinsic is not None  # it was asked for
    extrinsic = np.clip(result.coded_extrinsic.astype(np.float64), -LARGEST_LLR, LARGEST_LLR)
    margins = np.abs(result.llr).mean(-1)
    decoded = zip(result.bits, result.iterations, margins, strict=True)
    words = [
        codeword_of(DecodedBlock(bits, int(count), float(margin)), one, identity, name)
        for (bits, count, margin), one in zip(decoded, llr, strict=True)
    ]
    return [_Attempt(word, one) for word, one in zip(words, extrinsic, strict=True)]
