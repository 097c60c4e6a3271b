"""Codewords: LLRs to bits by channel decoder and CRC, once for a packet or iteratively for a layer.

In a pair every symbol is a bit. In the single mode a row of D11 is data times the row's polarity (`signal.polarity`), a
check of three: symbol = polarity x datum. With t = tanh(L / 2) of the symbols' LLRs and m the data's means, the
LLR of the polarity is

    L_s = L(column 0) + sum over the row of 2 artanh(t m),

and the message to each symbol or datum is the product of the other two members of the check.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.combining import is_consistent
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, LARGEST_LLR, information
from heliograph.receive.packet import Codeword, hard_decisions
from heliograph.receive.settings import Feedback
from heliograph.signal.block import check, unpack
from heliograph.signal.code import Algorithm, Code
from heliograph.signal.packet import LayerFormat, PacketFormat


@dataclass(frozen=True, slots=True)
class Decoding:
    """Parameters of decoding."""

    # Algorithm of the turbo code: "max-log" with scaled extrinsic values, or "log-map"
    algorithm: Algorithm = "max-log"
    # Maximum number of iterations, 1 or more
    iterations: int = 8
    # Feedback from the decoder to the equaliser
    feedback: Feedback = "propagation"
    # True to decode samples at the LEDs before the equaliser runs
    led_by_led: bool = True
    # True to combine a codeword with repetitions received earlier
    combining: bool = True


def decode_packet(
    luminances: Floats, seen: NDArray[np.bool_], form: PacketFormat, identity: int, options: Decoding = Decoding()
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet."""
    soft = form.split(form.soft_data(luminances))
    llrs = np.concatenate([soft_to_llr(values, seen) for values in soft.values()], axis=1)
    return decode_llrs(llrs, form, identity, options)


def decode_llrs(
    llrs: Floats, form: PacketFormat, identity: int, options: Decoding = Decoding()
) -> dict[str, tuple[Codeword, ...]]:
    """Decode all layers of a packet by LLRs of the symbols, (pairs, n n)."""
    high = form.layers["high"]
    bits = SymbolMapper(form).bits(llrs, [np.zeros((high.pairs, high.symbols))])
    received = {name: layer.deinterleave(part) for (name, layer), part in zip(form.layers.items(), bits, strict=True)}
    # codewords of equal codes are decoded together
    groups: dict[Code, list[tuple[str, int]]] = defaultdict(list)
    for name, rows in received.items():
        groups[form.layers[name].code] += [(name, i) for i in range(len(rows))]
    words: dict[tuple[str, int], Codeword] = {}
    for code, keys in groups.items():
        llrs = np.stack([received[name][i] for name, i in keys])
        decoded, _ = _decode_together(code, llrs, [name for name, _ in keys], identity, options)
        words |= zip(keys, decoded, strict=True)
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


def _decode_together(
    code: Code, llrs: Floats, layers: Sequence[str], identity: int, options: Decoding, coded_output: bool = False
) -> tuple[list[Codeword], NDArray[np.float32] | None]:
    """Decode LLRs (codewords, E) of some layers' codewords; return also the extrinsic LLRs of the coded bits."""
    result = code.decode(
        llrs, algorithm=options.algorithm, iterations=options.iterations, check=check, coded_output=coded_output
    )
    words, known = list[Codeword](), information(llrs)
    rows = zip(llrs, layers, result.bits, result.iterations, result.llr, known, strict=True)
    for llr, layer, bits, iterations, decoded_llr, information_ in rows:
        block = unpack(bits)
        status: Literal["ok", "crc_fail", "mismatch"] = "crc_fail" if block is None else "ok"
        if block is not None and (block.identity, block.layer) != (identity, layer):
            status, block = "mismatch", None
        raw, margin = hard_decisions(llr), float(np.abs(decoded_llr).mean())
        received = llr.astype(np.float32)
        words.append(Codeword(status, block, bits, raw, int(iterations), margin, received, float(information_)))
    return words, result.coded_extrinsic


class Layer:
    """Codewords of a layer between iterations, with some codewords known from the start."""

    def __init__(self, form: LayerFormat, identity: int, known: Sequence[Codeword] | None = None):
        shape = form.codewords, form.code.length
        self.form, self._identity = form, identity
        # (codewords, E) LLRs by the last equalisation, whitening undone
        self.llr = np.zeros(shape)
        # (codewords, E) mean of each coded bit, 1 for 0 and -1 for 1, and the variance
        self.soft, self.variance = np.zeros(shape), np.ones(shape)
        # (codewords, E) LLRs of this packet for comparison with earlier packets: 0 except for distinguishing bits
        self.own = np.zeros(shape)
        # (codewords, E) LLRs of earlier packets with the same codeword
        self.earlier = np.zeros(shape)
        # the codewords as last decoded, and the coded bits as decided by the first equalisation
        self.words = tuple(known or ())
        self._raw = np.stack([word.raw for word in known]) if known else None
        self._known = np.zeros(form.codewords, bool)
        for i, word in enumerate(self.words):
            self._known[i] = word.status != "crc_fail"
            self._feed_back(i, word)

    @property
    def is_open(self) -> NDArray[np.bool_]:
        """(codewords,) True for undecoded codewords."""
        return np.array([word.status == "crc_fail" for word in self.words] or [True] * len(self.llr))

    @property
    def information(self) -> Floats:
        """(codewords,) bit per coded bit in the LLRs of this packet and earlier packets."""
        return information(self.llr + self.earlier)

    def equalise(self, sent: Floats) -> None:
        """Take the LLRs of a new equalisation, (pairs, symbols)."""
        self.llr = self.form.deinterleave(np.clip(sent, -LARGEST_LLR, LARGEST_LLR))
        self._raw = hard_decisions(self.llr) if self._raw is None else self._raw

    def keep_own(self) -> None:
        """Keep the LLRs of this packet for comparison with earlier packets."""
        self.own = np.where(self.form.code.distinguishing, self.llr, 0.0)

    def decode(self, options: Decoding) -> None:
        """Decode the open codewords, with LLRs of earlier packets unless these fail or contradict this packet."""
        numbers: list[int] = np.flatnonzero(self.is_open).tolist()
        decoded = dict(zip(numbers, self._decode((self.llr + self.earlier)[numbers], options), strict=True))
        doubtful = [
            i
            for i, (word, _) in decoded.items()
            if self.earlier[i].any() and (word.status == "crc_fail" or not self._is_consistent(i, word))
        ]
        for i, alone in zip(doubtful, self._decode(self.llr[doubtful], options), strict=True):
            # the earlier packets' codeword may differ
            if decoded[i][0].status != "crc_fail" or alone[0].status != "crc_fail":
                decoded[i], self.earlier[i] = alone, 0.0
        assert self._raw is not None  # it is equalised
        words, is_soft = dict(enumerate(self.words)), options.feedback in ("soft", "propagation")
        for i, (word, extrinsic) in decoded.items():
            words[i] = replace(word, raw=self._raw[i], llr=self.llr[i].astype(np.float32))
            self._feed_back(i, word, extrinsic if is_soft else None)
        self.words = tuple(words[i] for i in range(len(self.llr)))

    def reject_inconsistent(self) -> None:
        """Reject codewords that disagree with the LLRs of this packet; the bits are unknown again."""
        words = list(self.words)
        for i, word in enumerate(words):
            if word.status != "crc_fail" and not self._known[i] and not self._is_consistent(i, word):
                words[i] = replace(word, status="crc_fail", block=None)
                self.soft[i], self.variance[i] = 0.0, 1.0
        self.words = tuple(words)

    def known_llrs(self) -> list[Floats]:
        """LLRs (E,) of each codeword; the largest possible if it is decoded."""
        return list(np.where(self.variance.max(1, keepdims=True) == 0, LARGEST_LLR * self.soft, self.llr))

    def drop_feedback(self) -> None:
        """Drop the feedback of failed codewords."""
        self.soft[self.is_open], self.variance[self.is_open] = 0.0, 1.0

    def mean(self) -> Floats:
        """(pairs, symbols) mean of each bit as sent."""
        return self.form.interleave(self.soft * (1.0 - 2.0 * self.form.chips))

    def variances(self) -> Floats:
        """(pairs, symbols) variance of each bit as sent."""
        return self.form.interleave(self.variance)

    def _feed_back(self, number: int, word: Codeword, extrinsic: Floats | None = None) -> None:
        """Set mean and variance of a codeword's bits: known, or by extrinsic LLRs (E,), or unknown."""
        if word.status != "crc_fail":
            self.soft[number], self.variance[number] = coded_signs(self.form.code, word), 0.0
        elif extrinsic is None:
            self.soft[number], self.variance[number] = 0.0, 1.0
        else:
            # decoding errors stem from the noise of the equaliser: extrinsic LLRs count less
            self.soft[number] = np.tanh(0.5 * 0.85 * extrinsic)
            self.variance[number] = np.maximum(1 - self.soft[number] ** 2, 2 * KNOWN_VARIANCE)

    def _is_consistent(self, number: int, word: Codeword) -> bool:
        return is_consistent(self.own[number], coded_signs(self.form.code, word))

    def _decode(self, llr: Floats, options: Decoding) -> list[tuple[Codeword, Floats]]:
        """Decode LLRs (codewords, E) together, also to extrinsic LLRs; only one iteration if all are hopeless."""
        if not len(llr):
            return []
        if is_hopeless(information(llr), self.form).all():
            options = replace(options, iterations=1)
        layers = [self.form.name] * len(llr)
        words, extrinsic = _decode_together(self.form.code, llr, layers, self._identity, options, coded_output=True)
        assert extrinsic is not None  # by coded_output
        return list(zip(words, np.clip(extrinsic.astype(np.float64), -LARGEST_LLR, LARGEST_LLR), strict=True))


def is_hopeless(information: Floats, form: LayerFormat) -> NDArray[np.bool_]:
    """Return True for codewords with too little information (bit per coded bit) to decode; it saves iterations."""
    # a code of rate 1/3 needs 1.3 times the rate
    return information < 0.3 * form.code.k / form.code.length


def coded_signs(code: Code, word: Codeword) -> Floats:
    """Coded bits (E,) of a codeword, 1 for 0 and -1 for 1."""
    return np.asarray(1.0 - 2.0 * code.encode(word.bits))


class SymbolMapper:
    """Maps means and LLRs between bits of layers and symbols of the equaliser."""

    def __init__(self, form: PacketFormat):
        self._single = form.single
        self._half = form.settings.side // 2
        self._edges = np.cumsum([layer.symbols for layer in form.layers.values()])[:-1]
        self._llr = np.zeros((form.layers["high"].pairs, self._half, self._half))

    def expected(self, means: Sequence[Floats], variances: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Compute mean and variance of each symbol, (patterns, n n)."""
        if not self._single:
            return np.concatenate(means, axis=1), np.concatenate(variances, axis=1)
        data = means[0].reshape(-1, self._half, self._half - 1)
        checks, total = self._decode_polarities(data)
        mean, square = np.zeros_like(self._llr), np.zeros_like(self._llr)
        mean[:, 1:, 0] = np.tanh(0.5 * checks[:, 1:].sum(-1))
        known = np.tanh(0.5 * (total[..., None] - checks))
        mean[:, :, 1:] = known * data
        # a variance above 1 - mean^2 marks an undecoded datum as unknown
        square[:, :, 1:] = known**2 * (1 - variances[0].reshape(data.shape))
        square[:, :, 0] = mean[:, :, 0] ** 2
        flat = len(mean), self._half**2
        high = mean.reshape(flat), 1 - square.reshape(flat)
        return np.concatenate([high[0], *means[1:]], axis=1), np.concatenate([high[1], *variances[1:]], axis=1)

    def bits(self, llr: Floats, means: Sequence[Floats]) -> list[Floats]:
        """Compute LLRs of the bits of each layer, (patterns, bits)."""
        if not self._single:
            return np.split(llr, self._edges, axis=1)
        size = self._half**2
        latest = llr[:, :size].reshape(self._llr.shape)
        # the extrinsic LLR of a known symbol is 0: keep the last one
        self._llr = np.where(latest == 0, self._llr, latest)
        checks, total = self._decode_polarities(means[0].reshape(-1, self._half, self._half - 1))
        data = _llr_of(np.tanh(0.5 * (total[..., None] - checks)) * np.tanh(0.5 * self._llr[:, :, 1:]))
        return [data.reshape(len(llr), -1), *np.split(llr[:, size:], self._edges[1:] - self._edges[0], axis=1)]

    def _decode_polarities(self, data: Floats) -> tuple[Floats, Floats]:
        """Compute messages of data to the polarities of rows, and the LLRs of these; row 0 has the polarity +1."""
        checks = _llr_of(np.tanh(0.5 * self._llr[:, :, 1:]) * data)
        total = self._llr[:, :, 0] + checks.sum(-1)
        checks[:, 0], total[:, 0] = 0.0, 2 * LARGEST_LLR
        return checks, total


def _llr_of(mean: Floats) -> Floats:
    """Compute the LLR of a mean, at most 28."""
    return np.asarray(2 * np.arctanh(np.clip(mean, -1 + 1e-12, 1 - 1e-12)))
