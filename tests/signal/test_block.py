"""Blocks: fields, CRC against zlib, channel errors and invalid arguments."""

import zlib
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.signal.block import MIN_BITS, Block, FileBlock, FileNotice, check, pack, payload_bytes, unpack
from heliograph.signal.packet import whitening
from heliograph.signal.settings import LAYERS
from heliograph.signal.turbo import QPP_SIZES

SMALL = Block("high", 3, 1, 0, 1, b"\xa5")


@st.composite
def blocks(draw: st.DrawFn) -> tuple[Block, int]:
    k = draw(st.sampled_from([k for k in QPP_SIZES if k >= MIN_BITS]))
    room = payload_bytes(k)
    sequence = draw(st.integers(0, min(65535, (2**24 - 2) // room)))
    length = min(sequence * room + draw(st.integers(1, 2 * room)), 2**24 - 1)
    payload = draw(st.binary(min_size=room, max_size=room))[: length - sequence * room]
    return Block(draw(st.sampled_from(LAYERS)), draw(st.integers(0, 255)), draw(st.integers(0, 255)), sequence, length,
                 payload), k  # fmt: skip


@examples(40)
@given(blocks())
def test_round_trip_with_the_check_sum_of_zlib(case: tuple[Block, int]) -> None:
    block, k = case
    bits = pack(block, k)
    assert bits.shape == (k,)
    data = np.packbits(bits).tobytes()
    assert int.from_bytes(data[-4:], "big") == zlib.crc32(data[:-4])
    assert check(bits)
    assert unpack(bits) == block


def test_every_single_and_double_error_is_detected_block_by_block() -> None:
    flips = [*combinations(range(MIN_BITS), 1), *combinations(range(MIN_BITS), 2)]
    bad = np.tile(pack(SMALL, MIN_BITS), (len(flips), 1))
    for row, places in zip(bad, flips, strict=True):
        row[list(places)] ^= 1
    assert not check(bad).any()
    assert unpack(bad[0]) is None
    bits = np.stack([pack(SMALL, 104)] * 6).reshape(2, 3, 104)
    bits[1, 0, 17] ^= 1
    assert check(bits).tolist() == [[True, True, True], [False, True, True]]


@pytest.mark.parametrize("first", [0x00, 0x20, 0xF0, 0x13, 0x1F])
def test_reserved_versions_and_layers_are_ignored(first: int) -> None:
    body = bytes([first]) + np.packbits(pack(SMALL, 104)).tobytes()[1:-4]
    bits = np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4, "big"), dtype=np.uint8))
    assert check(bits)
    assert unpack(bits) is None


def test_files_without_length_or_symbol_size_are_ignored() -> None:
    blocks: list[FileNotice | FileBlock] = [FileNotice("low", 0, 0, 0)]
    blocks += [FileBlock("low", 0, 0, 0, length, size, 0, b"") for length, size in ((5, 0), (0, 4))]
    for block in blocks:
        bits = pack(block, 336)
        assert check(bits)
        assert unpack(bits) is None


def test_payload_beyond_the_message_is_cut_off() -> None:
    block = unpack(pack(replace(SMALL, sequence=9), 104))
    assert block is not None
    assert block.payload == b""


@pytest.mark.parametrize(("name", "values", "message"), [
    ("identity", (-1, 256), "block's identity is 0 to 255, not {}"),
    ("stream", (-1, 256), "block's stream is 0 to 255, not {}"),
    ("sequence", (-1, 65536), "block's sequence is 0 to 65535, not {}"),
    ("length", (-1, 1 << 24), "block's length is 0 to 16777215, not {}"),
    ("layer", ("top",), "layers are high, middle, low, not top"),
    ("payload", (b"ab",), "holds 1 bytes of payload, not 2"),
])  # fmt: skip
def test_invalid_blocks_are_refused(name: str, values: tuple[Any, ...], message: str) -> None:
    for value in values:
        with pytest.raises(ValueError, match=message.format(value)):
            pack(replace(SMALL, **{name: value}), 104)


@pytest.mark.parametrize("k", [96, 0, 105, 1028])
def test_invalid_sizes_are_refused(k: int) -> None:
    with pytest.raises(ValueError, match="multiple of 8 bits, at least 104"):
        payload_bytes(k)


def test_whitened_idle_blocks_are_balanced_and_unlike() -> None:
    chips = np.stack([whitening(3072, layer, i) for layer in LAYERS for i in range(4)])
    signs = 1 - 2 * chips.astype(float)
    likeness = signs @ signs.T / 3072
    assert np.abs(signs.mean(1)).max() < 5 / np.sqrt(3072)  # 5 standard deviations for random chips
    assert np.abs(likeness - np.eye(len(chips))).max() < 5 / np.sqrt(3072)
