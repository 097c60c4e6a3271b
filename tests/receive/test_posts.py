"""Posts passing in front of an array, drawn as in `benchmarks.behaviour`."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.scenarios import draw_passage
from scenes import statuses

from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import Packet, make_receiver


@cache
def read(number: int, until_s: float, seed: int = 1) -> tuple[int, list[Packet]]:
    """Return the number of the first packet after the post, and soft receiver packets until `until_s`."""
    settings, post, film_seed = draw_passage(np.random.default_rng((seed, number)))
    rng = np.random.default_rng(film_seed)
    receiver = make_receiver(settings.signal, replace(settings.receive, receiver="soft"))
    packets = list[Packet]()
    for frame, truth in simulate(settings, default_messages(settings), film_seed, None, 40):
        if frame.time_s >= until_s:
            break
        packets += receiver.push(post.draw(frame, truth, rng))
    return math.ceil(post.end_s / settings.signal.packet_s), [*packets, *receiver.finish()]


def numbers_of(packets: list[Packet]) -> list[int]:
    return [round(packet.start_time_s / 0.1) for packet in packets if packet.status == "ok"]


@pytest.mark.slow
def test_first_packet_after_a_post_is_read() -> None:
    # regression: the half-hidden header at 0.5 s resembled a tilt
    first, packets = read(1, 0.71)
    assert first in numbers_of(packets)


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a track 7 % too narrow is trusted after one packet; the next is lost")
def test_array_detected_at_the_edge_of_a_post_is_read_again() -> None:
    # the header at 0.3 s appears 7 % too narrow; LED-by-LED decoding recovers this packet, but not the next
    first, packets = read(4, 0.505, seed=11)
    assert numbers_of(packets)[-2:] == [3, 4]
    assert first in numbers_of(packets)


@pytest.mark.slow
def test_packet_with_a_header_measured_too_narrow_is_decoded_per_led() -> None:
    # the post's edge makes the header at 0.3 s appear 7 % too narrow
    _, packets = read(4, 0.505, seed=11)
    assert numbers_of(packets)[:3] == [0, 1, 3]


@pytest.mark.parametrize(("number", "seed", "count"), [
    # regression: pose shifted by 1.4 px, 1.5 pitches
    (0, 1, 2),
    # regression: partly hidden LEDs next to the post were flagged late and gave overconfident wrong symbols
    (7, 3, 3),
    # the equaliser fails on the second packet; LED-by-LED decoding recovers this packet
    (23, 11, 2),
    # regression: pose shifted by 1.2 px before a post brighter than the array hid an LED, then by 20 px
    (6, 23, 4),
    # regression: the post is as bright as the array; LEDs learnt as dead shifted the pose by an LED
    (96, 41, 4),
])  # fmt: skip
@pytest.mark.slow
def test_packets_beside_and_behind_a_post_are_read(number: int, seed: int, count: int) -> None:
    _, packets = read(number, 0.1 * count + 0.01, seed=seed)
    assert statuses(packets) == ["ok"] * count
