"""Films with and without an array, and what each way of detecting and the receiver make of them."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from heliograph.channel import ImuTrace
from heliograph.experiments.detection import ablation as cand
from heliograph.experiments.detection.ablation import WAYS, Probe, Scores
from heliograph.experiments.detection.clutter import Film, shoot
from heliograph.experiments.detection.identities import detections
from heliograph.experiments.detection.lamps import Backdrop
from heliograph.experiments.result import Context
from heliograph.measure.statistics import Count
from heliograph.receive import Pose
from heliograph.receive.settings import ReceiveSettings

DISTANCES = (25.0, 50.0, 80.0)
FOUND = 0.95
"""Share of arrays that the second threshold lets through."""

SCORE = ReceiveSettings().detect.score
"""The receiver's own threshold, by which the ways are compared first."""

LAMPS = "lamps"
"""The scene full of lamps, which move, flicker and turn; the others are footage and a drawn street at rest."""

BATCH = 15
"""Films of a scene that a worker takes at a time."""

LAMP_FILMS = 3
"""Times as many films of the lamps as of the other scenes: there the false alarms are."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is filmed.

    Attributes
    ----------
    without, with_array
        Films of each scene without an array, and with one at each distance.
    reach
        Frames of a clip that are used.
    repeats, step
        Films of an identity at each distance; every `step`-th identity is filmed.
    """

    without: int
    with_array: int
    reach: int
    repeats: int
    step: int = 1


@dataclass(slots=True)
class Measured:
    """Scores of the four ways, and counts of the receiver as it is set."""

    scores: dict[str, Scores] = field(default_factory=lambda: {way.name: Scores({}, {}) for way in WAYS})
    receiver_false: dict[str, Count] = field(default_factory=dict)
    receiver_found: dict[tuple[str, float], Count] = field(default_factory=dict)
    example: tuple[float, Film, Pose] | None = None

    def add(self, more: "Measured") -> None:
        """Take the films of another batch."""
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
        """False alarms of the receiver as it is set, in some scenes or all."""
        return together(count for scene, count in self.receiver_false.items() if scenes is None or scene in scenes)

    def set_found(self, distance_m: float, scenes: Collection[str] | None = None) -> Count:
        """Arrays it finds at a distance, in some scenes or all."""
        return together(
            count
            for (scene, z), count in self.receiver_found.items()
            if z == distance_m and (scenes is None or scene in scenes)
        )


@dataclass(frozen=True, slots=True)
class Batch:
    """Films of a scene: which, with an array at a distance (None: without one), and what they are drawn from."""

    scene: str
    backdrop: Backdrop
    place: int
    distance_m: float | None
    trials: range
    imu: ImuTrace | None
    seed: int


def measure(scenes: Mapping[str, Backdrop], effort: Effort, imu: ImuTrace | None, context: Context) -> Measured:
    """Scores of all ways in all films."""
    out = Measured()
    for one in context.each("detection", film_batch, _batches(scenes, effort, imu, context.seed), (0.0, 0.7)):
        out.add(one)
    return out


def _batches(scenes: Mapping[str, Backdrop], effort: Effort, imu: ImuTrace | None, seed: int) -> Iterator[Batch]:
    for place, (name, scene) in enumerate(scenes.items()):
        for distance in (None, *DISTANCES):
            bare = effort.without * (LAMP_FILMS if name == LAMPS else 1)
            films = range(bare if distance is None else effort.with_array)
            for start in films[::BATCH]:
                yield Batch(name, scene, place, distance, films[start : start + BATCH], imu, seed)


def film_batch(batch: Batch) -> Measured:
    """Film and search."""
    out, probes = Measured(), {way.name: Probe(way) for way in WAYS}
    for trial in batch.trials:
        if batch.distance_m is None:
            rng = np.random.default_rng([batch.seed, batch.place, trial, 0])
            _without(out, probes, batch.scene, shoot(batch.backdrop(rng), rng, batch.imu))
        else:
            seed = (batch.seed, batch.place, trial, round(batch.distance_m))
            _with(out, probes, batch.scene, batch.backdrop, batch.distance_m, seed, batch.imu)
    return out


def _without(out: Measured, probes: Mapping[str, Probe], scene: str, film: Film) -> None:
    for name, probe in probes.items():
        best = cand.best_false(probe.candidates(film))
        score = best.score if best else 0.0
        out.scores[name].false.setdefault(scene, []).append(score)
        if best and name == WAYS[0].name and (out.example is None or score > out.example[0]):
            out.example = score, film, best.pose
    out.receiver_false.setdefault(scene, Count()).add(1, bool(detections(film)))


def _with(
    out: Measured,
    probes: Mapping[str, Probe],
    scene: str,
    backdrop: Backdrop,
    distance: float,
    seed: tuple[int, ...],
    imu: ImuTrace | None,
) -> None:
    """The same moment with an array of each kind of header."""
    films: dict[str, Film] = {}
    for way in WAYS:
        if way.detector not in films:
            rng = np.random.default_rng(seed)
            identity = int(rng.integers(30))
            films[way.detector] = shoot(backdrop(rng), rng, imu, distance, way.detector, (identity,))
        film, wanted = films[way.detector], identity if way.detector == "m_sequence" else None
        assert film.truth is not None
        score = cand.score_of_array(probes[way.name].candidates(film), film.truth, wanted)
        out.scores[way.name].true.setdefault((scene, distance), []).append(score)
    film = films["m_sequence"]
    assert film.truth is not None
    truth = film.truth
    found = any(cand.same(one.fit.pose, truth) and one.identity == identity for one in detections(film))
    out.receiver_found.setdefault((scene, distance), Count()).add(1, found)


def together(counts: Iterable[Count]) -> Count:
    """The sum of counts."""
    every = list(counts)
    return Count(sum(c.trials for c in every), sum(c.errors for c in every))


def false_alarms(scores: Scores, threshold: float = SCORE, scenes: Collection[str] | None = None) -> Count:
    """Films without an array, of some scenes or all, in which something exceeds a threshold."""
    false = [s for scene, found in scores.false.items() if scenes is None or scene in scenes for s in found]
    return Count(len(false), sum(s > threshold for s in false))


def found_above(scores: Scores, threshold: float = SCORE, scenes: Collection[str] | None = None) -> Count:
    """Arrays at all distances, in some scenes or all, that exceed a threshold."""
    true = [s for (scene, _), found in scores.true.items() if scenes is None or scene in scenes for s in found]
    return Count(len(true), sum(s > threshold for s in true))


def threshold_of(scores: Scores) -> float:
    """The threshold that `FOUND` of the arrays exceed, all distances together."""
    return cand.threshold_for_found(np.concatenate([scores.all_true(z) for z in DISTANCES]), FOUND)


def found_at(scores: Scores, distance: float, share: float) -> Count:
    """Arrays found at the threshold that at most a share of the films without one exceed."""
    true = scores.all_true(distance)
    return Count(true.size, int((true > cand.threshold_for_false(scores.all_false(), share)).sum()))


def less(a: Count, b: Count) -> bool | None:
    """Whether rate a is below rate b; None where the intervals overlap."""
    if a.interval()[1] < b.interval()[0]:
        return True
    return False if a.interval()[0] > b.interval()[1] else None
