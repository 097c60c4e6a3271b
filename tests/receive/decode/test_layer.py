"""A layer's codewords: each step gives another layer and leaves the one before as it was."""

from copy import deepcopy
from dataclasses import fields

import numpy as np
import pytest
from known_packets import FORM, IDENTITY, random_blocks
from numpy.typing import NDArray

from heliograph.receive.decode.codeword import Decoding, Layer, decode_layer
from heliograph.signal.block import Block

Floats = NDArray[np.float64]

NAME = "middle"
LAYER = FORM.layers[NAME]
OPTIONS = Decoding("log-map")


def sent_llrs(blocks: list[Block], size: float, wrong: float = 0.0) -> Floats:
    """LLRs (pairs, symbols) of a size for the bits as they were sent, a fraction of them of the wrong sign."""
    signs = 1.0 - 2.0 * LAYER.encode(blocks)
    return size * np.where(np.random.default_rng(0).uniform(size=signs.shape) < wrong, -signs, signs)


def same(one: Layer, other: Layer) -> bool:
    """Whether two layers have the same fields; words are compared by their status."""
    arrays = [field.name for field in fields(Layer) if field.name not in ("form", "words")]
    return [w.status for w in one.words] == [w.status for w in other.words] and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays
    )


@pytest.mark.parametrize(("wrong", "status"), [(0.0, "ok"), (0.4, "crc_fail")])
def test_decoding_leaves_its_argument_as_it_was(wrong: float, status: str) -> None:
    layer = Layer.unknown(LAYER).equalised(sent_llrs(random_blocks(0)[NAME], 1.0, wrong))
    before = deepcopy(layer)
    after = decode_layer(layer, NAME, IDENTITY, OPTIONS, feedback=True)
    assert same(layer, before)
    assert [w.status for w in after.words] == [status] * LAYER.codewords
    assert not same(after, before)
    # what is fed back of codewords that failed is all that is dropped, and again in another layer
    kept = deepcopy(after)
    bare = after.without_feedback()
    assert same(after, kept)
    assert same(bare, after) == (status == "ok")


def test_earlier_packets_of_another_codeword_are_left_out() -> None:
    """Their LLRs would have the decoder read their codeword; this packet's own are clear enough."""
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    other = Layer.unknown(LAYER).equalised(sent_llrs(others, 9.0)).llr
    layer = Layer.unknown(LAYER).equalised(sent_llrs(blocks, 3.0)).with_own().with_earlier(other)
    after = decode_layer(layer, NAME, IDENTITY, OPTIONS, feedback=True)
    assert [word.block for word in after.words] == blocks
    assert not after.earlier_llr.any()
    assert np.array_equal(layer.earlier_llr, other)


def test_a_codeword_that_only_earlier_packets_support_is_doubted() -> None:
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    layer = decode_layer(
        Layer.unknown(LAYER).equalised(sent_llrs(others, 3.0)).with_own().equalised(sent_llrs(blocks, 3.0)),
        NAME,
        IDENTITY,
        OPTIONS,
        feedback=True,
    )
    rejected = layer.reject_inconsistent()
    assert [word.status for word in layer.words] == ["ok"] * LAYER.codewords
    assert [(word.status, word.block) for word in rejected.words] == [("crc_fail", None)] * LAYER.codewords
    # and nothing of it is known any more
    assert not rejected.soft.any()
    assert (rejected.variance == 1).all()


def test_a_codeword_that_another_reading_of_the_packet_decoded_is_not_doubted() -> None:
    """Its bits are known from the start, so the equaliser has no LLRs of them."""
    blocks = random_blocks(0)[NAME]
    words = decode_layer(
        Layer.unknown(LAYER).equalised(sent_llrs(blocks, 3.0)), NAME, IDENTITY, OPTIONS, feedback=True
    ).words
    layer = Layer.unknown(LAYER).with_known(words).with_own()
    assert same(layer.reject_inconsistent(), layer)
