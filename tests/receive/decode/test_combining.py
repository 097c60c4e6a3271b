"""Soft combining for repeated packets and codewords."""

import numpy as np
import pytest
from known_packets import (
    FORM,
    GAIN,
    NOISE,
    KnownPoses,
    by_matrices,
    decoded,
    equalised,
    random_blocks,
    right,
    statistics_of,
)

from heliograph.base.arrays import Floats
from heliograph.receive.decode.combining import BufferedPacket, SoftBuffer, is_consistent
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Words
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, Format

# distance in m with only the high layer decodable from one packet: single packets give the middle layer up to 148 m
# and the high layer up to 200 m; two packets give the middle layer up to 158 m
FAR = 154

CODEWORDS, PACKETS = 32, 4  # buffer capacity: codewords per kind, and packets
PAIRS, KIND, ZEROS = FORM.settings.data_pairs, ("high", FORM.layers["high"].code), np.zeros(400)


def random_llrs(rng: np.random.Generator, count: int = 1) -> Floats:
    """Return unreliable LLRs of codewords (codewords, 400), distinguishable from chance."""
    return np.asarray(rng.choice([-3.0, 3.0], (count, 400)))


def statuses(words: Words) -> list[str]:
    return [word.status for by in words.values() for word in by]


@pytest.mark.slow
def test_repeated_packet_is_decoded_with_a_buffer() -> None:
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    first, second, third = (statistics_of(blocks, FAR, seed) for seed in range(3))
    for alone in (decoded(second), decoded(first, buffer=buffer)):
        assert right(alone, blocks) == [True, False, False, False]
    # later packets reuse the decoded layers
    for packet in (second, third):
        assert right(decoded(packet, buffer=buffer), blocks)[:3] == [True, True, True]


@pytest.mark.slow
def test_rejected_codeword_is_not_used() -> None:
    """Only the earlier packet supports the low layer: rejected bits must not refine poses or LED brightness."""
    blocks, low = random_blocks(0), FORM.layers["low"].symbols
    signs = [layer.deinterleave(1.0 - 2.0 * layer.encode(blocks[name])) for name, layer in FORM.layers.items()]
    llrs = tuple(LARGEST_LLR * word for words in signs for word in words)
    before = BufferedPacket(FORM.format, llrs, tuple(statistics_of(blocks, 60, 1)), GAIN, NOISE)
    packet = KnownPoses(statistics_of(blocks, 200, 2))
    read = equalised(packet, buffer=SoftBuffer().with_packet(before))
    assert statuses(read.words) == ["ok", "ok", "ok", "crc_fail"]
    assert (read.variance[:, -low:] > 0.9).all()
    assert max(packet.known) == FORM.settings.side**2 - low


@pytest.mark.slow
def test_packet_with_known_codewords_is_combined() -> None:
    """LED-by-LED codewords are known from the start; combining adds the others."""
    blocks, buffer = random_blocks(0), SoftBuffer()
    for seed in (1, 2):
        packet = [*statistics_of(blocks, 105, seed)[:14], *[None] * 10]
        alone = decoded(packet)
        assert right(alone, blocks) == [True, True, True, False]
        read = equalised(packet, buffer=buffer, known=alone)
        assert read.buffer is not None
        buffer = read.buffer
    assert all(right(read.words, blocks))


@pytest.mark.slow
def test_repeated_packet_supplies_missing_pairs() -> None:
    """At 105 m the low layer needs more pairs than either packet has."""
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    first, second = (statistics_of(blocks, 105, seed) for seed in range(2))
    early, late = [*first[:14], *[None] * 10], [*[None] * 10, *second[10:]]
    reads = decoded(early, buffer=buffer), decoded(late), decoded(late, buffer=buffer)
    assert [all(right(read, blocks)) for read in reads] == [False, False, True]


@pytest.mark.slow
def test_another_packet_is_not_combined() -> None:
    blocks, buffer = random_blocks(1), [SoftBuffer()]
    decoded(statistics_of(random_blocks(0), FAR, 1), buffer=buffer)
    packet = statistics_of(blocks, 140)
    for read in (decoded(packet), decoded(packet, buffer=buffer)):
        assert right(read, blocks) == [True, True, True, False]


@pytest.mark.slow
def test_repeated_codeword_in_another_packet_is_combined() -> None:
    buffer, repeated = [SoftBuffer()], random_blocks(0)["middle"]
    for seed in range(1, 4):
        sent = {**random_blocks(seed), "middle": repeated}
        read = right(decoded(statistics_of(sent, FAR - 3, seed), buffer=buffer), sent)
    assert read[1:3] == [True, True]


def test_only_packets_of_one_format_are_combined() -> None:
    llrs = list(random_llrs(np.random.default_rng(0)))
    packet = BufferedPacket(AGREED, tuple(llrs), (None,))
    buffer = SoftBuffer().with_packet(packet)
    assert buffer.same_packet(AGREED, llrs) is packet
    assert buffer.same_packet(Format(high=0.5), llrs) is None
    assert buffer.same_packet(AGREED, [-llrs[0]]) is None


def test_contradicting_codeword_makes_another_packet() -> None:
    high, low = random_llrs(np.random.default_rng(1), 2)
    packet = BufferedPacket(AGREED, (high, low), (None,))
    assert packet.likeness([high, low]) > 20
    assert packet.likeness([high, ZEROS]) > 15
    assert packet.likeness([high, -low]) == 0


@pytest.mark.slow
def test_packets_that_share_a_codeword_are_kept_apart() -> None:
    """Also for weak second packets: no first packet codeword passes for a different codeword in the second."""
    count, earlier, first = 0, [SoftBuffer()], random_blocks(50)
    second = {**random_blocks(51), "high": first["high"]}
    for seed in (1, 2):
        assert right(decoded(statistics_of(first, FAR, seed), buffer=earlier), first)[0]
    for distance_m, pairs in ((150, 3), (180, 24)):
        buffer = earlier[:]
        packet = [*statistics_of(second, distance_m, 3)[:pairs], *[None] * (PAIRS - pairs)]
        words = decoded(packet, buffer=buffer)
        read = [status for status in statuses(words) if status == "ok"]
        assert sum(right(words, second)) == len(read)
        # the buffer never loses codewords
        assert sum(right(words, second)) >= sum(right(decoded(packet), second))
        count += len(read)
    assert count


@pytest.mark.slow
def test_similar_blocks_are_kept_apart() -> None:
    """Texts differ in one digit; buffered decoding gives the same codewords as separate decoding."""
    buffer, alone, together = [SoftBuffer()], 0, 0
    for number in range(3):
        text = [b"%05d km/h, %8.3f m" % (line, number) for line in range(2)]
        blocks = {
            name: [Block(name, b.identity, 2 * number + i, 0, len(text[i]), text[i]) for i, b in enumerate(by)]
            for name, by in random_blocks(0).items()
        }
        # alternate between decodable and undecodable middle layer
        packet = statistics_of(blocks, (140, FAR)[number % 2], number)
        words = decoded(packet, buffer=buffer)
        assert statuses(words).count("ok") == sum(right(words, blocks))
        together += sum(right(words, blocks))
        alone += sum(right(decoded(packet), blocks))
    assert together == alone == 2 * 3 + 1


def of_gain(statistics: list[PairStatistics | None], gain: float) -> list[PairStatistics | None]:
    """Scale pair statistics to another gain."""
    return [
        PairStatistics(one.gram, gain * one.matched, one.offset, gain * one.cross, one.offset_power) if one else None
        for one in statistics
    ]


@pytest.mark.slow
def test_dim_or_noisy_packets_are_weighted() -> None:
    """Weighting by noise and gain: a noisy or dim packet must not hurt."""
    blocks = random_blocks(0)
    second = statistics_of(blocks, FAR - 3, 2)
    single = sum(right(decoded(second), blocks))
    assert single >= 1
    for gain, noise in ((180.0, 40.0), (90.0, 4.5)):
        buffer = [SoftBuffer()]
        first = of_gain(statistics_of(blocks, FAR, 1, noise=noise * (GAIN / gain) ** 2), gain / GAIN)
        decoded(first, channel=(gain, noise), buffer=buffer)
        assert sum(right(decoded(second, buffer=buffer), blocks)) >= single


def test_combined_packet_is_the_sum_in_units_of_the_later() -> None:
    """Noise and gain units follow the later packet; single pairs are rescaled."""
    rng = np.random.default_rng(9)
    before, now = (by_matrices(rng.normal(size=(30, 8)), *rng.normal(size=(2, 30))) for _ in range(2))
    kept = BufferedPacket(AGREED, (), (before, before, None), gain=90.0, noise=2.0)
    both, once, other = kept.joined([now, None, now], 180.0, 6.0)
    assert other is now
    assert once is not None
    assert both is not None
    # g^2 / s^2 B^T B, g / s^2 B^T d and d^T d / s^2 are invariant
    powers = {"gram": 2, "matched": 1, "offset": 2, "cross": 1, "offset_power": 2, "power": 0}
    for name, power in powers.items():
        first, scaled = (np.asarray(getattr(one, name)) for one in (before, once))
        assert 180.0**power / 6.0 * scaled == pytest.approx(90.0**power / 2.0 * first, rel=1e-6), name
    assert both.matched == pytest.approx(once.matched + now.matched)
    assert both.pixels == once.pixels + now.pixels == 60


def test_decoded_and_empty_packets_leave_the_buffer_unchanged() -> None:
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    assert all(right(decoded(statistics_of(blocks, 60), buffer=buffer), blocks))
    decoded([None] * PAIRS, buffer=buffer)
    assert all(kept == SoftBuffer() for kept in buffer)


def test_buffers_are_immutable() -> None:
    llr, of_packet = random_llrs(np.random.default_rng(3), 2)
    packet = BufferedPacket(AGREED, (of_packet,), (None,) * PAIRS)
    buffer = SoftBuffer().with_codeword(KIND, llr, ZEROS)
    other = buffer.with_codeword(KIND, -llr, ZEROS).with_packet(packet)
    without = other.without(packet)
    assert [one.same_packet(AGREED, packet.llrs) for one in (buffer, other, without)] == [None, packet, None]
    kept = [one.same_codeword(KIND, sign * llr) for one in (buffer, other) for sign in (1, -1)]
    assert np.array_equal(kept, [llr, ZEROS, llr, -llr])


def test_sum_replaces_its_parts() -> None:
    buffer, llrs = SoftBuffer(), random_llrs(np.random.default_rng(8), CODEWORDS)
    for one in llrs:
        buffer = buffer.with_codeword(KIND, one, ZEROS)
    buffer = buffer.with_codeword(KIND, llrs[-1], buffer.same_codeword(KIND, llrs[-1]))
    kept = [buffer.same_codeword(KIND, one) for one in llrs]
    assert np.array_equal(kept, [*llrs[:-1], 2 * llrs[-1]])


def test_packet_must_support_codewords_of_earlier_packets() -> None:
    rng = np.random.default_rng(4)
    signs = rng.choice([-1.0, 1.0], 1000)
    # LLRs over Gaussian noise follow N(2 / s^2, 4 / s^2)
    llr = 0.5 * signs + rng.normal(0, 1, 1000)
    assert is_consistent(llr, signs)
    assert not is_consistent(llr, rng.choice([-1.0, 1.0], 1000))
    assert not is_consistent(np.where(np.arange(1000) < 20, llr, 0.0), signs)
    some = np.where(rng.uniform(size=1000) < 0.25, -1, 1) * signs
    assert not is_consistent(3 * llr, some)
    assert not is_consistent(np.zeros(1000), signs)


def test_numbers_of_codewords_and_packets_are_bounded() -> None:
    buffer, llrs = SoftBuffer(), random_llrs(np.random.default_rng(5), CODEWORDS + 3)
    for llr in llrs:
        buffer = buffer.with_codeword(KIND, llr, ZEROS)
        buffer = buffer.with_packet(BufferedPacket(AGREED, (llr,), (None,) * PAIRS))
    is_kept = [bool(buffer.same_codeword(KIND, llr).any()) for llr in llrs]
    assert is_kept == [False] * 3 + [True] * CODEWORDS
    is_kept = [buffer.same_packet(AGREED, [llr]) is not None for llr in llrs]
    assert is_kept == [False] * (len(llrs) - PACKETS) + [True] * PACKETS
