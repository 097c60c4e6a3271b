"""Frames that start with a packet belong to it, though their times are a rounding error early."""

import pytest
from link_packets import small

from heliograph.link.simulate import default_messages
from heliograph.measure.errors import ErrorCounter

SETTINGS = small("channel.duration_s=1")
FPS = 1000.0


@pytest.mark.parametrize("packet", [3, 6, 7])
def test_the_first_frame_of_a_packet_is_not_taken_for_the_last_of_the_one_before(packet: int) -> None:
    """The array is hidden in that one frame, so that packet does not count as missed; the others do."""
    first = 100 * packet
    # 0.3 s is 2.9999999999999996 times 0.1 s
    assert first / FPS // 0.1 == packet - 1
    counter = ErrorCounter(SETTINGS, default_messages(SETTINGS))
    for frame in range(1000):
        # each packet from a distance of its own
        counter.saw(frame / FPS, [20.0 + 10 * (frame // 100)], [frame != first])
    missed = {near_m: errors["high"].missed for near_m, errors in counter.bins().items()}
    assert missed == {20.0 + 10 * k: 1 for k in range(10) if k != packet}
