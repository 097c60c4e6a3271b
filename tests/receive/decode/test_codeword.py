"""Codewords and layers from soft data: LLR calibration, erasures, foreign blocks, noise and earlier packets."""

from functools import cache

import known_packets
import numpy as np
import pytest
from known_packets import random_blocks
from numpy.typing import NDArray
from scenes import levels, link

from heliograph.link.simulate import default_messages, transmitters
from heliograph.receive.decode.codeword import Decoding, Layer, decode_packet, soft_to_llr
from heliograph.receive.packet import ERASED
from heliograph.signal.block import AnyBlock, Block
from heliograph.signal.code import Algorithm
from heliograph.signal.haar import inverse_transform
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS, SignalSettings

Floats = NDArray[np.float64]

OPTIONS = Decoding()
ALL = np.ones(48, dtype=bool)


@cache
def sent() -> tuple[PacketFormat, dict[str, list[AnyBlock]], Floats]:
    """Return packet format, blocks and luminances x' = level - 2 for identity 0."""
    settings = link()
    stream = levels(settings)
    patterns = np.stack([next(stream) for _ in range(100)])[4::2]
    blocks = transmitters(settings, default_messages(settings))[0].blocks(0)
    return PacketFormat(settings.signal), blocks, patterns.astype(float) - 2


@pytest.mark.parametrize("amplitude", [1.0, 0.02, 300.0])
def test_clean_packet_is_decoded(amplitude: float) -> None:
    form, blocks, x = sent()
    layers = decode_packet(amplitude * x, ALL, form, 0, OPTIONS)
    for name in LAYERS:
        assert [w.block for w in layers[name]] == blocks[name]
        assert all(w.status == "ok" and w.iterations == 1 and not (w.raw == ERASED).any() for w in layers[name])


@pytest.mark.parametrize("esn0_db", [-4.0, 0.0, 4.0])
def test_llrs_are_calibrated(esn0_db: float) -> None:
    rng = np.random.default_rng(int(esn0_db) + 10)
    sigma = 10 ** (-esn0_db / 20) / np.sqrt(2)
    bits = rng.integers(0, 2, (800, 64))
    llr = soft_to_llr(3.7 * (1 - 2 * bits + rng.normal(0, sigma, bits.shape)), np.ones(800, dtype=bool))
    predicted, wrong = 1 / (1 + np.exp(np.abs(llr))), (llr < 0) != bits
    assert predicted.mean() == pytest.approx(wrong.mean(), rel=0.2)
    # calibrated for small, medium and large LLRs, given enough errors
    parts = np.array_split(np.argsort(np.abs(llr), axis=None), 3)
    counted = [part for part in parts if wrong.ravel()[part].sum() > 300]
    assert counted
    for part in counted:
        assert predicted.ravel()[part].mean() == pytest.approx(wrong.ravel()[part].mean(), rel=0.2)


def test_extreme_values_give_finite_llrs() -> None:
    seen = np.ones(6, dtype=bool)
    for soft in (np.zeros((6, 64)), np.ones((6, 64)), -np.ones((6, 64)) * 1e9, np.eye(6, 64) * 1e-12):
        llr = soft_to_llr(soft, seen)
        assert np.isfinite(llr).all()
        assert (np.sign(llr) * np.sign(soft) >= 0).all()


def test_unseen_pairs_are_erased() -> None:
    rng = np.random.default_rng(0)
    form, blocks, x = sent()
    seen = rng.permutation(48) >= 14
    # erased values must not matter
    spoilt = np.where(seen[:, None, None], x, rng.normal(0, 100, x.shape))
    layers = decode_packet(spoilt, seen, form, 0, OPTIONS)
    assert [w.block for name in LAYERS for w in layers[name]] == [b for name in LAYERS for b in blocks[name]]
    erased = np.concatenate([w.raw == ERASED for name in LAYERS for w in layers[name]])
    assert erased.mean() == pytest.approx(14 / 48)
    assert not soft_to_llr(rng.normal(size=(48, 64)), seen)[~seen].any()


def test_packet_without_pairs_is_erased() -> None:
    form, _, x = sent()
    layers = decode_packet(x, np.zeros(48, dtype=bool), form, 0, OPTIONS)
    assert all(w.status == "crc_fail" and (w.raw == ERASED).all() for words in layers.values() for w in words)


@pytest.mark.parametrize("algorithm", ["max-log", "log-map"])
def test_noise_is_corrected(algorithm: Algorithm) -> None:
    form, blocks, x = sent()
    noisy = x + np.random.default_rng(1).normal(0, 1.0, x.shape)
    layers = decode_packet(noisy, ALL, form, 0, Decoding(algorithm))
    assert [w.block for name in LAYERS for w in layers[name]] == [b for name in LAYERS for b in blocks[name]]


def test_block_of_another_array_is_a_mismatch() -> None:
    form, _, x = sent()
    layers = decode_packet(x, ALL, form, 7, OPTIONS)
    assert {(w.status, w.block) for words in layers.values() for w in words} == {("mismatch", None)}


def test_block_of_another_layer_is_rejected() -> None:
    form, _, x = sent()
    d = form.soft_data(x)
    swapped = d.copy()
    swapped[:, :8, :8], swapped[:, 8:, 8:] = d[:, 8:, 8:], d[:, :8, :8]
    layers = decode_packet(inverse_transform(swapped), ALL, form, 0, OPTIONS)
    assert [w.status == "ok" for name in LAYERS for w in layers[name]] == [False, True, True, False]


@pytest.mark.parametrize("kind", ["noise", "strong", "constant sign"])
def test_noise_is_never_decoded(kind: str) -> None:
    # short codewords, 20 per packet: K = 104 is the shortest block and the hardest case for the CRC
    form = PacketFormat(SignalSettings(data_pairs=5))
    words = sum(layer.codewords for layer in form.layers.values())
    rng, count = np.random.default_rng(3), 0
    while count < 700:
        x = rng.normal(0, 1, (5, 16, 16))
        x = {"noise": x, "strong": 50 * np.sign(x), "constant sign": np.abs(x)}[kind]
        layers = decode_packet(x, np.ones(5, dtype=bool), form, 0, Decoding(iterations=2))
        assert all(w.status == "crc_fail" and w.block is None for row in layers.values() for w in row)
        count += words


def test_on_off_keying_is_decoded() -> None:
    settings = link("signal.modulation=ook")
    stream = levels(settings)
    x = np.stack([next(stream) for _ in range(100)])[4::2].astype(float) - 2
    layers = decode_packet(x, ALL, PacketFormat(settings.signal), 0, OPTIONS)
    assert {w.status for words in layers.values() for w in words} == {"ok"}


NAME = "middle"
LAYER = known_packets.FORM.layers[NAME]
LOG_MAP = Decoding("log-map")


def sent_llrs(blocks: list[Block], size: float, wrong: float = 0.0) -> Floats:
    """Return LLRs (pairs, symbols) with magnitude `size`; a fraction `wrong` has flipped signs."""
    signs = 1.0 - 2.0 * LAYER.encode(blocks)
    return size * np.where(np.random.default_rng(0).uniform(size=signs.shape) < wrong, -signs, signs)


def equalised(llrs: Floats) -> Layer:
    layer = Layer(LAYER, known_packets.IDENTITY)
    layer.equalise(llrs)
    return layer


@pytest.mark.parametrize(("wrong", "status"), [(0.0, "ok"), (0.4, "crc_fail")])
def test_only_feedback_of_failed_codewords_is_dropped(wrong: float, status: str) -> None:
    layer = equalised(sent_llrs(random_blocks(0)[NAME], 1.0, wrong))
    layer.decode(LOG_MAP)
    assert [w.status for w in layer.words] == [status] * LAYER.codewords
    before = layer.soft.copy()
    assert before.any()
    layer.drop_feedback()
    assert np.array_equal(layer.soft, before) == (status == "ok")
    assert layer.soft.any() == (status == "ok")


def test_llrs_of_another_codeword_are_ignored() -> None:
    """Foreign LLRs would favour another codeword; the current LLRs suffice."""
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    layer = equalised(sent_llrs(blocks, 3.0))
    layer.keep_own()
    layer.earlier = equalised(sent_llrs(others, 9.0)).llr
    layer.decode(LOG_MAP)
    assert [word.block for word in layer.words] == blocks
    assert not layer.earlier.any()


def test_codeword_that_only_earlier_packets_support_is_rejected() -> None:
    blocks, others = random_blocks(0)[NAME], random_blocks(1)[NAME]
    layer = equalised(sent_llrs(others, 3.0))
    layer.keep_own()
    layer.equalise(sent_llrs(blocks, 3.0))
    layer.decode(LOG_MAP)
    assert [word.status for word in layer.words] == ["ok"] * LAYER.codewords
    layer.reject_inconsistent()
    assert [(word.status, word.block) for word in layer.words] == [("crc_fail", None)] * LAYER.codewords
    assert not layer.soft.any()
    assert (layer.variance == 1).all()


def test_codeword_known_from_samples_is_not_rejected() -> None:
    """Known bits give zero LLRs in the equaliser, but the codeword stays decoded."""
    first = equalised(sent_llrs(random_blocks(0)[NAME], 3.0))
    first.decode(LOG_MAP)
    layer = Layer(LAYER, known_packets.IDENTITY, first.words)
    layer.keep_own()
    layer.reject_inconsistent()
    assert layer.words == first.words
    assert np.array_equal(layer.soft, first.soft)
    assert not layer.variance.any()
