"""Pyramid search: every size is searched on one level and reported in sensor coordinates."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.detect import search as pyramid
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.budget import SearchLoad, TokenBucket
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.frame_window import first_present
from heliograph.receive.detect.search import HeaderSearch, PyramidSearch, level_parameters
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT
from heliograph.receive.geometry.view import View, halved
from heliograph.signal.header import all_header_cells, header_levels
from heliograph.signal.settings import SignalSettings

SEARCH = SearchParameters(
    min_side_px=8.0, max_side_px=512.0, min_contrast=0.03, score=0.9, regularity=0.5, candidates=6, blur_px=0.55
)

ORIGIN = (13, 7)
SHAPE = (210, 250)

NEAR = Pose(100.3, 108.7, 7.2, 0.01, 1.6)
FAR = Pose(222.4, 40.2, 1.3, 0.0, 0.6)

LIGHT = 0.25
"""Fraction of full scale for an unresolved array; resolved LEDs are four times as bright."""


@pytest.mark.parametrize("largest", [20.0, 64.0, 65.0, 90.0, 130.0, 512.0, 1000.0])
@pytest.mark.parametrize("side", [8, 16, 32])
def test_every_size_is_looked_for_on_a_level(side: int, largest: float) -> None:
    levels = level_parameters(replace(SEARCH, max_side_px=largest), side)
    # in sensor px
    spans = [(2**k * one.min_side_px, 2**k * one.max_side_px) for k, one in enumerate(levels)]
    assert spans[0][0] == 8.0
    assert max(span[1] for span in spans) == pytest.approx(largest)
    for finer, coarser in pairwise(spans):
        # no gaps between levels, and no redundant level
        assert coarser[0] <= finer[1] <= coarser[1]
    assert all(least <= most for least, most in spans)


@pytest.mark.parametrize(("side", "finest_px"), [(8, 32.0), (16, 64.0), (32, 64.0)])
def test_single_leds_hardly_show_on_a_level(side: int, finest_px: float) -> None:
    finest, *reduced = level_parameters(SEARCH, side)
    assert finest.max_side_px == finest_px
    assert reduced
    assert all(one.max_side_px <= 0.7 * finest_px for one in reduced)


def test_what_is_small_is_looked_for_in_the_cameras_frames_alone() -> None:
    (only,) = level_parameters(replace(SEARCH, max_side_px=64.0), SIDE)
    assert only == replace(SEARCH, max_side_px=64.0)


def test_levels_begin_with_the_blur_that_they_show() -> None:
    for k, one in enumerate(level_parameters(SEARCH, SIDE)):
        assert one.blur_px == pytest.approx(View(k).pose_in(Pose(0, 0, 20, 0, 0.55)).blur)
        assert (one.min_contrast, one.score, one.candidates) == (0.03, 0.9, 6)


def header_of(identity: int) -> NDArray[np.float64]:
    return header_levels(identity) / 4.0


def frames_of(
    *arrays: tuple[Pose, int], motion: tuple[float, float] = (0.0, 0.0), count: int = 8, dimmed: float = 1.0
) -> list[Frame]:
    """Return frames with two header pairs, then dark frames; arrays move at constant velocity."""
    rng, out = np.random.default_rng(0), []
    for k in range(count):
        light = np.full(SHAPE, 0.1)
        for pose, identity in arrays:
            lit = header_of(identity) if k % 2 == 0 else 1 - header_of(identity)
            if k < 4:
                light += (
                    dimmed * LIGHT * draw(pose.moved((k - 1.5) * motion[0], (k - 1.5) * motion[1]), lit, ORIGIN, SHAPE)
                )
        out.append(frame_of(light, k, rng, ORIGIN))
    return out


def search_of(
    frames: list[Frame], taken: tuple[Pose, ...] = (), search: PyramidSearch | None = None
) -> tuple[dict[int, Detection], int]:
    search = search or PyramidSearch(SEARCH, SignalSettings())
    found = [one for frame in frames for one in search.search(frame, taken)]
    return {one.identity: one for one in found}, len(found)


@pytest.mark.parametrize("pose", [NEAR, FAR])
def test_an_array_is_found_where_it_is_on_the_sensor(pose: Pose) -> None:
    found, count = search_of(frames_of((pose, 11)))
    assert count == 1
    fit = found[11].fit
    assert fit.vector[:2] == pytest.approx([pose.x, pose.y], abs=0.05)
    assert fit.pose.pitch == pytest.approx(pose.pitch, rel=0.003)
    assert fit.pose.blur == pytest.approx(pose.blur, rel=0.1)
    assert fit.gain == pytest.approx(LIGHT * 255, rel=0.03)
    assert found[11].start_time_s == pytest.approx(0.0)
    # noise-limited covariance in sensor units
    assert 1e-8 < fit.covariance[0, 0] < 0.05**2


def test_its_drift_is_that_on_the_sensor() -> None:
    found, _ = search_of(frames_of((NEAR, 11), motion=(0.9, -0.5)))
    assert found[11].drift == pytest.approx((900.0, -500.0), abs=60.0)


def test_near_and_far_arrays_are_found_at_once() -> None:
    found, count = search_of(frames_of((NEAR, 11), (FAR, 20)))
    assert count == 2
    for identity, pose in ((11, NEAR), (20, FAR)):
        assert found[identity].fit.vector[:3] == pytest.approx([pose.x, pose.y, np.log(pose.pitch)], abs=0.05)


@pytest.mark.parametrize(("taken", "left"), [((NEAR,), {20}), ((FAR,), {11}), ((NEAR, FAR), set())])
def test_what_is_followed_is_not_found_again(taken: tuple[Pose, ...], left: set[int]) -> None:
    found, count = search_of(frames_of((NEAR, 11), (FAR, 20)), taken)
    assert set(found) == left
    assert count == len(left)


def test_a_settled_search_finds_other_orientations_no_longer() -> None:
    frames = frames_of((NEAR, 11))
    for orientation, known in ((UPRIGHT, {11}), (ORIENTATIONS[1], set())):
        search = PyramidSearch(SEARCH, SignalSettings())
        search.set_orientation(orientation)
        found, _ = search_of(frames, search=search)
        assert {one.identity for one in found.values() if one.orientation == UPRIGHT} == known


@pytest.mark.parametrize(("side_px", "reduced"), [(3, False), (40, True)])
def test_frames_are_reduced_where_something_large_alternates(
    side_px: int, reduced: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[Frame]()

    def noted(frame: Frame) -> Frame:
        seen.append(frame)
        return halved(frame)

    monkeypatch.setattr(pyramid, "halved", noted)
    frames = frames_of()
    for frame in frames[::2]:
        frame.pixels[70 : 70 + side_px, 90 : 90 + side_px] += 30
    assert search_of(frames)[0] == {}
    assert bool(seen) == reduced


@pytest.mark.parametrize("dimmed", [0.08, 0.12, 0.16])
def test_dim_arrays_are_found_as_if_all_frames_were_reduced(dimmed: float) -> None:
    films = [frames_of((replace(NEAR, x=NEAR.x + 0.7 * k), 11), dimmed=dimmed) for k in range(3)]
    found = [search_of(one)[0].keys() for one in films]
    for one, known in zip(films, found, strict=True):
        search = PyramidSearch(SEARCH, SignalSettings())
        search._min_contrast = 0.0
        assert search_of(one, search=search)[0].keys() == known
    assert any(found) == (dimmed > 0.1)


@pytest.mark.parametrize("pose", [NEAR, FAR])
def test_candidates_of_all_levels_count(pose: Pose) -> None:
    search = PyramidSearch(SEARCH, SignalSettings())
    assert search.budget.load == SearchLoad()
    search_of(frames_of((pose, 11)), search=search)
    assert search.budget.load.fitted >= 1
    assert search.budget.load.left_out == 0


@pytest.mark.parametrize("pose", [NEAR, FAR])
def test_a_frame_after_a_gap_shows_an_array_once(pose: Pose) -> None:
    """The search handles the gap first, then the frame."""
    search = PyramidSearch(SEARCH, SignalSettings())
    found = [search.search(frame) for frame in frames_of((pose, 11), count=12) if frame.index != 6]
    assert max(map(len, found)) == 1


def test_the_last_frames_are_the_cameras_own() -> None:
    search, frames = HeaderSearch(SEARCH, SignalSettings(), synchronous=True), frames_of((NEAR, 11), count=16)
    search.start(1e-3)
    for frame in frames:
        search.search(frame)
    # header: four patterns, plus four on each side
    assert [one.index for one in search.recent] == list(range(4, 16))
    assert all(one.pixels is frames[one.index].pixels for one in search.recent)


def flickering_frame(k: int, rng: np.random.Generator, origin: tuple[int, int] = (0, 0)) -> Frame:
    """Return a 256 x 192 frame that flickers in 8 px squares inside a static rim."""
    pixels = np.full((192, 256), 40, np.uint8)
    pixels[16:176, 16:240] = np.kron(rng.integers(0, 256, (20, 28), np.uint8), np.ones((8, 8), np.uint8))
    return Frame(k, 1e-3 * k, pixels, origin=origin)


class NoRefill(TokenBucket):
    def refill(self) -> None:
        pass


def scarce_search() -> PyramidSearch:
    """Return a search with less than half a budget, and no refill."""
    budget = NoRefill(0.3, 1e-3)
    budget.charge(0.6 * budget.capacity)
    return PyramidSearch(SEARCH, SignalSettings(), budget)


@pytest.mark.parametrize("level", [1, 2])
def test_what_is_left_out_as_old_is_so_on_all_levels(level: int) -> None:
    frame = flickering_frame(0, np.random.default_rng(2), (200, 120))
    reduced = frame
    for _ in range(level):
        reduced = halved(reduced)
    old = np.zeros((24, 32), bool)
    old[:, :16] = True
    searched = pyramid._without_skipped(old, ~old, [frame], [pyramid._with_rim(reduced, 16)], level)
    # block centres in sensor px
    x0, y0 = pyramid._with_rim(reduced, 16).origin
    rows, columns = (8 * np.arange(n) + 3.5 for n in searched.shape)
    x, y = 2**level * (columns + x0), 2**level * (rows + y0)
    inside = (y > 120 + 8 * 2**level) & (y < 120 + 192 - 8 * 2**level)
    left, right = (x > 200 + 8 * 2**level) & (x < 328 - 8 * 2**level), x > 328 + 8 * 2**level
    assert left.any()
    assert not searched[np.ix_(inside, left)].any()
    assert searched[np.ix_(inside, right)].all()
    # including the static rim
    assert searched[0].all()


@pytest.mark.parametrize("jump", [(64, 0), (-64, 0), (0, 96), (-96, -32), (160, 0)])
def test_a_window_may_jump_while_blocks_are_left_out(jump: tuple[int, int]) -> None:
    search, rng = scarce_search(), np.random.default_rng(3)
    for k in range(60):
        search.search(flickering_frame(k, rng, (200 + jump[0], 200 + jump[1]) if k >= 30 else (200, 200)))
    assert search.budget.load.blocks > 0


def test_no_level_searches_what_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first reduced level shows a 96 px array unless the search skips the blocks there."""
    found = list[int]()
    for nothing in (False, True):
        if nothing:
            monkeypatch.setattr(pyramid, "_without_skipped", lambda *slots: np.zeros(blocks_of(slots[3]), bool))
        search, rng = scarce_search(), np.random.default_rng(3)
        for k in range(80):
            frame = flickering_frame(k, rng, (200, 200))
            pixels = np.full((400, 600), 40, np.uint8)
            pixels[:192, :256] = frame.pixels
            if 60 <= k < 64:
                sign = 1 - 2 * (k % 2)
                pixels[280:376, 400:496] = 100 + 60 * sign * np.kron(all_header_cells()[4], np.ones((24, 24)))
            found += [one.identity for one in search.search(Frame(k, 1e-3 * k, pixels)) if one.is_clear]
        assert search.budget.load.blocks > 0
    assert found == [4]


def blocks_of(slots: Sequence[Frame | None]) -> tuple[int, int]:
    rows, columns = first_present(slots).pixels.shape
    return -(-rows // 8), -(-columns // 8)


@pytest.mark.parametrize("origin", [(0, 1), (3, 2), (5, 7)])
@pytest.mark.parametrize("rows", range(8, 14))
def test_frames_that_are_low_are_searched(rows: int, origin: tuple[int, int]) -> None:
    """Reduced frames start at an even row; a level may be empty."""
    search, rng = (
        PyramidSearch(replace(SEARCH, cpu_share=1e6), SignalSettings()),
        np.random.default_rng(0),
    )
    for k in range(12):
        pixels = rng.integers(0, 256, (rows, 300)).astype(np.uint8)
        assert not search.search(Frame(k, 1e-3 * k, pixels, origin=origin))
