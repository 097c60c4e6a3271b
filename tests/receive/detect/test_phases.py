"""Phase search for arbitrary frame rates: streams with one frame per pattern."""

from collections import defaultdict

import numpy as np
import pytest

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import HeaderSearch, PyramidSearch
from heliograph.signal.settings import SignalSettings

PARAMETERS = SearchParameters(
    min_side_px=4.0, max_side_px=64.0, min_contrast=0.03, score=0.9, regularity=0.15, candidates=6, blur_px=0.55
)


def streams(fps: float, frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> list[list[Frame]]:
    """Record the frames each detector receives."""
    pushed: dict[int, list[Frame]] = defaultdict(list)

    def push(self: PyramidSearch, frame: Frame, taken: list[Pose]) -> list[Detection]:
        pushed[id(self)].append(frame)
        return []

    monkeypatch.setattr(PyramidSearch, "search", push)
    search = HeaderSearch(PARAMETERS, SignalSettings())
    search.start(1 / fps)
    for frame in frames:
        assert search.search(frame) == []
    return list(pushed.values())


def film(fps: float, count: int) -> list[Frame]:
    return [Frame(k, k / fps, np.zeros((4, 4), np.uint8)) for k in range(count)]


@pytest.mark.parametrize(("fps", "phases"), [(1300.0, 4), (1500.0, 4), (2000.0, 2), (2700.0, 2), (4000.0, 4)])
def test_streams_have_the_frame_of_each_pattern_that_is_nearest_to_their_phase(
    fps: float, phases: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = streams(fps, film(fps, 400), monkeypatch)
    assert len(found) == phases
    offsets = []
    for stream in found:
        numbers = [frame.index for frame in stream]
        # the last frame may not be the nearest yet
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        times = 1e3 * np.array([frame.time_s for frame in stream]) - numbers
        phase = round(phases * float(np.median(times))) / phases
        # within half a frame period, except for the first frame
        assert np.abs(times - phase)[1:].max() < 0.5e3 / fps + 1e-9
        offsets.append(phase % 1)
    assert sorted(offsets) == [k / phases for k in range(phases)]


@pytest.mark.parametrize("fps", [990.0, 1000.0, 1015.0])
def test_of_a_camera_of_the_lights_rate_every_frame_is_searched(fps: float, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [frame for frame in film(fps, 60) if frame.index not in (20, 30, 31)]
    (stream,) = streams(fps, frames, monkeypatch)  # the half-period detector is separate
    assert [frame.time_s for frame in stream] == [frame.time_s for frame in frames]
    # dropped frames leave gaps
    gaps = np.diff([frame.index for frame in stream])
    assert gaps.tolist() == np.diff([frame.index for frame in frames]).tolist()


def test_frames_around_a_header_are_kept() -> None:
    search = HeaderSearch(PARAMETERS, SignalSettings())
    search.start(1 / 1500.0)
    for frame in film(1500.0, 100):
        search.search(frame)
    # header: four patterns, plus four on each side
    assert [frame.index for frame in search.recent] == list(range(82, 100))


def test_a_slower_camera_is_refused() -> None:
    with pytest.raises(HeliographError, match="at least one frame a pattern"):
        HeaderSearch(PARAMETERS, SignalSettings()).start(1 / 970.0)
