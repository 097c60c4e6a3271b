"""`locate`, `follow` and `sample` on films from `panel_films`, an independent renderer."""

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from benchmarks.panel_scenes import draw_scene
from numpy.typing import NDArray
from panel_films import PanelFilm, keystone, moving
from threadpoolctl import threadpool_info, threadpool_limits

import heliograph
from heliograph.measure.statistics import Count
from heliograph.panel.lattice import Lattice
from heliograph.panel.place import Shape
from heliograph.panel.search import settle

ROWS, COLUMNS = 16, 20
Colours = NDArray[np.uint8]


@cache
def small(blur: float = 1.6, **changes: Any) -> PanelFilm:
    """Return a moving, tilted panel with 16 x 20 LEDs and a pitch of about 6 px."""
    place = keystone((75.0, 60.0), 107.0, 1.25, 0.07, 0.15)
    film = PanelFilm(moving(place, (0.2, -0.1), 1.0), ROWS, COLUMNS, 150, 120, blur, noise=1.5)
    return replace(film, **changes)


@cache
def film_of(count: int, blur: float, **changes: Any) -> list[Colours]:
    return list(small(blur, **changes).film(count))


def frames(count: int, blur: float = 1.6, **changes: Any) -> list[Colours]:
    return film_of(4 if count <= 4 else 16, blur, **changes)[:count]


def off(place: heliograph.Place, film: PanelFilm, number: int = 0) -> float:
    """Return the largest corner coordinate error in px."""
    return float(np.abs(place.corners - film.corners(number)).max())


def wrong(values: list[Any], film: PanelFilm) -> int:
    """Count bit errors with a threshold at each LED's mean over the film."""
    seen = np.array(values)
    return int(((seen > seen.mean(axis=0)) != np.array([film.bits(k) for k in range(len(values))])).sum())


@pytest.mark.slow
def test_panel_is_found_by_its_changes() -> None:
    place = heliograph.locate(frames(2), rows=ROWS, columns=COLUMNS)
    assert off(place, small()) < 0.06
    # emitters are discs of 0.55 pitch diameter, hence 0.14 pitches standard deviation
    assert abs(place.blur - np.hypot(1.6, 0.55 / 4 * 6.0)) < 0.1
    assert place.score > 0.99
    np.testing.assert_allclose(place.leds(ROWS, COLUMNS)[0, 0], place.corners[0] + 3, atol=1.0)


def test_a_bright_panel_is_found_in_a_single_gray_frame() -> None:
    film = small(colours=1, scenery=5.0)
    place = heliograph.locate(film.frame(0)[..., 0], rows=ROWS, columns=COLUMNS)
    assert off(place, film) < 0.06


@pytest.mark.parametrize("hand", [1.0, 5.0])
def test_corners_by_hand_are_put_right(hand: float) -> None:
    given = small().corners(0) + hand * np.array([[1, -1], [-0.5, 1], [1, 1], [-1, 0.3]])
    place = heliograph.locate(frames(1)[0], corners=given, rows=ROWS, columns=COLUMNS)
    assert off(place, small()) < 0.06


def test_a_frame_with_an_origin_is_placed_on_the_sensor() -> None:
    gray = np.rint(frames(1)[0].mean(axis=2)).astype(np.uint8)
    window = heliograph.Frame(0, 0.0, np.ascontiguousarray(gray[3:, 5:]), 8, (5, 3))
    place = heliograph.locate(window, small().corners(0) + 1, rows=ROWS, columns=COLUMNS)
    assert off(place, small()) < 0.08
    values = heliograph.sample(window, place, ROWS, COLUMNS)
    np.testing.assert_allclose(values, heliograph.sample(gray, place, ROWS, COLUMNS), atol=1e-3)


def test_without_its_rows_and_columns_the_outline_is_found() -> None:
    still = small(corners=moving(small().corners(0), (0, 0), 0, 0))
    shown = list(still.film(4))
    for given in ({}, {"region": (10, 5, 135, 110)}, {"corners": still.corners(0) + np.array([3, -3])}):
        assert off(heliograph.locate(shown, **given), still) < 6  # one pitch


@pytest.mark.slow
def test_panel_next_to_another_is_found_in_its_region() -> None:
    left, right = (small(corners=lambda _, x=x: keystone((x, 60.0), 74.0), width=180, seed=x) for x in (45, 133))
    both = [np.where(np.arange(180)[None, :, None] < 88, left.frame(k), right.frame(k)) for k in range(2)]
    for film, region in ((left, (2, 2, 86, 116)), (right, (90, 2, 88, 116))):
        assert off(heliograph.locate(both, region=region, rows=ROWS, columns=COLUMNS), film) < 0.2


@pytest.mark.slow
def test_a_panel_is_followed_and_read_in_three_colours() -> None:
    film, shown = small(), frames(16)
    start = heliograph.locate(shown[:2], rows=ROWS, columns=COLUMNS)
    places = list(heliograph.follow(shown, start, ROWS, COLUMNS))
    assert max(off(place, film, k) for k, place in enumerate(places)) < 0.1
    for unblur in (False, True):
        values = [heliograph.sample(*one, ROWS, COLUMNS, unblur, film.leak) for one in zip(shown, places, strict=True)]
        assert (values[0].shape, wrong(values, film)) == ((ROWS, COLUMNS, 3), 0)


def test_places_may_be_changed_while_a_panel_is_followed() -> None:
    shown = frames(3)
    start = heliograph.Place(small().corners(0))
    usual = [place.corners for place in heliograph.follow(shown, start, ROWS, COLUMNS)]
    for place, corners in zip(heliograph.follow(shown, start, ROWS, COLUMNS), usual, strict=True):
        np.testing.assert_array_equal(place.corners, corners)
        place.corners[:] = 0


@pytest.mark.slow
def test_a_panel_that_is_hidden_for_a_while_is_found_again() -> None:
    film, shown = small(), frames(6)
    shown[2] = shown[3] = np.full_like(shown[0], 30)
    places = list(heliograph.follow(shown, heliograph.Place(film.corners(0)), ROWS, COLUMNS))
    assert [place.score > 0.9 for place in places] == [k not in (2, 3) for k in range(6)]
    np.testing.assert_array_equal(places[3].corners, places[1].corners)
    assert off(places[5], film, 5) < 0.06


def test_its_algebra_runs_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two BLAS threads took nine times as long on a loaded machine."""
    threads: list[int] = []

    def light(self: Lattice, images: Any) -> Any:
        threads.extend(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")
        return known(self, images)

    known = Lattice.light
    monkeypatch.setattr(Lattice, "light", light)
    with threadpool_limits(limits=2, user_api="blas"):
        seen = frames(2)
        place = heliograph.locate(seen[0], small().corners(0), rows=ROWS, columns=COLUMNS)
        located = len(threads)
        (second, _) = heliograph.follow(seen, place, ROWS, COLUMNS)
        followed = len(threads)
        heliograph.sample(seen[0], second, ROWS, COLUMNS, unblur=True)
    assert 0 < located < followed < len(threads)
    assert set(threads) == {1}


def test_places_are_given_frame_by_frame() -> None:
    taken = []
    places = heliograph.follow((taken.append(k) or frame for k, frame in enumerate(frames(10))),  # type: ignore[func-returns-value]
                               heliograph.Place(small().corners(0)), ROWS, COLUMNS)  # fmt: skip
    next(places)
    assert taken == [0]


@pytest.mark.slow
def test_equalisation_reads_blurred_leds() -> None:
    """With a blur of 0.55 pitches an LED spreads a fifth of its light to each neighbour."""
    film, shown = small(3.2, spread=0.02), frames(16, 3.2, spread=0.02)
    places = [heliograph.Place(film.corners(k), float(np.hypot(3.2, 0.55 / 4 * 6.0))) for k in range(16)]
    blurred, sharp = (
        wrong([heliograph.sample(*one, ROWS, COLUMNS, unblur) for one in zip(shown, places, strict=True)], film)
        for unblur in (False, True)
    )
    assert blurred > 20 * max(sharp, 1)
    assert sharp < 20


def test_light_is_that_of_each_led_alone() -> None:
    film = small(2.6, colours=1, noise=0.1, spread=0.0, fall_off=0.0, scenery=4.0)
    blur = float(np.hypot(2.6, 0.55 / 4 * 6.0))
    lit = np.zeros((ROWS, COLUMNS, 1), bool)
    lit[5, 7] = lit[5, 8] = lit[11, 3] = True
    place = heliograph.Place(film.corners(0), blur)
    values = heliograph.sample(film.frame(0, lit)[..., 0], place, ROWS, COLUMNS, unblur=True)
    on = values[lit[..., 0]]
    assert on.min() > 0.85 * on.max() > 5
    assert np.abs(values[~lit[..., 0]]).max() < 0.1 * on.max()


def test_leds_beyond_the_frame_are_no_numbers() -> None:
    cut = frames(1)[0][:, 60:]
    place = heliograph.Place(small().corners(0) - [60, 0], 1.8)
    whole = heliograph.sample(frames(1)[0], heliograph.Place(small().corners(0), 1.8), ROWS, COLUMNS, True)
    for unblur in (False, True):
        values = heliograph.sample(cut, place, ROWS, COLUMNS, unblur)
        missing = place.leds(ROWS, COLUMNS)[..., 0] < -0.5
        assert (np.isnan(values).all(axis=-1) == missing).all()
    np.testing.assert_allclose(values[:, -5:], whole[:, -5:], atol=3.0)


@pytest.mark.slow
def test_a_panel_of_64_x_64_in_three_colours_is_read() -> None:
    film = PanelFilm(moving(keystone((280.0, 280.0), 430.0, 1.0, 0.06, 0.15)), blur=2.0)
    shown = list(film.film(2))
    start = heliograph.locate(shown, rows=64, columns=64)
    places = list(heliograph.follow(shown, start, 64, 64))
    assert max(off(start, film), *(off(place, film, k) for k, place in enumerate(places))) < 0.04
    values = np.array([heliograph.sample(*one, 64, 64, True, film.leak) for one in zip(shown, places, strict=True)])
    # two frames are too few for a mean per LED
    known, found = np.array([film.bits(k) for k in range(2)]), values > values.mean(axis=(0, 1, 2))
    assert Count(known.size, int((known != found).sum())).interval()[1] < 2e-4


@pytest.mark.parametrize("seed", [8, 17, 31])
def test_score_separates_right_from_wrong_places(seed: int) -> None:
    scene = draw_scene(seed, count=1)
    image = scene.frames[0].mean(axis=2, dtype=np.float32)
    right, (rows, columns) = scene.corners[0], (scene.rows, scene.columns)
    across, down = (right[1] - right[0]) / columns, (right[3] - right[0]) / rows
    wrong = [(right + across / 2, 0, 0), (right + down / 2, 0, 0), (right, 0, 1), (right, 0, -1), (right, 1, 0)]
    wrong += [(right + across, 0, 0), (right - across, 0, 0), (right + down, 0, 0), (right - down, 0, 0)]

    def score(corners: Any, more_rows: int = 0, more_columns: int = 0) -> float:
        shape = Shape(rows + more_rows, columns + more_columns)
        return settle([image], corners, shape, right, shift=False).score

    assert score(right) >= 0.75
    assert max(score(*one) for one in wrong) < 0.75


@pytest.mark.slow
@pytest.mark.parametrize("seed", [16, 19, 35])
def test_a_hand_held_panel_with_bloom_is_found_or_corners_are_asked_for(seed: int) -> None:
    """Trusting a wrong outline ends in numpy.linalg.LinAlgError or in an error of several pitches."""
    scene = draw_scene(seed, count=2)
    place = None
    with suppress(heliograph.HeliographError):
        place = heliograph.locate(scene.frames, rows=scene.rows, columns=scene.columns)
    assert place is None or (place.score >= 0.75 and scene.error_pitches(place.corners) < 0.4)


FRAME = np.zeros((120, 150), np.uint8)
PLACE = heliograph.Place(np.array([[20.0, 20], [120, 20], [120, 100], [20, 100]]), 1.5)
Anything: Any = heliograph


def sample(frame: Any = FRAME, place: Any = PLACE, **options: Any) -> Any:
    return heliograph.sample(frame, place, 16, 16, **options)


def test_a_still_dark_frame_leaves_corners_by_hand_without_a_score() -> None:
    place = heliograph.locate(FRAME, PLACE.corners, rows=16, columns=16)
    assert place.score < 0.75
    assert np.abs(place.corners - PLACE.corners).max() < 0.5 * 5.0


DOORS: dict[str, tuple[Callable[[], object], str]] = {
    "no frame": (lambda: Anything.locate("film.mkv"), "heliograph.Frame or an array (rows, columns)"),
    "no frames": (lambda: Anything.locate([]), "a frame or a list of frames, not an empty one"),
    "four colours": (lambda: Anything.locate(np.zeros((9, 9, 4))), "not float64 of (9, 9, 4)"),
    "masked pixels": (lambda: sample(np.ma.masked_less(FRAME, 10)), "pixels of a frame are masked"),
    "no pixels": (lambda: Anything.locate(np.zeros((0, 9))), "no pixels: its shape is (0, 9)"),
    "no numbers": (lambda: Anything.locate(np.full((20, 20), np.nan)), "levels that are not finite"),
    "two sizes": (lambda: Anything.locate([FRAME, FRAME[1:]]), "have one size"),
    "nothing there": (lambda: Anything.locate(FRAME), "nothing is bright or changes: give corners="),
    "nothing in there": (lambda: Anything.locate(FRAME, region=(0, 0, 50, 50)), "in the region 0,0,50,50"),
    "three corners": (lambda: Anything.locate(FRAME, [(1, 1), (2, 2), (3, 3)]), "corners are four points (x, y)"),
    "corners as text": (lambda: Anything.locate(FRAME, "1,1,2,2"), "corners are four points (x, y)"),
    "corners beyond": (lambda: Anything.locate(FRAME, PLACE.corners + 900), "no panel in a frame of 150x120 pixels"),
    "a region of three": (lambda: Anything.locate(FRAME, region=(1, 2, 3)), "(x, y, columns, rows) in integer pixels"),
    "a region beyond": (lambda: Anything.locate(FRAME, region=(400, 0, 50, 50)), "which is 150x120"),
    "rows alone": (lambda: Anything.locate(FRAME, rows=16), "columns of LEDs are an integer"),
    "one row": (lambda: Anything.sample(FRAME, PLACE, 1, 16), "rows of LEDs are an integer, 2 or more, not 1"),
    "half a row": (lambda: Anything.sample(FRAME, PLACE, 1.5, 16), "not 1.5"),
    "too many": (lambda: Anything.sample(FRAME, PLACE, 1000, 1000), "at most 65536 LEDs"),
    "no place": (lambda: sample(place=[[1, 2]]), "a place is a result of locate"),
    "follow nothing": (lambda: Anything.follow(None, PLACE, 16, 16), "any iterable of frames"),
    "follow nowhere": (lambda: Anything.follow([], None, 16, 16), "a place is a result of locate"),
    "no blur": (lambda: sample(place=replace(PLACE, blur=np.nan), unblur=True), "the blur of the place"),
    "much blur": (lambda: sample(place=replace(PLACE, blur=9.0), unblur=True), "too close for a blur"),
    "endless blur": (lambda: sample(place=replace(PLACE, blur=1e6), unblur=True), "too close for a blur"),
    "leakage of gray": (lambda: sample(leakage=np.eye(3)), "the frame has one channel"),
    "leakage": (lambda: sample(np.dstack([FRAME] * 3), leakage=np.ones((3, 3))), "that has an inverse"),
}


NO_PANELS = {
    "crossed": [(20, 20), (120, 100), (120, 20), (20, 100)],
    "on a line": [(20, 20), (60, 60), (100, 100), (110, 110)],
    "three on a line": [(20, 20), (70, 20), (120, 20), (70, 100)],
    "nearly on a line": [(20, 20), (70, 19), (120, 20), (70, 100)],
    "twice the same": [(20, 20), (20, 20), (120, 100), (20, 100)],
    "all the same": [(20, 20)] * 4,
    "not convex": [(20, 20), (120, 20), (40, 40), (20, 100)],
    "mirrored": [(120, 20), (20, 20), (20, 100), (120, 100)],
    "mostly beyond": [(110, 20), (260, 20), (260, 100), (110, 100)],
    "LEDs closer than pixels": [(20, 20), (40, 20), (40, 40), (20, 40)],
    "seen along its surface": [(20, 50), (120, 20), (120, 100), (20, 55)],
}


@pytest.mark.parametrize("name", NO_PANELS)
def test_impossible_corners_are_reported_in_one_line(name: str) -> None:
    corners = np.array(NO_PANELS[name], float)
    place = heliograph.Place(corners, 1.5)
    calls: list[Callable[[], object]] = [
        lambda: heliograph.locate(FRAME, corners, rows=16, columns=16),
        lambda: list(heliograph.follow([FRAME], place, 16, 16)),
        lambda: sample(place=place), lambda: sample(place=place, unblur=True),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(heliograph.HeliographError, match=r"^the corners .* are no panel[^\n]*$"):
            call()


@pytest.mark.parametrize(("call", "says"), DOORS.values(), ids=DOORS)
def test_wrong_arguments_are_reported_in_one_line(call: Callable[[], object], says: str) -> None:
    with pytest.raises(heliograph.HeliographError, match=re.escape(says)):
        call()
