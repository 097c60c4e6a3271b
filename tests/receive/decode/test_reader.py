"""Plain receiver's reader: LED positions follow the pose in each frame."""

import numpy as np
from numpy.typing import NDArray
from recorder import Recorder
from scenes import drawn_film, link

from heliograph.receive import receive_frames
from heliograph.receive.events import DecodeEvent, ExtractEvent

Floats = NDArray[np.float64]


def test_leds_are_read_where_they_are_in_each_frame() -> None:
    """Pattern and inverse have poses one pattern apart in motion."""

    def even(t: Floats) -> Floats:
        return np.stack([40.3 + 300 * t, 48.8 - 200 * t], -1)

    settings, recorder = link("signal.data_pairs=24"), Recorder()
    frames = drawn_film(settings, 53, even, distance_m=40.0)
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [packet.status for packet in packets] == ["ok"]
    # skip the velocity transient
    events = recorder.of(ExtractEvent)[8:]
    times = np.array([frame.time_s + 0.5e-3 for event in events for frame in event.frames])
    places = np.array([(pose.x, pose.y) for event in events for pose in event.poses])
    assert np.abs((places - even(times)).reshape(-1, 2, 2).mean(0)).max() < 0.03
    (decode,) = recorder.of(DecodeEvent)
    assert decode.luminances is not None
    assert all(event.luminances is not None for event in events)
    assert np.array_equal(decode.luminances[8:], np.array([event.luminances for event in events]))
