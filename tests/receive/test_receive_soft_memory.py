"""Packets and codewords of a carousel that come again."""

import numpy as np
import pytest
from soft_looks import FORM, decoded, looks_at, random_blocks, right

from heliograph.receive.soft.memory import KEPT_PACKETS, Memory, SeenPacket
from heliograph.signal.formats import AGREED, Format

FAR = 150
"""Where one look gives the high layer and no more."""


def test_a_packet_that_comes_again_is_read() -> None:
    blocks, memory = random_blocks(0), Memory()
    assert right(decoded(looks_at(blocks, FAR, 1), memory=memory), blocks) == [True, False, False, False]
    assert right(decoded(looks_at(blocks, FAR, 2), memory=memory), blocks)[:3] == [True, True, True]
    # and from then on, with what is known of it
    assert right(decoded(looks_at(blocks, FAR, 3), memory=memory), blocks)[:3] == [True, True, True]


def test_pairs_seen_in_one_look_only_are_taken_from_it() -> None:
    blocks, memory = random_blocks(0), Memory()
    first, second = looks_at(blocks, 110, 1), looks_at(blocks, 110, 2)
    assert not all(right(decoded([*first[:14], *[None] * 10], memory=memory), blocks))
    assert right(decoded([*[None] * 10, *second[10:]], memory=memory), blocks)[:3] == [True, True, True]


def test_another_packet_is_not_taken_for_it() -> None:
    memory = Memory()
    decoded(looks_at(random_blocks(0), FAR, 1), memory=memory)
    blocks = random_blocks(1)
    looks = looks_at(blocks, 140, 2)
    assert right(decoded(looks, memory=memory), blocks) == right(decoded(looks), blocks)


def test_a_codeword_in_other_company_is_added_to() -> None:
    memory, blocks = Memory(), random_blocks(0)
    for seed in range(1, 4):
        others = {**random_blocks(seed), "middle": blocks["middle"]}
        words = decoded(looks_at(others, FAR, seed), memory=memory)
    assert right(words, others)[1:3] == [True, True]


def test_only_looks_of_one_format_are_joined() -> None:
    llrs = [np.random.default_rng(0).choice([-3.0, 3.0], 400)]
    memory = Memory()
    packet = SeenPacket(AGREED, tuple(llrs), (None,))
    memory.keep_packet(packet)
    assert memory.recall_packet(Format(high=0.5), llrs) is None
    assert memory.recall_packet(AGREED, [-llrs[0]]) is None
    assert memory.recall_packet(AGREED, llrs) is packet
    # it is kept anew by who recalled it
    assert memory.recall_packet(AGREED, llrs) is None


def test_a_codeword_that_contradicts_makes_another_packet() -> None:
    rng = np.random.default_rng(1)
    high, low = rng.choice([-3.0, 3.0], 400), rng.choice([-3.0, 3.0], 400)
    packet = SeenPacket(AGREED, (high, low), (None,))
    assert packet.likeness([high, low]) > 20
    assert packet.likeness([high, np.zeros(400)]) > 15
    assert packet.likeness([high, -low]) == 0


@pytest.mark.parametrize("count", [KEPT_PACKETS + 3])
def test_memory_is_bounded(count: int) -> None:
    rng, memory = np.random.default_rng(2), Memory()
    llrs = [rng.choice([-3.0, 3.0], 400) for _ in range(count)]
    for llr in llrs:
        memory.keep_packet(SeenPacket(AGREED, (llr,), (None,) * FORM.settings.data_pairs))
    found = [memory.recall_packet(AGREED, [llr]) is not None for llr in llrs]
    assert found == [False] * 3 + [True] * KEPT_PACKETS
