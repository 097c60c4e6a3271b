"""Error counter: exact counts, assigned to the correct packet and distance."""

from dataclasses import replace

import pytest
from link_packets import LAYERS, perfect, small, sums, tampered, watch

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages
from heliograph.measure.counts import pooled
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.receive.decode.codeword import ERASED

SETTINGS = small()
K = 1024


def counter_of(settings: LinkSettings = SETTINGS) -> ErrorCounter:
    return ErrorCounter(settings, default_messages(settings))


def test_perfect_packets_have_no_error() -> None:
    counter = counter_of()
    watch(counter, range(300))
    for number in range(3):
        counter.received(perfect(SETTINGS, number))
    assert list(sums(counter)) == [
        ("high", 3 * K, 0, 0, 3, 0, 0),
        ("middle", 6 * K, 0, 0, 6, 0, 0),
        ("low", 3 * K, 0, 0, 3, 0, 0),
    ]
    assert counter.false_codewords == 0


def test_dropped_frames_count_as_filmed() -> None:
    counter = counter_of()
    for first, last in ((0, 40), (44, 99), (102, 200)):
        watch(counter, range(first, last))
    # two packets were sent and filmed, both with lost frames
    assert next(sums(counter)) == ("high", 0, 0, 0, 2, 2, 2)


def test_turned_bits_are_counted_one_by_one() -> None:
    counter = counter_of()
    watch(counter, range(200))
    packet = tampered(perfect(SETTINGS, 0), "middle", 1, [0, 5, 1023], raw=[7, 8], status="crc_fail", block=None)
    counter.received(tampered(packet, "low", 0, [3], status="crc_fail", block=None))
    counter.received(perfect(SETTINGS, 1))
    assert list(sums(counter)) == [
        ("high", 2 * K, 0, 0, 2, 0, 0),
        ("middle", 4 * K, 3, 2, 4, 1, 0),
        ("low", 2 * K, 1, 0, 2, 1, 0),
    ]
    assert counter.false_codewords == 0


def test_a_failed_codeword_is_an_error_even_with_all_bits_right() -> None:
    counter = counter_of()
    watch(counter, range(100))
    counter.received(tampered(perfect(SETTINGS, 0), "high", 0, [], status="crc_fail", block=None))
    assert next(sums(counter)) == ("high", K, 0, 0, 1, 1, 0)


def test_wrong_bits_that_pass_for_right_are_a_false_codeword() -> None:
    counter = counter_of()
    watch(counter, range(100))
    counter.received(tampered(perfect(SETTINGS, 0), "high", 0, [9]))
    assert counter.false_codewords == 1
    assert next(sums(counter)) == ("high", K, 1, 0, 1, 1, 0)


def test_erased_bits_are_no_raw_bits() -> None:
    counter = counter_of()
    watch(counter, range(100))
    packet = perfect(SETTINGS, 0)
    word = packet.layers["high"][0]
    raw = word.raw.copy()
    raw[:100] = ERASED
    raw[100] ^= 1
    counter.received(replace(packet, layers={**packet.layers, "high": (replace(word, raw=raw),)}))
    high = counter.total()["high"]
    assert (high.raw_bits, high.raw_errors) == (raw.size - 100, 1)
    # a single equalisation has no other raw bits
    assert (high.final_raw_bits, high.final_raw_errors) == (raw.size - 100, 1)


def test_raw_bits_of_the_last_equalisation_are_counted_apart() -> None:
    counter = counter_of()
    watch(counter, range(100))
    packet = perfect(SETTINGS, 0)
    word = packet.layers["high"][0]
    first, last = word.raw.copy(), word.raw.copy()
    first[:7] ^= 1
    last[:2] ^= 1
    last[5:8] = ERASED
    words = (replace(word, raw=first, final_raw=last),)
    counter.received(replace(packet, layers={**packet.layers, "high": words}))
    high = counter.total()["high"]
    assert (high.raw_bits, high.raw_errors, high.raw_squares) == (first.size, 7, 49)
    assert (high.final_raw_bits, high.final_raw_errors, high.final_raw_squares) == (first.size - 3, 2, 4)


def test_missed_packets_count_as_codeword_errors_not_as_bits() -> None:
    counter = counter_of()
    watch(counter, range(300))
    counter.received(perfect(SETTINGS, 1))
    assert list(sums(counter)) == [
        ("high", K, 0, 0, 3, 2, 2),
        ("middle", 2 * K, 0, 0, 6, 4, 4),
        ("low", K, 0, 0, 3, 2, 2),
    ]
    assert next(sums(counter)) == ("high", K, 0, 0, 3, 2, 2), "asking twice changes nothing"


def test_a_packet_may_still_come_after_it_was_reported_missed() -> None:
    counter = counter_of()
    watch(counter, range(100))
    assert next(sums(counter))[4:] == (1, 1, 1)
    counter.received(perfect(SETTINGS, 0))
    assert next(sums(counter))[4:] == (1, 0, 0)
    assert counter.false_codewords == 0


def test_packets_not_filmed_whole_or_out_of_view_are_not_missed() -> None:
    counter = counter_of()
    watch(counter, range(50, 250), visible=lambda frame: (frame != 150,))
    assert counter.bins() == {}


def test_a_packet_filmed_in_part_is_left_out() -> None:
    """Packets cut off by the film's ends do not count, nor fall into the 0 m bin."""
    counter = counter_of()
    watch(counter, range(70, 100), distances=(62.0,))
    counter.received(perfect(SETTINGS, 0))
    assert counter.bins() == {}


def test_a_packet_handed_out_early_counts_once_it_is_filmed_whole() -> None:
    """A lost array emits a packet before the packet's last frame."""
    counter = counter_of()
    watch(counter, range(70), distances=(62.0,))
    counter.received(perfect(SETTINGS, 0))
    assert counter.bins() == {}
    watch(counter, range(70, 100), distances=(62.0,))
    assert list(counter.bins()) == [60.0]
    assert counter.total()["high"].codewords == 1


@pytest.mark.parametrize("what", ["identity", "early", "late"])
def test_a_packet_that_was_not_sent_is_false(what: str) -> None:
    counter = counter_of()
    watch(counter, range(200))
    packet = perfect(SETTINGS, 1)
    if what == "identity":
        packet = replace(packet, identity=5)
    elif what == "early":
        packet = replace(packet, start_time_s=-0.9)
    else:
        packet = replace(packet, start_time_s=7.0)
    before = list(sums(counter))
    counter.received(packet)
    assert (counter.false_packets, counter.false_codewords, counter.duplicates) == (1, 4, 0)
    assert list(sums(counter)) == before, "a false packet is no packet sent"


def test_a_false_packet_without_a_right_codeword_is_false_all_the_same() -> None:
    counter = counter_of()
    watch(counter, range(200))
    packet = replace(perfect(SETTINGS, 1), identity=5)
    for layer, word in (("high", 0), ("middle", 0), ("middle", 1), ("low", 0)):
        packet = tampered(packet, layer, word, [1], status="crc_fail", block=None)
    counter.received(packet)
    assert (counter.false_packets, counter.false_codewords) == (1, 0)


def test_the_same_packet_again_is_a_duplicate_and_nothing_false() -> None:
    counter = counter_of()
    watch(counter, range(200))
    counter.received(perfect(SETTINGS, 1))
    before = list(sums(counter))
    counter.received(perfect(SETTINGS, 1))
    assert (counter.duplicates, counter.false_packets, counter.false_codewords) == (1, 0, 0)
    assert list(sums(counter)) == before


@pytest.mark.parametrize("better_first", [True, False])
def test_of_duplicates_the_better_counts(better_first: bool) -> None:
    counter = counter_of()
    watch(counter, range(100))
    better = tampered(perfect(SETTINGS, 0), "low", 0, [3], status="crc_fail", block=None)
    worse = tampered(better, "high", 0, [5, 6], status="crc_fail", block=None)
    for packet in (better, worse) if better_first else (worse, better):
        counter.received(packet)
    assert (counter.duplicates, counter.false_codewords) == (1, 0)
    assert [row[1:6:2] for row in sums(counter)] == [(K, 0, 0), (2 * K, 0, 0), (K, 0, 1)]
    assert [row[2] for row in sums(counter)] == [0, 0, 1]


def test_a_duplicate_with_false_content_is_false() -> None:
    counter = counter_of()
    watch(counter, range(100))
    counter.received(perfect(SETTINGS, 0))
    counter.received(tampered(perfect(SETTINGS, 0), "high", 0, [9]))
    assert (counter.duplicates, counter.false_packets, counter.false_codewords) == (1, 0, 1)
    assert next(sums(counter)) == ("high", K, 0, 0, 1, 0, 0), "the first is the better"


def test_a_packet_of_another_moment_has_wrong_content() -> None:
    """The array and the time are correct, but the packet was sent at another time."""
    counter = counter_of()
    watch(counter, range(200))
    counter.received(replace(perfect(SETTINGS, 1), start_time_s=0.0))
    assert (counter.false_packets, counter.false_codewords) == (0, 4)


def test_errors_go_to_the_bin_of_the_packets_middle() -> None:
    counter = counter_of()
    # 80 m at the start, 10 m nearer per packet: packet centres at 75, 65 and 55 m, less one frame
    watch(counter, range(300), distances=lambda frame: (80.0 - frame * 0.1 - 0.05,))
    counter.received(perfect(SETTINGS, 0))
    counter.received(tampered(perfect(SETTINGS, 1), "high", 0, [1, 2], status="crc_fail", block=None))
    bins = counter.bins()
    assert list(bins) == [50.0, 60.0, 70.0]
    assert [e["high"].bit_errors for e in bins.values()] == [0, 2, 0]
    assert [e["high"].missed for e in bins.values()] == [1, 0, 0]
    report = counter.report()
    assert [(row["from_m"], row["to_m"]) for row in report] == [(z, z + BIN_M) for z in bins]
    assert report[1]["high"] == {
        "bits": K, "errors": 2, "raw_bits": 3 * K, "raw_errors": 0, "codewords": 1, "codeword_errors": 1, "missed": 0
    }  # fmt: skip
    assert set(report[0]) == {"from_m", "to_m", *LAYERS}
    assert pooled(bins.values())["high"].codewords == 3


def test_an_array_that_starts_late_sends_nothing_before() -> None:
    settings = small("channel.arrays.0.start_s=0.05")
    counter = counter_of(settings)
    watch(counter, range(150))
    counter.received(perfect(settings, 0))
    assert next(sums(counter)) == ("high", K, 0, 0, 1, 0, 0)


def test_two_arrays_are_counted_apart() -> None:
    settings = load_settings("two-arrays")
    counter = counter_of(settings)
    watch(counter, range(240), distances=(52.0, 33.0), visible=(True, True))
    counter.received(perfect(settings, 0, array=0))
    counter.received(perfect(settings, 0, array=1))
    counter.received(tampered(perfect(settings, 1, array=1), "low", 0, [4], status="crc_fail", block=None))
    bins = counter.bins()
    assert list(bins) == [30.0, 50.0]
    assert (bins[30.0]["low"].codewords, bins[30.0]["low"].codeword_errors) == (2, 1)
    assert (bins[50.0]["low"].codewords, bins[50.0]["low"].missed) == (2, 1)
    assert counter.false_codewords == 0


@pytest.mark.parametrize("ppm", [-10_000, 10_000])
def test_the_cameras_clock_is_not_the_arrays(ppm: int) -> None:
    """A 1 % clock error exceeds half a packet after a few seconds."""
    settings = small(f"channel.camera.clock_ppm={ppm}", "channel.duration_s=10")
    counter = counter_of(settings)
    watch(counter, range(8000, 9000))
    sent = perfect(settings, 85)
    counter.received(replace(sent, start_time_s=sent.start_time_s / (1 + ppm * 1e-6)))
    assert counter.false_codewords == 0
    assert counter.total()["high"].codeword_errors == 9


def test_a_packet_read_in_another_format_is_wrong_not_a_fault() -> None:
    sent = small("transmit.formats=[{high='9/10'}]")
    counter = ErrorCounter(sent, default_messages(sent))
    watch(counter, range(100))
    counter.received(perfect(small(), 0))
    total = counter.total()
    assert (total["high"].codewords, total["high"].codeword_errors, total["high"].bits) == (1, 1, 0)
    assert counter.false_codewords == 1
    # the formats differ only in the layers sent
    assert total["low"].codeword_errors == 0


@pytest.mark.parametrize("packet", [3, 6])
def test_the_first_frame_of_a_packet_is_not_taken_for_the_last_of_the_one_before(packet: int) -> None:
    """Rounding puts the frame slightly early. The packet hidden only in this frame is not missed; the others are."""
    first = 100 * packet
    # 0.3 / 0.1 is 2.9999999999999996
    assert first * 1e-3 / 0.1 < packet
    counter = counter_of(small("channel.duration_s=1"))
    # each packet has a different distance
    watch(counter, range(1000), lambda frame: (20.0 + 10 * (frame // 100),), lambda frame: (frame != first,))
    missed = {near_m: errors["high"].missed for near_m, errors in counter.bins().items()}
    assert missed == {20.0 + 10 * k: 1 for k in range(10) if k != packet}
