"""Codewords and layers from soft data: calibration, erasures, foreign blocks, earlier packets and polarity."""

from functools import cache
from itertools import islice, product

import known_packets
import numpy as np
import pytest
from known_packets import random_blocks
from numpy.typing import NDArray
from scenes import levels, link

from heliograph.base.arrays import Floats
from heliograph.link.simulate import default_messages, transmitters
from heliograph.receive.decode.codeword import Decoding, Layer, SymbolMapper, decode_packet, soft_to_llr
from heliograph.receive.packet import ERASED, Codeword
from heliograph.signal.block import AnyBlock, Block
from heliograph.signal.code import Algorithm
from heliograph.signal.formats import Format
from heliograph.signal.haar import inverse_transform
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS, SignalSettings

OPTIONS, ALL = Decoding(), np.ones(48, dtype=bool)


@cache
def sent() -> tuple[PacketFormat, list[AnyBlock], Floats]:
    """Return packet format, blocks of all layers and luminances x' = level - 2 for identity 0."""
    settings = link()
    blocks = transmitters(settings, default_messages(settings))[0].blocks(0)
    x = np.stack(list(islice(levels(settings), 100)))[4::2].astype(float) - 2
    return PacketFormat(settings.signal), [block for name in LAYERS for block in blocks[name]], x


def decode(x: Floats, seen: NDArray[np.bool_] = ALL, identity: int = 0, options: Decoding = OPTIONS) -> list[Codeword]:
    layers = decode_packet(x, seen, sent()[0], identity, options)
    return [word for name in LAYERS for word in layers[name]]


@pytest.mark.parametrize("amplitude", [1.0, 0.02, 300.0])
def test_clean_packet_is_decoded(amplitude: float) -> None:
    _, blocks, x = sent()
    words = decode(amplitude * x)
    assert [(w.block, w.status, w.iterations) for w in words] == [(block, "ok", 1) for block in blocks]
    assert not any((w.raw == ERASED).any() for w in words)


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


@pytest.mark.parametrize("soft", [np.zeros((6, 64)), np.ones((6, 64)), np.full((6, 64), -1e9), np.eye(6, 64) * 1e-12])
def test_extreme_values_give_finite_llrs(soft: Floats) -> None:
    llr = soft_to_llr(soft, np.ones(6, dtype=bool))
    assert np.isfinite(llr).all()
    assert (np.sign(llr) * np.sign(soft) >= 0).all()


@pytest.mark.parametrize("count", [14, 48])
def test_unseen_pairs_are_erased(count: int) -> None:
    rng, (_, blocks, x) = np.random.default_rng(0), sent()
    seen = rng.permutation(48) >= count
    # erased values must not matter
    words = decode(np.where(seen[:, None, None], x, rng.normal(0, 100, x.shape)), seen)
    status = [("ok", block) if count < 48 else ("crc_fail", None) for block in blocks]
    assert [(w.status, w.block) for w in words] == status
    assert np.concatenate([w.raw == ERASED for w in words]).mean() == pytest.approx(count / 48)
    assert not soft_to_llr(rng.normal(size=(48, 64)), seen)[~seen].any()


@pytest.mark.parametrize("algorithm", ["max-log", "log-map"])
def test_noise_is_corrected(algorithm: Algorithm) -> None:
    _, blocks, x = sent()
    noisy = x + np.random.default_rng(1).normal(0, 1.0, x.shape)
    assert [w.block for w in decode(noisy, options=Decoding(algorithm))] == blocks


def test_block_of_another_array_is_a_mismatch() -> None:
    assert {(w.status, w.block) for w in decode(sent()[2], identity=7)} == {("mismatch", None)}


def test_block_of_another_layer_is_rejected() -> None:
    form, _, x = sent()
    d = form.soft_data(x)
    swapped = d.copy()
    swapped[:, :8, :8], swapped[:, 8:, 8:] = d[:, 8:, 8:], d[:, :8, :8]
    assert [w.status == "ok" for w in decode(inverse_transform(swapped))] == [False, True, True, False]


@pytest.mark.parametrize("kind", ["noise", "strong", "constant sign"])
def test_noise_is_never_decoded(kind: str) -> None:
    # four short codewords per packet: K = 104 is the shortest block and the hardest case for the CRC
    form, rng = PacketFormat(SignalSettings(data_pairs=5)), np.random.default_rng(3)
    for _ in range(175):
        x = rng.normal(0, 1, (5, 16, 16))
        x = {"noise": x, "strong": 50 * np.sign(x), "constant sign": np.abs(x)}[kind]
        layers = decode_packet(x, np.ones(5, dtype=bool), form, 0, Decoding(iterations=2))
        assert [(w.status, w.block) for row in layers.values() for w in row] == [("crc_fail", None)] * 4


NAME, LOG_MAP = "middle", Decoding("log-map")
LAYER = known_packets.FORM.layers[NAME]
BLOCKS, OTHERS = (random_blocks(seed)[NAME] for seed in (0, 1))


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
    layer = equalised(sent_llrs(BLOCKS, 1.0, wrong))
    layer.decode(LOG_MAP)
    assert [w.status for w in layer.words] == [status] * LAYER.codewords
    before = layer.soft.copy()
    assert before.any()
    layer.drop_feedback()
    assert np.array_equal(layer.soft, before if status == "ok" else 0 * before)


def test_llrs_of_another_codeword_are_ignored() -> None:
    """Foreign LLRs would favour another codeword; the current LLRs suffice."""
    layer = equalised(sent_llrs(BLOCKS, 3.0))
    layer.keep_own()
    layer.earlier = equalised(sent_llrs(OTHERS, 9.0)).llr
    layer.decode(LOG_MAP)
    assert [word.block for word in layer.words] == BLOCKS
    assert not layer.earlier.any()


def test_codeword_that_only_earlier_packets_support_is_rejected() -> None:
    layer = equalised(sent_llrs(OTHERS, 3.0))
    layer.keep_own()
    layer.equalise(sent_llrs(BLOCKS, 3.0))
    layer.decode(LOG_MAP)
    assert [word.status for word in layer.words] == ["ok"] * LAYER.codewords
    layer.reject_inconsistent()
    assert [(word.status, word.block) for word in layer.words] == [("crc_fail", None)] * LAYER.codewords
    assert not layer.soft.any()
    assert (layer.variance == 1).all()


def test_codeword_known_from_samples_is_not_rejected() -> None:
    """Known bits give zero LLRs in the equaliser, but the codeword stays decoded."""
    first = equalised(sent_llrs(BLOCKS, 3.0))
    first.decode(LOG_MAP)
    layer = Layer(LAYER, known_packets.IDENTITY, first.words)
    layer.keep_own()
    layer.reject_inconsistent()
    assert layer.words == first.words
    assert np.array_equal(layer.soft, first.soft)
    assert not layer.variance.any()


SMALL = PacketFormat(SignalSettings(side=8, data_pairs=21), Format(mode="single"))


def by_hand(llr: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Return extrinsic data LLRs and symbol priors for a row of 4 symbols by enumeration; polarity comes first."""

    def odds(symbol: int | None, datum: int | None) -> Floats:
        """Return total probabilities for symbol (or datum) = +1 and -1."""
        total = np.zeros(2)
        for s, *d in product((1, -1), repeat=4):
            values = [s, *(s * one for one in d)]
            p = 1.0
            for k in range(4):
                p *= 1.0 if k == symbol else 1 / (1 + np.exp(-values[k] * llr[k]))
            for k in range(3):
                p *= 1.0 if k == datum else (1 + d[k] * mean[k]) / 2
            shown = values[symbol] if symbol is not None else d[datum or 0]
            total[0 if shown > 0 else 1] += p
        return total

    data = np.array([np.log(np.divide(*odds(None, k))) for k in range(3)])
    symbols = [odds(k, None) for k in range(4)]
    return data, np.array([(a - b) / (a + b) for a, b in symbols])


def test_messages_are_those_of_exact_sums() -> None:
    rng, mapper, llr = np.random.default_rng(1), SymbolMapper(SMALL), np.zeros((42, 64))
    llr[:, :16] = rng.normal(0, 2, (42, 16))
    means = [rng.uniform(-0.9, 0.9, (42, 12)), np.zeros((42, 32)), np.zeros((42, 16))]
    high = mapper.bits(llr, means)[0].reshape(42, 4, 3)
    mean, variance = mapper.expected(means, [1 - m**2 for m in means])
    for pattern, row in ((0, 1), (17, 3), (41, 2)):
        seen, data = llr[pattern, :16].reshape(4, 4)[row], means[0][pattern].reshape(4, 3)[row]
        expected, prior = by_hand(seen, data)
        assert high[pattern, row] == pytest.approx(expected, abs=1e-9)
        assert mean[pattern, :16].reshape(4, 4)[row] == pytest.approx(prior, abs=1e-9)
    assert variance[:, :16] == pytest.approx(1 - mean[:, :16] ** 2, abs=1e-9)
    # row 0 has no polarity: symbols equal data, and the first symbol carries no datum
    assert high[:, 0] == pytest.approx(llr[:, 1:4])
    assert mean[:, :4] == pytest.approx(np.pad(means[0][:, :3], ((0, 0), (1, 0))))
    assert np.all(variance[:, 0] == 1)


def test_a_polarity_once_known_stays_known() -> None:
    """The equaliser gives no LLRs for known symbols."""
    mapper = SymbolMapper(SMALL)
    llr = np.full((42, 64), 30.0)
    none = [np.zeros((42, n)) for n in (12, 32, 16)]
    mapper.bits(llr, none)
    known = [np.ones((42, 12)), *none[1:]]
    certain = [np.zeros((42, 12)), np.ones((42, 32)), np.ones((42, 16))]
    for _ in range(3):
        mean, variance = mapper.expected(known, certain)
        assert variance[:, 1:4].max() < 1e-3
        assert mean[:, 5:8].min() > 0.999
        llr[:, :16] = 0
        mapper.bits(llr, known)


def test_in_pairs_every_symbol_is_a_bit() -> None:
    form = PacketFormat(SignalSettings(side=8, data_pairs=40))
    rng, mapper = np.random.default_rng(2), SymbolMapper(form)
    llr = rng.normal(size=(40, 64))
    means = [rng.uniform(-1, 1, (40, n)) for n in (16, 32, 16)]
    assert np.array_equal(np.concatenate(mapper.bits(llr, means), axis=1), llr)
    mean, variance = mapper.expected(means, [1 - m**2 for m in means])
    assert np.array_equal(mean, np.concatenate(means, axis=1))
    assert np.array_equal(variance, 1 - mean**2)
