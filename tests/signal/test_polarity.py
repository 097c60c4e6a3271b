"""Single mode: light balance and packets."""

from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from heliograph.base.errors import SettingsError
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.polarity import balance
from heliograph.signal.settings import SignalSettings
from heliograph.transmit import Transmitter

SINGLE = Format(mode="single")
MESSAGES = {"high": [bytes(range(200))], "middle": [bytes(400)], "low": [b"low" * 90]}


def unbalance(d11: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the data, (..., h, h - 1), from balanced matrices D11, (..., h, h); the inverse of `balance`."""
    polarity = d11[..., :1].copy()
    polarity[..., 0, :] = 1
    return np.asarray(d11[..., 1:] * polarity)


def random_data(half: int, count: int, seed: int) -> np.ndarray[Any, np.dtype[np.int8]]:
    return np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), (count, half, half - 1))


@examples(40)
@given(st.sampled_from([2, 4, 8, 16]), st.integers(1, 30), st.integers(0, 2**32 - 1), st.integers(-9, 9))
def test_data_and_polarities_are_restored(half: int, count: int, seed: int, ahead: int) -> None:
    data = random_data(half, count, seed)
    d11 = balance(data, ahead)
    assert d11.shape == (count, half, half)
    assert set(np.unique(d11)) <= {-1, 1}
    assert np.array_equal(unbalance(d11), data)
    assert np.array_equal(d11[:, 0, 1:], data[:, 0])  # row 0 keeps its polarity


def test_the_running_sum_stays_at_zero_and_even_the_worst_data_are_balanced_over_two_patterns() -> None:
    data = random_data(8, 4000, 1)
    sums = np.cumsum(balance(data).sum((1, 2)))
    assert np.abs(sums).max() <= 8
    assert np.mean(sums == 0) > 0.98
    assert np.mean(np.abs(data.sum((1, 2))) > 8) > 0.2  # unbalanced random data exceed 8 in almost a third of patterns
    # identical rows, all ones: seven polarities per eight rows; the eighth row has none
    sums = np.cumsum(balance(np.ones((40, 8, 7), np.int8)).sum((1, 2)))
    assert np.abs(sums).max() <= 8


def test_packets_have_twice_the_bits_but_for_a_column() -> None:
    paired, single = (PacketFormat(SignalSettings(), named) for named in (Format(), SINGLE))
    for name, share in (("high", 7 / 8), ("middle", 1), ("low", 1)):
        bits = [form.layers[name].codewords * form.layers[name].code.length for form in (paired, single)]
        assert bits[1] == 2 * share * bits[0]
    assert (single.layers["high"].pairs, single.layers["high"].symbols) == (96, 56)


def test_a_transmitter_gives_the_same_light_in_every_pattern() -> None:
    formats = [SINGLE, Format(), Format(mode="single", high=0.9)]
    packets = np.concatenate(list(islice(Transmitter(SignalSettings(), 7, MESSAGES, formats).packets(), 30)))
    given = np.cumsum(packets.mean((1, 2)) / 4 - 0.5)
    assert np.abs(given[1::2]).max() < 0.02  # mean excess after every second pattern, in units of full light
    assert np.abs(given[99::100]).max() < 0.02
    inverted = [p.inverted for p in islice(Transmitter(SignalSettings(), 7, MESSAGES, formats).patterns(), 200)]
    assert (sum(inverted[:100]), sum(inverted[100:])) == (2, 50)


def test_it_is_a_mode_of_the_hierarchical_code() -> None:
    with pytest.raises(SettingsError, match=r'signal\.modulation = "haar"'):
        PacketFormat(SignalSettings(modulation="ook"), SINGLE)
