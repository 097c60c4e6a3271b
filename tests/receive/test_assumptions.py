"""Packets that are read more than once: which assumptions are tried, and what is kept of them."""

from collections.abc import Sequence

import numpy as np
import pytest
from known_packets import FORM
from numpy.typing import NDArray
from scenes import SIDE

from heliograph.receive import Codeword, Pose, assumptions
from heliograph.receive.assumptions import Assumption, all_leds_sound, read_packet
from heliograph.receive.decode.gain_and_noise import GainAndNoise
from heliograph.receive.decode.observed import DecodedPacket
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.track.pose_refinement import ObservedPacket
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
    monkeypatch.setattr(assumptions, "realigned", moved)
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
    reading = assumptions.ReadPacket.of(Assumption(SEEMS_DEAD, [None]), decoded("-"))
    other = all_leds_sound(reading)
    assert other is not None
    assert (other.led_gains.values == 1).all()
    assert other.cutouts is reading.assumed.cutouts
