"""Soft combining for repeated packets and codewords."""

import numpy as np
import pytest
from known_packets import FORM, GAIN, IDENTITY, NOISE, KnownPoses, decoded, random_blocks, right, statistics_of
from numpy.typing import NDArray

from heliograph.base.threads import one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import BufferedPacket, SoftBuffer, is_consistent
from heliograph.receive.decode.turbo_equaliser import decode_iteratively
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import Words
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, Format

Floats = NDArray[np.float64]

FAR = 154
"""Distance in m with only the high layer decodable from one packet.

Single packets give the middle layer up to 148 m and the high layer up to 200 m; two packets give the middle
layer up to 158 m.
"""

CODEWORDS, PACKETS = 32, 4
"""Buffer capacity: codewords per kind, and packets."""

PAIRS = FORM.settings.data_pairs


def random_llrs(rng: np.random.Generator) -> Floats:
    """Return unreliable codeword LLRs, distinguishable from chance."""
    return np.asarray(rng.choice([-3.0, 3.0], 400))


def statuses(words: Words) -> list[str]:
    return [word.status for by in words.values() for word in by]


@pytest.mark.slow
def test_repeated_packet_is_decoded_with_a_buffer() -> None:
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    first, second, third = (statistics_of(blocks, FAR, seed) for seed in range(3))
    assert right(decoded(second), blocks) == [True, False, False, False]
    assert right(decoded(first, buffer=buffer), blocks) == [True, False, False, False]
    assert right(decoded(second, buffer=buffer), blocks)[:3] == [True, True, True]
    # later packets reuse the decoded layers
    assert right(decoded(third, buffer=buffer), blocks)[:3] == [True, True, True]


@pytest.mark.slow
def test_rejected_codeword_is_not_used() -> None:
    """Only the earlier packet supports the low layer: rejected bits must not refine poses or LED brightness."""
    blocks = random_blocks(0)
    coded = {name: np.asarray(1.0 - 2.0 * layer.encode(blocks[name])) for name, layer in FORM.layers.items()}
    signs = [layer.deinterleave(coded[name]) for name, layer in FORM.layers.items()]
    llrs = tuple(LARGEST_LLR * word for words in signs for word in words)
    before = BufferedPacket(FORM.format, llrs, tuple(statistics_of(blocks, 60, 1)), GAIN, NOISE)
    packet = KnownPoses(statistics_of(blocks, 200, 2))
    with one_thread():
        buffer = SoftBuffer().with_packet(before)
        read = decode_iteratively(packet, GAIN, IDENTITY, Decoding("log-map"), buffer)
    assert statuses(read.words) == ["ok", "ok", "ok", "crc_fail"]
    low = slice(-FORM.layers["low"].symbols, None)
    assert (read.variance[:, low] > 0.9).all()
    assert max(packet.known) == FORM.settings.side**2 - FORM.layers["low"].symbols


@pytest.mark.slow
def test_packet_with_known_codewords_is_combined() -> None:
    """LED-by-LED codewords are known from the start; combining adds the others."""
    blocks, buffer = random_blocks(0), SoftBuffer()
    for seed in (1, 2):
        packet = [*statistics_of(blocks, 105, seed)[:14], *[None] * 10]
        alone = decoded(packet)
        assert right(alone, blocks) == [True, True, True, False]
        with one_thread():
            read = decode_iteratively(KnownPoses(packet), GAIN, IDENTITY, Decoding("log-map"), buffer, known=alone)
        assert read.buffer is not None
        buffer = read.buffer
    assert all(right(read.words, blocks))


@pytest.mark.slow
def test_repeated_packet_supplies_missing_pairs() -> None:
    """At 105 m the low layer needs more pairs than either packet has."""
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    first, second = (statistics_of(blocks, 105, seed) for seed in range(2))
    early, late = [*first[:14], *[None] * 10], [*[None] * 10, *second[10:]]
    assert not all(right(decoded(early, buffer=buffer), blocks))
    assert not all(right(decoded(late), blocks))
    assert all(right(decoded(late, buffer=buffer), blocks))


@pytest.mark.slow
def test_another_packet_is_not_combined() -> None:
    buffer = [SoftBuffer()]
    decoded(statistics_of(random_blocks(0), FAR, 1), buffer=buffer)
    blocks = random_blocks(1)
    packet = statistics_of(blocks, 140)
    alone = right(decoded(packet), blocks)
    assert alone == [True, True, True, False]
    assert right(decoded(packet, buffer=buffer), blocks) == alone


@pytest.mark.slow
def test_repeated_codeword_in_another_packet_is_combined() -> None:
    buffer, repeated, read = [SoftBuffer()], random_blocks(0)["middle"], list[list[bool]]()
    for seed in range(1, 4):
        sent = {**random_blocks(seed), "middle": repeated}
        read.append(right(decoded(statistics_of(sent, FAR - 3, seed), buffer=buffer), sent)[1:3])
    assert read[-1] == [True, True]


def test_only_packets_of_one_format_are_combined() -> None:
    llrs = [random_llrs(np.random.default_rng(0))]
    packet = BufferedPacket(AGREED, tuple(llrs), (None,))
    buffer = SoftBuffer().with_packet(packet)
    assert buffer.same_packet(Format(high=0.5), llrs) is None
    assert buffer.same_packet(AGREED, [-llrs[0]]) is None
    assert buffer.same_packet(AGREED, llrs) is packet
    assert buffer.without(packet).same_packet(AGREED, llrs) is None


def test_contradicting_codeword_makes_another_packet() -> None:
    rng = np.random.default_rng(1)
    high, low = random_llrs(rng), random_llrs(rng)
    packet = BufferedPacket(AGREED, (high, low), (None,))
    assert packet.likeness([high, low]) > 20
    assert packet.likeness([high, np.zeros(400)]) > 15
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
    rng, pairs = np.random.default_rng(9), []
    for _ in range(2):
        b, d, o = rng.normal(size=(30, 8)), rng.normal(size=30), rng.normal(size=30)
        gram = (b.T @ b).astype(np.float32)
        pairs.append(PairStatistics(gram, b.T @ d, b.T @ o, float(d @ o), float(o @ o), float(d @ d), 30))
    kept = BufferedPacket(AGREED, (), (pairs[0], pairs[0], None), gain=90.0, noise=2.0)
    both, once, other = kept.joined([pairs[1], None, pairs[1]], 180.0, 6.0)
    assert other is pairs[1]
    assert once is not None
    assert both is not None
    # g^2 / s^2 B^T B, g / s^2 B^T d and d^T d / s^2 are invariant
    for power, now, before in (
        (2, once.gram, pairs[0].gram),
        (1, once.matched, pairs[0].matched),
        (2, once.offset, pairs[0].offset),
        (1, once.cross, pairs[0].cross),
        (2, once.offset_power, pairs[0].offset_power),
        (0, once.power, pairs[0].power),
    ):
        assert 180.0**power / 6.0 * np.asarray(now) == pytest.approx(90.0**power / 2.0 * np.asarray(before), rel=1e-6)
    assert both.matched == pytest.approx(once.matched + pairs[1].matched)
    assert both.pixels == once.pixels + pairs[1].pixels == 60


def test_decoded_and_empty_packets_leave_the_buffer_unchanged() -> None:
    blocks, buffer = random_blocks(0), [SoftBuffer()]
    assert all(right(decoded(statistics_of(blocks, 60), buffer=buffer), blocks))
    decoded([None] * PAIRS, buffer=buffer)
    assert all(kept == SoftBuffer() for kept in buffer)


def test_buffers_are_immutable() -> None:
    rng = np.random.default_rng(3)
    llr, kind = random_llrs(rng), ("high", FORM.layers["high"].code)
    packet = BufferedPacket(AGREED, (random_llrs(rng),), (None,) * PAIRS)
    buffer = SoftBuffer().with_codeword(kind, llr, np.zeros(400))
    other = buffer.with_codeword(kind, -llr, np.zeros(400)).with_packet(packet)
    assert not buffer.same_codeword(kind, -llr).any()
    assert buffer.same_packet(AGREED, packet.llrs) is None
    assert (buffer.same_codeword(kind, llr) == llr).all()
    assert (other.same_codeword(kind, llr) == llr).all()
    assert (other.same_codeword(kind, -llr) == -llr).all()
    assert other.same_packet(AGREED, packet.llrs) is packet
    assert other.without(packet).same_packet(AGREED, packet.llrs) is None
    assert other.same_packet(AGREED, packet.llrs) is packet


def test_sum_replaces_its_parts() -> None:
    rng, buffer, kind = np.random.default_rng(8), SoftBuffer(), ("high", FORM.layers["high"].code)
    llr = random_llrs(rng)
    others = [random_llrs(rng) for _ in range(CODEWORDS - 1)]
    for one in (*others, llr):
        buffer = buffer.with_codeword(kind, one, np.zeros(400))
    buffer = buffer.with_codeword(kind, llr, buffer.same_codeword(kind, llr))
    assert (buffer.same_codeword(kind, llr) == 2 * llr).all()
    assert all((buffer.same_codeword(kind, one) == one).all() for one in others)


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
    rng, buffer, kind = np.random.default_rng(5), SoftBuffer(), ("high", FORM.layers["high"].code)
    llrs = [random_llrs(rng) for _ in range(CODEWORDS + 3)]
    for llr in llrs:
        buffer = buffer.with_codeword(kind, llr, np.zeros(400))
        buffer = buffer.with_packet(BufferedPacket(AGREED, (llr,), (None,) * PAIRS))
    is_kept = [bool(buffer.same_codeword(kind, llr).any()) for llr in llrs]
    assert is_kept == [False] * 3 + [True] * CODEWORDS
    is_kept = [buffer.same_packet(AGREED, [llr]) is not None for llr in llrs]
    assert is_kept == [False] * (len(llrs) - PACKETS) + [True] * PACKETS
