"""Codewords: LLRs to bits by channel decoder and CRC, once for a packet or iteratively for a layer."""

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.combining import is_consistent
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, LARGEST_LLR, information
from heliograph.receive.packet import Codeword
from heliograph.signal.block import check, unpack
from heliograph.signal.code import Algorithm, Code
from heliograph.signal.packet import LayerFormat, PacketFormat

ERASED = 255
"""Raw bit that was not received."""

HOPELESS = 0.3
"""Information in LLRs, as a fraction of a code's rate, below which a codeword is not expected to decode.

It only saves iterations: a code of rate 1/3 needs 1.3 times the rate.
"""


@dataclass(frozen=True, slots=True)
class Decoding:
    """Parameters of the channel decoder."""

    # Algorithm of the turbo code: "max-log" with scaled extrinsic values, or "log-map"
    algorithm: Algorithm = "max-log"
    # Maximum number of iterations, 1 or more
    iterations: int = 8
    # Factor on the extrinsic LLRs of failed codewords that are fed back: decoding errors stem from the same noise
    feedback_scale: float = 0.85


def decode_packet(
    luminances: Floats, seen: NDArray[np.bool_], form: PacketFormat, identity: int, options: Decoding | None = None
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet."""
    options = options or Decoding()
    soft = form.split(form.soft_data(luminances))
    received = {name: form.layers[name].deinterleave(soft_to_llr(values, seen)) for name, values in soft.items()}
    # codewords of equal codes are decoded together
    groups: dict[Code, list[tuple[str, int]]] = defaultdict(list)
    for name, rows in received.items():
        groups[form.layers[name].code] += [(name, i) for i in range(len(rows))]
    words: dict[tuple[str, int], Codeword] = {}
    for code, keys in groups.items():
        llrs = np.stack([received[name][i] for name, i in keys])
        result = code.decode(llrs, algorithm=options.algorithm, iterations=options.iterations, check=check)
        for (name, i), *decoded in zip(keys, llrs, result.bits, result.iterations, result.llr, strict=True):
            words[name, i] = _codeword(*decoded, identity=identity, layer=name)
    return {name: tuple(words[name, i] for i in range(len(rows))) for name, rows in received.items()}


def unread(form: PacketFormat, identity: int) -> dict[str, tuple[Codeword, ...]]:
    """Codewords by layer of a packet that was not received."""
    pairs, side = form.layers["high"].pairs, form.settings.side
    return decode_packet(np.zeros((pairs, side, side)), np.zeros(pairs, bool), form, identity, Decoding(iterations=1))


def soft_to_llr(soft: Floats, seen: NDArray[np.bool_]) -> Floats:
    """LLR = ln P(b=0)/P(b=1) of soft values +-a in Gaussian noise, by the moments of the values."""
    known = soft[seen]
    if not known.size:
        return np.zeros_like(soft)
    # with m2 = a^2 + s^2 and m4 = a^4 + 6 a^2 s^2 + 3 s^4: a^4 = (3 m2^2 - m4) / 2
    squared = known * known
    m2, m4 = float(squared.mean()), float((squared * squared).mean())
    # moments of few values may fall outside the bounds
    a2 = min(np.sqrt(max((3 * m2**2 - m4) / 2, 1e-4 * m2**2)), 0.999 * m2)
    # LLR = 2 a y / s^2
    llr = 2 * np.sqrt(a2) / max(m2 - a2, TINY) * soft
    return np.clip(np.where(seen[:, None], llr, 0.0), -LARGEST_LLR, LARGEST_LLR)


def _codeword(
    llr: Floats, bits: NDArray[np.uint8], iterations: int, decoded_llr: Floats, *, identity: int, layer: str
) -> Codeword:
    """Codeword by its received LLRs, decided bits and decoded LLRs."""
    block = unpack(bits)
    if block is None:
        status: Literal["ok", "crc_fail", "mismatch"] = "crc_fail"
    elif (block.identity, block.layer) != (identity, layer):
        status, block = "mismatch", None
    else:
        status = "ok"
    margin = float(np.abs(decoded_llr).mean())
    return Codeword(status, block, bits, hard(llr), int(iterations), margin, information=float(information(llr)))


def hard(llr: Floats) -> NDArray[np.uint8]:
    """Decisions on LLRs, `ERASED` where an LLR is 0."""
    return np.where(llr == 0, ERASED, llr < 0).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Layer:
    """Codewords of a layer between iterations."""

    # Code, codewords and interleaver
    form: LayerFormat
    # (codewords, E) LLRs by the last equalisation, whitening undone
    llr: Floats
    # (codewords, E) mean of each coded bit, 1 for 0 and -1 for 1
    soft: Floats
    # (codewords, E) variance of each coded bit
    variance: Floats
    # (codewords, E) LLRs of this packet for comparison with earlier packets: 0 except for distinguishing bits
    own: Floats
    # (codewords, E) LLRs of earlier packets with the same codeword
    earlier_llr: Floats
    # The codewords as last decoded; empty before the first decoding
    words: tuple[Codeword, ...]
    # (codewords,) True for codewords known from the start
    known: NDArray[np.bool_]
    # (codewords, E) uint8 coded bits as decided by the first equalisation; None before it
    raw: NDArray[np.uint8] | None = None

    @classmethod
    def unknown(cls, form: LayerFormat) -> "Layer":
        """Layer before the first equalisation."""
        zeros, variance = np.zeros((form.codewords, form.code.length)), np.ones((form.codewords, form.code.length))
        return cls(form, zeros, zeros, variance, zeros, zeros, (), np.zeros(form.codewords, bool))

    def with_known(self, words: tuple[Codeword, ...]) -> "Layer":
        """Return the layer with codewords of another attempt; failed codewords stay unknown."""
        soft, variance = self.soft.copy(), self.variance.copy()
        known = np.array([word.status != "crc_fail" for word in words])
        for i in np.flatnonzero(known):
            soft[i], variance[i] = coded_signs(self.form.code, words[i]), 0.0
        raw = np.stack([word.raw for word in words])
        return replace(self, soft=soft, variance=variance, words=words, known=known, raw=raw)

    @property
    def open(self) -> list[int]:
        """Numbers of the undecoded codewords."""
        return [i for i in range(len(self.llr)) if not self.words or self.words[i].status == "crc_fail"]

    @property
    def information(self) -> Floats:
        """(codewords,) bit per coded bit in the LLRs of this packet and earlier packets."""
        return information(self.llr + self.earlier_llr)

    @property
    def hopeless(self) -> bool:
        """True if all undecoded codewords have too little information to decode."""
        return bool((self.information[self.open] < HOPELESS * self.form.code.k / self.form.code.length).all())

    def equalised(self, sent: Floats) -> "Layer":
        """Return the layer with the LLRs of a new equalisation."""
        llr = self.form.deinterleave(np.clip(sent, -LARGEST_LLR, LARGEST_LLR))
        return replace(self, llr=llr, raw=hard(llr) if self.raw is None else self.raw)

    def with_earlier(self, earlier: Floats) -> "Layer":
        """Return the layer with the LLRs of earlier packets of the same codewords."""
        return replace(self, earlier_llr=earlier)

    def with_own(self) -> "Layer":
        """Return the layer with the LLRs of the first equalisation as the LLRs of this packet."""
        return replace(self, own=np.where(self.form.code.distinguishing, self.llr, 0.0))

    def reject_inconsistent(self) -> "Layer":
        """Reject codewords that disagree with the LLRs of this packet; the bits are unknown again."""
        words, soft, variance = list(self.words), self.soft.copy(), self.variance.copy()
        for i, (word, own, known) in enumerate(zip(self.words, self.own, self.known, strict=True)):
            if word.status != "crc_fail" and not known and not is_consistent(own, coded_signs(self.form.code, word)):
                words[i], soft[i], variance[i] = replace(word, status="crc_fail", block=None), 0.0, 1.0
        return replace(self, words=tuple(words), soft=soft, variance=variance)

    def needed_earlier(self, number: int) -> bool:
        """Return True if a codeword failed, or needed the LLRs of earlier packets."""
        return self.words[number].status == "crc_fail" or bool(self.earlier_llr[number].any())

    def known_llrs(self) -> list[Floats]:
        """LLRs (E,) of each codeword; the largest possible if it is decoded."""
        known = self.variance.max(1) == 0
        return [
            LARGEST_LLR * soft if is_known else llr
            for llr, soft, is_known in zip(self.llr, self.soft, known, strict=True)
        ]

    def without_feedback(self) -> "Layer":
        """Drop the feedback of failed codewords."""
        failed = [i for i, word in enumerate(self.words) if word.status == "crc_fail"]
        soft, variance = self.soft.copy(), self.variance.copy()
        soft[failed], variance[failed] = 0.0, 1.0
        return replace(self, soft=soft, variance=variance)

    def mean(self) -> Floats:
        """(pairs, symbols) mean of each bit as sent."""
        return self.form.interleave(self.soft * (1.0 - 2.0 * self.form.chips))

    def variances(self) -> Floats:
        """(pairs, symbols) variance of each bit as sent."""
        return self.form.interleave(self.variance)


def decode_layer(layer: Layer, name: str, identity: int, options: Decoding, feedback: bool) -> Layer:
    """Decode the open codewords."""
    code, words = layer.form.code, dict(enumerate(layer.words))
    soft, variance, earlier = layer.soft.copy(), layer.variance.copy(), layer.earlier_llr.copy()
    assert layer.raw is not None  # it is equalised
    for i, (word, extrinsic, used_earlier) in _attempts(layer, name, identity, options).items():
        words[i] = replace(word, raw=layer.raw[i], final_raw=hard(layer.llr[i]))
        if not used_earlier:
            earlier[i] = 0.0
        if words[i].status != "crc_fail":
            soft[i], variance[i] = coded_signs(code, words[i]), 0.0
        elif not feedback:
            soft[i], variance[i] = 0.0, 1.0
        else:
            soft[i] = np.tanh(0.5 * options.feedback_scale * extrinsic)
            variance[i] = np.maximum(1 - soft[i] ** 2, 2 * KNOWN_VARIANCE)
    decoded = tuple(words[i] for i in range(len(layer.llr)))
    return replace(layer, soft=soft, variance=variance, earlier_llr=earlier, words=decoded)


def coded_signs(code: Code, word: Codeword) -> Floats:
    """Coded bits (E,) of a codeword, 1 for 0 and -1 for 1."""
    return np.asarray(1.0 - 2.0 * code.encode(word.bits))


def _attempts(layer: Layer, name: str, identity: int, options: Decoding) -> dict[int, tuple[Codeword, Floats, bool]]:
    """Decode open codewords: {number: (codeword, extrinsic LLRs (E,), True if LLRs of earlier packets were used)}."""
    code, numbers = layer.form.code, layer.open
    decoded = _decode(code, (layer.llr + layer.earlier_llr)[numbers], identity, name, options)
    attempts = {i: (*attempt, True) for i, attempt in zip(numbers, decoded, strict=True)}
    doubtful = [i for i, (word, _, _) in attempts.items() if _is_doubtful(layer, i, word)]
    for i, attempt in zip(doubtful, _decode(code, layer.llr[doubtful], identity, name, options), strict=True):
        # the earlier packets' codeword may differ
        if attempts[i][0].status != "crc_fail" or attempt[0].status != "crc_fail":
            attempts[i] = *attempt, False
    return attempts


def _is_doubtful(layer: Layer, number: int, word: Codeword) -> bool:
    """Return True if LLRs of earlier packets were added, but did not help, or contradict this packet."""
    if not layer.earlier_llr[number].any():
        return False
    return word.status == "crc_fail" or not is_consistent(layer.own[number], coded_signs(layer.form.code, word))


def _decode(code: Code, llr: Floats, identity: int, name: str, options: Decoding) -> list[tuple[Codeword, Floats]]:
    """Decode LLRs (codewords, E) together; only one iteration if all are hopeless. Returns extrinsic LLRs as well."""
    if not len(llr):
        return []
    hopeless = (information(llr) < HOPELESS * code.k / code.length).all()
    result = code.decode(
        llr,
        algorithm=options.algorithm,
        iterations=1 if hopeless else options.iterations,
        check=check,
        coded_output=True,
    )
    assert result.coded_extrinsic is not None  # by coded_output
    extrinsic = np.clip(result.coded_extrinsic.astype(np.float64), -LARGEST_LLR, LARGEST_LLR)
    words = [
        _codeword(*decoded, identity=identity, layer=name)
        for decoded in zip(llr, result.bits, result.iterations, result.llr, strict=True)
    ]
    return list(zip(words, extrinsic, strict=True))
