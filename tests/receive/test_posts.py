"""Posts that pass before an array, drawn as the benchmark of them draws them."""

from itertools import takewhile

import numpy as np
import pytest
from benchmarks.poles import Passage, draw, receive, whole

from heliograph.receive import Packet


def read(number: int, until_s: float, seed: int = 1) -> tuple[Passage, list[Packet]]:
    """A passage of a seed, and what the soft receiver reads of it up to a time."""
    passage = draw(np.random.default_rng((seed, number)))
    return passage, receive(passage, list(takewhile(lambda frame: frame.time_s < until_s, passage.frames())), "soft")


@pytest.mark.slow
def test_the_first_packet_in_clear_sight_is_read() -> None:
    # its header at 0.5 s was found with a half hidden, and taken for tilted
    passage, packets = read(1, 1.0)
    assert whole(passage, packets)


@pytest.mark.slow
def test_a_post_beside_the_array_pulls_no_packet_away() -> None:
    # by 1.4 px, a pitch and a half
    _, packets = read(0, 0.21)
    assert [packet.status for packet in packets] == ["ok", "ok"]


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a track 7 % too narrow is trusted after one packet; the next is lost")
def test_an_array_found_behind_the_edge_of_a_post_is_found_again() -> None:
    # its header at 0.3 s showed it 7 % too narrow; read LED by LED its packet is right all the same, the next one not
    passage, packets = read(4, 0.505, seed=11)
    assert [round(packet.start_time_s / 0.1) for packet in packets if packet.status == "ok"][-2:] == [3, 4]
    assert whole(passage, packets)


@pytest.mark.slow
def test_a_packet_whose_header_is_measured_too_narrow_is_decoded_per_led() -> None:
    # the edge of a post makes the header at 0.3 s 7 % too narrow
    _, packets = read(4, 0.405, seed=11)
    assert [round(packet.start_time_s / 0.1) for packet in packets if packet.status == "ok"] == [0, 1, 3]


@pytest.mark.slow
def test_a_packet_is_decode_per_led_where_a_post_misleads_the_equaliser() -> None:
    # the equaliser alone reads nothing of the second one
    _, packets = read(23, 0.205, seed=11)
    assert [packet.status for packet in packets] == ["ok", "ok"]


@pytest.mark.slow
def test_a_packet_that_is_hidden_more_and_more_is_read_by_what_is_left() -> None:
    # LEDs beside the post are hidden in part, and are noticed late: wrong symbols were certain
    _, packets = read(7, 0.31, seed=3)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok"]


@pytest.mark.slow
def test_what_a_post_hides_in_a_header_is_not_dead() -> None:
    # the post is as bright as the array; LEDs learnt as dead stayed so for the packet, and led the pose a LED astray
    _, packets = read(96, 0.41, seed=41)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok", "ok"]


@pytest.mark.slow
def test_a_post_brighter_than_the_array_does_not_pull_its_pose() -> None:
    # by 1.2 px before it hid an LED, then by 20
    _, packets = read(6, 0.41, seed=23)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok", "ok"]
