"""Layer state between iterations."""

import numpy as np
import pytest
from known_packets import FORM, IDENTITY, random_blocks
from numpy.typing import NDArray

from heliograph.receive.decode.codeword import Decoding, Layer
from heliograph.signal.block import Block

Floats = NDArray[np.float64]

NAME = "middle"
LAYER = FORM.layers[NAME]
OPTIONS = Decoding("log-map")


def sent_llrs(blocks: list[Block], size: float, wrong: float = 0.0) -> Floats:
    """Return LLRs (pairs, symbols) with magnitude `size`; a fraction `wrong` has flipped signs."""
    signs = 1.0 - 2.0 * LAYER.encode(blocks)
    return size * np.where(np.random.default_rng(0).uniform(size=signs.shape) < wrong, -signs, signs)


def equalised(llrs: Floats) -> Layer:
    layer = Layer(LAYER, IDENTITY)
    layer.equalise(llrs)
    return layer


@pytest.mark.parametrize(("wrong", "status"), [(0.0, "ok"), (0.4, "crc_fail")])
def test_feedback_of_codewords_that_failed_is_all_that_is_dropped(wrong: float, status: str) -> None:
    layer = equalised(sent_llrs(random_blocks(0)[NAME], 1.0, wrong))
    layer.decode(OPTIONS)
    assert [w.status for w in layer.words] == [status] * LAYER.codewords
    before = layer.soft.copy()
    assert before.any()
    layer.drop_feedback()
    assert np.array_equal(layer.soft, before) == (status == "ok")
    assert layer.soft.any() == (status == "ok")


def test_earlier_packets_of_another_codeword_are_left_out() -> None:
    """Foreign LLRs would favour another codeword; the current LLRs suffice."""
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    layer = equalised(sent_llrs(blocks, 3.0))
    layer.keep_own()
    layer.earlier = equalised(sent_llrs(others, 9.0)).llr
    layer.decode(OPTIONS)
    assert [word.block for word in layer.words] == blocks
    assert not layer.earlier.any()


def test_a_codeword_that_only_earlier_packets_support_is_doubted() -> None:
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    layer = equalised(sent_llrs(others, 3.0))
    layer.keep_own()
    layer.equalise(sent_llrs(blocks, 3.0))
    layer.decode(OPTIONS)
    assert [word.status for word in layer.words] == ["ok"] * LAYER.codewords
    layer.reject_inconsistent()
    assert [(word.status, word.block) for word in layer.words] == [("crc_fail", None)] * LAYER.codewords
    assert not layer.soft.any()
    assert (layer.variance == 1).all()


def test_a_codeword_that_another_reading_of_the_packet_decoded_is_not_doubted() -> None:
    """Known bits give zero LLRs in the equaliser, but the codeword stays decoded."""
    first = equalised(sent_llrs(random_blocks(0)[NAME], 3.0))
    first.decode(OPTIONS)
    layer = Layer(LAYER, IDENTITY, first.words)
    layer.keep_own()
    layer.reject_inconsistent()
    assert layer.words == first.words
    assert np.array_equal(layer.soft, first.soft)
    assert not layer.variance.any()
