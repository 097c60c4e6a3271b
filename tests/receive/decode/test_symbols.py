"""Soft polarity decisions in single mode against exact sums."""

from itertools import product

import numpy as np
import pytest

from heliograph.base.arrays import Floats
from heliograph.receive.decode.codeword import SymbolMapper
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

SMALL = PacketFormat(SignalSettings(side=8, data_pairs=21), Format(mode="single"))


def by_hand(llr: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Return extrinsic data LLRs and symbol priors for a row of 4 symbols by enumeration; polarity comes first."""

    def odds(symbol: int | None, datum: int | None) -> Floats:
        """Return total probabilities for symbol (or datum) = +1 and -1."""
        total = np.zeros(2)
        for s, *d in product((1, -1), repeat=4):
            values = [s, *(s * one for one in d)]
            p = 1.0
            for k in range(4):
                p *= 1.0 if k == symbol else 1 / (1 + np.exp(-values[k] * llr[k]))
            for k in range(3):
                p *= 1.0 if k == datum else (1 + d[k] * mean[k]) / 2
            shown = values[symbol] if symbol is not None else d[datum or 0]
            total[0 if shown > 0 else 1] += p
        return total

    data = np.array([np.log(np.divide(*odds(None, k))) for k in range(3)])
    symbols = [odds(k, None) for k in range(4)]
    return data, np.array([(a - b) / (a + b) for a, b in symbols])


def test_messages_are_those_of_exact_sums() -> None:
    rng, mapper, llr = np.random.default_rng(1), SymbolMapper(SMALL), np.zeros((42, 64))
    llr[:, :16] = rng.normal(0, 2, (42, 16))
    means = [rng.uniform(-0.9, 0.9, (42, 12)), np.zeros((42, 32)), np.zeros((42, 16))]
    high = mapper.bits(llr, means)[0].reshape(42, 4, 3)
    mean, variance = mapper.expected(means, [1 - m**2 for m in means])
    for pattern, row in ((0, 1), (17, 3), (41, 2)):
        seen, data = llr[pattern, :16].reshape(4, 4)[row], means[0][pattern].reshape(4, 3)[row]
        expected, prior = by_hand(seen, data)
        assert high[pattern, row] == pytest.approx(expected, abs=1e-9)
        assert mean[pattern, :16].reshape(4, 4)[row] == pytest.approx(prior, abs=1e-9)
    assert variance[:, :16] == pytest.approx(1 - mean[:, :16] ** 2, abs=1e-9)
    # row 0 has no polarity: symbols equal data, and the first symbol carries no datum
    assert high[:, 0] == pytest.approx(llr[:, 1:4])
    assert mean[:, :4] == pytest.approx(np.pad(means[0][:, :3], ((0, 0), (1, 0))))
    assert np.all(variance[:, 0] == 1)


def test_a_polarity_once_known_stays_known() -> None:
    """The equaliser gives no LLRs for known symbols."""
    mapper = SymbolMapper(SMALL)
    llr = np.full((42, 64), 30.0)
    none = [np.zeros((42, n)) for n in (12, 32, 16)]
    mapper.bits(llr, none)
    known = [np.ones((42, 12)), *none[1:]]
    certain = [np.zeros((42, 12)), np.ones((42, 32)), np.ones((42, 16))]
    for _ in range(3):
        mean, variance = mapper.expected(known, certain)
        assert variance[:, 1:4].max() < 1e-3
        assert mean[:, 5:8].min() > 0.999
        llr[:, :16] = 0
        mapper.bits(llr, known)


def test_in_pairs_every_symbol_is_a_bit() -> None:
    form = PacketFormat(SignalSettings(side=8, data_pairs=40))
    rng, mapper = np.random.default_rng(2), SymbolMapper(form)
    llr = rng.normal(size=(40, 64))
    means = [rng.uniform(-1, 1, (40, n)) for n in (16, 32, 16)]
    assert np.array_equal(np.concatenate(mapper.bits(llr, means), axis=1), llr)
    mean, variance = mapper.expected(means, [1 - m**2 for m in means])
    assert np.array_equal(mean, np.concatenate(means, axis=1))
    assert np.array_equal(variance, 1 - mean**2)
