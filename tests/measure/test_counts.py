"""Counts: sums, JSON, and the rate bound for zero errors."""

import json

import numpy as np
import pytest

from heliograph.measure.counts import BlockCounts, LayerCounts, no_errors, pooled, ticks
from heliograph.measure.statistics import Count, clopper_pearson

READ = LayerCounts.of_packet(Count(1024, 3), Count(3072, 20), Count(2, 1))
MISSED = LayerCounts.of_missed(2)


def block(distance_m: float, counts: LayerCounts) -> BlockCounts:
    layers = {**no_errors(), "low": counts}
    return BlockCounts(layers, {distance_m: layers}, {"high": 0, "middle": 0, "low": 800}, 5, 4, 1, 2, 3, 0.02, 20)


def test_a_packet_is_one_cluster_of_errors_unless_of_another_format() -> None:
    assert (READ.packets, READ.bit_squares, READ.raw_squares, READ.missed) == (1, 9, 400, 0)
    assert (READ.decoded.clusters, READ.decoded.squares, READ.raw.squares) == (1, 9, 400)
    assert (READ.words.trials, READ.words.errors, READ.words.clusters, READ.words.squares) == (2, 1, 1, 1)
    assert (MISSED.words.clusters, MISSED.words.squares) == (1, 4)
    wrong = LayerCounts.of_packet(Count(), Count(), Count(2, 2))
    assert (wrong.packets, wrong.bits, wrong.codeword_errors, wrong.missed) == (0, 0, 2, 0)


def test_counts_add_and_subtract_field_by_field_and_layer_by_layer() -> None:
    total = READ + MISSED + READ
    assert (total.codewords, total.codeword_errors, total.missed, total.raw_squares) == (6, 4, 2, 800)
    assert (total - READ, total - MISSED) == (READ + MISSED, READ + READ)
    assert LayerCounts.of_missed(6, 3) == MISSED + MISSED + MISSED
    assert pooled([]) == no_errors()
    assert pooled([{"low": READ}, {"low": MISSED}]) == {**no_errors(), "low": READ + MISSED}


def test_without_an_error_packets_bound_the_rate_and_bits_that_of_a_single_film() -> None:
    clean = LayerCounts(bits=6000, packets=6)
    assert (clean.decoded.bound, clean.decoded_bits.bound) == (3 / 6, 3 / 6000)


def test_codewords_that_fail_with_their_packet_count_as_one_trial() -> None:
    """Packets of four codewords are lost as a whole: the interval is that of the packets."""
    together = pooled({"low": LayerCounts.of_missed(4)} for _ in range(5))["low"]
    good = LayerCounts(codewords=60, sent_packets=15)
    assert (together + good).words.interval() == pytest.approx(clopper_pearson(5, 20))
    # single wrong codewords in many packets are nearly independent
    rng = np.random.default_rng(3)
    scattered = LayerCounts()
    for wrong in rng.binomial(4, 0.25, 400):
        scattered += LayerCounts.of_packet(Count(), Count(), Count(4, int(wrong)))
    low, high = scattered.words.interval()
    plain_low, plain_high = Count(1600, scattered.codeword_errors).interval()
    assert 1 <= (high - low) / (plain_high - plain_low) < 1.15


def test_times_are_sorted_into_tenths_of_a_millisecond() -> None:
    assert [ticks(time_s) for time_s in (0.1, 0.10004, 0.00006, -1e-9)] == ["1000", "1000", "1", "0"]
    one = BlockCounts(latency={"1000": 2}, acquisition={"5": 1}, position_px=0.5)
    total = one + BlockCounts(latency={"1000": 1, "1020": 4})
    assert (total.latency, total.acquisition, total.position_px) == ({"1000": 3, "1020": 4}, {"5": 1}, 0.5)
    assert BlockCounts.from_plain(json.loads(json.dumps(total.to_plain()))) == total


@pytest.mark.parametrize("histogram", [{"-1": 1}, {"1.5": 1}, {"x": 1}, {"1": -1}])
def test_stored_times_are_checked(histogram: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"match pattern|greater than"):
        BlockCounts.from_plain({**BlockCounts().to_plain(), "latency": histogram})


def test_blocks_add_up_by_layer_and_distance_and_survive_json() -> None:
    total = BlockCounts() + block(40.0, READ) + block(70.0, MISSED) + block(40.0, READ)
    assert total.layers["low"] == READ + READ + MISSED
    assert {start: layers["low"] for start, layers in total.bins.items()} == {40.0: READ + READ, 70.0: MISSED}
    assert total.payload_bits == {"high": 0, "middle": 0, "low": 2400}
    assert (total.false_codewords, total.false_packets, total.duplicates, total.frames) == (3, 6, 9, 60)
    assert (total.packets, total.detected, total.codewords) == (15, 12, 6)
    assert total.film_s == pytest.approx(0.06)
    one = block(40.0, READ) + block(70.0, MISSED)
    assert BlockCounts.from_plain(json.loads(json.dumps(one.to_plain()))) == one
