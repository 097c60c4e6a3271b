"""Mutual information from LLRs."""

import numpy as np
import pytest

from heliograph.receive.equalise.lmmse import information, llr_of


def test_information_in_llrs() -> None:
    llr = np.array([[0.0] * 4, [50.0] * 4, [-1e4] * 4, [np.log(9)] * 4])
    # P(wrong) = 1/2, 0, 0 and 1/10
    assert information(llr) == pytest.approx([0, 1, 1, 1 + 0.1 * np.log2(0.1) + 0.9 * np.log2(0.9)])


def test_llr_near_a_symbol_is_gaussian() -> None:
    precision, mean = np.array([0.0, 0.5, 4.0, 9.0]), np.array([0.0, -0.3, 0.8, 1.3])
    assert llr_of(precision, precision * mean) == pytest.approx(2 * precision * mean, abs=1e-6)


def test_llr_far_from_both_symbols_is_small() -> None:
    precision, mean = np.full(5, 1e4), np.array([-1.0, -0.5, 0.02, 0.2, 1.0])
    llr = llr_of(precision, precision * mean)
    assert (np.sign(llr) == np.sign(mean)).all()
    assert np.abs(llr[1:4]).max() < 4
    assert np.abs(llr[2]) < 0.3
    assert llr[-1] == pytest.approx(-llr[0])
    assert llr[-1] > 30
