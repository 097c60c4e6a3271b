"""Films with and without an array, searched by each variant of the detector and by the receiver."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import ImuTrace
from heliograph.experiments.detection import ablation
from heliograph.experiments.detection.ablation import VARIANTS, VariantDetector
from heliograph.experiments.detection.clutter import Backdrop, ClutterFilm, film_moment
from heliograph.experiments.detection.identities import detections
from heliograph.experiments.report import Context
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.header import IDENTITIES

DISTANCES_M = (25.0, 50.0, 80.0)

FOUND = 0.95
"""Fraction of the arrays above the fitted threshold."""

SCORE = ReceiveSettings().detect.score
"""Threshold of the receiver."""

RECEIVER = "receiver as set"
"""Name of the receiver in tables; its scores are 1 for a detection, else 0."""

LAMPS = "lamps"
"""Scene full of lamps, with three times as many films."""


@dataclass(slots=True)
class DetectionScores:
    """Best scores of a detector in each film."""

    # By scene: score of the best candidate in films with no array, 0 for none
    false: dict[str, list[float]] = field(default_factory=dict)
    # By scene and distance in m: score of the array, 0 if missed
    true: dict[tuple[str, float], list[float]] = field(default_factory=dict)

    def all_false(self, scenes: Collection[str] | None = None) -> NDArray[np.float64]:
        """Scores of films with no array, (n,)."""
        return np.hstack([[], *(self.false[scene] for scene in self.false if scenes is None or scene in scenes)])

    def all_true(self, distance_m: float | None = None, scenes: Collection[str] | None = None) -> NDArray[np.float64]:
        """Scores of films with an array, (n,)."""
        chosen = [
            place for place in self.true if distance_m in (None, place[1]) and (scenes is None or place[0] in scenes)
        ]
        return np.hstack([[], *(self.true[place] for place in chosen)])

    def false_alarms(self, threshold: float = SCORE, scenes: Collection[str] | None = None) -> Count:
        """Films with no array and a candidate above a threshold."""
        return _count_above(self.all_false(scenes), threshold)

    def found(
        self, threshold: float = SCORE, scenes: Collection[str] | None = None, distance_m: float | None = None
    ) -> Count:
        """Arrays with a score above a threshold."""
        return _count_above(self.all_true(distance_m, scenes), threshold)

    def fitted_threshold(self) -> float:
        """Threshold that the fraction `FOUND` of all arrays exceeds."""
        return ablation.threshold_for_found(self.all_true(), FOUND)

    def found_at(self, distance_m: float, fraction: float) -> Count:
        """Arrays found at the threshold that at most a fraction of the films with no array exceeds."""
        return self.found(ablation.threshold_for_false(self.all_false(), fraction), distance_m=distance_m)


def _count_above(scores: NDArray[np.float64], threshold: float) -> Count:
    return Count(scores.size, int((scores > threshold).sum()))


@dataclass(frozen=True, slots=True)
class DetectionEffort:
    """Number of films."""

    # Films of each scene with no array, and with an array at each distance
    without: int
    with_array: int
    # Frames of a clip, from the first on
    reach: int
    # Films of an identity at each distance
    repeats: int
    # Step between filmed identities
    step: int = 1


@dataclass(slots=True)
class DetectionTrials:
    """Scores of the variants and of the receiver."""

    scores: dict[str, DetectionScores] = field(
        default_factory=lambda: {name: DetectionScores() for name in (*(v.name for v in VARIANTS), RECEIVER)}
    )
    # Worst false alarm of the first variant: score, film and pose
    example: tuple[float, ClutterFilm, Pose] | None = None

    def add(self, more: "DetectionTrials") -> None:
        """Add the films of another batch."""
        for name, scores in more.scores.items():
            for scene, false in scores.false.items():
                self.scores[name].false.setdefault(scene, []).extend(false)
            for place, true in scores.true.items():
                self.scores[name].true.setdefault(place, []).extend(true)
        if more.example and (self.example is None or more.example[0] > self.example[0]):
            self.example = more.example


@dataclass(frozen=True, slots=True)
class SceneFilms:
    """Films of a scene."""

    scene: str
    backdrop: Backdrop
    # Number of the scene
    number: int
    # Distance of the array in m; None: no array
    distance_m: float | None
    # Numbers of the films
    trials: range
    # Recorded motion; None: a road of class C
    imu: ImuTrace | None
    seed: int


def measure(
    scenes: Mapping[str, Backdrop],
    effort: DetectionEffort,
    imu: ImuTrace | None,
    context: Context,
    batch_size: int = 15,
) -> DetectionTrials:
    """Score all variants in all films; a worker takes `batch_size` films at a time."""
    out = DetectionTrials()
    for batch in context.each(
        "detection", film_scene, _batches(scenes, effort, imu, context.seed, batch_size), (0, 0.7)
    ):
        out.add(batch)
    return out


def _batches(
    scenes: Mapping[str, Backdrop], effort: DetectionEffort, imu: ImuTrace | None, seed: int, batch_size: int
) -> Iterator[SceneFilms]:
    for number, (name, scene) in enumerate(scenes.items()):
        for distance in (None, *DISTANCES_M):
            without = effort.without * (3 if name == LAMPS else 1)
            films = range(without if distance is None else effort.with_array)
            for start in films[::batch_size]:
                yield SceneFilms(name, scene, number, distance, films[start : start + batch_size], imu, seed)


def film_scene(batch: SceneFilms) -> DetectionTrials:
    """Film a scene, and search each film by all variants and by the receiver."""
    out, detectors = DetectionTrials(), {variant.name: VariantDetector(variant) for variant in VARIANTS}
    for trial in batch.trials:
        if batch.distance_m is None:
            _search_without_array(out, detectors, batch, trial)
        else:
            _search_with_array(out, detectors, batch, trial, batch.distance_m)
    return out


def _search_without_array(
    out: DetectionTrials, detectors: Mapping[str, VariantDetector], batch: SceneFilms, trial: int
) -> None:
    rng = np.random.default_rng([batch.seed, batch.number, trial, 0])
    film = film_moment(batch.backdrop(rng), rng, batch.imu)
    for name, detector in detectors.items():
        best = ablation.best_false(detector.candidates(film))
        score = best.score if best else 0.0
        out.scores[name].false.setdefault(batch.scene, []).append(score)
        if best and name == VARIANTS[0].name and (out.example is None or score > out.example[0]):
            out.example = score, film, best.pose
    out.scores[RECEIVER].false.setdefault(batch.scene, []).append(float(bool(detections(film))))


def _search_with_array(
    out: DetectionTrials, detectors: Mapping[str, VariantDetector], batch: SceneFilms, trial: int, distance_m: float
) -> None:
    """Search the same moment with an array of each kind of header."""
    place = batch.scene, distance_m
    kinds: tuple[Literal["all_on", "m_sequence"], ...] = ("all_on", "m_sequence")
    for kind in kinds:
        rng = np.random.default_rng((batch.seed, batch.number, trial, round(distance_m)))
        identity = int(rng.integers(IDENTITIES))
        film = film_moment(batch.backdrop(rng), rng, batch.imu, distance_m, kind, (identity,))
        (truth,) = film.truths
        for variant in VARIANTS:
            if variant.detector == kind:
                candidates = detectors[variant.name].candidates(film)
                score = ablation.score_of_array(candidates, truth, identity if kind == "m_sequence" else None)
                out.scores[variant.name].true.setdefault(place, []).append(score)
        if kind == "m_sequence":
            hit = any(ablation.is_same(d.fit.pose, truth) and d.identity == identity for d in detections(film))
            out.scores[RECEIVER].true.setdefault(place, []).append(float(hit))


def is_lower(a: Count, b: Count) -> bool | None:
    """True if a rate is lower than another; None if their 95 % intervals overlap."""
    if a.interval()[1] < b.interval()[0]:
        return True
    return False if a.interval()[0] > b.interval()[1] else None
