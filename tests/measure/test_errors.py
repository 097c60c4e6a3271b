"""Error counter: exact counts, assigned to the correct packet and distance."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from link_packets import LAYERS, perfect, sums, tampered, watch
from scenes import link

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages
from heliograph.measure.counts import BUDGET_S, pooled
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.receive.packet import ERASED, Packet

SETTINGS = link()
K = 1024


def counter_of(settings: LinkSettings = SETTINGS, frames: range = range(0)) -> ErrorCounter:
    counter = ErrorCounter(settings, default_messages(settings))
    watch(counter, frames)
    return counter


def test_dropped_frames_count_as_filmed() -> None:
    counter = counter_of()
    for first, last in ((0, 40), (44, 99), (102, 200)):
        watch(counter, range(first, last))
    assert next(sums(counter)) == ("high", 0, 0, 0, 2, 2, 2)  # two packets were sent and filmed, both with lost frames


FAILED = {"status": "crc_fail", "block": None}


def packet(number: int, *changes: tuple[str, int, list[int], dict[str, Any]], **to: Any) -> Packet:
    """Return a packet with wrong bits in codewords, by layer and number, and changed fields."""
    changed = perfect(SETTINGS, number)
    for layer, word, bits, fields in changes:
        changed = tampered(changed, layer, word, bits, **fields)
    return replace(changed, **to)


BETTER = packet(0, ("low", 0, [3], FAILED))
WORSE = packet(0, ("low", 0, [3], FAILED), ("high", 0, [5, 6], FAILED))
READ_ONE_OF_TWO: list[tuple[int, ...]] = [(K, 0, 2, 1, 1), (2 * K, 0, 4, 2, 2), (K, 0, 2, 1, 1)]
NONE_OF_TWO: list[tuple[int, ...]] = [(0, 0, 2, 2, 2), (0, 0, 4, 4, 4), (0, 0, 2, 2, 2)]
BETTER_READ: list[tuple[int, ...]] = [(K, 0, 1, 0, 0), (2 * K, 0, 2, 0, 0), (K, 1, 1, 1, 0)]
CASES: dict[str, tuple[int, list[Packet], list[tuple[int, ...]], tuple[int, int, int]]] = {
    "all packets right": (
        300, [packet(0), packet(1), packet(2)],
        [(3 * K, 0, 3, 0, 0), (6 * K, 0, 6, 0, 0), (3 * K, 0, 3, 0, 0)], (0, 0, 0),
    ),
    "wrong bits": (
        200, [packet(0, ("middle", 1, [0, 5, 1023], FAILED), ("low", 0, [3], FAILED)), packet(1)],
        [(2 * K, 0, 2, 0, 0), (4 * K, 3, 4, 1, 0), (2 * K, 1, 2, 1, 0)], (0, 0, 0),
    ),
    "failed with right bits": (
        100, [packet(0, ("high", 0, [], FAILED))], [(K, 0, 1, 1, 0), (2 * K, 0, 2, 0, 0), (K, 0, 1, 0, 0)], (0, 0, 0)
    ),
    "accepted with wrong bits": (
        100, [packet(0, ("high", 0, [9], {}))], [(K, 1, 1, 1, 0), (2 * K, 0, 2, 0, 0), (K, 0, 1, 0, 0)], (1, 0, 0)
    ),
    "missed": (300, [packet(1)], [(K, 0, 3, 2, 2), (2 * K, 0, 6, 4, 4), (K, 0, 3, 2, 2)], (0, 0, 0)),
    "other array": (200, [packet(1, identity=5)], NONE_OF_TWO, (4, 1, 0)),
    "before the film": (200, [packet(1, start_time_s=-0.9)], NONE_OF_TWO, (4, 1, 0)),
    "after the film": (200, [packet(1, start_time_s=7.0)], NONE_OF_TWO, (4, 1, 0)),
    "repeated": (200, [packet(1), packet(1)], READ_ONE_OF_TWO, (0, 0, 1)),
    "better packet first": (100, [BETTER, WORSE], BETTER_READ, (0, 0, 1)),
    "better packet second": (100, [WORSE, BETTER], BETTER_READ, (0, 0, 1)),
    "repeated with false content": (
        100, [packet(0), packet(0, ("high", 0, [9], {}))],
        [(K, 0, 1, 0, 0), (2 * K, 0, 2, 0, 0), (K, 0, 1, 0, 0)], (1, 0, 1),
    ),
}  # fmt: skip
"""Frames; packets; bits, bit errors, codewords, wrong and missed codewords by layer; false codewords and packets, and
duplicates."""


@pytest.mark.parametrize(("frames", "packets", "rows", "false"), CASES.values(), ids=list(CASES))
def test_packets_are_counted(
    frames: int, packets: list[Packet], rows: list[tuple[int, ...]], false: tuple[int, int, int]
) -> None:
    counter = counter_of(frames=range(frames))
    for received in packets:
        counter.received(received)
    for _ in range(2):  # a repeated request changes nothing
        assert [(*row[1:3], *row[4:]) for row in sums(counter)] == rows
        assert [row[3] for row in sums(counter)] == [0, 0, 0]
    assert (counter.false_codewords, counter.false_packets, counter.duplicates) == false


def test_raw_bits_of_both_equalisations_are_counted_without_erasures() -> None:
    received = packet(0)
    word = received.layers["high"][0]
    first, last = word.raw.copy(), word.raw.copy()
    first[:7] ^= 1
    first[100:110] = ERASED
    last[:2] ^= 1
    last[5:8] = ERASED
    known = first.size - 10
    # LLRs of the last equalisation; a receiver may give none
    llrs = np.where(last == ERASED, 0.0, 1.0 - 2.0 * (last == 1)).astype(np.float32)
    for llr, expected in ((np.zeros(0, np.float32), (known, 7, 49)), (llrs, (first.size - 3, 2, 4))):
        counter = counter_of(frames=range(100))
        words = (replace(word, raw=first, llr=llr),)
        counter.received(replace(received, layers={**received.layers, "high": words}))
        high = counter.total()["high"]
        assert (high.raw_bits, high.raw_errors, high.raw_squares) == (known, 7, 49)
        assert (high.final_raw_bits, high.final_raw_errors, high.final_raw_squares) == expected


def test_late_packet_is_no_longer_missed() -> None:
    counter = counter_of(frames=range(100))
    for missed in (1, 0):
        assert next(sums(counter))[4:] == (1, missed, missed)
        counter.received(perfect(SETTINGS, 0))
    assert counter.false_codewords == 0


def test_packets_partly_filmed_hidden_or_before_the_start_are_not_missed() -> None:
    counter = counter_of()
    watch(counter, range(50, 250), visible=lambda frame: (frame != 150,))
    assert counter.bins() == {}
    settings = link("channel.arrays.0.start_s=0.05")
    counter = counter_of(settings, range(150))
    counter.received(perfect(settings, 0))
    assert next(sums(counter)) == ("high", K, 0, 0, 1, 0, 0)


def test_early_packet_counts_once_its_last_frame_is_known() -> None:
    """A lost array emits a packet before the packet's last frame."""
    counter = counter_of()
    watch(counter, range(70), distances=(62.0,))
    counter.received(perfect(SETTINGS, 0))
    assert counter.bins() == {}
    watch(counter, range(70, 100), distances=(62.0,))
    assert (list(counter.bins()), counter.total()["high"].codewords) == ([60.0], 1)


def test_packet_of_another_time_has_wrong_content() -> None:
    counter = counter_of(frames=range(200))
    counter.received(replace(perfect(SETTINGS, 1), start_time_s=0.0))
    assert (counter.false_packets, counter.false_codewords) == (0, 4)


def test_errors_are_binned_by_the_middle_of_the_packet() -> None:
    counter = counter_of()
    # 80 m at the start, 10 m nearer per packet: packet centres at 75, 65 and 55 m, less one frame
    watch(counter, range(300), distances=lambda frame: (80.0 - frame * 0.1 - 0.05,))
    counter.received(perfect(SETTINGS, 0))
    counter.received(tampered(perfect(SETTINGS, 1), "high", 0, [1, 2], status="crc_fail", block=None))
    bins = counter.bins()
    assert (list(bins), [e["high"].bit_errors for e in bins.values()]) == ([50.0, 60.0, 70.0], [0, 2, 0])
    assert [e["high"].missed for e in bins.values()] == [1, 0, 0]
    report = counter.report()
    assert [(row["from_m"], row["to_m"]) for row in report] == [(z, z + BIN_M) for z in bins]
    assert report[1]["high"] == {
        "bits": K, "errors": 2, "raw_bits": 3 * K, "raw_errors": 0, "codewords": 1, "codeword_errors": 1, "missed": 0
    }  # fmt: skip
    assert (set(report[0]), pooled(bins.values())["high"].codewords) == ({"from_m", "to_m", *LAYERS}, 3)


def test_two_arrays_are_counted_separately() -> None:
    settings = load_settings("two-arrays")
    counter = counter_of(settings)
    watch(counter, range(240), distances=(52.0, 33.0), visible=(True, True))
    counter.received(perfect(settings, 0, array=0))
    counter.received(perfect(settings, 0, array=1))
    counter.received(tampered(perfect(settings, 1, array=1), "low", 0, [4], status="crc_fail", block=None))
    bins = counter.bins()
    assert (list(bins), bins[30.0]["low"].codewords, bins[30.0]["low"].codeword_errors) == ([30.0, 50.0], 2, 1)
    assert (bins[50.0]["low"].codewords, bins[50.0]["low"].missed, counter.false_codewords) == (2, 1, 0)


@pytest.mark.parametrize("ppm", [-10_000, 10_000])
def test_camera_clock_differs_from_the_array_clock(ppm: int) -> None:
    """A 1 % clock error exceeds half a packet after a few seconds."""
    settings = link(f"channel.camera.clock_ppm={ppm}", "channel.duration_s=10")
    counter, sent = counter_of(settings, range(8000, 9000)), perfect(settings, 85)
    counter.received(replace(sent, start_time_s=sent.start_time_s / (1 + ppm * 1e-6)))
    assert (counter.false_codewords, counter.total()["high"].codeword_errors) == (0, 9)


def test_packet_in_another_format_is_wrong() -> None:
    sent = link("transmit.formats=[{high='9/10'}]")
    counter = ErrorCounter(sent, default_messages(sent))
    watch(counter, range(100))
    counter.received(perfect(link(), 0))
    total = counter.total()
    assert (total["high"].codewords, total["high"].codeword_errors, total["high"].bits) == (1, 1, 0)
    assert counter.false_codewords == 1
    assert total["low"].codeword_errors == 0  # the formats differ only in the layers sent


@pytest.mark.parametrize("number", [3, 6])
def test_first_frame_of_a_packet_belongs_to_this_packet(number: int) -> None:
    """Rounding puts the frame slightly early. The packet hidden only in this frame is not missed; the others are."""
    first = 100 * number
    assert first * 1e-3 / 0.1 < number  # 0.3 / 0.1 is 2.9999999999999996
    counter = counter_of(link("channel.duration_s=1"))
    # each packet has a different distance
    watch(counter, range(1000), lambda frame: (20.0 + 10 * (frame // 100),), lambda frame: (frame != first,))
    missed = {near_m: errors["high"].missed for near_m, errors in counter.bins().items()}
    assert missed == {20.0 + 10 * k: 1 for k in range(10) if k != number}


def watch_places(counter: ErrorCounter, frames: range, *places: tuple[float, float, float]) -> None:
    """Pass frame truths with places (x, y, pitch) in px to the counter."""
    for frame in frames:
        counter.saw(frame * 1e-3, [50.0] * len(places), [True] * len(places), places)


PLACE = (83.0, 64.0, 1.2)  # 5 px from the pose of `perfect`; half of the array is 9.6 px


def test_times_of_packets_start_at_the_first_led_edge_and_end_with_the_exposure() -> None:
    """The array appears in frame 20; packets 1 and 2 come out 3 and 40 frames after their last frames."""
    counter, exposure_s = counter_of(), SETTINGS.channel.camera.exposure_s
    watch(counter, range(203), visible=lambda frame: (frame >= 20,))
    counter.received(packet(1))
    watch(counter, range(203, 340))
    counter.received(packet(2))
    found = counter.outcomes()
    late = [round((after + exposure_s) * 1e4) for after in (0.102, 0.139)]
    assert found["latency"] == {str(ticks): 1 for ticks in late}
    assert (found["arrays"], found["acquisition"]) == (1, {str(round((0.182 + exposure_s) * 1e4)): 1})


def test_only_correct_codewords_in_time_and_once_are_goodput() -> None:
    sizes = {name: 8 * sum(len(w.block.payload) for w in ws if w.block) for name, ws in packet(0).layers.items()}
    in_time, late = 99 + round(1e3 * BUDGET_S), 101 + round(1e3 * BUDGET_S)
    for frames, bits in ((in_time, sum(sizes.values()) - sizes["high"]), (late, 0)):
        counter = counter_of(frames=range(frames))
        counter.received(packet(0, ("high", 0, [9], {})))  # accepted with a wrong bit
        counter.received(packet(0, ("high", 0, [9], {})))
        assert counter.outcomes()["timely_bits"] == bits


def test_packet_without_a_correct_codeword_has_no_latency() -> None:
    counter = counter_of(frames=range(100))
    wrong = [(layer, k, [1], FAILED) for layer, words in packet(0).layers.items() for k in range(len(words))]
    counter.received(packet(0, *wrong))
    found = counter.outcomes()
    assert (found["latency"], found["acquisition"], found["arrays"]) == ({}, {}, 1)


def test_positions_are_compared_in_the_middle_and_within_half_an_array() -> None:
    counter = counter_of()
    watch_places(counter, range(40), (0.0, 0.0, 1.2))
    watch_places(counter, range(40, 200), PLACE)
    counter.received(packet(0))
    pose = packet(1).pose
    counter.received(packet(1, pose=replace(pose, x=PLACE[0] - 10.0, y=PLACE[1])))
    found = counter.outcomes()
    assert (found["located"], found["misplaced"], found["position_px"]) == (1, 1, pytest.approx(5.0))
    # without places nothing is known
    counter = counter_of(frames=range(100))
    counter.received(packet(0))
    assert (counter.outcomes()["located"], counter.outcomes()["misplaced"]) == (0, 0)


def test_detections_of_no_array_are_false() -> None:
    counter = counter_of(frames=range(200))
    for hypotheses, false in (([(0, 0.1)], 0), ([(9, 0.1), (0, 0.1)], 0), ([(9, 0.1)], 1), ([(0, 7.0), (3, 0.0)], 2)):
        counter.found(hypotheses)
        assert counter.outcomes()["false_detections"] == false
    assert counter.detected() == (2, 1)


def test_acquisition_is_timed_for_each_array() -> None:
    settings = load_settings("two-arrays")
    counter = counter_of(settings)
    watch(counter, range(300), distances=(52.0, 33.0), visible=(True, True))
    counter.received(perfect(settings, 1, array=1))
    found = counter.outcomes()
    assert (found["arrays"], sum(found["acquisition"].values())) == (2, 1)
