"""A layer's codewords while their packet is decoded: what is known of their bits, and what the turbo decoder adds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import entr, expit

from heliograph.receive.decode import LARGEST_LLR, codeword_of, hard
from heliograph.receive.packets import Codeword
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.equalise import KNOWN
from heliograph.receive.soft.memory import faithful
from heliograph.signal.block import check
from heliograph.signal.packet import LayerFormat
from heliograph.signal.turbo import TurboCode
from heliograph.signal.turbo.rate_match import STREAMS

Floats = NDArray[np.float64]

TRUST = 0.85
"""Share at which a failed codeword's LLRs are fed back: a decoder's guesses come from the noise they are added to."""

HOPELESS = 0.3
"""Share of a code's rate that LLRs must tell of each bit: of less nothing comes, and where all open codewords of a
layer tell less, one iteration has to do."""


@dataclass(slots=True)
class Layer:
    """What is known of a layer's codewords.

    Attributes
    ----------
    form
        Its format.
    llr
        (codewords, E) of the equaliser's last round.
    soft
        (codewords, E) mean of each coded bit, 1 for 0 and -1 for 1.
    variance
        (codewords, E) variance of each.
    own
        (codewords, E) what this look tells codewords apart by: the `telling` of its LLRs, nothing else known.
    recalled
        (codewords, E) LLRs of earlier looks at each codeword.
    words
        The codewords by the last decoding.
    """

    form: LayerFormat
    llr: Floats
    soft: Floats
    variance: Floats
    own: Floats
    recalled: Floats
    words: list[Codeword]

    @classmethod
    def unknown(cls, form: LayerFormat) -> "Layer":
        """A layer of which nothing is known."""
        shape = form.codewords, form.code.length
        return cls(form, np.zeros(shape), np.zeros(shape), np.ones(shape), np.zeros(shape), np.zeros(shape), [])

    @property
    def telling(self) -> NDArray[np.bool_]:
        """(E,) coded bits that differ by chance in different codewords: those of the second encoder.

        The bits of blocks are much alike, as are texts and filling, and those of the first encoder with them.
        """
        return np.asarray(self.form.code.positions % STREAMS == STREAMS - 1)

    def doubt(self) -> None:
        """Take codewords for wrong that this look alone does not speak for."""
        for i, (word, own) in enumerate(zip(self.words, self.own, strict=True)):
            if word.status != "crc_fail" and not faithful(own, _signs(self.form.code, word)):
                self.words[i] = replace(word, status="crc_fail", block=None)

    def unsure(self, number: int) -> bool:
        """Whether a codeword is not decoded, or only with the help of earlier looks."""
        return self.words[number].status == "crc_fail" or bool(self.recalled[number].any())

    def sure_llrs(self) -> list[Floats]:
        """LLRs (E,) of each codeword, those of a decoded one without doubt."""
        known = self.variance.max(1) == 0
        return [LARGEST_LLR * soft if sure else llr for llr, soft, sure in zip(self.llr, self.soft, known, strict=True)]

    def forget_guesses(self) -> None:
        """Know nothing any more of the codewords that are not decoded."""
        for i, word in enumerate(self.words):
            if word.status == "crc_fail":
                self.soft[i], self.variance[i] = 0.0, 1.0

    def mean(self) -> Floats:
        """(pairs, cells) mean of each cell."""
        return self.form.interleave(self.soft * (1.0 - 2.0 * self.form.chips))

    def variances(self) -> Floats:
        """(pairs, cells) variance of each cell."""
        return self.form.interleave(self.variance)


def information(llr: Floats) -> Floats:
    """What LLRs (..., E) tell of their bits if they are right, in bit each, (...,)."""
    # I = 1 - h2(P(wrong)), P(wrong) = 1 / (1 + exp |L|)
    wrong = expit(-np.abs(llr))
    return np.asarray(1 - (entr(wrong) + entr(1 - wrong)).mean(-1) / np.log(2))


def decode_layer(layer: Layer, name: str, identity: int, settings: ReceiveSettings) -> None:
    """Decode the codewords still open and tell what is known of their bits by now."""
    code = layer.form.code
    open_ = [i for i in range(len(layer.llr)) if not layer.words or layer.words[i].status == "crc_fail"]
    words = dict(enumerate(layer.words))
    found = dict(zip(open_, _decode(code, (layer.llr + layer.recalled)[open_], identity, name, settings), strict=True))
    doubtful = [i for i, (word, _) in found.items() if _doubtful(layer, i, word)]
    for i, (word, after) in zip(doubtful, _decode(code, layer.llr[doubtful], identity, name, settings), strict=True):
        # what was recalled may be another codeword, like this one
        if found[i][0].status != "crc_fail" or word.status != "crc_fail":
            layer.recalled[i], found[i] = 0.0, (word, after)
    for i, (word, after) in found.items():
        words[i] = replace(word, raw=hard(layer.llr[i]))
        if word.status == "crc_fail" and settings.soft.feedback != "soft":
            layer.soft[i], layer.variance[i] = 0.0, 1.0
        elif word.status == "crc_fail":
            layer.soft[i] = np.tanh(0.5 * TRUST * after)
            layer.variance[i] = np.maximum(1 - layer.soft[i] ** 2, 2 * KNOWN)
        else:
            layer.soft[i], layer.variance[i] = _signs(code, word), 0.0
    layer.words = [words[i] for i in range(len(layer.llr))]


def _doubtful(layer: Layer, number: int, word: Codeword) -> bool:
    """Whether a codeword was not read with what was recalled, or by that alone."""
    if not layer.recalled[number].any():
        return False
    return word.status == "crc_fail" or not faithful(layer.own[number], _signs(layer.form.code, word))


def _signs(code: TurboCode, word: Codeword) -> Floats:
    """Coded bits (E,) of a codeword, 1 for 0 and -1 for 1."""
    return np.asarray(1.0 - 2.0 * code.encode(word.bits))


def _decode(
    code: TurboCode, llr: Floats, identity: int, name: str, settings: ReceiveSettings
) -> list[tuple[Codeword, Floats]]:
    """The codewords of LLRs (codewords, E), and what the code adds to the LLRs of their coded bits.

    They are decoded together, which takes no longer than one of them; where all are hopeless one iteration has to do.
    """
    if not len(llr):
        return []
    few = (information(llr) < HOPELESS * code.rate).all()
    result = code.decode(
        llr,
        algorithm=settings.soft.algorithm,
        iterations=1 if few else settings.decode.iterations,
        stop="crc",
        check=check,
        coded_output=True,
    )
    assert result.coded_extrinsic is not None  # it was asked for
    after = np.clip(result.coded_extrinsic.astype(np.float64), -LARGEST_LLR, LARGEST_LLR)
    margins = np.abs(result.llr).mean(-1)
    decoded = zip(result.bits, result.iterations, margins, strict=True)
    words = [
        codeword_of((bits, int(count), float(margin)), one, identity, name)
        for (bits, count, margin), one in zip(decoded, llr, strict=True)
    ]
    return list(zip(words, after, strict=True))
