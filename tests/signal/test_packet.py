"""Packets: bit placement, codeword sizes and decoding from patterns to blocks."""

from itertools import product
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from heliograph.signal.block import AnyBlock, Block, unpack
from heliograph.signal.packet import LayerFormat, PacketFormat
from heliograph.signal.pwm import waveform
from heliograph.signal.settings import LAYERS, RateSettings, SignalSettings
from heliograph.signal.turbo import QPP_SIZES

Modulation = Literal["haar", "ook"]


def make(side: int = 16, pairs: int = 48, rate: float = 1 / 3, modulation: Modulation = "haar") -> PacketFormat:
    rates = RateSettings(high=rate, middle=rate, low=rate)
    return PacketFormat(SignalSettings(side=side, data_pairs=pairs, rate=rates, modulation=modulation))


def random_blocks(form: PacketFormat, identity: int, seed: int = 1) -> dict[str, list[Block]]:
    rng = np.random.default_rng(seed)

    def block(layer: LayerFormat, i: int) -> Block:
        return Block(layer.name, identity, seed, i, 1 << 20, rng.bytes(layer.payload_bytes))

    return {name: [block(layer, i) for i in range(layer.codewords)] for name, layer in form.layers.items()}


def read(form: PacketFormat, patterns: NDArray[Any], gain: float = 1.0) -> dict[str, list[AnyBlock | None]]:
    """Decode noiseless patterns: pair differences, Haar transform, deinterleaving, turbo decoder."""
    data = patterns[2 * form.settings.header_pairs :].astype(float)
    soft = form.split(form.soft_data(gain * (data[0::2] - data[1::2])))
    found = {}
    for name, layer in form.layers.items():
        bits = layer.code.decode(4 * layer.deinterleave(soft[name])).bits
        found[name] = [unpack(row) for row in bits]
    return found


@pytest.mark.parametrize(("side", "pairs", "rate"), [
    (4, 78, 1 / 3), (4, 117, 0.5), (8, 21, 1 / 3), (8, 33, 0.75), (16, 48, 1 / 3), (16, 49, 0.9), (32, 13, 0.5),
])  # fmt: skip
def test_patterns_give_the_blocks_back_and_pairs_have_constant_light(side: int, pairs: int, rate: float) -> None:
    form = make(side, pairs, rate)
    blocks = random_blocks(form, 7)
    patterns = form.patterns(7, blocks)
    assert patterns.shape == (2 * (2 + pairs), side, side)
    assert patterns.dtype == np.uint8
    assert patterns.max() <= 4
    assert read(form, patterns) == blocks
    assert read(form, patterns, 0.3) == blocks  # gain invariance
    assert np.all(patterns[0::2] + patterns[1::2] == 4)
    assert np.allclose(waveform(patterns).reshape(-1, 8).sum(1), 4)  # constant flux in every pair, header and data


@examples(30)
@given(st.sampled_from([4, 8, 12, 16, 20, 24, 32, 44, 48, 64]), st.integers(1, 200))
def test_interleaver_is_a_bijection_for_any_size(side: int, pairs: int) -> None:
    code = make().layers["high"].code
    for quarters in (1, 2):
        places = LayerFormat("high", 1, code, pairs, quarters * (side // 2) ** 2).places
        assert np.array_equal(np.sort(places), np.arange(pairs * quarters * (side // 2) ** 2))


@examples(40)
@given(st.sampled_from([4, 8, 16]), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_split_undoes_join(side: int, pairs: int, seed: int) -> None:
    form = make(side)
    symbols = np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), (pairs, side**2))
    d = form.join(symbols)
    parts = form.split(d.astype(float))
    assert np.array_equal(np.concatenate([parts[name] for name in LAYERS], axis=1), symbols)
    h = side // 2  # paper's quarters: D11 high, D12 then D21 middle, D22 low
    assert np.array_equal(parts["high"][0], d[0, :h, :h].ravel())
    assert np.array_equal(parts["middle"][0], np.concatenate([d[0, :h, h:].ravel(), d[0, h:, :h].ravel()]))
    assert np.array_equal(parts["low"][0], d[0, h:, h:].ravel())


@pytest.mark.parametrize("modulation", ["haar", "ook"])
def test_layers_are_where_blur_leaves_them(modulation: Modulation) -> None:
    """Means over 2 x 2 LEDs preserve the high layer for Haar coding, and no layer for on-off keying."""
    form = make(16, 48, modulation=modulation)
    blocks = random_blocks(form, 0)
    patterns = form.patterns(0, blocks).astype(float)
    means = patterns.reshape(-1, 8, 2, 8, 2).mean((2, 4))
    found = read(form, np.kron(means, np.ones((1, 2, 2))))
    assert (found["high"] == blocks["high"]) == (modulation == "haar")
    assert found["middle"] != blocks["middle"]
    assert found["low"] != blocks["low"]


def test_a_lost_quarter_of_the_array_or_of_the_packet_is_decoded() -> None:
    form = make()
    for name, layer in form.layers.items():
        info = np.random.default_rng(3).integers(0, 2, (layer.codewords, layer.code.k), dtype=np.uint8)
        sent = 1.0 - 2.0 * layer.interleave(layer.code.encode(info) ^ layer.chips).astype(np.float64)
        for start, along_pairs in product((0, 0.4, 0.75), (True, False)):
            kept = sent.copy()
            size = kept.shape[0] if along_pairs else kept.shape[1]
            gone = slice(int(start * size), int((start + 0.25) * size))
            kept[gone if along_pairs else slice(None), slice(None) if along_pairs else gone] = 0
            assert np.array_equal(layer.code.decode(4 * layer.deinterleave(kept)).bits, info), name


@pytest.mark.parametrize("rate", [1 / 3, 0.5, 0.75, 0.9])
@pytest.mark.parametrize(("side", "pairs"), [(8, 77), (16, 48), (64, 101)])
def test_codewords_fill_the_packet_at_about_the_rate(side: int, pairs: int, rate: float) -> None:
    layers, quarter = make(side, pairs, rate).layers, (side // 2) ** 2 * pairs
    for name, quarters in zip(LAYERS, (1, 2, 1), strict=True):
        layer = layers[name]
        assert layer.codewords * layer.code.length == quarters * quarter
        assert layer.code.k in QPP_SIZES
        assert layer.code.k / layer.code.length <= 0.9
        # half the largest step between sizes, or a full step at the highest rate
        assert abs(layer.code.k - rate * layer.code.length) <= (64 if rate > 0.88 else 32)
    assert layers["middle"].codewords == 2 * layers["high"].codewords == 2 * layers["low"].codewords
    assert layers["middle"].code == layers["high"].code


def test_codewords_are_as_long_as_may_be() -> None:
    high = make().layers["high"]  # 16 x 16, 48 pairs: 3072 bits per quarter, one codeword with 1024 bits at rate 1/3
    assert (high.codewords, high.code.k, high.code.length, high.payload_bytes) == (1, 1024, 3072, 116)
    # 32 x 32, 101 pairs at 0.9: 25856 = 2^8 * 101 bits; a quarter needs K = 5818, a half K = 11635
    assert make(32, 101, 0.9).layers["high"].codewords == 4


def test_whitening_is_in_the_light() -> None:
    """Nearly empty idle blocks light half the LEDs: levels follow 1 4 6 4 1."""
    form = make()
    idle = {name: [Block(name, 0, 0, 0, 0, b"")] * layer.codewords for name, layer in form.layers.items()}
    shares = np.bincount(form.data_patterns(idle).ravel(), minlength=5) / (48 * 256)
    assert np.allclose(shares, np.array([1, 4, 6, 4, 1]) / 16, atol=0.02)


def test_all_on_header_changes_the_header_alone() -> None:
    form, other = make(), PacketFormat(SignalSettings(header="all_on"))
    blocks = random_blocks(form, 7)
    usual, all_on = form.patterns(3, blocks), other.patterns(3, blocks)
    assert np.array_equal(all_on[:4].reshape(4, -1), np.array([4, 0, 4, 0])[:, None].repeat(256, 1))
    assert np.array_equal(all_on[4:], usual[4:])
    assert np.array_equal(other.header_pattern(0), other.header_pattern(29))
    assert not np.array_equal(form.header_pattern(0), form.header_pattern(29))
