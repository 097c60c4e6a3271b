"""Input LLR saturation at 1e4."""

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.signal.turbo import TurboCode

LIMIT = 1e4


def llrs(size: float) -> tuple[TurboCode, NDArray[np.float64]]:
    """Return noisy codeword LLRs with mean magnitude `size`."""
    rng, code = np.random.default_rng(0), TurboCode(k=104, coded_bits=312)
    signs = 1.0 - 2.0 * code.encode(rng.integers(0, 2, 104))
    return code, size * (signs + rng.normal(0, 0.5, 312))


@pytest.mark.parametrize("size", [10.0, 100.0, 1000.0])
def test_max_log_is_linear_in_its_llrs(size: float) -> None:
    """Doubled input LLRs give equal bits and doubled output LLRs."""
    code, llr = llrs(size)
    once, twice = (code.decode(factor * llr, algorithm="max-log", iterations=2, coded_output=True) for factor in (1, 2))
    assert np.array_equal(once.bits, twice.bits)
    assert twice.llr == pytest.approx(2 * once.llr, rel=1e-4)


def test_beyond_the_limit_llrs_are_all_the_same() -> None:
    code, llr = llrs(1.0)
    signs = np.sign(llr)
    at, beyond = (code.decode(signs * size, algorithm="max-log", iterations=2) for size in (LIMIT, 100 * LIMIT))
    below = code.decode(signs * 0.5 * LIMIT, algorithm="max-log", iterations=2)
    assert np.array_equal(at.llr, beyond.llr)
    assert not np.allclose(at.llr, below.llr)
