"""Repeated packet decoding under different assumptions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from known_packets import FORM
from numpy.typing import NDArray
from scenes import SIDE

from heliograph.receive import Codeword, Pose
from heliograph.receive.decode import soft_packet as assumptions
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.soft_packet import count_open, read_packet
from heliograph.receive.decode.turbo_equaliser import TurboEqualiser
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.packet import Words

Floats = NDArray[np.float64]

SEEMS_DEAD = LedGains(np.where(np.arange(SIDE)[:, None] < 4, 0.0, np.ones((SIDE, SIDE))), np.ones((SIDE, SIDE)))
CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def words(read: str) -> Words:
    """Return high layer codewords; x marks decoded codewords."""
    bits = np.zeros(8, np.uint8)
    return {"high": tuple(Codeword("ok" if one == "x" else "crc_fail", None, bits, bits, 1, 0.0) for one in read)}


def decoded(read: str, led_gains: LedGains = SEEMS_DEAD) -> TurboEqualiser:
    """Return an equalised packet with some decoded codewords."""
    observed = ObservedPacket([None], Noise(1.0, 1.0), FORM, led_gains)
    packet = TurboEqualiser(observed, 1.0, 1.0, 0, Decoding(), None, 255.0)
    packet.words = words(read)
    return packet


def moved(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Return cut-outs with shifted poses."""
    return [None if one is None else one.moved(np.array([1.0, 0.0, 0.0, 0.0])) for one in cutouts], 1.0


@pytest.mark.parametrize(
    ("results", "open_", "best"),
    [
        (["xxx"], 0, 0),
        (["xx-", "xxx"], 0, 1),
        # no better individually, but the decoded codewords count
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
    packets, tried = [decoded(result) for result in results], list[tuple[Sequence[Cutout | None], LedGains]]()

    def equalise(cutouts: Sequence[Cutout | None], led_gains: LedGains, known: Words | None) -> TurboEqualiser:
        assert known is None
        tried.append((cutouts, led_gains))
        return packets[len(tried) - 1]

    reading = read_packet([CUTOUT], SEEMS_DEAD, FORM, None, equalise)
    assert len(tried) == len(results)
    assert count_open(reading.words) == open_
    assert reading is packets[best]
    assert all(led_gains is SEEMS_DEAD or (led_gains.values == 1).all() for _, led_gains in tried)
    # shifted poses come last
    assert [cutouts[0] is CUTOUT for cutouts, _ in tried] == [True, True, False][: len(tried)]


def attempts(led_gains: LedGains, known: Words | None) -> list[tuple[LedGains, Words | None]]:
    """Record the assumptions tried for a packet that never decodes."""
    tried = list[tuple[LedGains, Words | None]]()

    def equalise(_cutouts: Sequence[Cutout | None], led_gains: LedGains, known: Words | None) -> TurboEqualiser:
        tried.append((led_gains, known))
        return decoded("--", led_gains)

    read_packet([None], led_gains, FORM, known, equalise)
    return tried


def test_leds_that_all_shine_are_not_assumed_once_more() -> None:
    assert len(attempts(LedGains.sound(SIDE), None)) == 1


def test_known_codewords_are_left_out_until_the_brightness_is_learnt() -> None:
    known, sound = words("x-"), LedGains.sound(SIDE)
    assert [given for _, given in attempts(sound, known)] == [known, None]
    assert [given for _, given in attempts(replace(sound, packets=1), known)] == [known]
