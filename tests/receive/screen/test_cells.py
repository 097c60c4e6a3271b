"""Screen cells and their position in frames, and the bounded search for a screen."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame, Pixels
from heliograph.probe.screens import sharpen_corners
from heliograph.receive.screen import locate
from heliograph.receive.screen.cells import PARAMETERS, SAMPLES_PER_S, CellTracker, Place, Sample, SearchBudget
from heliograph.receive.screen.locate import ArraySearch, Candidate, find_quadrilaterals, mean_change, reduce_frame

SIDE, MIDDLE = 16, np.array([8.0, 8.0])
LINEAR = (np.arange(256) / 255).astype(np.float32)
CORNERS = np.array([[60.0, 41.0], [225.0, 50.0], [216.0, 212.0], [52.0, 203.0]])


def levels(seed: int) -> Floats:
    return np.random.default_rng(seed).binomial(4, 0.5, (SIDE, SIDE)).astype(float)


def drawn(cells: Floats, corners: Floats = CORNERS, blur: float = 1.0) -> Pixels:
    fine, n = np.kron(cells, np.ones((16, 16))).astype(np.float32) / 4, 16 * SIDE
    square = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32) - 0.5
    four = cv2.getPerspectiveTransform(square.astype(np.float32), (4 * corners + 1.5).astype(np.float32))
    large = cv2.warpPerspective(fine, four, (1280, 1040), flags=cv2.INTER_LINEAR, borderValue=0.02)
    light = cv2.GaussianBlur(cv2.resize(large, (320, 260), interpolation=cv2.INTER_AREA), (0, 0), blur)
    noise = np.random.default_rng(5).normal(0, 0.01, light.shape)
    out: Pixels = np.clip(255 * (0.05 + 0.8 * light + noise), 0, 255).astype(np.uint8)
    return out


def fitted(pixels: Pixels, corners: Floats, steps: int, blur: float = 1.0) -> Sample:
    place = Place.of(corners, SIDE)
    return CellTracker(SIDE, blur, LINEAR, SearchBudget(), place).fit(Frame(0, 0.0, pixels), place, steps)


def test_cells_are_measured_at_a_known_place() -> None:
    cells = levels(1)
    seen = fitted(drawn(cells), CORNERS, 0)
    assert seen.light == pytest.approx(0.05 + 0.2 * cells, abs=0.04)
    assert seen.misfit < 0.15


@pytest.mark.parametrize("off", [(0.0, 0.0), (3.0, -2.0), (-4.0, 4.0)])
def test_place_is_fitted_from_half_a_cell_away(off: tuple[float, float]) -> None:
    seen = fitted(drawn(levels(2)), CORNERS + off, 10)
    assert np.abs(seen.place.corners(SIDE) - CORNERS).max() < 0.5


@pytest.mark.parametrize("px", [1.6, 2.5, 5.0, 10.0])
def test_two_steps_remove_most_of_an_offset(px: float) -> None:
    corners = (CORNERS - 40) * px / 10 + 40
    errors = []
    for seed in range(8):
        start, blur = corners + np.array([0.3, -0.2]) * px, min(1.0, 0.3 * px)
        seen = fitted(drawn(levels(seed), corners, blur), start, 2, blur)
        errors.append(np.abs(seen.place.at(MIDDLE) - Place.of(corners, SIDE).at(MIDDLE)).max() / px)
    assert np.median(errors) < 0.04


def test_blocks_of_many_cells_are_fitted_from_two_cells_away() -> None:
    side = 64
    cells = np.random.default_rng(3).binomial(4, 0.5, (side, side)).astype(np.uint8)
    pixels = np.pad(np.kron(40 + 40 * cells, np.ones((5, 5), np.uint8)), 40, constant_values=10)
    place = Place.of(np.array([[0, 0], [320, 0], [320, 320], [0, 320]]) + 39.5, side)
    rough = place.shifted(1.6, 1.3)
    start = CellTracker(side, 0.4, LINEAR, SearchBudget(), rough).fit_blocks(Frame(0, 0.0, pixels), rough)
    tracker = CellTracker(side, 0.4, LINEAR, SearchBudget(), start)
    sample = tracker.track(Frame(0, 0.0, pixels))
    assert sample is not None
    assert np.abs(sample.place.corners(side) - place.corners(side)).max() < 1.0  # a fifth of a cell


def test_jump_by_a_cell_is_tracked() -> None:
    tracker = CellTracker(SIDE, 1.0, LINEAR, SearchBudget(), Place.of(CORNERS, SIDE))
    for k in range(5):
        corners = CORNERS + np.array([10.0 * (k == 4), 0.0])
        seen = tracker.track(Frame(k, k / 30, drawn(levels(k), corners)))
        assert seen is not None
        assert np.abs(seen.place.corners(SIDE) - corners).max() < 0.5


def test_array_is_tracked_after_black_frames() -> None:
    tracker = CellTracker(SIDE, 1.0, LINEAR, SearchBudget(), Place.of(CORNERS, SIDE))
    for k in range(40):
        tracker.track(Frame(k, k / 30, np.zeros((260, 320), np.uint8)))
    seen = tracker.track(Frame(40, 40 / 30, drawn(levels(1))))
    assert seen is not None
    assert np.abs(seen.place.corners(SIDE) - CORNERS).max() < 0.5


def test_changing_array_is_outlined() -> None:
    frames = [LINEAR[drawn(levels(k))] for k in range(6)]
    small = [reduce_frame(frame) for frame in frames]
    found = find_quadrilaterals(mean_change([one for one, _ in small]), small[0][1])
    assert np.abs(found[0] - CORNERS).max() < 6
    sharp = sharpen_corners(mean_change(frames), found[0], small[0][1])
    assert np.abs(sharp - CORNERS).max() < 2.5


def test_static_image_has_no_array() -> None:
    still = LINEAR[drawn(levels(1))]
    assert find_quadrilaterals(mean_change([still, still, still]), 1) == []


def test_places_are_moved() -> None:
    place = Place.of(CORNERS, SIDE)
    assert place.moved(np.array([3.0, 4.0])).corners(SIDE) == pytest.approx(CORNERS + np.array([3, 4]), abs=1e-3)
    assert place.shifted(1, 0).at(np.zeros(2)) == pytest.approx(place.at(np.array([1.0, 0.0])))
    assert place.cell_px(SIDE) == pytest.approx(163.8 / 16, abs=0.1)


def test_budget_grows_with_film_time_up_to_the_initial_budget() -> None:
    budget = SearchBudget(share=0.5, first_s=1.0, debt_s=0.5)
    budget.spend(1.2 * SAMPLES_PER_S)
    assert (budget.is_left, budget.is_overdrawn) == (False, False)
    budget.earn(1.0)
    assert budget.is_left
    budget.earn(1000.0)
    budget.spend(1.6 * SAMPLES_PER_S)
    assert budget.is_overdrawn


def search_at_a_place(side: int, budget: SearchBudget) -> tuple[ArraySearch, Place]:
    place = Place.of(np.array([[20, 20], [100, 20], [100, 100], [20, 100]], float), side)
    return ArraySearch(side, 2.2, budget), place


def test_interrupted_search_continues_with_the_next_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    budget, counts = SearchBudget(), list[int]()
    search, place = search_at_a_place(8, budget)

    def fit(_corners: Floats) -> Candidate:
        budget.spend(2 * budget.first_s * SAMPLES_PER_S)
        return np.inf, place, 1.0

    def count(frames: Sequence[object]) -> object:
        counts.append(len(frames))
        return None

    monkeypatch.setattr(search, "_fit_candidate", fit)
    monkeypatch.setattr(locate, "mean_change", count)
    monkeypatch.setattr(locate, "find_quadrilaterals", lambda *_: [None])
    rng = np.random.default_rng(1)
    for k in range(90):
        search.push(Frame(k, k / 30, rng.integers(0, 255, (48, 64), dtype=np.uint8)))
        if k % 6 == 5:
            budget.fill()
    assert set(counts[-6:]) == set(PARAMETERS.windows)


def test_doubtful_array_is_accepted_only_after_many_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two slow patterns only noise changes, which resembles a poor array."""
    search, place = search_at_a_place(8, SearchBudget())
    monkeypatch.setattr(search, "_fit_candidate", lambda *_: (0.5, place, 1.0))
    rng, found = np.random.default_rng(1), list[bool]()
    for k in range(PARAMETERS.kept_frames):
        cells = rng.integers(20, 230, (8, 8)).astype(np.uint8).repeat(10, 0).repeat(10, 1)
        found.append(search.push(Frame(k, k / 30, np.pad(cells, 20, constant_values=10))) is not None)
    assert PARAMETERS.max_doubtful <= found.index(True) + 1 <= PARAMETERS.kept_frames
