"""False detections: thresholds and curves of synthetic scores, and the detectors on a few films."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from film_checks import uniform, write_levels

from heliograph.base.frames import Frame
from heliograph.channel.settings import Placement
from heliograph.experiments.detection import clutter
from heliograph.experiments.detection import experiment as detection
from heliograph.experiments.report import Context
from heliograph.measure.statistics import Count
from heliograph.receive.geometry.pose import Pose
from heliograph.signal.header import IDENTITIES

pytestmark = pytest.mark.slow
BEST = "M-sequence, 4 frames"
SCENES = {clutter.LAMPS: clutter.lamp_backdrop, "drawn scene": clutter.drawn_backdrop}
SURROUNDINGS = clutter.Surroundings(SCENES, None, 3)


def test_curve_rises_from_zero_to_one_and_thresholds_pass_the_requested_fraction() -> None:
    rng = np.random.default_rng(0)
    alarms, found = detection.curve(rng.random(50), rng.random(40) ** 0.3)
    assert (alarms, found, alarms[0], found[0]) == (sorted(alarms), sorted(found), 0, 0)
    assert (alarms[-1], found[-1]) == (1, 1)
    scores = np.arange(100) / 100
    assert (scores > detection.threshold_for_false(scores, 0.01)).sum() == 1
    assert (scores > detection.threshold_for_false(scores, 0.0)).sum() == 0
    assert (scores > detection.threshold_for_found(scores, 0.95)).sum() == 95
    assert (np.full(7, 0.5) > detection.threshold_for_found(np.full(7, 0.5), 0.9)).all()  # equal scores pass together


def test_a_lower_rate_needs_separate_intervals() -> None:
    assert detection.is_lower(Count(100, 0), Count(100, 20))
    assert detection.is_lower(Count(100, 20), Count(100, 0)) is False
    assert detection.is_lower(Count(10, 0), Count(10, 2)) is None


def test_m_sequences_separate_arrays_from_lamps_better_than_lit_arrays() -> None:
    false, example = detection.film_scene(SURROUNDINGS, (clutter.LAMPS, None, range(2)))
    true, none = detection.film_scene(SURROUNDINGS, (clutter.LAMPS, 50.0, range(1)))
    assert ({len(scores) for scores in false.values()}, {len(scores) for scores in true.values()}) == ({2}, {1})
    assert max(false[BEST]) < max(false[detection.REFERENCE])
    assert max(false[BEST]) < true[BEST][0]
    assert true[detection.RECEIVER] == [1.0]
    assert none is None
    assert example is not None
    assert example[0] == max(false[detection.REFERENCE])


def test_scores_do_not_depend_on_batches() -> None:
    street = clutter.Surroundings({"drawn scene": clutter.drawn_backdrop}, None, 0)
    scores, _ = detection.measure(street, 2, 0, Context())
    for name, values in detection.film_scene(street, ("drawn scene", None, range(1, 2)))[0].items():
        assert (scores[name].films["drawn scene", None][1:], scores[name].all_true().size) == (values, 0)


def synthetic_scores() -> detection.Scores:
    """Scores with many false alarms of lit arrays among lamps, and none elsewhere."""
    scenes = {"clip": 40, "drawn scene": 40, "lamps": 120}
    quiet: dict[tuple[str, float | None], list[float]] = {(scene, None): [0.0] * n for scene, n in scenes.items()}
    quiet |= {(scene, z): [0.99] for scene in scenes for z in detection.DISTANCES_M}
    alarms = quiet | {("lamps", None): [0.95] * 60 + [0.0] * 60}
    kinds = {name: kind for name, (kind, _) in detection.VARIANTS.items()} | {detection.RECEIVER: "m_sequence"}
    return {name: detection.DetectionScores(alarms if kind == "all_on" else quiet) for name, kind in kinds.items()}


def test_lamps_are_judged_apart_from_other_scenes() -> None:
    claims = detection.compared(synthetic_scores())
    assert [claim.verdict for claim in claims] == ["differs", "holds", "shown", "holds"]
    assert "clip 0 of 40" in claims[0].ours
    assert "none had a candidate" in claims[0].why
    assert "lamps" not in claims[0].ours
    assert "lamps 60 of 120" in claims[1].ours
    assert not any("of 200" in claim.ours for claim in (*claims, detection.ingredients(synthetic_scores())))


def test_the_result_has_counts_figures_and_tables() -> None:
    every = {
        z: detection.Confusion(np.eye(IDENTITIES, IDENTITIES + 1, dtype=np.int64))
        for z in (*detection.DISTANCES_M, detection.FAR_M)
    }
    frame = Frame(0, 0.0, np.zeros((32, 32), np.uint8))
    example = 0.95, clutter.ClutterFilm([frame] * 2, 0, ()), Pose(16.0, 16.0, 1.0, 0.0)
    done = detection.report(synthetic_scores(), example, every, every)
    assert all(" of " in finding.ours for finding in done.findings)
    assert [finding.verdict for finding in done.findings[-4:]] == ["holds", "holds", "shown", "shown"]
    assert "right 90 of 90" in done.findings[-4].ours
    assert len(json.loads(json.dumps(done.data))["identities"]["25 m"]) == 30
    assert (done.data["receiver"]["found"]["clip, 25 m"], len(done.pictures)) == ([0, 1], 4)
    assert all(len(row) == len(table.head) for table in done.tables for row in table.rows)


def test_films_are_repeatable_and_show_the_header_at_the_array() -> None:
    rngs = [np.random.default_rng(5) for _ in range(2)]
    one, other = (clutter.film_moment(clutter.lamp_backdrop(rng), rng, None, 50.0, "all_on") for rng in rngs)
    assert len(one.frames) == clutter.FRAMES
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(one.frames, other.frames, strict=True))
    (truth,) = one.truths
    x, y = round(truth.x), round(truth.y)
    on, off, on_again, off_again = (
        frame.pixels[y - 3 : y + 4, x - 3 : x + 4].mean() for frame in one.frames[one.first : one.first + 4]
    )
    assert min(on, on_again) > 150
    assert max(off, off_again) < 30
    found = detection.VariantDetector(*detection.VARIANTS[detection.REFERENCE]).candidates(one)
    assert detection.score_of_array(found, truth, None) > 0.9
    assert detection.score_of_array(found, truth.moved(40, 0), None) == 0


def test_lamps_change_between_frames() -> None:
    images = list(clutter.lamp_backdrop(np.random.default_rng(1))[0].frames())
    assert images[0].shape == clutter.SIZE
    assert any(np.abs(a.astype(int) - b).max() > 50 for a, b in pairwise(images))


@pytest.mark.parametrize("two_in_view", [False, True])
def test_identities_are_distinguished(two_in_view: bool) -> None:
    street = clutter.Surroundings({"drawn scene": clutter.drawn_backdrop}, None, 0)
    by_distance = detection.confusion(street, (150.0,), (6, 28), 1, Context(), (0, 1), two_in_view=two_in_view)
    found = by_distance[150.0]
    assert found.counts.sum() == found.right.trials == (4 if two_in_view else 2)
    assert found.right.errors == found.right.trials
    assert found.wrong.errors == found.missed.errors == 0
    assert (found.counts.sum(1)[[6, 28]] >= 1).all()  # the requested identities, and additional neighbours


def test_two_arrays_in_one_view_are_counted_each_at_its_place() -> None:
    places = [Placement(x_m=-0.4, y_m=0.0), Placement(x_m=0.4, y_m=0.1)]
    rng = np.random.default_rng(2)
    backdrop, camera = clutter.drawn_backdrop(rng), detection.small_camera(places)
    film = clutter.film_moment(backdrop, rng, None, 50.0, "m_sequence", (3, 17), camera)
    assert detection.identities_seen(film) == [3, 17]
    left, right = film.truths
    assert right.x - left.x == pytest.approx(0.8 * 2917 / 50, abs=0.5)
    # a position without an array is a miss, despite the neighbouring array
    assert detection.identities_seen(replace(film, truths=(left.moved(0, 60), right))) == [IDENTITIES, 17]


@pytest.mark.real_data
def test_clips_are_backdrops(data: Path) -> None:
    scenes = clutter.backdrops({"night": data / "driving" / "night-road.mp4"}, 4)
    rng = np.random.default_rng(0)
    film = clutter.film_moment(scenes["night"](rng), rng, None)
    assert (film.truths, film.frames[0].pixels.shape) == ((), (512, 1024))
    assert film.frames[0].pixels.std() > 5


def test_a_moment_of_a_clip_is_a_pair_of_successive_frames(tmp_path: Path) -> None:
    path = tmp_path / "clip.mkv"
    write_levels(path, uniform(40 * np.arange(4), 48, 64), 30)
    footage, start_s = clutter.clip_backdrop(path, 4, np.random.default_rng(0))
    levels = [int(image.mean()) for image in footage.frames()]
    assert levels in (pytest.approx([0, 40], abs=1), pytest.approx([80, 120], abs=1))
    assert footage.rate_hz == 30
    assert 0 <= start_s <= 1 / 30 - clutter.FRAMES / 1000
