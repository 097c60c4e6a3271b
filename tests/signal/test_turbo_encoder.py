"""Turbo encoder, interleaver and rate matching against external vectors."""

import csv
import re
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.signal.turbo import QPP_SIZES, TurboCode
from heliograph.signal.turbo.encoder import selection
from heliograph.signal.turbo.qpp import coefficients, interleaver

Bits = NDArray[np.uint8]


def read_bits(path: Path) -> Bits:
    return np.array(re.findall(r"[01]", path.read_text()), dtype=np.uint8)


def in_block_order(mother: Bits) -> Bits:
    """Reorder interleaved d0 d1 d2 into consecutive streams S, P1, P2, as in MATLAB's lteTurboEncode."""
    return mother.reshape(-1, 3).T.ravel()


@pytest.mark.real_data
def test_interleaver_table_is_the_standards(data: Path) -> None:
    with (data / "turbo" / "turbo_coeffs.csv").open(encoding="utf-8-sig") as file:
        rows = [tuple(map(int, (row["K"], row["f1"], row["f2"]))) for row in csv.DictReader(file)]
    assert rows == [(k, *coefficients(k)) for k in QPP_SIZES]


def test_every_interleaver_is_a_permutation_with_the_qpp_property() -> None:
    for k in QPP_SIZES:
        order = interleaver(k)
        assert np.array_equal(np.sort(order), np.arange(k))
        assert gcd(coefficients(k)[0], k) == 1  # permutation polynomial: f1 is coprime to K (Sun and Takeshita, 2005)
        assert np.array_equal(order % 2, np.arange(k) % 2)  # parity-preserving: contention-free parallel memory access


@pytest.mark.real_data
@pytest.mark.parametrize("k", [40, 112, 168, 432])
def test_sionna_vectors(data: Path, k: int) -> None:
    bits, coded = (np.load(data / "turbo" / f"ref_k{k}_{name}.npy") for name in "ux")
    assert np.array_equal(TurboCode(k=k).encode(bits), coded)


@pytest.mark.real_data
def test_matlab_k40(data: Path) -> None:
    """The first 40 input bits give 132 coded bits in block order S P1 P2; the file holds more."""
    folder = data / "turbo" / "matlab"
    bits = read_bits(folder / "test_turboCode.infile")[:40]
    expected = read_bits(folder / "test_turboCode.outfile.ground")
    assert np.array_equal(in_block_order(TurboCode(k=40).encode(bits)), expected)


@pytest.mark.real_data
def test_matlab_k5504(data: Path) -> None:
    """`infile` is lteTurboEncode output in block order S P1 P2, `ground` the 5504 information bits."""
    folder = data / "turbo" / "matlab"
    coded, bits = (read_bits(folder / f"test_decodeTurbo.{end}") for end in ("infile", "outfile.ground"))
    assert np.array_equal(in_block_order(TurboCode(k=5504).encode(bits)), coded)
    decoded = TurboCode(k=5504).decode(4.0 * (1 - 2.0 * coded.reshape(3, -1).T.ravel()))
    assert np.array_equal(decoded.bits, bits)


# (stream length D, coded bits E, redundancy version) per call, in file order
MATLAB_CALLS = [(8, 10, 0), (8, 100, 2), (24, 60, 1), (24, 600, 0), (836, 5796, 0)]


@pytest.mark.real_data
def test_matlab_rate_matching(data: Path) -> None:
    """Redundancy version 0 in the calls of test_rateMatchTurbo.m in microsoft/OTP4LTE-U, all with Ncb = Kw.

    Each call reads 3 D bits as streams S, P1, P2 in block order and yields E bits; D need not equal K + 4. The calls
    cover puncturing, repetition and dummy bits: D = 8, 24 and 836 leave rectangles incomplete.
    """
    folder = data / "turbo" / "matlab"
    pattern = read_bits(folder / "test_rateMatchTurbo.infile")
    expected = read_bits(folder / "test_rateMatchTurbo.outfile.ground")
    first, sent = 0, 0
    for stream_length, coded_bits, version in MATLAB_CALLS:
        streams = pattern[first : first + 3 * stream_length].reshape(3, stream_length)
        if version == 0:
            matched = streams.T.ravel()[selection(stream_length, coded_bits)]
            assert np.array_equal(matched, expected[sent : sent + coded_bits])
        first, sent = first + 3 * stream_length, sent + coded_bits
    assert sent == expected.size


@pytest.mark.parametrize("coded_bits", [None, 312, 150])
def test_distinguishing_bits_differ_by_chance_however_alike_the_blocks_are(coded_bits: int | None) -> None:
    """Blocks differ in a few bits; the interleaved second encoder then changes half its output bits."""
    rng, code = np.random.default_rng(1), TurboCode(k=104, coded_bits=coded_bits)
    assert code.distinguishing.shape == (code.length,)
    block, parts = rng.integers(0, 2, 104), []
    for _ in range(200):
        other = block.copy()
        other[rng.integers(60, 70, 3)] ^= 1
        parts.append(code.encode(block) != code.encode(other))
    differ = np.array([part for part in parts if part.any()])
    assert differ[:, code.distinguishing].mean() > 1.5 * differ[:, ~code.distinguishing].mean()
    assert 0.1 < code.distinguishing.mean() < 0.4  # a third of the mother code bits; higher rates puncture some


def test_encode_takes_any_leading_shape() -> None:
    bits = np.random.default_rng(2).integers(0, 2, (2, 3, 40))
    code = TurboCode(k=40, coded_bits=100)
    coded = code.encode(bits)
    assert coded.shape == (2, 3, 100)
    assert coded.dtype == np.uint8
    assert np.array_equal(coded[1, 2], code.encode(bits[1, 2]))
    assert code.encode(bits[:0]).shape == (0, 3, 100)
    assert np.array_equal(code.encode(bits.astype(bool)), coded)


@pytest.mark.parametrize(("settings", "message"), [
    ({"k": 1000}, r"not 1000; the nearest is 992 or 1008"), ({"k": 7}, r"not 7; the nearest is 40"),
    ({"k": 9000}, r"not 9000; the nearest is 6144"),
    ({"k": 1024, "coded_bits": 1137}, r"k = 1024 at rate 9/10 .* coded_bits >= 1138, not 1137"),
])  # fmt: skip
def test_settings_that_make_no_code(settings: dict[str, int], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        TurboCode(**settings)


@pytest.mark.parametrize(("bits", "message"), [
    (np.zeros(41, np.uint8), r"40 values a block .* shape \(41,\)"), (np.full(40, 2), "0 or 1, not int64 up to 2"),
    (np.zeros(40), "not float64"), (1, r"not shape \(\)"),
])  # fmt: skip
def test_bits_that_are_none(bits: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TurboCode(k=40).encode(bits)
