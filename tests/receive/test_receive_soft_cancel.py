"""Equaliser, cancellation and turbo decoder together, on looks whose channel is known."""

from itertools import pairwise

import numpy as np
import pytest
from soft_looks import FORM, GAIN, IDENTITY, NOISE, cells_of, decoded, looks_at, random_blocks, right

from heliograph.measure.statistics import clopper_pearson
from heliograph.receive.decode import ERASED
from heliograph.receive.packets import Codeword
from heliograph.receive.soft.cancel import Light
from heliograph.receive.soft.codewords import information
from heliograph.receive.soft.equalise import equalise
from heliograph.receive.soft.look import Look
from heliograph.receive.soft.threads import one_thread


def test_layers_come_one_after_the_other() -> None:
    blocks = random_blocks(0)
    looks = looks_at(blocks, 100)
    assert right(decoded(looks, rounds=1), blocks) == [True, False, False, False]
    assert right(decoded(looks, rounds=2), blocks) == [True, True, True, False]
    assert right(decoded(looks), blocks) == [True, True, True, True]


@pytest.mark.parametrize("seed", range(3))
def test_near_all_is_decoded_in_the_first_round(seed: int) -> None:
    blocks = random_blocks(seed)
    assert all(right(decoded(looks_at(blocks, 60, seed), rounds=1), blocks))


def test_too_far_nothing_is_taken_for_right() -> None:
    words = decoded(looks_at(random_blocks(0), 300))
    assert [w.status for by in words.values() for w in by] == ["crc_fail"] * 4
    assert not any(w.block for by in words.values() for w in by)


def test_guesses_of_failed_codewords_help() -> None:
    blocks = random_blocks(0)
    looks = looks_at(blocks, 140)
    assert right(decoded(looks, propagate=False), blocks) == [True, True, True, False]
    assert right(decoded(looks, feedback="decoded", propagate=False), blocks) == [True, False, False, False]


@pytest.mark.parametrize(("z", "number"), [(148, 1), (204, 0)])
def test_cells_that_are_not_decoded_are_two_valued(z: float, number: int) -> None:
    """Where Gaussian cells leave codewords of a layer unread, those of -1 and +1 leave fewer."""
    read, gaussian = 0, 0
    for seed in range(4):
        blocks = random_blocks(seed)
        looks = looks_at(blocks, z, seed)
        read += right(decoded(looks), blocks)[number]
        gaussian += right(decoded(looks, propagate=False), blocks)[number]
    assert gaussian < read


def test_without_feedback_each_layer_is_on_its_own() -> None:
    blocks = random_blocks(0)
    assert right(decoded(looks_at(blocks, 100), feedback="none"), blocks) == [True, False, False, False]


def test_pairs_not_seen_are_erased() -> None:
    blocks = random_blocks(2)
    looks = looks_at(blocks, 80, 2)
    seen = [None if number % 4 == 1 else look for number, look in enumerate(looks)]
    words = decoded(seen)
    assert all(right(words, blocks))
    # an LLR of 0 is no bit
    erased = sum(int((w.raw == ERASED).sum()) for w in words["high"])
    assert erased == FORM.layers["high"].symbols * len(looks) // 4


def test_a_packet_never_seen_is_not_right() -> None:
    words = decoded([None] * FORM.settings.data_pairs)
    for word in (w for by in words.values() for w in by):
        assert word.status == "crc_fail"
        assert (word.raw == ERASED).all()


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_gain_is_found_along_with_the_cells(factor: float) -> None:
    blocks, light = random_blocks(0), Light(factor * GAIN, NOISE)
    assert all(right(decoded(looks_at(blocks, 90), light=light), blocks))
    # each round it comes nearer
    assert abs(light.gain / GAIN - 1) < 0.4 * abs(factor - 1)


@pytest.mark.parametrize(("z", "moves", "asked"), [(160, 0, 1), (160, 2, 3), (100, 0, 2)])
def test_poses_are_sharpened_while_something_may_come_of_it(z: float, moves: int, asked: int) -> None:
    """At 160 m the high layer alone can be read: once, or until the poses stay; at 100 m after each of two layers."""
    looks, calls = looks_at(random_blocks(0), z), list[bool]()

    def again(*_: object) -> tuple[list[Look | None], bool]:
        calls.append(len(calls) < moves)
        return looks, calls[-1]

    decoded(looks, again=again)
    assert len(calls) == asked


def test_information_of_llrs() -> None:
    llr = np.array([[0.0] * 4, [50.0] * 4, [-1e4] * 4, [np.log(9)] * 4])
    # P(wrong) = 1/2, 0, 0 and 1/10
    assert information(llr) == pytest.approx([0, 1, 1, 1 + 0.1 * np.log2(0.1) + 0.9 * np.log2(0.9)])


def test_rounds_end_where_nothing_is_told_any_more() -> None:
    rounds: list[str] = []
    decoded(looks_at(random_blocks(0), 300), observe=lambda stage, _: rounds.append(stage))
    assert rounds == ["equalise"] * 3


def test_codewords_of_another_array_are_not_used() -> None:
    words = decoded(looks_at(random_blocks(0), 60), identity=IDENTITY + 1)
    assert {w.status for by in words.values() for w in by} == {"mismatch"}
    assert not any(w.block for by in words.values() for w in by)


def test_raw_bits_are_those_of_the_equaliser() -> None:
    blocks = random_blocks(3)
    words = decoded(looks_at(blocks, 90, 3))
    for name, layer in FORM.layers.items():
        for word, sent in zip(words[name], layer.code.encode([w.bits for w in words[name]]), strict=True):
            assert 0 < np.mean(word.raw != sent) < 0.2, name


def margins(words: dict[str, tuple[Codeword, ...]]) -> list[float]:
    return [w.margin for by in words.values() for w in by]


def test_equal_looks_give_equal_codewords() -> None:
    looks = looks_at(random_blocks(0), 110)
    assert margins(decoded(looks)) == margins(decoded(looks))


@pytest.mark.parametrize("z", [70, 100, 150])
def test_claimed_error_probabilities_are_those_observed(z: float) -> None:
    """First pass, nothing known, the channel known exactly: P(wrong) = 1 / (1 + exp |LLR|)."""
    claimed, wrong = [], []
    for seed in range(4):
        blocks = random_blocks(seed)
        for look, cells in zip(looks_at(blocks, z, seed), cells_of(blocks), strict=True):
            assert look is not None
            with one_thread():
                llr = equalise(look, GAIN, NOISE, np.zeros(256), np.ones(256)).llr
            claimed.append(1 / (1 + np.exp(np.abs(llr))))
            wrong.append((llr > 0) != (cells > 0))
    p, w = np.concatenate(claimed), np.concatenate(wrong)
    edges, told = [0, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.501], 0
    for low, high in pairwise(edges):
        here = (p >= low) & (p < high)
        if here.sum() > 500:
            told += 1
            least, most = clopper_pearson(int(w[here].sum()), int(here.sum()), 0.999)
            assert least / 1.1 < p[here].mean() < 1.1 * most, (low, high)
    assert told >= 2
