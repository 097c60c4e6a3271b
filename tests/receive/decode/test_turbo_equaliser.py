"""Iterative equalisation and turbo decoding for known channels, and soft combining for repeated packets."""

from dataclasses import replace
from itertools import pairwise, product
from typing import get_args

import known_packets
import numpy as np
import pytest
from known_packets import FORM, GAIN, KnownPoses, decoded, equalised, random_blocks, right, statistics_of
from observe_oracle import pair_model
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.measure.statistics import clopper_pearson
from heliograph.receive.decode.combining import BufferedPacket, SoftBuffer, is_consistent
from heliograph.receive.decode.turbo_equaliser import update_channel
from heliograph.receive.equalise.lmmse import LARGEST_LLR, equalise
from heliograph.receive.events import EqualiseEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import ERASED, Words, hard_decisions
from heliograph.receive.settings import Feedback
from heliograph.receive.sync.combine import combine_pair
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, Format


# every iteration makes progress, so no pose refinement follows
@pytest.mark.parametrize(("distance_m", "known"), [(60, [[]]), (100, [[], ["high"], ["high", "middle"]])])
@pytest.mark.slow
def test_each_iteration_decodes_a_layer_and_cancels_it(distance_m: float, known: list[list[str]]) -> None:
    """A near array is decoded in one iteration."""
    blocks, events = random_blocks(0), list[EqualiseEvent]()
    packet = KnownPoses(statistics_of(blocks, distance_m))
    assert right(decoded(packet, observe=events.append), blocks) == [True] * 4
    # known symbols have LLR 0
    assert [[name for name, llr in event.llr.items() if not llr.any()] for event in events] == known
    assert packet.known == []


def test_far_packet_fails_after_three_iterations() -> None:
    events = list[EqualiseEvent]()
    words = decoded(statistics_of(random_blocks(0), 300), observe=events.append)
    assert [(w.status, w.block) for by in words.values() for w in by] == [("crc_fail", None)] * 4
    assert [(event.identity, event.iteration) for event in events] == [(known_packets.IDENTITY, k) for k in range(3)]


@pytest.mark.parametrize(("feedback", "distance_m", "count"), [
    ("none", 100, 1), ("decoded", 100, 4), ("decoded", 140, 1), ("soft", 140, 3), ("propagation", 140, 3),
])  # fmt: skip
@pytest.mark.slow
def test_more_feedback_decodes_farther_packets(feedback: Feedback, distance_m: float, count: int) -> None:
    blocks, packet = random_blocks(0), KnownPoses(statistics_of(random_blocks(0), distance_m))
    # first the high, then two middle codewords and the low layer
    assert right(decoded(packet, feedback), blocks) == [k < count for k in range(4)]
    # without feedback, poses are not refined
    assert feedback != "none" or not packet.known


@pytest.mark.slow
def test_binary_prior_decodes_more_than_a_gaussian() -> None:
    read = dict.fromkeys(("propagation", "soft"), 0)
    for feedback, seed in product(get_args(Feedback)[-2:], (0, 1)):
        blocks = random_blocks(seed)
        read[feedback] += right(decoded(statistics_of(blocks, 148, seed), feedback), blocks)[1]
    assert read["soft"] < read["propagation"]


@pytest.mark.parametrize(("missing", "is_read"), [(slice(1, None, 4), True), (slice(None), False)])
def test_missing_pairs_are_erased(missing: slice, is_read: bool) -> None:
    blocks = random_blocks(2)
    packet = statistics_of(blocks, 80, 2)
    erased = len(packet[missing]) / len(packet)
    packet[missing] = [None] * len(packet[missing])
    words = decoded(packet)
    assert right(words, blocks) == [is_read] * 4
    # LLR 0 is an erasure
    assert np.mean([w.raw == ERASED for w in words["high"]]) == erased
    assert is_read or {w.status for by in words.values() for w in by} == {"crc_fail"}


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_gain_estimate_improves_with_each_decoded_layer(factor: float) -> None:
    blocks, events, buffer = random_blocks(0), list[EqualiseEvent](), [SoftBuffer()]
    packet = KnownPoses(statistics_of(blocks, 120))
    words = decoded(packet, channel=(factor * GAIN, known_packets.NOISE), buffer=buffer, observe=events.append)
    # the low layer fails, so the buffer keeps the packet, in units of the gain
    assert right(words, blocks) == [True, True, True, False]
    kept = buffer[-1].same_packet(FORM.format, [llr for layer in events[0].llr.values() for llr in layer])
    assert kept is not None
    gains, noises = zip(*packet.channels, (kept.gain, kept.noise), strict=True)
    first, last = (abs(gain / GAIN - 1) for gain in gains)
    assert last <= first
    assert last < 0.4 * abs(factor - 1)
    assert set(noises) == {known_packets.NOISE}


def against_its_symbols(symbols: Floats, rng: np.random.Generator) -> PairStatistics:
    """Return statistics at 100 m with 0.4 px motion, in the direction that best resembles the symbols."""
    x, y = (float(v) for v in rng.uniform(12, 13, 2))
    pose = Pose(x, y, pitch_at(100), 0.0, 0.505)
    ways = [pose.moved(dx, dy) for dx, dy in ((0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4))]
    a = blur_matrix(pose, SIDE, (0, 0), known_packets.SHAPE)
    models = [pair_model(a, blur_matrix(moved, SIDE, (0, 0), known_packets.SHAPE), known_packets.T) for moved in ways]
    b, o = max(models, key=lambda model: float(symbols @ model[0].T @ model[1]))
    return known_packets.by_matrices(b, GAIN * (b @ symbols + o) + rng.normal(0, known_packets.NOISE**0.5, len(b)), o)


def test_combined_frames_are_decoded() -> None:
    """Each observation contains symbol products and leakage from adjacent pairs or the header."""
    combination = combine_pair(0.5 + np.arange(-2.0, 5.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    blocks = random_blocks(2)
    assert right(decoded(known_packets.combined_statistics_of(blocks, 80, combination)), blocks) == [True] * 4


@pytest.mark.slow
def test_motion_that_resembles_symbols_does_not_change_the_gain() -> None:
    blocks, rng = random_blocks(0), np.random.default_rng(7)
    packet = KnownPoses([against_its_symbols(symbols, rng) for symbols in known_packets.symbols_of(blocks)])
    read = equalised(packet)
    assert all(right(read.words, blocks))
    assert read.gain == pytest.approx(GAIN, rel=0.01)


def test_gain_and_noise_maximise_the_likelihood() -> None:
    rng = np.random.default_rng(8)
    # d = g l + n with known light l: <d, l>, |l|^2, |d|^2 and the number of pixels
    light, noise = rng.normal(size=5000), rng.normal(0, 0.7, 5000)
    d = 3.0 * light + noise
    moments = np.array([d @ light, light @ light, d @ d, 5000.0])
    assert update_channel(2.0, 1.0, moments) == pytest.approx((3.0, 1.0), rel=0.01)
    gain, variance = update_channel(2.0, 1.0, moments, combined=True)
    assert gain == pytest.approx(3.0, rel=0.01)
    assert variance == pytest.approx(np.mean((d - gain * light) ** 2))
    # without light the gain is unchanged; noise is at least rounding noise, 2 / 12
    dark = update_channel(2.0, 1.0, np.array([0.0, 0.0, 0.0, 10.0]), combined=True)
    assert dark == pytest.approx((2.0, 1 / 6))


@pytest.mark.parametrize(("match", "gain"), [(600.0, 255.0), (250.0, 250.0), (-40.0, 200.0)])
@pytest.mark.parametrize("combined", [False, True])
def test_gain_is_at_most_the_full_scale_of_the_sensor(match: float, gain: float, combined: bool) -> None:
    """Weak pairs give arbitrary quotients of either sign."""
    assert update_channel(200.0, 1.0, np.array([match, 1.0, 1e5, 1e3]), 255.0, combined)[0] == gain


def test_pair_without_a_solution_is_skipped(caplog: pytest.LogCaptureFixture) -> None:
    blocks = random_blocks(5)
    pairs = statistics_of(blocks, 60)
    bad = pairs[7]
    assert bad is not None
    pairs[7] = replace(bad, gram=-bad.gram)
    caplog.set_level("INFO")
    assert right(decoded(pairs), blocks) == [True] * 4
    assert {record.message for record in caplog.records} == {
        f"array {known_packets.IDENTITY}: pair 7 is left out: the equaliser's matrix is not positive definite"
    }


@pytest.mark.parametrize(("distance_m", "moves", "count"), [(160, 0, 1), (160, 2, 3), (100, 0, 0)])
@pytest.mark.slow
def test_poses_are_refined_while_codewords_may_be_decoded(distance_m: float, moves: int, count: int) -> None:
    """At 160 m only the high layer is decodable: refine once, or until poses converge. At 100 m all layers are."""
    packet = KnownPoses(statistics_of(random_blocks(0), distance_m), moves)
    decoded(packet)
    assert len(packet.known) == count


def test_codewords_of_another_array_are_rejected() -> None:
    words = decoded(statistics_of(random_blocks(0), 60), identity=known_packets.IDENTITY + 1)
    assert {(w.status, w.block) for by in words.values() for w in by} == {("mismatch", None)}


def test_raw_bits_are_of_the_first_equalisation_and_final_bits_of_the_last() -> None:
    """Decoded codewords no longer interfere: the last layer has the fewest final errors."""
    events = list[EqualiseEvent]()
    words = decoded(statistics_of(random_blocks(3), 90, 3), observe=events.append)
    assert len(events) > 1
    for name, layer in FORM.layers.items():
        sent = layer.code.encode([w.bits for w in words[name]])
        for word, llr, coded in zip(words[name], events[0].llr[name], sent, strict=True):
            assert (word.raw == hard_decisions(llr)).all()
            assert 0 < np.mean(word.final_raw != coded) < 0.2, name
    changed = [np.mean(words[name][0].raw != words[name][0].final_raw) for name in ("high", "low")]
    assert changed[0] == 0
    assert changed[1] > 0.1


@pytest.mark.parametrize("distance_m", [70, 150])
@pytest.mark.slow
def test_predicted_error_probabilities_match_observed_ones(distance_m: float) -> None:
    """The first iteration knows only the channel: P(wrong) = 1 / (1 + exp |LLR|).

    The Gaussian interference model overestimates the tails, so LLRs may be too small but never too large.
    """
    predicted, wrong = [], []
    for seed in range(2):
        blocks = random_blocks(seed)
        for pair, symbols in zip(
            statistics_of(blocks, distance_m, seed), known_packets.symbols_of(blocks), strict=True
        ):
            assert pair is not None
            with one_thread():
                llr = equalise(pair, GAIN, known_packets.NOISE, np.zeros(256), np.ones(256)).llr
            predicted.append(1 / (1 + np.exp(np.abs(llr))))
            wrong.append((llr > 0) != (symbols > 0))
    p, w = np.concatenate(predicted), np.concatenate(wrong)
    edges, counted = [0, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.501], 0
    for low, high in pairwise(edges):
        here = (p >= low) & (p < high)
        if here.sum() > 500:
            counted += 1
            least, most = clopper_pearson(int(w[here].sum()), int(here.sum()), 0.999)
            assert least / 1.1 < p[here].mean() < (1.1 if low >= 0.1 else 1.6) * most, (low, high)
    assert counted >= 2


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
    signs = {name: np.asarray(1.0 - 2.0 * layer.encode(blocks[name])) for name, layer in FORM.layers.items()}
    llrs = tuple(LARGEST_LLR * word for name in signs for word in FORM.layers[name].deinterleave(signs[name]))
    before = BufferedPacket(FORM.format, llrs, tuple(statistics_of(blocks, 60, 1)), GAIN, known_packets.NOISE)
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


def of_gain(packet: list[PairStatistics | None], gain: float) -> list[PairStatistics | None]:
    scale = {"matched": gain, "cross": gain, "power": gain**2}
    return [one and replace(one, **{k: s * getattr(one, k) for k, s in scale.items()}) for one in packet]


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
    rng = np.random.default_rng(9)
    before, now = (known_packets.by_matrices(rng.normal(size=(30, 8)), *rng.normal(size=(2, 30))) for _ in range(2))
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
