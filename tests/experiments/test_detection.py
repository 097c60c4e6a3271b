"""False detections: thresholds and curves for synthetic scores, and four variants on a few films."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.channel import Placement
from heliograph.experiments.detection import ablation, trials
from heliograph.experiments.detection import experiment as detection
from heliograph.experiments.detection.ablation import VARIANTS, VariantDetector
from heliograph.experiments.detection.clutter import (
    FRAMES,
    SIZE,
    ClipBackdrop,
    backdrops,
    drawn_backdrop,
    film_moment,
    lamp_backdrop,
)
from heliograph.experiments.detection.experiment import compared, ingredients
from heliograph.experiments.detection.identities import confusion, identities_seen, small_camera
from heliograph.experiments.detection.trials import DetectionEffort, DetectionScores, DetectionTrials
from heliograph.experiments.report import Context, ExperimentResult
from heliograph.measure.statistics import Count
from heliograph.media import create_film
from heliograph.signal.header import IDENTITIES

pytestmark = pytest.mark.slow


def test_curve_rises_from_nothing_to_all() -> None:
    rng = np.random.default_rng(0)
    alarms, found = ablation.curve(rng.random(50), rng.random(40) ** 0.3)
    assert alarms == sorted(alarms)
    assert found == sorted(found)
    assert (alarms[0], found[0]) == (0, 0)
    assert (alarms[-1], found[-1]) == (1, 1)


def test_thresholds_let_through_what_they_should() -> None:
    scores = np.arange(100) / 100
    assert (scores > ablation.threshold_for_false(scores, 0.01)).sum() == 1
    assert (scores > ablation.threshold_for_false(scores, 0.0)).sum() == 0
    assert (scores > ablation.threshold_for_found(scores, 0.95)).sum() == 95
    # equal scores pass together
    assert (np.full(7, 0.5) > ablation.threshold_for_found(np.full(7, 0.5), 0.9)).all()


def test_less_needs_intervals_apart() -> None:
    assert trials.is_lower(Count(100, 0), Count(100, 20))
    assert trials.is_lower(Count(100, 20), Count(100, 0)) is False
    assert trials.is_lower(Count(10, 0), Count(10, 2)) is None


@pytest.fixture(scope="module")
def measured() -> DetectionTrials:
    scenes = {"lamps": lamp_backdrop, "drawn scene": drawn_backdrop}
    return trials.measure(scenes, DetectionEffort(2, 1, 4, 1), None, Context(seed=3))


def test_m_sequence_dominates_at_equal_false_alarms(measured: DetectionTrials) -> None:
    all_on, sequence = measured.scores[VARIANTS[0].name], measured.scores[VARIANTS[3].name]
    assert sequence.all_false().max() < all_on.all_false().max()
    for distance in trials.DISTANCES_M:
        for share in (0.0, 0.2, 0.5):
            ours, theirs = (one.found_at(distance, share) for one in (sequence, all_on))
            assert ours.trials == theirs.trials == 2
            assert ours.errors >= theirs.errors
    assert all_on.false_alarms().errors > sequence.false_alarms().errors


def test_films_are_counted_once_by_each_way(measured: DetectionTrials) -> None:
    for variant in VARIANTS:
        assert measured.scores[variant.name].all_false().size == 2 * 3 + 2
        assert [measured.scores[variant.name].all_true(z).size for z in trials.DISTANCES_M] == [2, 2, 2]
    receiver = measured.scores[trials.RECEIVER]
    assert {scene: len(found) for scene, found in receiver.false.items()} == {"lamps": 6, "drawn scene": 2}
    assert receiver.false_alarms().trials == 8
    assert [receiver.found(scenes=["lamps"], distance_m=z).trials for z in trials.DISTANCES_M] == [1, 1, 1]
    assert measured.example is not None


def test_results_do_not_depend_on_how_films_are_handed_out() -> None:
    scenes, effort = {"drawn scene": drawn_backdrop}, DetectionEffort(1, 0, 4, 1)
    whole = trials.measure(scenes, effort, None, Context())
    assert trials.measure(scenes, effort, None, Context(workers=2), batch_size=1).scores == whole.scores


def test_lamps_are_judged_apart_from_what_is_filmed() -> None:
    scenes = {"clip": 40, "drawn scene": 40, "lamps": 120}
    false = {scene: [0.0] * films for scene, films in scenes.items()}
    true = {(scene, z): [0.99] for scene in scenes for z in trials.DISTANCES_M}
    alarms = false | {"lamps": [0.95] * 60 + [0.0] * 60}
    counts = DetectionTrials(
        {variant.name: DetectionScores(alarms if variant.detector == "all_on" else false, true) for variant in VARIANTS}
    )
    claims = compared(counts)
    assert [one.verdict for one in claims] == ["differs", "holds", "shown", "holds"]
    assert "clip 0 of 40" in claims[0].ours
    assert "none had a candidate" in claims[0].why
    assert "lamps" not in claims[0].ours
    assert "lamps 60 of 120" in claims[1].ours
    assert not any("of 200" in one.ours for one in (*claims, ingredients(counts)))


def test_films_are_repeatable_and_hold_what_they_say() -> None:
    films = []
    for _ in range(2):
        rng = np.random.default_rng(5)
        films.append(film_moment(lamp_backdrop(rng), rng, None, 50.0, "all_on"))
    one, other = films
    assert len(one.frames) == FRAMES
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(one.frames, other.frames, strict=True))
    assert one.truth is not None
    x, y = round(one.truth.x), round(one.truth.y)
    # header: on, off, on, off
    light = [frame.pixels[y - 3 : y + 4, x - 3 : x + 4].mean() for frame in one.frames[one.first : one.first + 4]]
    assert min(light[0], light[2]) > 150
    assert max(light[1], light[3]) < 30
    found = VariantDetector(VARIANTS[0]).candidates(one)
    assert ablation.score_of_array(found, one.truth, None) > 0.9
    assert ablation.score_of_array(found, one.truth.moved(40, 0), None) == 0


def test_lamps_change_between_frames() -> None:
    images = list(lamp_backdrop(np.random.default_rng(1)).footage.frames())
    assert images[0].shape == SIZE
    assert any(np.abs(a.astype(int) - b).max() > 50 for a, b in pairwise(images))


@pytest.mark.parametrize("beside", [False, True])
def test_identities_are_told_apart(beside: bool) -> None:
    scenes = {"drawn scene": drawn_backdrop}
    told = confusion((50.0, 150.0), scenes, 1, None, Context(), (0, 1), (0, 6, 28), beside=beside)
    for one in told.values():
        assert one.counts.sum() == one.right.trials == (6 if beside else 3)
        assert one.right.errors == one.right.trials
        assert one.wrong.errors == one.missed.errors == 0
        # the requested identities, and additional neighbours
        assert (one.counts.sum(1)[[0, 6, 28]] >= 1).all()


def test_two_arrays_in_one_view_are_counted_each_at_its_place() -> None:
    places = [Placement(x_m=-0.4, y_m=0.0), Placement(x_m=0.4, y_m=0.1)]
    rng = np.random.default_rng(2)
    film = film_moment(drawn_backdrop(rng), rng, None, 50.0, "m_sequence", (3, 17), small_camera(places))
    assert identities_seen(film) == [3, 17]
    left, right = film.truths
    assert right.x - left.x == pytest.approx(0.8 * 2917 / 50, abs=0.5)
    # a position without an array is a miss, despite the neighbouring array
    assert identities_seen(replace(film, truths=(left.moved(0, 60), right))) == [IDENTITIES, 17]


def test_best_of_nothing() -> None:
    assert ablation.best_false([]) is None
    assert DetectionScores({}, {}).all_false().size == 0


def test_the_result_has_counts() -> None:
    done: ExperimentResult = detection.run(Context(), DetectionEffort(1, 1, 4, 1, 15))
    assert done.key == "fig6"
    assert all(" of " in finding.ours for finding in done.findings)
    assert [finding.verdict for finding in done.findings[-2:]] == ["shown", "shown"]
    assert len(done.data["identities"]["25 m"]) == 30


@pytest.mark.real_data
def test_clips_are_backdrops(data: Path) -> None:
    scenes = backdrops({"night": data / "driving" / "night-road.mp4"}, 4)
    rng = np.random.default_rng(0)
    film = film_moment(scenes["night"](rng), rng, None)
    assert film.truth is None
    assert film.frames[0].pixels.shape == (512, 1024)
    assert film.frames[0].pixels.std() > 5


def clip_of(path: Path, level: int) -> None:
    """Write a clip with four uniform frames."""
    with create_film(path, width=64, height=48, rate_hz=30) as film:
        for k in range(4):
            film.write(Frame(k, k / 30, np.full((48, 64), level, np.uint8)))


def test_a_clip_that_is_replaced_is_read_anew(tmp_path: Path) -> None:
    path, rng = tmp_path / "clip.mkv", np.random.default_rng(0)
    levels = []
    for level in (40, 200):
        clip_of(path, level)
        levels.append(int(next(iter(ClipBackdrop(path, 4)(rng).footage.frames())).mean()))
    assert levels == pytest.approx([40, 200], abs=1)
    path.unlink()
    with pytest.raises(MediaError, match="cannot read"):
        ClipBackdrop(path, 4)(rng)
