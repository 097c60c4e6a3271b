"""Information in LLRs."""

import numpy as np
import pytest

from heliograph.receive.equalise.llr import information


def test_information_in_llrs() -> None:
    llr = np.array([[0.0] * 4, [50.0] * 4, [-1e4] * 4, [np.log(9)] * 4])
    # P(wrong) = 1/2, 0, 0 and 1/10
    assert information(llr) == pytest.approx([0, 1, 1, 1 + 0.1 * np.log2(0.1) + 0.9 * np.log2(0.9)])
