"""Films with and without an array, searched by each variant of the detector and by the receiver."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel import Placement
from heliograph.channel.settings import ChannelSettings
from heliograph.experiments.detection.clutter import LAMPS, ClutterFilm, HeaderKind, Surroundings, film_moment
from heliograph.experiments.detection.variants import (
    REFERENCE,
    VARIANTS,
    HeaderCandidate,
    VariantDetector,
    detections,
    is_same,
)
from heliograph.experiments.report import Context
from heliograph.link.settings import load_settings
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


@dataclass(slots=True)
class DetectionScores:
    """Best scores of a detector in each film."""

    # By scene: score of the best candidate in films with no array, 0 for none
    false: dict[str, list[float]] = field(default_factory=dict)
    # By scene and distance in m: score of the array, 0 if missed
    true: dict[tuple[str, float], list[float]] = field(default_factory=dict)

    def all_false(self, scenes: Collection[str] | None = None) -> Floats:
        """Scores of films with no array, (n,)."""
        return np.hstack([[], *(scores for scene, scores in self.false.items() if scenes is None or scene in scenes)])

    def all_true(self, distance_m: float | None = None, scenes: Collection[str] | None = None) -> Floats:
        """Scores of films with an array, (n,)."""
        chosen = [
            values
            for (scene, z), values in self.true.items()
            if distance_m in (None, z) and (scenes is None or scene in scenes)
        ]
        return np.hstack([[], *chosen])

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
        return threshold_for_found(self.all_true(), FOUND)

    def found_at(self, distance_m: float, fraction: float) -> Count:
        """Arrays found at the threshold that at most a fraction of the films with no array exceeds."""
        return self.found(threshold_for_false(self.all_false(), fraction), distance_m=distance_m)


def _count_above(scores: Floats, threshold: float) -> Count:
    return Count(scores.size, int((scores > threshold).sum()))


def threshold_for_false(false: Floats, fraction: float) -> float:
    """Lowest threshold that at most a fraction of the scores of films with no array exceeds."""
    allowed = int(fraction * false.size)
    return float(np.sort(false)[::-1][allowed]) if false.size > allowed else 0.0


def threshold_for_found(true: Floats, fraction: float) -> float:
    """Highest threshold that at least a fraction of the scores of arrays exceeds."""
    needed = int(np.ceil(fraction * true.size))
    return float(np.nextafter(np.sort(true)[::-1][needed - 1], -1)) if needed else 1.0


Scores = dict[str, DetectionScores]
"""Scores by detector."""

Example = tuple[float, ClutterFilm, Pose]
"""Score, film and pose of a false alarm."""


def measure(
    surroundings: Surroundings, without: int, with_array: int, context: Context
) -> tuple[Scores, Example | None]:
    """Score all detectors in films with no array and with an array; return the worst false alarm of `REFERENCE`."""
    batches: list[tuple[str, float | None, range]] = []
    for scene in surroundings.scenes:
        for distance_m in (None, *DISTANCES_M):
            # three times as many films of lamps
            films = range(with_array if distance_m else without * (3 if scene == LAMPS else 1))
            batches += [(scene, distance_m, films[start : start + 15]) for start in films[::15]]
    results = context.each("detection", partial(film_scene, surroundings), batches, (0, 0.7))
    scores = {name: DetectionScores() for name in (*VARIANTS, RECEIVER)}
    for (scene, distance_m, _), (found, _) in zip(batches, results, strict=True):
        for name, values in found.items():
            if distance_m is None:
                scores[name].false.setdefault(scene, []).extend(values)
            else:
                scores[name].true.setdefault((scene, distance_m), []).extend(values)
    return scores, _worst([example for _, example in results])


def _worst(examples: Sequence[Example | None]) -> Example | None:
    return max((example for example in examples if example), key=lambda example: example[0], default=None)


def film_scene(
    surroundings: Surroundings, batch: tuple[str, float | None, range]
) -> tuple[dict[str, list[float]], Example | None]:
    """Search the films of a scene by all variants and by the receiver: scores, and the worst false alarm."""
    scene, distance_m, films = batch
    number, backdrop = list(surroundings.scenes).index(scene), surroundings.scenes[scene]
    detectors = {name: VariantDetector(*variant) for name, variant in VARIANTS.items()}
    scores: dict[str, list[float]] = {name: [] for name in (*VARIANTS, RECEIVER)}
    examples: list[Example | None] = []
    for trial in films:
        seed = (surroundings.seed, number, trial, round(distance_m or 0))
        if distance_m is None:
            rng = np.random.default_rng(seed)
            film = film_moment(backdrop(rng), rng, surroundings.imu)
            for name, detector in detectors.items():
                best = max(detector.candidates(film), key=lambda candidate: candidate.score, default=None)
                scores[name].append(best.score if best else 0.0)
                if best and name == REFERENCE:
                    examples.append((best.score, film, best.pose))
            scores[RECEIVER].append(float(bool(detections(film))))
            continue
        # the same moment with an array of each kind of header
        kinds: tuple[HeaderKind, ...] = ("all_on", "m_sequence")
        for kind in kinds:
            rng = np.random.default_rng(seed)
            identity = int(rng.integers(IDENTITIES))
            film = film_moment(backdrop(rng), rng, surroundings.imu, distance_m, kind, (identity,))
            (truth,) = film.truths
            for name, detector in detectors.items():
                if VARIANTS[name][0] == kind:
                    wanted = identity if kind == "m_sequence" else None
                    scores[name].append(score_of_array(detector.candidates(film), truth, wanted))
            if kind == "m_sequence":
                hit = any(is_same(d.fit.pose, truth) and d.identity == identity for d in detections(film))
                scores[RECEIVER].append(float(hit))
    return scores, _worst(examples)


def score_of_array(found: Sequence[HeaderCandidate], truth: Pose, identity: int | None) -> float:
    """Highest score of candidates at the array, 0 for none."""
    return max((c.score for c in found if is_same(c.pose, truth) and identity in (None, c.identity)), default=0.0)


@dataclass(frozen=True, slots=True)
class Confusion:
    """Confusion matrix of identities."""

    # (30, 31): shown identities in rows, found identities in columns; the last column: missed
    counts: NDArray[np.int64]

    @property
    def right(self) -> Count:
        """Arrays found with the correct identity, of all arrays."""
        return Count(int(self.counts.sum()), int(np.trace(self.counts)))

    @property
    def wrong(self) -> Count:
        """Arrays found with another identity, of all arrays found."""
        found = int(self.counts[:, :-1].sum())
        return Count(found, found - int(np.trace(self.counts)))

    @property
    def missed(self) -> Count:
        """Missed arrays, of all arrays."""
        return Count(int(self.counts.sum()), int(self.counts[:, -1].sum()))


def confusion(
    surroundings: Surroundings,
    distances_m: Sequence[float],
    identities: Sequence[int],
    repeats: int,
    context: Context,
    span: tuple[float, float],
    *,
    two_in_view: bool = False,
) -> dict[float, Confusion]:
    """Film each identity at each distance, from a car at rest with shake."""
    works = [(z, identity) for z in distances_m for identity in identities]
    title = "identities, two in view" if two_in_view else "identities"
    results = context.each(title, partial(film_identity, surroundings, repeats, two_in_view), works, span)
    counts = {z: np.zeros((IDENTITIES, IDENTITIES + 1), dtype=np.int64) for z in distances_m}
    for (z, _), pairs in zip(works, results, strict=True):
        for shown, found in pairs:
            counts[z][shown, found] += 1
    return {z: Confusion(matrix) for z, matrix in counts.items()}


def film_identity(
    surroundings: Surroundings, repeats: int, two_in_view: bool, work: tuple[float, int]
) -> list[tuple[int, int]]:
    """Shown and found identity (30: none) of each array in films of an identity, each with another scene."""
    (distance_m, identity), backdrops = work, list(surroundings.scenes.values())
    pairs: list[tuple[int, int]] = []
    for repeat in range(repeats):
        kind = [1] if two_in_view else []
        rng = np.random.default_rng([surroundings.seed, round(10 * distance_m), identity, repeat, *kind])
        shown, places = [identity], [Placement(x_m=0.0, y_m=0.0)]
        if two_in_view:
            shown.append(int((identity + rng.integers(1, IDENTITIES)) % IDENTITIES))
            # panels are 0.36 m wide
            half = 0.5 * float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.2))
            places = [Placement(x_m=x, y_m=float(rng.uniform(-0.2, 0.2))) for x in (-half, half)]
        scene = backdrops[(identity + repeat) % len(backdrops)](rng)
        film = film_moment(scene, rng, surroundings.imu, distance_m, "m_sequence", shown, small_camera(places))
        pairs += zip(shown, identities_seen(film), strict=True)
    return pairs


def small_camera(places: Sequence[Placement]) -> ChannelSettings:
    """Reference link at rest, with a section of the sensor around the arrays."""
    channel = load_settings("paper", {"channel": {"speed_m_s": 0.0, "camera": {"width": 256, "height": 192}}}).channel
    return replace(channel, arrays=tuple(places))


def identities_seen(film: ClutterFilm) -> list[int]:
    """Identity found for each array of a film; 30: missed."""
    # the side is 6.2 px at 150 m, less than the default limit of the receiver
    hits = detections(film, 5.0)
    near = ([hit for hit in hits if is_same(hit.fit.pose, truth)] for truth in film.truths)
    return [max(found, key=lambda hit: hit.score).identity if found else IDENTITIES for found in near]
