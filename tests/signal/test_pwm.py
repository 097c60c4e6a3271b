"""Pulse width modulation: slots and exposure integrals."""

from itertools import permutations, product

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.signal import pwm

orders = st.permutations(range(4))


def test_waveforms_of_the_paper() -> None:
    # figure 4: level k/4 lights the LED for the first k/4 T_b
    levels = np.arange(5).reshape(5, 1, 1)
    expected = [[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 1]]
    assert pwm.lit_slots(levels)[..., 0, 0].tolist() == np.array(expected, bool).tolist()
    assert pwm.waveform(levels).tolist() == np.ravel(expected).tolist()
    assert pwm.waveform(np.array([[[4, 0], [1, 2]]])).tolist() == [0.75, 0.5, 0.25, 0.25]


def test_slots_are_lit_in_their_order() -> None:
    for order, level in product(permutations(range(4)), range(5)):
        lit = pwm.lit_slots(np.full((1, 1), level), order)[:, 0, 0]
        assert set(np.flatnonzero(lit)) == set(order[:level])


@examples(40)
@given(orders, st.integers(0, 2**32 - 1))
def test_pattern_and_inverse_make_a_constant(order: list[int], seed: int) -> None:
    levels = np.random.default_rng(seed).integers(0, 5, (5, 4, 4)).astype(np.uint8)
    inverse = pwm.invert(levels)
    assert inverse.dtype == np.uint8
    assert np.all(levels + inverse == 4)
    flux = pwm.waveform(np.stack([levels, inverse], 1).reshape(-1, 4, 4), order).reshape(5, 8)
    assert np.allclose(flux.sum(1), 4)  # eight slots, each LED lit in four
    assert np.array_equal(pwm.invert(inverse), levels)
