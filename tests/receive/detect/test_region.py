"""Given corners or region: initial pose and searched frame area."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scenes import SIDE, draw, frame_of

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import HeaderSearch, PyramidSearch
from heliograph.receive.geometry.pose import pose_of
from heliograph.receive.geometry.window import Window
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

PARAMETERS = SearchParameters(
    min_side_px=8.0, max_side_px=256.0, min_contrast=0.03, score=0.9, regularity=0.5, candidates=6, blur_px=0.55
)
POSES = [
    Pose(70.0, 50.0, 1.7, 0.0, 0.55),
    Pose(70.3, 50.8, 1.7, 0.7, 0.55, 0.05, -0.03),
    Pose(-20.0, 3.0, 4.0, -0.6, 0.55, -0.15, 0.1),
]


def corners_of(pose: Pose) -> Floats:
    """Return LED area corners (4, 2) in px, clockwise from the upper left."""
    unit = SIDE / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(unit @ pose.axes.T + [pose.x, pose.y])


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("first", range(4))
def test_corners_give_the_pose_whichever_comes_first(pose: Pose, way: int, first: int) -> None:
    corners = np.roll(corners_of(pose), first, axis=0)[::way]
    found = pose_of(corners.ravel().tolist(), SIDE, 0.55)
    np.testing.assert_allclose(found.full_vector(), pose.full_vector(), atol=1e-9)


def test_an_array_turned_by_more_is_one_turned_by_less_whose_header_is_turned() -> None:
    pose = replace(POSES[1], roll=POSES[1].roll + np.pi / 2)
    found = pose_of(corners_of(pose).ravel().tolist(), SIDE, 0.55)
    assert abs(found.roll) < np.pi / 4
    same = {tuple(one) for one in corners_of(found).round(6)}
    assert same == {tuple(one) for one in corners_of(pose).round(6)}


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[Frame]:
    """Record searched frame areas; the search returns no detections."""
    searched = list[Frame]()

    def push(self: PyramidSearch, frame: Frame, tracked: Sequence[Pose]) -> list[Detection]:
        searched.append(frame)
        return []

    monkeypatch.setattr(PyramidSearch, "search", push)
    return searched


def search_in(region: Window) -> HeaderSearch:
    search = HeaderSearch(PARAMETERS, SignalSettings(), synchronous=True, region=region)
    search.start(1e-3)
    return search


def frames(count: int, origin: tuple[int, int] = (0, 0)) -> list[Frame]:
    levels = np.random.default_rng(0).integers(0, 256, (count, 100, 200), np.uint8)
    return [Frame(k, 1e-3 * k, pixels, 8, origin) for k, pixels in enumerate(levels)]


def test_the_region_alone_is_searched_and_whole_frames_are_handed_on(searched: list[Frame]) -> None:
    search, seen = search_in((90, 70, 20, 16)), frames(5, (10, 20))
    for frame in seen:
        assert search.search(frame) == []
    for part, frame in zip(searched, seen, strict=True):
        x, y = (at - of for at, of in zip(part.origin, frame.origin, strict=True))
        rows, columns = part.pixels.shape
        assert 90 - 40 <= part.origin[0] < 90 < 110 <= part.origin[0] + columns < 110 + 40
        assert 70 - 40 <= part.origin[1] < 70 < 86 <= part.origin[1] + rows < 86 + 40
        np.testing.assert_array_equal(part.pixels, frame.pixels[y : y + rows, x : x + columns])
    assert [one.pixels.shape for one in search.recent] == [(100, 200)] * 5
    assert [one.index for one in search.recent] == [0, 1, 2, 3, 4]


def test_an_array_that_is_followed_is_looked_for_where_it_went(searched: list[Frame]) -> None:
    search = search_in((20, 20, 20, 20))
    first, second, third = frames(3)
    search.search(first)
    search.search(second, [Pose(150.0, 60.0, 2.0)])
    search.search(third)
    before, during, after = (part.origin[0] + part.pixels.shape[1] for part in searched)
    assert before < 100
    # array size 2 * SIDE px, plus the same margin
    assert during == after == 150 + SIDE + 2 * SIDE * 0.5 + 1
    assert {part.origin for part in searched} == {searched[0].origin}


def test_a_region_beyond_the_frames_is_refused() -> None:
    search = search_in((300, 20, 20, 20))
    with pytest.raises(HeliographError, match=r"the region 300,20,20,20 .* beyond the frames, which are 200x100$"):
        search.search(frames(1)[0])


def test_a_cameras_window_may_leave_the_region(searched: list[Frame]) -> None:
    search, (here, there, again) = search_in((20, 20, 20, 20)), frames(3)
    for frame in (here, replace(there, origin=(500, 0)), again):
        search.search(frame)
    assert [part.index for part in searched] == [0, 2]


@pytest.mark.parametrize(("pitch", "blur", "off_px"), [(1.7, 0.55, 1.5), (6.0, 1.4, 4.0)])
def test_a_header_turned_by_40_degrees_is_found_with_the_tilt_that_was_given(
    pitch: float, blur: float, off_px: float
) -> None:
    """The second case uses reduced frames."""
    pose = Pose(100.2, 80.9, pitch, np.radians(40.0), blur, 0.04, -0.02)
    seen = header_film(pose)
    by_hand = corners_of(pose) + off_px * np.array([[1, -1], [0, 1], [1, 0], [-1, -1]])
    start = pose_of(by_hand.ravel().tolist(), SIDE, 0.55)
    (found,) = found_in(seen, replace(PARAMETERS, start=start, everywhere=True))
    assert found.identity == 7
    np.testing.assert_allclose(corners_of(found.fit.pose), corners_of(pose), atol=0.05 * pitch)


def header_film(pose: Pose) -> list[Frame]:
    rng, lit = np.random.default_rng(3), header_levels(7) / 4.0
    shown = [lit, 1 - lit, lit, 1 - lit, *[np.zeros((SIDE, SIDE))] * 4]
    return [frame_of(0.1 + 0.25 * draw(pose, one, (0, 0), (160, 200)), k, rng) for k, one in enumerate(shown)]


def found_in(seen: list[Frame], parameters: SearchParameters) -> list[Detection]:
    search = PyramidSearch(parameters, SignalSettings())
    return [one for frame in seen for one in search.search(frame)]
