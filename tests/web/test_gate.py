import threading
import time
from math import inf

from waiting import HANG_S

from heliograph.web.watching.gate import Gate


def test_all_frames_pass_until_the_stop() -> None:
    gate = Gate()
    assert all(gate.pass_through(k) for k in range(5))
    gate.stop()
    assert not gate.pass_through(5)


def test_step_passes_one_frame_and_holds_the_next() -> None:
    gate = Gate()
    gate.allow(1)
    assert not gate.holds
    assert gate.pass_through(0.0)
    assert gate.holds


def test_packet_step_passes_frames_until_the_end_of_the_packet() -> None:
    gate = Gate()
    gate.allow(inf, until_packet=True)
    assert all(gate.pass_through(k) for k in range(50))
    gate.end_packet()
    assert gate.holds


def test_held_frame_passes_after_the_pause() -> None:
    gate, passed = Gate(), []
    gate.allow(0)
    waiting = threading.Thread(target=lambda: passed.append(gate.pass_through(0.0)))
    waiting.start()
    gate.allow(inf)
    waiting.join(HANG_S)
    assert passed == [True]


def test_frames_wait_for_their_time_at_a_speed() -> None:
    gate = Gate(speed=10.0)
    began = time.monotonic()
    assert all(gate.pass_through(k / 10) for k in range(3))
    assert time.monotonic() - began >= 0.02
