"""M-sequences: defining properties and SciPy as an oracle."""

import numpy as np
import pytest
from scipy.signal import max_len_seq

from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence, periodic_correlation

# primitive polynomials: Peterson and Weldon, Error-Correcting Codes, appendix C (octal)
PRIMITIVE = [0o7, 0o13, 0o23, 0o45, 0o103, 0o211, 0o435, 0o1021, 0o2011, 0o4005, 0o10123]


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


@pytest.mark.parametrize("polynomial", HEADER_POLYNOMIALS)
def test_recurrence(polynomial: int) -> None:
    a = m_sequence(polynomial)
    for k in range(15):
        terms = [int(a[(k + i) % 15]) for i in range(5) if polynomial >> i & 1]
        assert sum(terms) % 2 == 0


@pytest.mark.parametrize("polynomial", PRIMITIVE)
def test_period_and_runs_of_other_degrees(polynomial: int) -> None:
    m = polynomial.bit_length() - 1
    chips = m_sequence(polynomial)
    assert len(chips) == 2**m - 1
    # window property: each nonzero state occurs once per period
    windows = {np.roll(chips, -s)[:m].tobytes() for s in range(len(chips))}
    assert len(windows) == 2**m - 1
    assert chips.sum() == 2 ** (m - 1)


@pytest.mark.parametrize("polynomial", [*HEADER_POLYNOMIALS, *PRIMITIVE[:7]])
def test_same_as_scipy(polynomial: int) -> None:
    m = polynomial.bit_length() - 1
    taps = [i for i in range(1, m) if polynomial >> i & 1]
    theirs, _ = max_len_seq(m, taps=taps)
    assert phases(m_sequence(polynomial)) == phases(theirs)


def test_every_polynomial_of_small_degree_is_accepted_just_if_primitive() -> None:
    """Euler: phi(2^m - 1) / m polynomials with degree m are primitive."""
    for m, count in {2: 1, 3: 2, 4: 2, 5: 6, 6: 6, 7: 18, 8: 16}.items():
        good = 0
        for polynomial in range(1 << m, 2 << m):
            try:
                good += len(m_sequence(polynomial)) == 2**m - 1
            except ValueError as error:
                assert "not primitive" in str(error)  # noqa: PT017  # the loop counts both outcomes
        assert good == count


@pytest.mark.parametrize("state", [0, 16, -1])
def test_state_out_of_range(state: int) -> None:
    with pytest.raises(ValueError, match="state must be 1 to 15"):
        m_sequence(0b11001, state)


@pytest.mark.parametrize("polynomial", [0, 1, 0b11, 1 << 25])
def test_degree_out_of_range(polynomial: int) -> None:
    with pytest.raises(ValueError, match="degree 2 to 24"):
        m_sequence(polynomial)
