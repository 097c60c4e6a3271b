"""Iterative equalisation, interference cancellation and turbo decoding for known channels."""

from dataclasses import replace
from itertools import pairwise, product
from typing import get_args

import numpy as np
import pytest
from known_packets import (
    FORM,
    GAIN,
    IDENTITY,
    NOISE,
    SHAPE,
    KnownPoses,
    T,
    by_matrices,
    combined_statistics_of,
    decoded,
    equalised,
    random_blocks,
    right,
    statistics_of,
    symbols_of,
)
from observe_oracle import pair_model
from render_oracle import blur_matrix
from scenes import SIDE, pitch_at

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.measure.statistics import clopper_pearson
from heliograph.receive import Pose
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.turbo_equaliser import update_channel
from heliograph.receive.equalise.lmmse import equalise
from heliograph.receive.events import EqualiseEvent
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.packet import ERASED, hard_decisions
from heliograph.receive.settings import Feedback
from heliograph.receive.sync.combine import combine_pair


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
    assert [(event.identity, event.iteration) for event in events] == [(IDENTITY, k) for k in range(3)]


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
    words = decoded(packet, channel=(factor * GAIN, NOISE), buffer=buffer, observe=events.append)
    # the low layer fails, so the buffer keeps the packet, in units of the gain
    assert right(words, blocks) == [True, True, True, False]
    kept = buffer[-1].same_packet(FORM.format, [llr for layer in events[0].llr.values() for llr in layer])
    assert kept is not None
    gains, noises = zip(*packet.channels, (kept.gain, kept.noise), strict=True)
    first, last = (abs(gain / GAIN - 1) for gain in gains)
    assert last <= first
    assert last < 0.4 * abs(factor - 1)
    assert set(noises) == {NOISE}


def against_its_symbols(symbols: Floats, rng: np.random.Generator) -> PairStatistics:
    """Return statistics at 100 m with 0.4 px motion, in the direction that best resembles the symbols."""
    x, y = (float(v) for v in rng.uniform(12, 13, 2))
    pose = Pose(x, y, pitch_at(100), 0.0, 0.505)
    ways = [pose.moved(dx, dy) for dx, dy in ((0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4))]
    a = blur_matrix(pose, SIDE, (0, 0), SHAPE)
    models = [pair_model(a, blur_matrix(moved, SIDE, (0, 0), SHAPE), T) for moved in ways]
    b, o = max(models, key=lambda model: float(symbols @ model[0].T @ model[1]))
    return by_matrices(b, GAIN * (b @ symbols + o) + rng.normal(0, NOISE**0.5, len(b)), o)


def test_combined_frames_are_decoded() -> None:
    """Each observation contains symbol products and leakage from adjacent pairs or the header."""
    combination = combine_pair(0.5 + np.arange(-2.0, 5.0), 1.0, (0, 1, 2, 3))
    assert combination is not None
    blocks = random_blocks(2)
    assert right(decoded(combined_statistics_of(blocks, 80, combination)), blocks) == [True] * 4


@pytest.mark.slow
def test_motion_that_resembles_symbols_does_not_change_the_gain() -> None:
    blocks, rng = random_blocks(0), np.random.default_rng(7)
    packet = KnownPoses([against_its_symbols(symbols, rng) for symbols in symbols_of(blocks)])
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
        f"array {IDENTITY}: pair 7 is left out: the equaliser's matrix is not positive definite"
    }


@pytest.mark.parametrize(("distance_m", "moves", "count"), [(160, 0, 1), (160, 2, 3), (100, 0, 0)])
@pytest.mark.slow
def test_poses_are_refined_while_codewords_may_be_decoded(distance_m: float, moves: int, count: int) -> None:
    """At 160 m only the high layer is decodable: refine once, or until poses converge. At 100 m all layers are."""
    packet = KnownPoses(statistics_of(random_blocks(0), distance_m), moves)
    decoded(packet)
    assert len(packet.known) == count


def test_codewords_of_another_array_are_rejected() -> None:
    words = decoded(statistics_of(random_blocks(0), 60), identity=IDENTITY + 1)
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
        for pair, symbols in zip(statistics_of(blocks, distance_m, seed), symbols_of(blocks), strict=True):
            assert pair is not None
            with one_thread():
                llr = equalise(pair, GAIN, NOISE, np.zeros(256), np.ones(256)).llr
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
