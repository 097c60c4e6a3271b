"""Channel code interface: stopping checks and distinguishing bits."""

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.signal.turbo import TurboCode


def test_a_check_stops_the_decoder_unless_it_is_said_otherwise() -> None:
    rng, code = np.random.default_rng(0), TurboCode(k=104, coded_bits=312)
    bits = rng.integers(0, 2, (3, 104)).astype(np.uint8)

    def right(decisions: NDArray[np.uint8]) -> NDArray[np.bool_]:
        return np.asarray((decisions == bits[: len(decisions)]).all(1))

    llr = 4.0 * (1.0 - 2.0 * code.encode(bits)) + rng.normal(0, 2.0, (3, 312))
    alone = code.decode(llr, check=right)
    said = code.decode(llr, check=right, stop="crc")
    assert np.array_equal(alone.iterations, said.iterations)
    never = code.decode(llr, check=lambda d: np.zeros(len(d), bool), iterations=3)
    assert never.iterations.tolist() == [3, 3, 3]


@pytest.mark.parametrize("coded_bits", [None, 312, 150])
def test_distinguishing_bits_differ_by_chance_however_alike_the_blocks_are(coded_bits: int | None) -> None:
    """Blocks differ in a few bits; the interleaved second encoder then changes half its output bits."""
    rng, code = np.random.default_rng(1), TurboCode(k=104, coded_bits=coded_bits)
    assert code.distinguishing.shape == (code.length,)
    block = rng.integers(0, 2, 104)
    parts = []
    for _ in range(200):
        other = block.copy()
        other[rng.integers(60, 70, 3)] ^= 1
        parts.append(code.encode(block) != code.encode(other))
    differ = np.array([part for part in parts if part.any()])
    assert differ[:, code.distinguishing].mean() > 1.5 * differ[:, ~code.distinguishing].mean()
    # a third of the mother code bits; higher rates puncture some
    assert 0.1 < code.distinguishing.mean() < 0.4
