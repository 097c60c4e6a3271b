"""Packets and codewords of a carousel that come again."""

import numpy as np
from soft_looks import FORM, decoded, looks_at, random_blocks, right

from heliograph.receive.soft.cancel import Light
from heliograph.receive.soft.look import Look
from heliograph.receive.soft.memory import KEPT, KEPT_PACKETS, Memory, SeenPacket, faithful
from heliograph.signal.block import Block
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
    # of each one sum is kept
    assert len(memory._kept["middle", FORM.layers["middle"].code]) == 2


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


def test_packets_that_share_a_codeword_are_told_apart() -> None:
    """Also where little is seen of the second: nothing of the first one's may be passed for its own."""
    count = 0
    for z, pairs in ((150, 3), (180, 5), (180, 24), (240, 10)):
        first = random_blocks(50)
        second, memory = {**random_blocks(51), "high": first["high"]}, Memory()
        for seed in (1, 2):
            assert right(decoded(looks_at(first, FAR - 2, seed), memory=memory), first)[0]
        looks: list[Look | None] = [*looks_at(second, z, 3)[:pairs], *[None] * (24 - pairs)]
        words = decoded(looks, memory=memory)
        read = [word for by in words.values() for word in by if word.status == "ok"]
        assert sum(right(words, second)) == len(read)
        # what one look gives is given with the memory too
        assert sum(right(words, second)) >= sum(right(decoded(looks), second))
        count += len(read)
    assert count


def test_blocks_that_are_much_alike_are_told_apart() -> None:
    memory, alone = Memory(), 0
    with_memory = 0
    for number in range(6):
        text = [b"%05d km/h, %8.3f m" % (line, number) for line in range(2)]
        blocks = {
            name: [Block(name, b.identity, number, i, len(text[i]), text[i]) for i, b in enumerate(by)]
            for name, by in random_blocks(0).items()
        }
        looks = looks_at(blocks, 147, number)
        with_memory += sum(right(decoded(looks, memory=memory), blocks))
        alone += sum(right(decoded(looks), blocks))
    assert with_memory == alone >= 6


def test_looks_of_other_light_and_noise_are_joined_as_what_they_are() -> None:
    """A noisy look adds little, and one of a dimmer light is scaled: neither takes away."""
    blocks = random_blocks(0)
    for gain, noise in ((180.0, 40.0), (90.0, 4.5)):
        memory = Memory()
        dimmer: list[Look | None] = [
            Look(look.gram, gain / 180 * look.seen, look.offset, gain / 180 * look.cross, look.drift)
            for look in looks_at(blocks, FAR, 1, noise=noise * (180 / gain) ** 2)
            if look
        ]
        decoded(dimmer, light=Light(gain, noise), memory=memory)
        second = looks_at(blocks, FAR - 3, 2)
        assert sum(right(decoded(second, memory=memory), blocks)) >= sum(right(decoded(second), blocks)) >= 1


def test_what_is_known_is_not_added_to_and_nothing_is_not_kept() -> None:
    blocks, memory = random_blocks(0), Memory()
    for seed in range(3):
        assert all(right(decoded(looks_at(blocks, 60, seed), memory=memory), blocks))
    decoded([None] * FORM.settings.data_pairs, memory=memory)
    assert not memory._packets
    assert not any(memory._kept.values())


def test_a_copy_goes_its_own_way() -> None:
    memory, llr = Memory(), np.random.default_rng(3).choice([-3.0, 3.0], 400)
    kind = "high", FORM.layers["high"].code
    memory.keep(kind, llr, np.zeros(400))
    other = memory.copy()
    other.keep(kind, -llr, np.zeros(400))
    assert not memory.recall(kind, -llr).any()
    assert (memory.recall(kind, llr) == llr).all()
    memory.become(other)
    assert (memory.recall(kind, -llr) == -llr).all()


def test_a_look_must_speak_for_what_others_helped_to_read() -> None:
    rng = np.random.default_rng(4)
    signs = rng.choice([-1.0, 1.0], 1000)
    # LLRs of a bit sent over Gaussian noise are N(2 / s^2, 4 / s^2)
    llr = 0.5 * signs + rng.normal(0, 1, 1000)
    assert faithful(llr, signs)
    assert not faithful(llr, rng.choice([-1.0, 1.0], 1000))
    assert not faithful(np.where(np.arange(1000) < 20, llr, 0.0), signs)
    some = np.where(rng.uniform(size=1000) < 0.25, -1, 1) * signs
    assert not faithful(3 * llr, some)
    assert not faithful(np.zeros(1000), signs)


def test_codewords_kept_are_bounded() -> None:
    rng, memory = np.random.default_rng(5), Memory()
    kind, llrs = ("high", FORM.layers["high"].code), [rng.choice([-3.0, 3.0], 400) for _ in range(KEPT + 3)]
    for llr in llrs:
        memory.keep(kind, llr, np.zeros(400))
    assert [bool(memory.recall(kind, llr).any()) for llr in llrs] == [False] * 3 + [True] * KEPT


def test_memory_is_bounded() -> None:
    rng, memory = np.random.default_rng(2), Memory()
    llrs = [rng.choice([-3.0, 3.0], 400) for _ in range(KEPT_PACKETS + 3)]
    for llr in llrs:
        memory.keep_packet(SeenPacket(AGREED, (llr,), (None,) * FORM.settings.data_pairs))
    found = [memory.recall_packet(AGREED, [llr]) is not None for llr in llrs]
    assert found == [False] * 3 + [True] * KEPT_PACKETS
