"""Packets that are read more than once: which assumptions are tried, and what is kept of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from known_packets import FORM
from numpy.typing import NDArray
from scenes import SIDE

from heliograph.receive import Codeword, Pose
from heliograph.receive.decode import soft_packet as assumptions
from heliograph.receive.decode.soft_packet import (
    Assumption,
    DecodeAttempt,
    all_leds_sound,
    read_packet,
    verify_first_packet,
)
from heliograph.receive.decode.turbo_equaliser import DecodedPacket, GainAndNoise
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.packet import Words
from heliograph.signal.packet import PacketFormat

Floats = NDArray[np.float64]

SEEMS_DEAD = LedGains.in_sight(np.where(np.arange(SIDE)[:, None] < 4, 0.0, np.ones((SIDE, SIDE))))
CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def decoded(read: str, form: PacketFormat = FORM) -> DecodedPacket[ObservedPacket]:
    """A packet of which codewords of the high layer are read where there is an x."""
    bits = np.zeros(8, np.uint8)
    words = tuple(Codeword("ok" if one == "x" else "crc_fail", None, bits, bits, 1, 0.0) for one in read)
    observed = ObservedPacket.of([None], Noise(1.0, 1.0), form, LedGains.sound(SIDE))
    return DecodedPacket({"high": words}, observed, np.zeros(1), np.ones(1), GainAndNoise(1.0, 1.0), None)


def moved(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Cut-outs whose poses are pulled."""
    return [None if one is None else one.moved(np.array([1.0, 0.0, 0.0, 0.0])) for one in cutouts], 1.0


@pytest.mark.parametrize(
    ("results", "open_", "best"),
    [
        (["xxx"], 0, 0),
        (["xx-", "xxx"], 0, 1),
        # no better alone, but what it reads counts
        (["xx-", "--x"], 0, 0),
        (["x--", "-x-", "--x"], 0, 0),
        (["---", "x--", "xx-"], 1, 2),
        (["---", "---", "---"], 3, 0),
    ],
)
def test_a_packet_is_read_until_nothing_is_open(
    results: list[str], open_: int, best: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(assumptions, "align_by_power", moved)
    packets, tried = [decoded(result) for result in results], list[Assumption]()

    def decode(assumed: Assumption) -> DecodedPacket[ObservedPacket]:
        tried.append(assumed)
        return packets[len(tried) - 1]

    first = Assumption(SEEMS_DEAD, [CUTOUT])
    reading = read_packet(first, decode)
    assert len(tried) == len(results)
    assert reading.open == open_
    assert reading.decoded is packets[best]
    assert reading.assumed is tried[best]
    assert tried[0] is first
    assert all(one.led_gains is SEEMS_DEAD or (one.led_gains.values == 1).all() for one in tried)
    # other poses are assumed last
    assert [one.cutouts[0] is CUTOUT for one in tried] == [True, True, False][: len(tried)]


def test_leds_that_all_shine_are_not_assumed_once_more() -> None:
    tried = list[Assumption]()

    def decode(assumed: Assumption) -> DecodedPacket[ObservedPacket]:
        tried.append(assumed)
        return decoded("-")

    read_packet(Assumption(LedGains.sound(SIDE), [None]), decode)
    assert len(tried) == 1


def test_leds_that_seem_dead_are_assumed_to_shine() -> None:
    reading = assumptions.DecodeAttempt.of(Assumption(SEEMS_DEAD, [None]), decoded("-"))
    other = all_leds_sound(reading)
    assert other is not None
    assert (other.led_gains.values == 1).all()
    assert other.cutouts is reading.assumed.cutouts


def layers(read: str) -> Words:
    """Codewords of the high, middle and low layer, of which those are read where there is an x."""
    words = decoded(read).words["high"]
    return {"high": words[:1], "middle": words[1:3], "low": words[3:]}


def shown(words: Words) -> str:
    return "".join("x" if word.status == "ok" else "-" for by in words.values() for word in by)


@pytest.mark.parametrize(
    ("by_leds", "with_known", "alone", "asked", "misled"),
    [
        # what it adds to known codewords shows that its pose is right
        ("x---", "xx--", "", ["x---"], False),
        # what asks most of the pose is left to the equaliser
        ("xxxx", "xxxx", "", ["xxx-"], False),
        # nothing added: by itself it may show something
        ("x---", "x---", "x---", ["x---", "----"], False),
        ("x---", "x---", "----", ["x---", "----"], True),
        # it lacks what the LEDs showed
        ("x--x", "xx--", "xx--", ["x---", "----"], True),
        # nothing to begin with
        ("----", "", "x---", ["----"], False),
        ("---x", "", "----", ["----"], True),
        (None, "", "----", ["----"], False),
    ],
)
def test_the_equaliser_shows_that_the_pose_of_a_new_array_is_right(
    by_leds: str | None, with_known: str, alone: str, asked: list[str], misled: bool
) -> None:
    calls = list[str]()

    def read(known: Words | None) -> DecodeAttempt:
        calls.append("----" if known is None else shown(known))
        result = layers(alone if known is None else with_known)
        return DecodeAttempt(first, decoded("-"), result)

    first = Assumption(SEEMS_DEAD, [CUTOUT])
    reading, wrong = verify_first_packet(first, None if by_leds is None else layers(by_leds), read)
    assert calls == asked
    assert wrong == misled
    assert shown(reading.words) == (alone or with_known)


@pytest.mark.parametrize(("moved_px", "align_by_power", "asked"), [(0.4, False, 1), (0.6, False, 2), (0.0, True, 2)])
def test_what_is_read_at_other_poses_proves_nothing(moved_px: float, align_by_power: bool, asked: int) -> None:
    """Found behind the edge of a post, an array 7 % too narrow was read with its poses corrected by 1.3 px."""
    calls, first = list[Words | None](), Assumption(SEEMS_DEAD, [CUTOUT])
    whole, pair = decoded("x"), ObservedPacket.of([CUTOUT], Noise(1.0, 1.0), FORM, SEEMS_DEAD).pairs[0]
    assert pair is not None
    corrected = replace(pair, error=np.array([0.0, moved_px, 0.0, 0.0]))
    there = replace(whole, observed=replace(whole.observed, pairs=[corrected]))

    def read(known: Words | None) -> DecodeAttempt:
        calls.append(known)
        return DecodeAttempt(Assumption(SEEMS_DEAD, [CUTOUT]) if align_by_power else first, there, layers("xxxx"))

    assert not verify_first_packet(first, layers("x---"), read)[1]
    assert len(calls) == asked
