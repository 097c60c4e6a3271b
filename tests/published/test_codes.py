"""Channel codes of standards: conventions, tables and error correction."""

import hashlib
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

import heliograph
from heliograph.base.errors import HeliographError, SettingsError
from heliograph.cli.measure import codes
from heliograph.experiments.code_errors import count_blocks, draw
from heliograph.published.codes import LdpcCode, _bcjr, _lift, encode_lifted, parity_matrix, table
from heliograph.published.polar import PolarCode, Segment, crc
from heliograph.published.polar_kernels import decode_lists
from heliograph.signal.code import CODES, Code

LIBRARIES = {"turbo": "numpy", "ldpc-nr": "ldpc", "ldpc-wifi": "ldpc", "polar-nr": "numpy", "convolutional": "komm"}


@pytest.fixture(params=LIBRARIES)
def name(request: pytest.FixtureRequest) -> str:
    pytest.importorskip(LIBRARIES[request.param])
    return str(request.param)


def noisy(code: Code, ebn0_db: float, blocks: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return information bits, and LLRs of the zero codeword in white Gaussian noise."""
    rng, snr = np.random.default_rng(20), code.k / code.length * 10 ** (ebn0_db / 10)
    bits = rng.integers(0, 2, (blocks, code.k), dtype=np.uint8)
    return bits, 4 * snr * (1 + rng.standard_normal((blocks, code.length)) / np.sqrt(2 * snr))


def test_every_built_in_code_is_tested() -> None:
    assert set(LIBRARIES) == set(CODES.built_in)


def test_code_corrects_errors_with_positive_llrs_for_zeros(name: str) -> None:
    code = CODES[name](1536, 1 / 3).code
    bits, llr = noisy(code, 3.5, 8)
    assert (llr < 0).mean() > 0.08
    sent = llr * (1 - 2.0 * code.encode(bits))
    np.testing.assert_array_equal(code.decode(sent).bits, bits)
    result = code.decode(sent, coded_output=True)
    np.testing.assert_array_equal(result.llr < 0, bits)
    assert (result.coded_extrinsic * sent).mean() > 0 or name in ("polar-nr", "convolutional")


def test_errors_do_not_depend_on_the_codeword(name: str) -> None:
    code = CODES[name](1536, 1 / 3).code
    bits, llr = noisy(code, 0.75, 24)
    wrong = code.decode(llr).bits.any(axis=1)
    sent = llr * (1 - 2.0 * code.encode(bits))
    np.testing.assert_array_equal((code.decode(sent).bits != bits).any(axis=1), wrong)
    assert wrong.any()


def test_more_noise_gives_more_wrong_blocks(name: str) -> None:
    plan = CODES[name](768, 1 / 3)
    quiet, loud = (count_blocks(plan, ebn0_db, 100, 40) for ebn0_db in (6, -2))
    assert quiet.errors == 0
    assert loud.errors > 35
    assert b"<svg" in draw({(name, -2.0): loud, (name, 6.0): quiet}, [name])


def test_message_passes_the_link_with_each_code(name: str) -> None:
    signal = heliograph.SignalSettings(code=name, data_pairs=24)
    patterns = heliograph.encode({"high": b"by the standard"}, identity=4, settings=signal)
    assert [message.data for message in heliograph.decode(patterns, signal)] == [b"by the standard"]


@pytest.mark.parametrize(("bits", "rate"), [(1536, 1 / 3), (3072, 1 / 2), (6144, 1 / 3)])
def test_codewords_fill_the_layer(name: str, bits: int, rate: float) -> None:
    count, code = CODES[name](bits, rate)
    assert count * code.length == bits
    assert code.k % 8 == 0
    assert rate - 0.02 < code.k / code.length <= rate
    assert code.encode(np.zeros((2, 3, code.k), np.uint8)).shape == (2, 3, code.length)
    assert code.distinguishing.shape == (code.length,)
    assert hash(code) == hash(CODES[name](bits, rate).code)


@pytest.mark.parametrize(("standard", "k"), [("nr", 104), ("nr", 512), ("nr", 600), ("nr", 1024), ("wifi", 512)])
def test_ldpc_codewords_meet_the_checks(standard: str, k: int) -> None:
    lifted = _lift(LdpcCode("nr" if standard == "nr" else "wifi", k, 3 * k))
    words = encode_lifted(lifted, np.random.default_rng(3).integers(0, 2, (4, k), dtype=np.uint8))
    matrix = parity_matrix(lifted).astype(np.int64)
    assert not (matrix @ words.T % 2).any()
    assert not words[:, lifted.known].any()
    shared = matrix @ matrix.T
    shared.setdiag(0)
    # lifting sizes below the largest of a set have cycles of length 4
    assert (shared.max() == 1) == (k in (512, 600))


@pytest.mark.parametrize(
    ("code", "digest"), [(LdpcCode("nr", 560, 3440), "f521c89000a6bdd8"), (PolarCode(40, 863), "ed501cd10e1885fb")]
)
def test_codewords_equal_those_of_py3gpp(code: Code, digest: str) -> None:
    word = code.encode((np.arange(code.k) ** 2 // 7 % 2).astype(np.uint8))
    assert hashlib.sha256(np.packbits(word).tobytes()).hexdigest()[:16] == digest


def test_list_of_one_path_errs_as_often_as_successive_cancellation_of_komm() -> None:
    komm = pytest.importorskip("komm")
    segment, rng = Segment(53, 128), np.random.default_rng(1)
    snr = 10**-0.2
    llr = (4 * snr * (1 + rng.standard_normal((1000, 128)) / np.sqrt(2 * snr))).astype(np.float32)
    own = decode_lists(llr, segment.frozen, 1)[:, 0][:, ~segment.frozen]
    other = komm.SCDecoder(komm.PolarCode(7, np.flatnonzero(segment.frozen)), output_type="hard").decode(llr)
    wrong, wrong_of_other = own.any(axis=1).sum(), np.asarray(other).any(axis=1).sum()
    assert wrong_of_other > 300
    # min-sum against exact LLRs
    assert abs(int(wrong) - int(wrong_of_other)) < 0.1 * wrong_of_other
    assert segment.decode(llr).any(axis=1).sum() < 0.5 * wrong


def test_polar_order_is_a_permutation_by_weight_at_its_ends() -> None:
    order = table("polar_order")
    np.testing.assert_array_equal(np.sort(order), np.arange(1024))
    assert (order[0], order[-1]) == (0, 1023)


@pytest.mark.parametrize(
    ("k", "length", "size"), [(104, 1500, 1024), (104, 400, 512), (104, 200, 256), (256, 768, 1024)]
)
def test_polar_rate_matching_repeats_punctures_and_shortens(k: int, length: int, size: int) -> None:
    segment = Segment(k, length)
    assert (segment.size, int((~segment.frozen).sum())) == (size, k + 11)
    bits = np.random.default_rng(5).integers(0, 2, (6, k), dtype=np.uint8)
    llr = 4 * (1 - 2 * segment.encode(bits).astype(np.float32))
    np.testing.assert_array_equal(segment.decode(llr), bits)


def test_polar_crc_selects_the_path() -> None:
    code = PolarCode(512, 1536)
    assert len(code.segments) == 2
    # remainder of D^11 by D^11 + D^10 + D^9 + D^5 + 1
    np.testing.assert_array_equal(crc(np.array([[1]], np.uint8))[0], [1, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1])


def test_convolutional_code_has_the_polynomials_of_lte() -> None:
    pytest.importorskip("komm")
    code = CODES["convolutional"](96, 1 / 3).code
    impulse = code.encode(np.eye(1, code.k, dtype=np.uint8))[0, :21].reshape(7, 3).T
    np.testing.assert_array_equal(impulse, [[int(bit) for bit in f"{p:07b}"] for p in (0o133, 0o171, 0o165)])


def test_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "komm", None)
    _bcjr.cache_clear()
    with pytest.raises(HeliographError, match=r"needs the package komm: pip install 'heliograph\[codes\]'"):
        CODES["convolutional"](96, 1 / 3).code.encode(np.zeros(24, np.uint8))


def test_rate_above_a_standard_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rates up to 0\.5"):
        CODES["ldpc-wifi"](1536, 2 / 3)
    with pytest.raises(SettingsError, match=r"the code ldpc-nr has no codeword: .* change --bits or --rate"):
        codes(names=["ldpc-nr"], ebn0="1", bits=1536, rate=0.8)
