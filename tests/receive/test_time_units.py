"""Timestamps in other units give a one-line error, at no extra cost per frame."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from scenes import film, link

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import receive_frames
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader

ReadPair = FramePair | MeasuredHeader | None


class PairCount:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
        self.count, take = 0, ArrayReceiver._take

        def counted(array: ArrayReceiver, number: int, pair: ReadPair) -> Iterator[object]:
            self.count += 1
            assert self.count <= most, "pairs of a gap are gone through one by one"
            return take(array, number, pair)

        monkeypatch.setattr(ArrayReceiver, "_take", counted)


def retimed(frames: list[Frame], factor: float) -> list[Frame]:
    return [replace(frame, time_s=frame.time_s * factor) for frame in frames]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_work_for_a_frame_is_bounded_whatever_its_time(receiver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=8")
    frames = film(settings, 24)
    PairCount(monkeypatch, 20 * len(frames))
    for factor in (1e3, 1e6, 1e9, 1e-6, 1e-9):
        with pytest.raises(HeliographError, match=r"give times in seconds, .*--fps"):
            list(receive_frames(retimed(frames, factor), settings.signal, settings.receive))
    jump = [replace(frame, time_s=frame.time_s + (1e9 if frame.index > 19 else 0)) for frame in frames]
    packets = list(receive_frames(jump, settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"]
