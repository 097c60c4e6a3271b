"""Blocks: fields, CRC against zlib, channel errors and invalid arguments."""

import zlib
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.signal.block import MIN_BITS, Block, check, pack, payload_bytes, unpack
from heliograph.signal.settings import LAYERS
from heliograph.signal.turbo import QPP_SIZES
from heliograph.signal.whitening import whitening

SMALL = Block("high", 3, 1, 0, 1, b"\xa5")


@st.composite
def blocks(draw: st.DrawFn) -> tuple[Block, int]:
    k = draw(st.sampled_from([k for k in QPP_SIZES if k >= MIN_BITS]))
    room = payload_bytes(k)
    sequence = draw(st.integers(0, min(65535, (2**24 - 2) // room)))
    rest = draw(st.integers(1, 2 * room))
    length = min(sequence * room + rest, 2**24 - 1)
    payload = draw(st.binary(min_size=room, max_size=room))[: length - sequence * room]
    return Block(draw(st.sampled_from(LAYERS)), draw(st.integers(0, 255)), draw(st.integers(0, 255)), sequence, length,
                 payload), k  # fmt: skip


@given(blocks())
def test_round_trip_and_layout(case: tuple[Block, int]) -> None:
    block, k = case
    bits = pack(block, k)
    assert bits.shape == (k,)
    data = np.packbits(bits).tobytes()
    assert data[0] == 0x10 + LAYERS.index(block.layer)
    assert (data[1], data[2]) == (block.identity, block.stream)
    assert int.from_bytes(data[3:5], "big") == block.sequence
    assert int.from_bytes(data[5:8], "big") == block.length
    assert data[8:-4] == block.payload + bytes(k // 8 - 12 - len(block.payload))
    assert int.from_bytes(data[-4:], "big") == zlib.crc32(data[:-4])
    assert check(bits)
    assert unpack(bits) == block


def test_crc_is_that_of_ieee_802_3() -> None:
    """CRC-32 residue: data followed by a reflected (little-endian) CRC gives 0x2144DF1C."""
    data = np.packbits(pack(SMALL, 104)).tobytes()
    assert zlib.crc32(data[:-4] + data[-4:][::-1]) == 0x2144DF1C


def test_every_single_and_double_error_is_detected() -> None:
    good = pack(SMALL, MIN_BITS)
    flips = [*combinations(range(MIN_BITS), 1), *combinations(range(MIN_BITS), 2)]
    bad = np.tile(good, (len(flips), 1))
    for row, places in zip(bad, flips, strict=True):
        row[list(places)] ^= 1
    assert not check(bad).any()
    assert unpack(bad[0]) is None


def test_every_burst_up_to_32_bits_is_detected() -> None:
    rng = np.random.default_rng(1)
    good = pack(SMALL, 128)
    bad = np.tile(good, (3000, 1))
    for row in bad:
        length = rng.integers(1, 33)
        start = rng.integers(0, 128 - length + 1)
        burst = rng.integers(0, 2, length, dtype=np.uint8)
        burst[[0, -1]] = 1
        row[start : start + length] ^= burst
    assert not check(bad).any()


def test_batches_are_checked_block_by_block() -> None:
    bits = np.stack([pack(SMALL, 104)] * 6).reshape(2, 3, 104)
    bits[1, 0, 17] ^= 1
    assert check(bits).tolist() == [[True, True, True], [False, True, True]]


@pytest.mark.parametrize("first", [0x00, 0x20, 0xF0, 0x13, 0x1F])
def test_reserved_versions_and_layers_are_ignored(first: int) -> None:
    body = bytes([first]) + np.packbits(pack(SMALL, 104)).tobytes()[1:-4]
    bits = np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4, "big"), dtype=np.uint8))
    assert check(bits)
    assert unpack(bits) is None


def test_payload_beyond_the_message_is_cut_off() -> None:
    block = unpack(pack(replace(SMALL, sequence=9), 104))
    assert block is not None
    assert block.payload == b""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("identity", 256),
        ("identity", -1),
        ("stream", 256),
        ("stream", -1),
        ("sequence", 65536),
        ("sequence", -1),
        ("length", 1 << 24),
        ("length", -1),
    ],
)
def test_fields_out_of_range(name: str, value: int) -> None:
    with pytest.raises(ValueError, match=rf"block's {name} is 0 to \d+, not {value}"):
        pack(replace(SMALL, **{name: value}), 104)  # type: ignore[arg-type]


def test_unknown_layer_and_payload_too_long() -> None:
    with pytest.raises(ValueError, match="layers are high, middle, low, not top"):
        pack(replace(SMALL, layer="top"), 104)
    with pytest.raises(ValueError, match="holds 1 bytes of payload, not 2"):
        pack(replace(SMALL, payload=b"ab"), 104)


@pytest.mark.parametrize("k", [96, 0, 105, 1028])
def test_sizes_that_hold_no_block(k: int) -> None:
    with pytest.raises(ValueError, match="multiple of 8 bits, at least 104"):
        payload_bytes(k)


def test_whitening_is_the_m_sequence_from_each_start() -> None:
    """Step x^15 + x^14 + 1 chip by chip, period 2^15 - 1."""
    g = [1] * 15
    while len(g) < 3 * 32767:
        g.append(g[-1] ^ g[-15])
    assert g[:32767] == g[32767:65534]
    for number, layer in enumerate(LAYERS):
        for codeword in (0, 1, 63):
            start = (8192 * number + 509 * codeword) % 32767
            assert whitening(20000, layer, codeword).tolist() == g[start : start + 20000]


def test_whitened_idle_blocks_are_balanced_and_unlike() -> None:
    chips = np.stack([whitening(3072, layer, i) for layer in LAYERS for i in range(4)])
    signs = 1 - 2 * chips.astype(float)
    likeness = signs @ signs.T / 3072
    # 5 standard deviations for random chips
    assert np.abs(signs.mean(1)).max() < 5 / np.sqrt(3072)
    assert np.abs(likeness - np.eye(len(chips))).max() < 5 / np.sqrt(3072)
