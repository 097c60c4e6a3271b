"""Search for headers: phases of the camera, given places, and arrays of every size on a pyramid."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, Floats, draw, frame_of
from search_scenes import HEADER, search_parameters

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.detect import search as pyramid
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.frame_window import first_present
from heliograph.receive.detect.search import HeaderSearch, PyramidSearch, level_parameters
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose, pose_of
from heliograph.receive.geometry.view import View, halved
from heliograph.receive.geometry.window import Window
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

SEARCH = search_parameters(regularity=0.5, max_side_px=512.0)

Searches = dict[int, list[Frame]]  # frames of each search


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> Searches:
    """Record the frames of each `PyramidSearch`, which returns no detections."""
    frames_of_search: Searches = defaultdict(list)

    def record(self: PyramidSearch, frame: Frame, tracked: Sequence[Pose]) -> list[Detection]:
        frames_of_search[id(self)].append(frame)
        return []

    monkeypatch.setattr(PyramidSearch, "search", record)
    return frames_of_search


def search_all(fps: float, frames: list[Frame]) -> HeaderSearch:
    search = HeaderSearch(SEARCH, SignalSettings(), synchronous=False)
    search.start(1 / fps)
    assert [found for frame in frames for found in search.search(frame)] == []
    return search


def dark_film(fps: float, count: int) -> list[Frame]:
    return [Frame(k, k / fps, np.zeros((4, 4), np.uint8)) for k in range(count)]


@pytest.mark.parametrize(("fps", "phases"), [(1300.0, 4), (1500.0, 4), (2000.0, 2), (2700.0, 2), (4000.0, 4)])
def test_each_phase_has_the_nearest_frame_of_every_pattern(fps: float, phases: int, searched: Searches) -> None:
    search, offsets = search_all(fps, dark_film(fps, 400)), []
    for stream in searched.values():
        numbers = [frame.index for frame in stream]
        # the last frame may not be the nearest yet
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        times = 1e3 * np.array([frame.time_s for frame in stream]) - numbers
        phase = round(phases * float(np.median(times))) / phases
        # within half a frame period, except for the first frame
        assert np.abs(times - phase)[1:].max() < 0.5e3 / fps + 1e-9
        offsets.append(phase % 1)
    assert sorted(offsets) == [k / phases for k in range(phases)]
    # header: four patterns, plus four on each side
    assert fps != 1500.0 or [frame.index for frame in search.recent] == list(range(382, 400))


@pytest.mark.parametrize("fps", [990.0, 1000.0, 1015.0])
def test_every_frame_is_searched_at_the_rate_of_the_light(fps: float, searched: Searches) -> None:
    frames = [frame for frame in dark_film(fps, 60) if frame.index not in (20, 30, 31)]
    search_all(fps, frames)
    (stream,) = searched.values()
    # dropped frames leave gaps
    first = stream[0].index - frames[0].index
    assert [(f.index - first, f.time_s) for f in stream] == [(f.index, f.time_s) for f in frames]


def test_a_slower_camera_is_refused() -> None:
    with pytest.raises(HeliographError, match="at least one frame per pattern"):
        search_all(970.0, [])


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
def test_corners_in_any_order_give_the_pose_of_least_roll(pose: Pose, way: int, first: int) -> None:
    corners = np.roll(corners_of(pose), first, axis=0)[::way].ravel().tolist()
    np.testing.assert_allclose(pose_of(corners, SIDE, 0.55).full_vector(), pose.full_vector(), atol=1e-9)


def search_in(region: Window) -> HeaderSearch:
    search = HeaderSearch(SEARCH, SignalSettings(), synchronous=True, region=region)
    search.start(1e-3)
    return search


def noise_film(count: int, origin: tuple[int, int] = (0, 0)) -> list[Frame]:
    levels = np.random.default_rng(0).integers(0, 256, (count, 100, 200), np.uint8)
    return [Frame(k, 1e-3 * k, pixels, 8, origin) for k, pixels in enumerate(levels)]


def test_only_the_region_is_searched(searched: Searches) -> None:
    search, seen = search_in((90, 70, 20, 16)), noise_film(5, (10, 20))
    assert [found for frame in seen for found in search.search(frame)] == []
    (parts,) = searched.values()
    for part, frame in zip(parts, seen, strict=True):
        (left, top), (rows, columns) = part.origin, part.pixels.shape
        assert 90 - 40 <= left < 90 < 110 <= left + columns < 110 + 40
        assert 70 - 40 <= top < 70 < 86 <= top + rows < 86 + 40
        np.testing.assert_array_equal(part.pixels, frame.pixels[top - 20 :, left - 10 :][:rows, :columns])
    # whole frames are kept
    assert all(kept.pixels is frame.pixels for kept, frame in zip(search.recent, seen, strict=True))


def test_the_region_grows_with_a_tracked_array(searched: Searches) -> None:
    search = search_in((20, 20, 20, 20))
    for frame, tracked in zip(noise_film(3), ([], [Pose(150.0, 60.0, 2.0)], []), strict=True):
        search.search(frame, tracked)
    (parts,) = searched.values()
    before, *later = (part.origin[0] + part.pixels.shape[1] for part in parts)
    assert before < 100
    # array size 2 * SIDE px, plus the same margin
    assert later == [150 + SIDE + 2 * SIDE * 0.5 + 1] * 2
    assert {part.origin for part in parts} == {parts[0].origin}


def test_a_camera_window_may_leave_the_region_and_must_overlap_at_first(searched: Searches) -> None:
    search, frames = search_in((20, 20, 20, 20)), noise_film(3)
    for frame, x in zip(frames, (0, 500, 0), strict=True):
        search.search(replace(frame, origin=(x, 0)))
    assert [[part.index for part in parts] for parts in searched.values()] == [[0, 2]]
    with pytest.raises(HeliographError, match=r"the region 300,20,20,20 .* beyond the frames, which are 200x100$"):
        search_in((300, 20, 20, 20)).search(frames[0])


@pytest.mark.parametrize(("pitch", "blur", "off_px"), [(1.7, 0.55, 1.5), (6.0, 1.4, 4.0)])
def test_a_header_turned_by_40_degrees_is_found_with_the_given_tilt(pitch: float, blur: float, off_px: float) -> None:
    """The second case uses reduced frames."""
    pose, rng = Pose(100.2, 80.9, pitch, np.radians(40.0), blur, 0.04, -0.02), np.random.default_rng(3)
    lit = header_of(7)
    shown = [lit, 1 - lit, lit, 1 - lit, *[np.zeros((SIDE, SIDE))] * 4]
    seen = [frame_of(0.1 + 0.25 * draw(pose, one, (0, 0), (160, 200)), k, rng) for k, one in enumerate(shown)]
    by_hand = corners_of(pose) + off_px * np.array([[1, -1], [0, 1], [1, 0], [-1, -1]])
    start = pose_of(by_hand.ravel().tolist(), SIDE, 0.55)
    parameters = replace(SEARCH, max_side_px=256.0, start=start, everywhere=True)
    found, count = search_frames(seen, PyramidSearch(parameters, SignalSettings()))
    assert (list(found), count) == ([7], 1)
    np.testing.assert_allclose(corners_of(found[7].fit.pose), corners_of(pose), atol=0.05 * pitch)


ORIGIN, SHAPE = (13, 7), (210, 250)
NEAR, FAR = Pose(100.3, 108.7, 7.2, 0.01, 1.6), Pose(222.4, 40.2, 1.3, 0.0, 0.6)
LIGHT = 0.25  # fraction of full scale for an unresolved array; resolved LEDs are four times as bright


@pytest.mark.parametrize("largest", [20.0, 64.0, 65.0, 90.0, 130.0, 512.0, 1000.0])
@pytest.mark.parametrize("side", [8, 16, 32])
def test_the_levels_cover_every_size(side: int, largest: float) -> None:
    levels = level_parameters(replace(SEARCH, max_side_px=largest), side)
    # in sensor px
    spans = [(2**k * one.min_side_px, 2**k * one.max_side_px) for k, one in enumerate(levels)]
    assert (spans[0][0], max(most for _, most in spans)) == (8.0, pytest.approx(largest))
    assert all(least <= most for least, most in spans)
    # no gaps between levels, and no redundant level
    assert all(coarser[0] <= finer[1] <= coarser[1] for finer, coarser in pairwise(spans))


@pytest.mark.parametrize(("side", "finest_px"), [(8, 32.0), (16, 64.0), (32, 64.0)])
def test_single_leds_are_hardly_visible_on_a_level(side: int, finest_px: float) -> None:
    finest, *reduced = level_parameters(SEARCH, side)
    assert finest.max_side_px == finest_px
    assert 0 < max(one.max_side_px for one in reduced) <= 0.7 * finest_px
    # a level has the blur of reduced frames, and else the same parameters
    for k, one in enumerate((finest, *reduced)):
        assert one.blur_px == pytest.approx(View(k).pose_in(Pose(0, 0, 20, 0, 0.55)).blur)
        assert (one.min_contrast, one.score, one.candidates) == (0.03, 0.9, 6)
    small = replace(SEARCH, max_side_px=finest_px)
    assert level_parameters(small, side) == [small]


def header_of(identity: int) -> Floats:
    return header_levels(identity) / 4.0


def frames_of(
    *arrays: tuple[Pose, int], motion: tuple[float, float] = (0.0, 0.0), count: int = 8, dimmed: float = 1.0
) -> list[Frame]:
    """Return frames with two header pairs, then dark frames; arrays move at constant velocity."""
    rng, out = np.random.default_rng(0), []
    for k in range(count):
        light, step = np.full(SHAPE, 0.1), k - 1.5
        for pose, identity in arrays if k < 4 else ():
            lit, moved = header_of(identity), pose.moved(step * motion[0], step * motion[1])
            light += dimmed * LIGHT * draw(moved, 1 - lit if k % 2 else lit, ORIGIN, SHAPE)
        out.append(frame_of(light, k, rng, ORIGIN))
    return out


def search_frames(
    frames: list[Frame], search: PyramidSearch | None = None, tracked: tuple[Pose, ...] = ()
) -> tuple[dict[int, Detection], int]:
    search = search or PyramidSearch(SEARCH, SignalSettings())
    found = [detection for frame in frames for detection in search.search(frame, tracked)]
    return {detection.identity: detection for detection in found}, len(found)


@pytest.mark.parametrize("pose", [NEAR, FAR])
def test_an_array_is_found_at_its_place_on_the_sensor(pose: Pose) -> None:
    search = PyramidSearch(SEARCH, SignalSettings())
    assert search.budget.load == SearchLoad()
    found, count = search_frames(frames_of((pose, 11)), search)
    # the candidates of all levels count
    assert search.budget.load.fitted >= 1
    assert (count, search.budget.load.left_out) == (1, 0)
    assert found[11].start_time_s == pytest.approx(0.0)
    fit = found[11].fit
    assert fit.vector[:2] == pytest.approx([pose.x, pose.y], abs=0.05)
    assert fit.pose.pitch == pytest.approx(pose.pitch, rel=0.003)
    assert fit.pose.blur == pytest.approx(pose.blur, rel=0.1)
    assert fit.gain == pytest.approx(LIGHT * 255, rel=0.03)
    # noise-limited covariance in sensor units
    assert 1e-8 < fit.covariance[0, 0] < 0.05**2


def test_the_drift_refers_to_the_sensor() -> None:
    found, _ = search_frames(frames_of((NEAR, 11), motion=(0.9, -0.5)))
    assert found[11].drift == pytest.approx((900.0, -500.0), abs=60.0)


@pytest.mark.parametrize("tracked", [{}, {11: NEAR}, {20: FAR}, {11: NEAR, 20: FAR}])
def test_near_and_far_arrays_are_found_at_once_unless_tracked(tracked: dict[int, Pose]) -> None:
    found, count = search_frames(frames_of((NEAR, 11), (FAR, 20)), tracked=tuple(tracked.values()))
    assert len(found) == count
    places = {k: np.array([pose.x, pose.y, np.log(pose.pitch)]) for k, pose in ((11, NEAR), (20, FAR))}
    left = {k: pytest.approx(place, abs=0.05) for k, place in places.items() if k not in tracked}
    assert {identity: one.fit.vector[:3] for identity, one in found.items()} == left


@pytest.mark.slow
@pytest.mark.parametrize(("orientation", "known"), [(UPRIGHT, [11]), (ORIENTATIONS[1], [])])
def test_a_search_for_one_orientation_finds_no_other(orientation: Orientation, known: list[int]) -> None:
    search = PyramidSearch(SEARCH, SignalSettings())
    search.set_orientation(orientation)
    found, _ = search_frames(frames_of((NEAR, 11)), search)
    assert [one.identity for one in found.values() if one.orientation == UPRIGHT] == known


@pytest.mark.parametrize(("side_px", "reduced"), [(3, False), (40, True)])
def test_frames_are_reduced_if_a_large_area_alternates(side_px: int, reduced: bool) -> None:
    search, frames = PyramidSearch(SEARCH, SignalSettings()), frames_of()
    for frame in frames[::2]:
        frame.pixels[70 : 70 + side_px, 90 : 90 + side_px] += 30
    assert search_frames(frames, search) == ({}, 0)
    assert bool(search._reduced) == reduced


@pytest.mark.slow
@pytest.mark.parametrize("dimmed", [0.08, 0.12, 0.16])
def test_dim_arrays_are_found_as_if_all_frames_were_reduced(dimmed: float) -> None:
    found = []
    for k in range(2):
        frames = frames_of((replace(NEAR, x=NEAR.x + 0.7 * k), 11), dimmed=dimmed)
        search, always_reduced = (PyramidSearch(replace(SEARCH, rolls_deg=()), SignalSettings()) for _ in range(2))
        always_reduced._min_contrast = 0.0
        found.append(search_frames(frames, search)[0].keys())
        assert search_frames(frames, always_reduced)[0].keys() == found[-1]
    assert any(found) == (dimmed > 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("pose", [NEAR, FAR])
def test_a_frame_after_a_gap_shows_an_array_once(pose: Pose) -> None:
    """The search handles the gap first, then the frame."""
    search = PyramidSearch(SEARCH, SignalSettings())
    assert max(len(search.search(frame)) for frame in frames_of((pose, 11), count=12) if frame.index != 6) == 1


def flickering_frame(k: int, rng: np.random.Generator, origin: tuple[int, int] = (0, 0)) -> Frame:
    """Return a 256 x 192 frame that flickers in 8 px squares inside a static rim."""
    pixels = np.full((192, 256), 40, np.uint8)
    pixels[16:176, 16:240] = np.kron(rng.integers(0, 256, (20, 28), np.uint8), np.ones((8, 8), np.uint8))
    return Frame(k, 1e-3 * k, pixels, origin=origin)


def scarce_search() -> PyramidSearch:
    """Return a search with less than half a budget, and hardly any refill."""
    search = PyramidSearch(replace(SEARCH, cpu_share=0.3), SignalSettings(pattern_period_s=1e-6))
    search.budget.charge(0.6 * search.budget.capacity)
    return search


@pytest.mark.parametrize("level", [1, 2])
def test_blocks_without_novelty_are_skipped_on_all_levels(level: int) -> None:
    frame, old = flickering_frame(0, np.random.default_rng(2), (200, 120)), np.zeros((24, 32), bool)
    old[:, :16] = True
    reduced = pyramid._with_rim(halved(frame) if level == 1 else halved(halved(frame)), 16)
    searched = pyramid._without_skipped(old, ~old, [frame], [reduced], level)
    # block centres in sensor px
    columns, rows = (8 * np.arange(n) + 3.5 for n in searched.T.shape)
    x, y = 2**level * (columns + reduced.origin[0]), 2**level * (rows + reduced.origin[1])
    rim = 8 * 2**level
    inside, left = (y > 120 + rim) & (y < 120 + 192 - rim), (x > 200 + rim) & (x < 328 - rim)
    assert left.any()
    assert not searched[np.ix_(inside, left)].any()
    assert searched[np.ix_(inside, x > 328 + rim)].all()
    # including the static rim
    assert searched[0].all()


@pytest.mark.parametrize("jump", [(64, 0), (-64, 0), (0, 96), (-96, -32), (160, 0)])
def test_a_window_may_jump_while_blocks_are_skipped(jump: tuple[int, int]) -> None:
    search, rng = scarce_search(), np.random.default_rng(3)
    for k in range(44):
        search.search(flickering_frame(k, rng, (200 + jump[0], 200 + jump[1]) if k >= 24 else (200, 200)))
    assert search.budget.load.blocks > 0


def test_no_level_searches_skipped_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first reduced level shows a 96 px array unless the search skips the blocks there."""

    def skip_all(*slots: Sequence[Frame | None]) -> NDArray[np.bool_]:
        return np.zeros([-(-size // 8) for size in first_present(slots[3]).pixels.shape], bool)

    header, found = np.kron(2 * HEADER - 1, np.ones((3, 3))), list[int]()
    for skips_all in (False, True):
        if skips_all:
            monkeypatch.setattr(pyramid, "_without_skipped", skip_all)
        search, rng, pixels = scarce_search(), np.random.default_rng(3), np.full((400, 600), 40, np.uint8)
        for k in range(50):
            pixels[:192, :256] = flickering_frame(k, rng).pixels
            pixels[280:376, 400:496] = 100 + 60 * (1 - 2 * (k % 2)) * header if 40 <= k < 44 else 40
            found += [one.identity for one in search.search(Frame(k, 1e-3 * k, pixels.copy())) if one.is_clear]
        assert search.budget.load.blocks > 0
    assert found == [4]


@pytest.mark.parametrize("origin", [(0, 1), (3, 2), (5, 7)])
@pytest.mark.parametrize("rows", range(8, 14))
def test_low_frames_are_searched(rows: int, origin: tuple[int, int]) -> None:
    """Reduced frames start at an even row; a level may be empty."""
    search, rng = PyramidSearch(SEARCH, SignalSettings()), np.random.default_rng(0)
    for k in range(12):
        pixels = rng.integers(0, 256, (rows, 300)).astype(np.uint8)
        assert not search.search(Frame(k, 1e-3 * k, pixels, origin=origin))
