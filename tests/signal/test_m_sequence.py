"""M-sequences: defining properties and SciPy as an oracle."""

import numpy as np
import pytest
from scipy.signal import max_len_seq

from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence, periodic_correlation

# primitive polynomials: Peterson and Weldon, Error-Correcting Codes, appendix C (octal)
PRIMITIVE = [0o7, 0o13, 0o23, 0o45, 0o103, 0o211, 0o435]


def phases(chips: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> set[bytes]:
    return {np.roll(chips, s).astype(np.uint8).tobytes() for s in range(len(chips))}


def test_header_polynomials_are_the_papers_and_its_reciprocal() -> None:
    assert HEADER_POLYNOMIALS == (0b11001, 0b10011)
    forward, backward = (m_sequence(p) for p in HEADER_POLYNOMIALS)
    assert phases(forward[::-1]) == phases(backward)
    assert not phases(forward) & phases(backward)


@pytest.mark.parametrize("polynomial", HEADER_POLYNOMIALS)
def test_autocorrelation_of_every_phase(polynomial: int) -> None:
    seen = set()
    for state in range(1, 16):
        chips = m_sequence(polynomial, state)
        assert [int(chips[k]) for k in range(4)] == [state >> k & 1 for k in range(4)]
        assert periodic_correlation(chips, chips).tolist() == [15] + [-1] * 14
        assert chips.sum() == 8
        seen.add(chips.tobytes())
    # each nonzero state selects a distinct phase
    assert seen == phases(m_sequence(polynomial))


@pytest.mark.parametrize("polynomial", [*HEADER_POLYNOMIALS, *PRIMITIVE])
def test_same_as_scipy(polynomial: int) -> None:
    m = polynomial.bit_length() - 1
    taps = [i for i in range(1, m) if polynomial >> i & 1]
    theirs, _ = max_len_seq(m, taps=taps)
    assert phases(m_sequence(polynomial)) == phases(theirs)
