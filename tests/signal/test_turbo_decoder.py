"""Turbo decoder: reference against exhaustive enumeration, kernel against reference, and behaviour."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import turbo_oracle as reference
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import binom

from heliograph.signal.code import Algorithm
from heliograph.signal.turbo import QPP_SIZES, DecoderOptions, TurboCode
from heliograph.signal.turbo.code import Stop, decode_blocks
from heliograph.signal.turbo.encoder import encode_constituent, encode_mother
from heliograph.signal.turbo.qpp import interleaver

ALGORITHMS: list[Algorithm] = ["max-log", "log-map"]
TOY_ORDER = np.array([3, 0, 6, 1, 4, 7, 2, 5])
SILENT = np.zeros(132)
Floats = NDArray[np.float64]


def noisy(code: TurboCode, blocks: int, ebn0_db: float, seed: int) -> tuple[NDArray[np.uint8], Floats]:
    """Return random blocks and LLRs after BPSK in white noise."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2, (blocks, code.k), dtype=np.uint8)
    variance = 1 / (2 * code.rate * 10 ** (ebn0_db / 10))
    samples = 1 - 2.0 * code.encode(bits) + rng.normal(scale=variance**0.5, size=(blocks, code.length))
    return bits, 2 * samples / variance


def by_enumeration(words: NDArray[np.uint8], llr: Floats, algorithm: Algorithm) -> Floats:
    """Compute a-posteriori bit LLRs by enumerating all codewords."""
    log_p = llr @ (1.0 - words.T)
    total: Any = np.max if algorithm == "max-log" else logsumexp
    columns = [total(log_p[:, bit == 0], axis=1) - total(log_p[:, bit == 1], axis=1) for bit in words.T.astype(int)]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("spread", [0.5, 3.0, 30.0])
def test_one_siso_is_the_exact_posterior(algorithm: Algorithm, spread: float) -> None:
    """All bits, tail included, against enumeration of 256 words from the terminated constituent code."""
    info_words = (np.arange(256)[:, None] >> np.arange(8) & 1).astype(np.uint8)
    words = np.concatenate([info_words, *encode_constituent(info_words)], axis=1)
    llr = np.random.default_rng(3).normal(scale=spread, size=(20, 22))
    posterior = reference.siso(llr[:, :8], llr[:, 8:16], llr[:, 16:], algorithm)
    assert np.allclose(np.concatenate(posterior, axis=1), by_enumeration(words, llr, algorithm), atol=1e-9)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("order", [TOY_ORDER, interleaver(40), interleaver(528)], ids=["8", "40", "528"])
@pytest.mark.parametrize("stop", ["none", "agreement"])
@pytest.mark.slow
def test_kernel_is_the_reference(algorithm: Algorithm, order: NDArray[np.int64], stop: Stop) -> None:
    rng, k, blocks = np.random.default_rng(5), len(order), 9
    bits = rng.integers(0, 2, (blocks, k), dtype=np.uint8)
    mother = encode_mother(bits, order)
    llr = (2.0 * (1 - 2.0 * mother) + 2 * rng.normal(size=mother.shape)).astype(np.float32)
    llr[:, : 3 * k : 3] += (0.5 * (1 - 2.0 * bits) + rng.normal(size=bits.shape)).astype(np.float32)
    options = DecoderOptions(algorithm=algorithm, iterations=4, stop=stop)
    fast = decode_blocks(llr, np.arange(mother.shape[1]), order, options, coded_output=True)
    assert fast.coded_extrinsic is not None
    slow = reference.decode(llr.astype(np.float64), order, options)
    # kernel ln(1 + exp(-x)) has error 0.032, accumulated a few hundred times, mostly common to all states
    atol = 1.5 if algorithm == "log-map" else 0.01
    assert np.allclose(fast.llr, slow.llr, rtol=1e-3, atol=atol)
    coded_llr = fast.coded_extrinsic + llr
    assert np.allclose(coded_llr, slow.mother_llr, rtol=1e-3, atol=atol)
    assert np.allclose(coded_llr[:, : 3 * k : 3], fast.llr, atol=1e-3)
    assert np.array_equal(fast.iterations, slow.iterations)
    assert np.array_equal(fast.stopped, slow.stopped)
    assert np.std(fast.llr - slow.llr) < 0.2 * atol


def test_correction_of_log_map() -> None:
    """ln(exp a + exp b) within 0.032 for either order and for impossible states."""
    from heliograph.signal.turbo.kernels import IMPOSSIBLE, add

    a = np.float32(3.0)
    for b in np.append(np.linspace(-20, 20, 801, dtype=np.float32), IMPOSSIBLE):
        for pair in ((a, b), (b, a)):
            assert (add(*pair, True), add(*pair, None)) == (pytest.approx(np.logaddexp(*pair), abs=0.0325), max(pair))


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize("k", [40, 432])
def test_sionna_decisions(data: Path, k: int) -> None:
    """Sionna's decisions after ten iterations at Eb/N0 0 dB, rate 1/3: N0 = 3, LLR = 4 y / N0 (0 maps to +1)."""
    bits, samples, theirs = (np.load(data / "turbo" / f"ref_k{k}_{name}.npy") for name in ("u", "y", "uhat"))
    llr = 4.0 * samples / 3
    options = DecoderOptions(algorithm="log-map", iterations=10, stop="none")
    assert np.array_equal(reference.decode(llr, interleaver(k), options).llr < 0, theirs)
    ours = TurboCode(k=k).decode(llr, algorithm="log-map", iterations=10, stop="none").bits
    right = (theirs == bits).all(axis=1)
    assert np.array_equal(ours[right], bits[right])
    # undecodable words differ in single bits through the shorter correction: 47 of 4320 at K = 432
    assert (ours != theirs).mean() < 0.02


def test_noiseless_blocks_of_every_size_are_decoded() -> None:
    """Puncturing at rate 9/10 leaves all information bits decodable for every size; lower rates repeat bits."""
    cases = [(k, -(-10 * k // 9)) for k in QPP_SIZES] + [(200, None), (200, 201 * 3), (1056, 2112), (40, 200)]
    for k, coded_bits in cases:
        code = TurboCode(k=k, coded_bits=coded_bits)
        bits = np.random.default_rng(k).integers(0, 2, (2, k), dtype=np.uint8)
        assert np.array_equal(code.decode(8 * (1 - 2.0 * code.encode(bits))).bits, bits), k


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("stop", ["none", "agreement"])
def test_blocks_do_not_see_each_other(algorithm: Algorithm, stop: Stop) -> None:
    """Batching does not change results, although blocks stop at different iterations and are compacted."""
    code = TurboCode(k=104, coded_bits=300)
    _, llr = noisy(code, 200, 1.0, 6)
    whole = code.decode(llr, algorithm=algorithm, stop=stop, coded_output=True)
    if stop == "agreement":
        assert len(np.unique(whole.iterations)) > 3
    for parts in (np.split(llr, [1, 34, 100]), [llr[::-1]], [llr.reshape(20, 10, -1)]):
        results = [code.decode(part, algorithm=algorithm, stop=stop, coded_output=True) for part in parts]
        for name, expected in vars(whole).items():
            got = np.concatenate([getattr(result, name).reshape(-1, *expected.shape[1:]) for result in results])
            assert np.array_equal(got[::-1] if len(parts) == 1 and parts[0].ndim == 2 else got, expected), name


def test_check_stops_blocks_one_by_one() -> None:
    """With a perfect check, a block stops at the first correct iteration."""
    code = TurboCode(k=104)
    bits, llr = noisy(code, 100, 1.0, 7)
    known = {word.tobytes() for word in bits}
    result = code.decode(llr, check=lambda words: np.array([word.tobytes() in known for word in words], dtype=np.bool_))
    assert np.array_equal(result.stopped, (result.bits == bits).all(axis=1))
    assert result.stopped.mean() > 0.5
    assert np.all(result.iterations[~result.stopped] == 8)
    for block in range(0, 100, 9):
        count = int(result.iterations[block])
        again = code.decode(llr[block], iterations=count, stop="none")
        assert np.array_equal(again.llr, result.llr[block])
        if result.stopped[block] and count > 1:
            before = code.decode(llr[block], iterations=count - 1, stop="none")
            assert not np.array_equal(before.bits, bits[block])


def test_coded_llrs_are_calibrated() -> None:
    """Among coded bits with LLR near 1, the fraction of zeros is near e / (1 + e)."""
    code = TurboCode(k=1024)
    bits, llr = noisy(code, 100, -1.0, 10)
    result = code.decode(llr, algorithm="log-map", iterations=1, stop="none", coded_output=True)
    coded = code.encode(bits)
    assert result.coded_extrinsic is not None
    parity = np.s_[:, 1:3072:3]
    value = (result.coded_extrinsic + llr)[parity]
    near = (value > 0.9) & (value < 1.1)
    assert near.sum() > 1000
    assert abs((coded[parity][near] == 0).mean() - 1 / (1 + np.exp(-1.0))) < 0.04


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_llrs_of_any_size_and_type_give_finite_output(algorithm: Algorithm) -> None:
    code, rng = TurboCode(k=1024, coded_bits=1600), np.random.default_rng(12)
    bits = rng.integers(0, 2, (3, 1024), dtype=np.uint8)
    for size in (1e-30, 1e-6, 1e4, 1e6, 1e300, np.inf):
        result = code.decode(np.where(code.encode(bits) == 0, size, -size), algorithm=algorithm, coded_output=True)
        assert np.isfinite(result.llr).all()
        assert result.coded_extrinsic is not None
        assert np.isfinite(result.coded_extrinsic).all()
        # log-MAP also counts paths, which outweigh LLRs near 1e-6 for punctured bits
        if size > 1 or algorithm == "max-log":
            assert np.array_equal(result.bits, bits)
    contradictions = rng.choice([-np.inf, -1e6, -1.0, 0.0, 1.0, 1e6, np.inf], (2, 1600))
    assert np.isfinite(code.decode(contradictions, algorithm=algorithm, stop="none").llr).all()
    assert np.abs(TurboCode(k=40).decode(np.zeros(132), algorithm=algorithm, iterations=2).llr).max() < 0.01
    llr = 5 * (1 - 2.0 * code.encode(bits))
    for dtype in (np.float16, np.float32, np.int8, np.int64):
        assert np.array_equal(code.decode(llr.astype(dtype), algorithm=algorithm).bits, bits)
    empty = TurboCode(k=40).decode(np.zeros((0, 132)), algorithm=algorithm)
    assert (empty.bits.shape, empty.iterations.shape) == ((0, 40), (0,))


def test_repeated_bits_have_one_posterior() -> None:
    """The extrinsic LLR of a repeated bit includes the other copy."""
    code = TurboCode(k=40, coded_bits=200)
    _, llr = noisy(code, 3, 0.0, 8)
    result = code.decode(llr, coded_output=True, stop="none")
    assert result.coded_extrinsic is not None
    posterior = np.full((3, 132), np.nan)
    posterior[:, code.positions] = result.coded_extrinsic + llr
    assert np.allclose(posterior[:, code.positions], result.coded_extrinsic + llr, atol=1e-4)
    assert np.allclose(posterior[:, :120:3], result.llr, atol=1e-4)


@pytest.mark.parametrize(("llr", "options", "message"), [
    (np.zeros((2, 131)), {}, r"llr must have 132 values a block .* shape \(2, 131\)"),
    (np.full(132, np.nan), {}, r"llr must not hold NaN; 132 of 132"),
    (SILENT, {"algorithm": "sova"}, "setting 'algorithm': input should be 'max-log' or 'log-map', not 'sova'"),
    (SILENT, {"stop": "soon"}, "setting 'stop'"),
    (SILENT, {"iterations": 0}, "setting 'iterations': .* equal to 1, not 0"),
    (SILENT, {"scale": 1.5}, "setting 'scale': .* equal to 1, not 1.5"),
    (SILENT, {"scale": float("nan")}, "setting 'scale'"),
    (SILENT, {"stop": "crc"}, 'stop is "crc" and check is None'),
    (SILENT, {"stop": "agreement", "check": len}, 'stop is "agreement" and check is <built-in'),
])  # fmt: skip
def test_invalid_llrs_and_options_are_refused(llr: Floats, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TurboCode(k=40).decode(llr, **options)


@pytest.mark.parametrize(("algorithm", "blocks", "limit"), [("max-log", 2048, 0.17), ("log-map", 1024, 0.08)])
@pytest.mark.slow
def test_block_error_rate(algorithm: Algorithm, blocks: int, limit: float) -> None:
    """K = 1024 at 0.5 dB: error rate between half the limit and the limit, with a 1e-4 tail on each side."""
    code = TurboCode(k=1024)
    bits, llr = noisy(code, blocks, 0.5, 15)
    errors = int((code.decode(llr, algorithm=algorithm).bits != bits).any(axis=1).sum())
    assert binom.ppf(1e-4, blocks, 0.5 * limit) <= errors <= binom.ppf(1 - 1e-4, blocks, limit)


def test_scaling_pays() -> None:
    """Block error rate at 0.5 dB: unscaled max-log 0.58, scaled 0.15 (aff3ct)."""
    code = TurboCode(k=1024)
    bits, llr = noisy(code, 256, 0.5, 16)
    errors = [(code.decode(llr, scale=scale).bits != bits).any(axis=1).mean() for scale in (1.0, 0.75)]
    assert errors[0] > 2 * errors[1]


@pytest.mark.parametrize("size", [10.0, 100.0, 1000.0])
def test_max_log_is_linear_in_its_llrs(size: float) -> None:
    code = TurboCode(k=104, coded_bits=312)
    llr = size * noisy(code, 1, 6.0, 0)[1][0] / 8
    once, twice = (code.decode(factor * llr, algorithm="max-log", iterations=2, coded_output=True) for factor in (1, 2))
    assert np.array_equal(once.bits, twice.bits)
    assert twice.llr == pytest.approx(2 * once.llr, rel=1e-4)


def test_beyond_the_limit_llrs_are_all_the_same() -> None:
    code, limit = TurboCode(k=104, coded_bits=312), 1e4
    signs = np.sign(noisy(code, 1, 6.0, 0)[1][0])
    below, at, beyond = (
        code.decode(signs * size, algorithm="max-log", iterations=2).llr for size in (limit / 2, limit, 100 * limit)
    )
    assert np.array_equal(at, beyond)
    assert not np.allclose(at, below)
