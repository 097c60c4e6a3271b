"""Posts passing in front of an array, drawn as in `benchmarks.behaviour`."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.scenarios import draw_passage

from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import Packet, make_receiver


def read(number: int, until_s: float, seed: int = 1) -> tuple[int, list[Packet]]:
    """Return the number of the first packet after the post, and soft receiver packets until `until_s`."""
    settings, post, film_seed = draw_passage(np.random.default_rng((seed, number)))
    rng, receiver = (
        np.random.default_rng(film_seed),
        make_receiver(settings.signal, replace(settings.receive, receiver="soft")),
    )
    packets = list[Packet]()
    for frame, truth in simulate(settings, default_messages(settings), film_seed, None, 40):
        if frame.time_s >= until_s:
            break
        packets += receiver.push(post.draw(frame, truth, rng))
    return math.ceil(post.end_s / settings.signal.packet_s), [*packets, *receiver.finish()]


def numbers_of(packets: list[Packet]) -> list[int]:
    return [round(packet.start_time_s / 0.1) for packet in packets if packet.status == "ok"]


@pytest.mark.slow
def test_the_first_packet_in_clear_sight_is_read() -> None:
    # regression: the half-hidden header at 0.5 s resembled a tilt
    first, packets = read(1, 1.0)
    assert first in numbers_of(packets)


@pytest.mark.slow
def test_a_post_beside_the_array_pulls_no_packet_away() -> None:
    # regression: pose shifted by 1.4 px, 1.5 pitches
    _, packets = read(0, 0.21)
    assert [packet.status for packet in packets] == ["ok", "ok"]


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a track 7 % too narrow is trusted after one packet; the next is lost")
def test_an_array_found_behind_the_edge_of_a_post_is_found_again() -> None:
    # the header at 0.3 s appears 7 % too narrow; LED-by-LED decoding recovers this packet, but not the next
    first, packets = read(4, 0.505, seed=11)
    assert numbers_of(packets)[-2:] == [3, 4]
    assert first in numbers_of(packets)


@pytest.mark.slow
def test_a_packet_whose_header_is_measured_too_narrow_is_decoded_per_led() -> None:
    # the post's edge makes the header at 0.3 s appear 7 % too narrow
    _, packets = read(4, 0.405, seed=11)
    assert numbers_of(packets) == [0, 1, 3]


@pytest.mark.slow
def test_a_packet_is_decode_per_led_where_a_post_misleads_the_equaliser() -> None:
    # the equaliser fails on the second packet
    _, packets = read(23, 0.205, seed=11)
    assert [packet.status for packet in packets] == ["ok", "ok"]


@pytest.mark.slow
def test_a_packet_that_is_hidden_more_and_more_is_read_by_what_is_left() -> None:
    # regression: partly hidden LEDs next to the post were flagged late and gave overconfident wrong symbols
    _, packets = read(7, 0.31, seed=3)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok"]


@pytest.mark.slow
def test_what_a_post_hides_in_a_header_is_not_dead() -> None:
    # regression: the post is as bright as the array; LEDs learnt as dead shifted the pose by an LED
    _, packets = read(96, 0.41, seed=41)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok", "ok"]


@pytest.mark.slow
def test_a_post_brighter_than_the_array_does_not_pull_its_pose() -> None:
    # regression: pose shifted by 1.2 px before the post hid an LED, then by 20 px
    _, packets = read(6, 0.41, seed=23)
    assert [packet.status for packet in packets] == ["ok", "ok", "ok", "ok"]
