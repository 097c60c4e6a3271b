"""Films with and without an array, searched by each variant of the detector and by the receiver."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from heliograph.channel import ImuTrace
from heliograph.experiments.detection import ablation
from heliograph.experiments.detection.ablation import VARIANTS, DetectionScores, VariantDetector
from heliograph.experiments.detection.clutter import Backdrop, ClutterFilm, film_moment
from heliograph.experiments.detection.identities import detections
from heliograph.experiments.report import Context
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.receive.settings import ReceiveSettings

DISTANCES = (25.0, 50.0, 80.0)
FOUND = 0.95
"""Fraction of the arrays that exceed the second threshold."""

SCORE = ReceiveSettings().detect.score
"""The receiver's own threshold, the first by which the variants are compared."""

LAMPS = "lamps"
"""The scene full of lamps, which move, flicker and turn; the others are footage and a drawn street at rest."""

BATCH = 15
"""Films of a scene that a worker takes at a time."""

LAMP_FILMS = 3
"""Times as many films of the lamps as of the other scenes: there the false alarms are."""


@dataclass(frozen=True, slots=True)
class DetectionEffort:
    """How many films are taken."""

    # without, with_array: films of each scene without an array, and with one at each distance
    without: int
    with_array: int
    # Frames of a clip that are used, from the first on
    reach: int
    # Films of an identity at each distance
    repeats: int
    # Every `step`-th identity is filmed
    step: int = 1


@dataclass(slots=True)
class DetectionTrials:
    """Scores of the variants, and counts of the receiver as it is set."""

    # Best scores in each film, by the variant's name
    scores: dict[str, DetectionScores] = field(
        default_factory=lambda: {variant.name: DetectionScores({}, {}) for variant in VARIANTS}
    )
    # Films without an array by scene; those in which the receiver finds one count as errors
    receiver_false: dict[str, Count] = field(default_factory=dict)
    # Films with an array by scene and distance in m; those in which the receiver finds it count as errors
    receiver_found: dict[tuple[str, float], Count] = field(default_factory=dict)
    # The worst false alarm of the first variant: score, film and pose
    example: tuple[float, ClutterFilm, Pose] | None = None

    def add(self, more: "DetectionTrials") -> None:
        """Count the films of another batch as well."""
        for name, scores in more.scores.items():
            for scene, false in scores.false.items():
                self.scores[name].false.setdefault(scene, []).extend(false)
            for where, true in scores.true.items():
                self.scores[name].true.setdefault(where, []).extend(true)
        for scene, count in more.receiver_false.items():
            self.receiver_false.setdefault(scene, Count()).add(count.trials, count.errors)
        for where, count in more.receiver_found.items():
            self.receiver_found.setdefault(where, Count()).add(count.trials, count.errors)
        if more.example and (self.example is None or more.example[0] > self.example[0]):
            self.example = more.example

    def set_false(self, scenes: Collection[str] | None = None) -> Count:
        """False alarms of the receiver as it is set."""
        return together(count for scene, count in self.receiver_false.items() if scenes is None or scene in scenes)

    def set_found(self, distance_m: float, scenes: Collection[str] | None = None) -> Count:
        """Arrays that the receiver as it is set finds."""
        return together(
            count
            for (scene, z), count in self.receiver_found.items()
            if z == distance_m and (scenes is None or scene in scenes)
        )


@dataclass(frozen=True, slots=True)
class SceneFilms:
    """Films of a scene."""

    # scene, backdrop, place: name of the scene, the scene, and its number among all
    scene: str
    backdrop: Backdrop
    place: int
    # Distance of the array in m; None: there is none
    distance_m: float | None
    # Numbers of the films among those of their scene and distance, each 0 or more
    trials: range
    # Recorded motion; None: a road of class C
    imu: ImuTrace | None
    # Seed of all films, 0 or more
    seed: int


def measure(
    scenes: Mapping[str, Backdrop], effort: DetectionEffort, imu: ImuTrace | None, context: Context
) -> DetectionTrials:
    """Scores of all variants in all films."""
    out = DetectionTrials()
    for one in context.each("detection", film_scene, _batches(scenes, effort, imu, context.seed), (0.0, 0.7)):
        out.add(one)
    return out


def _batches(
    scenes: Mapping[str, Backdrop], effort: DetectionEffort, imu: ImuTrace | None, seed: int
) -> Iterator[SceneFilms]:
    for place, (name, scene) in enumerate(scenes.items()):
        for distance in (None, *DISTANCES):
            bare = effort.without * (LAMP_FILMS if name == LAMPS else 1)
            films = range(bare if distance is None else effort.with_array)
            for start in films[::BATCH]:
                yield SceneFilms(name, scene, place, distance, films[start : start + BATCH], imu, seed)


def film_scene(batch: SceneFilms) -> DetectionTrials:
    """Film a scene, and search each film by all variants and by the receiver."""
    out, detectors = DetectionTrials(), {variant.name: VariantDetector(variant) for variant in VARIANTS}
    for trial in batch.trials:
        if batch.distance_m is None:
            rng = np.random.default_rng([batch.seed, batch.place, trial, 0])
            _without(out, detectors, batch.scene, film_moment(batch.backdrop(rng), rng, batch.imu))
        else:
            seed = (batch.seed, batch.place, trial, round(batch.distance_m))
            _with(out, detectors, batch.scene, batch.backdrop, batch.distance_m, seed, batch.imu)
    return out


def _without(out: DetectionTrials, detectors: Mapping[str, VariantDetector], scene: str, film: ClutterFilm) -> None:
    for name, detector in detectors.items():
        best = ablation.best_false(detector.candidates(film))
        score = best.score if best else 0.0
        out.scores[name].false.setdefault(scene, []).append(score)
        if best and name == VARIANTS[0].name and (out.example is None or score > out.example[0]):
            out.example = score, film, best.pose
    out.receiver_false.setdefault(scene, Count()).add(1, bool(detections(film)))


def _with(
    out: DetectionTrials,
    detectors: Mapping[str, VariantDetector],
    scene: str,
    backdrop: Backdrop,
    distance: float,
    seed: tuple[int, ...],
    imu: ImuTrace | None,
) -> None:
    """The same moment with an array of each kind of header."""
    films: dict[str, ClutterFilm] = {}
    for variant in VARIANTS:
        if variant.detector not in films:
            rng = np.random.default_rng(seed)
            identity = int(rng.integers(30))
            films[variant.detector] = film_moment(backdrop(rng), rng, imu, distance, variant.detector, (identity,))
        film, wanted = films[variant.detector], identity if variant.detector == "m_sequence" else None
        assert film.truth is not None
        score = ablation.score_of_array(detectors[variant.name].candidates(film), film.truth, wanted)
        out.scores[variant.name].true.setdefault((scene, distance), []).append(score)
    film = films["m_sequence"]
    assert film.truth is not None
    truth = film.truth
    found = any(ablation.same(one.fit.pose, truth) and one.identity == identity for one in detections(film))
    out.receiver_found.setdefault((scene, distance), Count()).add(1, found)


def together(counts: Iterable[Count]) -> Count:
    """The sum of counts."""
    every = list(counts)
    return Count(sum(c.trials for c in every), sum(c.errors for c in every))


def false_alarms(scores: DetectionScores, threshold: float = SCORE, scenes: Collection[str] | None = None) -> Count:
    """Films without an array in which a candidate exceeds a threshold."""
    false = [s for scene, found in scores.false.items() if scenes is None or scene in scenes for s in found]
    return Count(len(false), sum(s > threshold for s in false))


def found_above(scores: DetectionScores, threshold: float = SCORE, scenes: Collection[str] | None = None) -> Count:
    """Arrays at all distances whose score exceeds a threshold."""
    true = [s for (scene, _), found in scores.true.items() if scenes is None or scene in scenes for s in found]
    return Count(len(true), sum(s > threshold for s in true))


def threshold_of(scores: DetectionScores) -> float:
    """The threshold that `FOUND` of the arrays exceed, all distances together."""
    return ablation.threshold_for_found(np.concatenate([scores.all_true(z) for z in DISTANCES]), FOUND)


def found_at(scores: DetectionScores, distance: float, fraction: float) -> Count:
    """Arrays found at the threshold that at most a fraction of the films without one exceed."""
    true = scores.all_true(distance)
    return Count(true.size, int((true > ablation.threshold_for_false(scores.all_false(), fraction)).sum()))


def is_lower(a: Count, b: Count) -> bool | None:
    """Whether a rate is below another; None where their 95 % intervals overlap."""
    if a.interval()[1] < b.interval()[0]:
        return True
    return False if a.interval()[0] > b.interval()[1] else None
