"""False detections of the all-on header and of the M-sequence, and identities.

Short films of the reference link with and without an array. Backgrounds are footage of a moving camera, a drawn street,
and a street full of lamps: moving, flickering with the mains, pulsed at 100 Hz to 1000 Hz, rotating beacons, and matrix
signs with rows lit in turn. All films include the shake of the car.

Four variants of the detector search each film for the header with no score threshold. They search for the lit array or
for the M-sequences of 30 identities, in the difference of two frames or in f0 - 3 f1 + 3 f2 - f3 of four. All use the
search and fit of the receiver, on the same scenes, shake and noise. Three size ranges have separate candidates, since
parts of a lit square are lit squares. The score is the correlation of pixels and fitted header. A false alarm is a film
with no array and a candidate above the threshold. An array is found if a candidate of this place, size and (M-sequence)
identity exceeds the threshold. Arrays are searched only at the true place, false alarms in full frames: other places in
the frame may score higher than an array. The channel fades between frames of a clip, so moving objects change evenly,
which cancels in four frames but not in two; the shake moves the scene frame by frame.

Two thresholds apply: 0.9 as in the receiver, and the threshold that 95 % of these arrays exceed, which is high because
the arrays are clean, sharp and unoccluded. Footage and the street at rest are judged separately from the street full of
lamps, which is designed to deceive and has three times as many films. Curves, and the table of arrays found at equal
false alarms, use this mixture. The receiver has all its checks, for instance of alternating frames. Identities are
filmed separately, and with an array of another identity 0.5 m to 1.2 m away, with unsynchronised packets; each array is
searched at the true place. Intervals are Clopper-Pearson, 95 %.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.settings import ChannelSettings, Placement
from heliograph.experiments import plots
from heliograph.experiments.detection.clutter import (
    LAMPS,
    ClutterFilm,
    HeaderKind,
    Surroundings,
    backdrops,
    film_moment,
)
from heliograph.experiments.report import (
    Context,
    ExperimentResult,
    Finding,
    Table,
    count_text,
    interval_text,
    verdict_of,
)
from heliograph.link.settings import load_settings
from heliograph.link.simulate import load_imu
from heliograph.measure.statistics import Count
from heliograph.receive.build import search_parameters
from heliograph.receive.detect.alternation import DETECT, alternation_means, alternation_of, busy_blocks, coarse_search
from heliograph.receive.detect.candidate import cell_weights, fit_near
from heliograph.receive.detect.detection import ALL_ON, Detection, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.pose import UPRIGHT, Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings

REFERENCE, PAPER = "all on, 2 frames", "M-sequence, 2 frames"

VARIANTS: dict[str, tuple[HeaderKind, int]] = {
    REFERENCE: ("all_on", 2),
    "all on, 4 frames": ("all_on", 4),
    PAPER: ("m_sequence", 2),
    "M-sequence, 4 frames": ("m_sequence", 4),
}
"""Searched header and number of combined frames by variant: the reference and the detector of the paper; the last is
that of the receiver."""


@dataclass(frozen=True, slots=True)
class HeaderCandidate:
    """Candidate of a header in the image."""

    # Correlation of the pixels with the fitted header, 0 to 1
    score: float
    pose: Pose
    # Identity of the header; 0 for a lit array
    identity: int


class VariantDetector:
    """Search of the receiver with no score threshold and no check of adjacent frames."""

    def __init__(self, header: HeaderKind, frames: int):
        settings, signal = ReceiveSettings(), SignalSettings()
        all_on = header == "all_on"
        usual = search_parameters(settings, signal)
        # candidates of each size range
        self._parameters = replace(usual, coarse_score=0.2, score=0.0, candidates=5, all_on=all_on)
        self._frames_used, self._side = frames, signal.side
        self._cells = (ALL_ON if all_on else headers((UPRIGHT,))).cells
        # separate size ranges, as parts of a lit square are lit squares
        self._size_ranges = np.array_split(self._parameters.sides(), 3)

    def candidates(self, film: ClutterFilm) -> list[HeaderCandidate]:
        """Candidates in the header frames of a film; with an array in the film, only at its place."""
        window = film.frames[film.first : film.first + self._frames_used]
        change, first = alternation_of(window), window[0]
        busy = busy_blocks(alternation_means(window), first, (), self._side, self._parameters.min_contrast)
        for truth in film.truths:
            busy &= _blocks_near(truth, busy.shape)
        if not busy.any():
            return []
        combined = CombinedFrame(first.index, first.time_s, change, first.origin, first.full_scale)
        rows = [coarse_search(combined, busy, self._parameters, self._cells, sides)[0] for sides in self._size_ranges]
        fitted = [self._fit(change, row, first.full_scale) for row in np.concatenate(rows)]
        return [candidate for candidate in fitted if candidate is not None]

    def _fit(self, change: NDArray[np.float32], row: Floats, full_scale: int) -> HeaderCandidate | None:
        """Fit a candidate like the detector: first with a blur that hides single LEDs, then with the nominal blur."""
        number, blur = int(row[4]), self._parameters.blur_px
        weights = float(np.sign(row[0])) * cell_weights(self._cells[number], self._side)
        start = Pose(row[1] - 0.5, row[2] - 0.5, row[3] / self._side, 0.0, blur)
        rough = fit_near(change, (0, 0), start, weights, DETECT.upright_sigma, DETECT.hiding_blur)
        if rough is None:
            return None
        fit = fit_near(change, (0, 0), replace(rough.pose, blur=blur), weights, DETECT.upright_sigma)
        if fit is None or fit.score < 0 or not self._parameters.is_plausible(fit, full_scale):
            return None
        if not self._parameters.is_in_size_range(fit.pose, self._side):
            return None
        return HeaderCandidate(fit.score, fit.pose, number)


def _blocks_near(truth: Pose, blocks: tuple[int, ...]) -> NDArray[np.bool_]:
    """Blocks of the search, (rows, columns), within half the side of an array from its centre."""
    reach = 8 * truth.pitch + BLOCK_PX
    y, x = ((np.arange(n) + 0.5) * BLOCK_PX for n in blocks)
    return np.asarray((abs(y - truth.y) < reach)[:, None] & (abs(x - truth.x) < reach))


def detections(film: ClutterFilm, min_side_px: float | None = None) -> list[Detection]:
    """Detections of the receiver in a film."""
    settings, signal = ReceiveSettings(), SignalSettings()
    if min_side_px:
        settings = replace(settings, detect=replace(settings.detect, min_side_px=min_side_px))
    detector = PyramidSearch(search_parameters(settings, signal), signal)
    return [detection for frame in film.frames for detection in detector.search(frame)]


def is_same(pose: Pose, truth: Pose) -> bool:
    """True if a pose is within a quarter of the side and a factor 1.25 in size of the true pose."""
    distance = np.hypot(pose.x - truth.x, pose.y - truth.y)
    return bool(distance < 0.25 * 16 * truth.pitch and 1 / 1.25 < pose.pitch / truth.pitch < 1.25)


DISTANCES_M = (25.0, 50.0, 80.0)

FOUND = 0.95  # fraction of the arrays above the fitted threshold
SCORE = ReceiveSettings().detect.score  # threshold of the receiver
RECEIVER = "receiver as set"  # name of the receiver in tables; its scores are 1 for a detection, else 0


@dataclass(slots=True)
class DetectionScores:
    """Best scores of a detector in each film."""

    # By scene and distance in m: score of the array, 0 if missed; distance None: of the best candidate with no array
    films: dict[tuple[str, float | None], list[float]] = field(default_factory=dict)

    def chosen(self, distances_m: Collection[float | None], scenes: Collection[str] | None = None) -> Floats:
        """Scores of films of some distances and scenes, (n,)."""
        chosen = list[float]()
        for (scene, distance_m), scores in self.films.items():
            if distance_m in distances_m and (scenes is None or scene in scenes):
                chosen += scores
        return np.array(chosen)

    def all_false(self, scenes: Collection[str] | None = None) -> Floats:
        """Scores of films with no array, (n,)."""
        return self.chosen([None], scenes)

    def all_true(self, distance_m: float | None = None, scenes: Collection[str] | None = None) -> Floats:
        """Scores of films with an array, (n,)."""
        return self.chosen([distance_m] if distance_m else DISTANCES_M, scenes)

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


Scores = dict[str, DetectionScores]  # scores by detector

Example = tuple[float, ClutterFilm, Pose]  # score, film and pose of a false alarm


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
            scores[name].films.setdefault((scene, distance_m), []).extend(values)
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


FAR_M = 150.0  # distance in m beyond the range of the paper


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


def run(context: Context, effort: DetectionEffort | None = None) -> ExperimentResult:
    """Search films for false detections and identities."""
    effort = effort or (DetectionEffort(6, 3, 16, 1) if context.quick else DetectionEffort(75, 20, 220, 10))
    scenes, imu = backdrops(context.clips, effort.reach), load_imu(context.imu) if context.imu else None
    surroundings = Surroundings(scenes, imu, context.seed)
    scores, example = measure(surroundings, effort.without, effort.with_array, context)
    places, shown, repeats = (*DISTANCES_M, FAR_M), range(0, IDENTITIES, effort.step), effort.repeats
    alone = confusion(surroundings, places, shown, repeats, context, (0.7, 0.9))
    # a film counts two arrays
    beside = confusion(surroundings, places, shown, -(-repeats // 2), context, (0.9, 1.0), two_in_view=True)
    return report(scores, example, alone, beside)


def report(
    scores: Scores, example: Example | None, alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]
) -> ExperimentResult:
    """Judge, draw and tabulate scores and identities."""
    pictures = [
        (_roc(scores), "Arrays found against false alarms for falling thresholds, all scenes together; left: none."),
        (_matrices(alone, "one array in view"), "Identity shown (down) and found (across; last column: missed)."),
        (_matrices(beside, "two arrays in view"), "The same with two different identities, both counted."),
    ]
    if example:
        caption = "Fig. 6: a false detection of the all-on detector; frame, and difference of two frames."
        pictures.insert(0, (_example(*example), caption))
    return ExperimentResult(
        findings=[
            *compared(scores),
            _identities_found(alone, "alone"),
            _identities_found(beside, "two in view"),
            ingredients(scores),
            _receiver_finding(scores),
        ],
        pictures=pictures,
        tables=[*_score_tables(scores), _identity_table(alone, beside)],
        data={
            "scores": {
                name: _plain(scores[name], "true", lambda part: [round(score, 4) for score in part])
                for name in VARIANTS
            },
            "receiver": _plain(scores[RECEIVER], "found", lambda part: [int(sum(part)), len(part)]),
            "identities": {f"{z:g} m": c.counts.tolist() for z, c in alone.items()},
            "identities_two_in_view": {f"{z:g} m": c.counts.tolist() for z, c in beside.items()},
        },
    )


def _plain(scores: DetectionScores, true: str, plain: Callable[[list[float]], list[float]]) -> dict[str, Any]:
    """Plain values of the scores, by scene, and with the key `true` by scene and distance."""
    return {
        "false": {scene: plain(values) for (scene, z), values in scores.films.items() if z is None},
        true: {f"{scene}, {z:g} m": plain(values) for (scene, z), values in scores.films.items() if z is not None},
    }


def _example(score: float, film: ClutterFilm, pose: Pose) -> Figure:
    first, second = (film.frames[film.first + k].pixels.astype(float) for k in (0, 1))
    figure = Figure(figsize=(10, 3.4))
    panels = figure.subplots(1, 2, subplot_kw={"xticks": [], "yticks": []})
    shown = ((first, 0, 255, "frame"), (first - second, -80, 80, f"difference; score of the candidate {score:.2f}"))
    for axes, (image, low, high, title) in zip(panels, shown, strict=True):
        axes.imshow(image, vmin=low, vmax=high)
        axes.set_title(title)
        plots.mark_square(axes, pose.x, pose.y, 8 * pose.pitch)
    return figure


def curve(false: Floats, true: Floats) -> tuple[list[float], list[float]]:
    """Fractions of false alarms and of arrays found for falling thresholds."""
    thresholds = np.unique(np.concatenate([false, true, [0.0, 1.0]]))[::-1]
    alarms, found = ([float((scores > t).mean()) for t in thresholds] for scores in (false, true))
    return alarms, found


def _roc(measured: Scores) -> Figure:
    figure = Figure(figsize=(10, 5))
    smallest = 0.5 / max(measured[REFERENCE].all_false().size, 1)
    # lines of different widths stay visible below each other
    styles = (("C3", 8.0), (plots.ORANGE, 5.5), (plots.GREEN, 3.2), (plots.BLUE, 1.4))
    for axes, distance in zip(figure.subplots(1, 3, sharey=True), DISTANCES_M, strict=True):
        for name, (colour, width) in zip(VARIANTS, styles, strict=True):
            alarms, found = curve(measured[name].all_false(), measured[name].all_true(distance))
            rates = 1000 * np.maximum(alarms, smallest)
            axes.step(rates, found, where="post", color=colour, lw=width, label=name)
        receiver = measured[RECEIVER]
        false, found_rate = max(receiver.false_alarms().rate, smallest), receiver.found(distance_m=distance).rate
        axes.plot(1000 * false, found_rate, "*", color="black", ms=15, label=RECEIVER, clip_on=False, zorder=5)
        axes.set(xscale="log", xlim=(700 * smallest, 1000), ylim=(-0.03, 1.03))
        axes.set(xlabel="false alarms in 1000 frames", title=f"{distance:g} m")
        axes.xaxis.set_minor_formatter(NullFormatter())
    figure.axes[0].set_ylabel("fraction of arrays found")
    plots.legend_below(figure)
    return figure


def _matrices(confusions: Mapping[float, Confusion], title: str) -> Figure:
    figure = Figure(figsize=(10, 3.6))
    figure.suptitle(title)
    for axes, (distance, one) in zip(figure.subplots(1, len(confusions)), confusions.items(), strict=True):
        axes.imshow(one.counts / np.maximum(one.counts.sum(1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1)
        axes.grid(visible=False)
        axes.axvline(29.5, color=plots.GRAY, lw=0.8)
        axes.set(xlabel="found", xticks=[0, 10, 20, 30], yticks=[0, 10, 20])
        axes.set_title(f"{distance:g} m: {count_text(one.right)} right")
        axes.set_xticklabels(["0", "10", "20", "none"])
    figure.axes[0].set_ylabel("shown")
    return figure


def compared(measured: Scores) -> list[Finding]:
    """Judge the two claims about false detections at the threshold of the receiver, by kind of scene."""
    groups = _kinds(measured)
    return [
        *(_false_alarms(measured, kind, scenes) for kind, scenes in groups.items()),
        *(_unique(measured, kind, scenes) for kind, scenes in groups.items()),
    ]


def _kinds(measured: Scores) -> dict[str, list[str]]:
    """Scenes by kind: recorded and drawn scenes at rest, and the drawn lamps."""
    names = _scenes(measured)
    groups = {
        "footage and a street at rest": [name for name in names if name != LAMPS],
        "drawn lamps": [name for name in names if name == LAMPS],
    }
    return {kind: scenes for kind, scenes in groups.items() if scenes}


def _scenes(measured: Scores) -> list[str]:
    """Scenes with no array."""
    return [scene for scene, distance_m in measured[REFERENCE].films if distance_m is None]


def _false_alarms(measured: Scores, kind: str, scenes: list[str]) -> Finding:
    all_on = measured[REFERENCE]
    alarms, why = all_on.false_alarms(scenes=scenes), ""
    if not alarms.errors:
        highest = max(all_on.all_false(scenes), default=0.0)
        best = f"the best candidate scored {highest:.2f}" if highest else "none had a candidate"
        why = (
            f"No false alarm in {alarms.trials} films: {best}. The shake leaves only edges of the background; the "
            "round and rectangular lights of the paper are among the lamps."
        )
    return Finding(
        f"Fig. 6: with all LEDs on, the rest of the background can be mistaken for the array: {kind}.",
        f"All on, 2 frames, score above {SCORE}, films with a false alarm: {_by_scene(all_on, scenes)}.",
        verdict_of(bool(alarms.errors)),
        why,
    )


def _unique(measured: Scores, kind: str, scenes: list[str]) -> Finding:
    alarms = {name: measured[name].false_alarms(scenes=scenes) for name in (PAPER, REFERENCE)}
    fewer, parts = is_lower(alarms[PAPER], alarms[REFERENCE]), []
    for name in alarms:
        scores, fitted = measured[name], measured[name].fitted_threshold()
        parts.append(f"{_summary(name, scores, scenes)}; above {fitted:.3f}, {_by_scene(scores, scenes, fitted)}")
    return Finding(
        f"Section IV-A: the M-sequence is unique in the background and makes detection reliable: {kind}.",
        f"Score above {SCORE}, and above the threshold that {FOUND:.0%} of all these arrays exceed. "
        f"{'. '.join(parts)}.",
        verdict_of(fewer),
        "" if fewer is not None else "The intervals overlap: these films do not decide the claim.",
    )


def is_lower(a: Count, b: Count) -> bool | None:
    """True if a rate is lower than another; None if their 95 % intervals overlap."""
    if a.interval()[1] < b.interval()[0]:
        return True
    return False if a.interval()[0] > b.interval()[1] else None


def _by_scene(scores: DetectionScores, scenes: Collection[str], threshold: float = SCORE) -> str:
    """Films with a false alarm, by scene."""
    return ", ".join(f"{scene} {counted(scores.false_alarms(threshold, [scene]))}" for scene in scenes)


def _summary(name: str, scores: DetectionScores, scenes: list[str]) -> str:
    """False alarms and arrays found at the threshold of the receiver."""
    found = count_text(scores.found(scenes=scenes))
    return f"{name}: films with a false alarm {_by_scene(scores, scenes)}, found {found}"


def _identities_found(confusions: Mapping[float, Confusion], view: str) -> Finding:
    """Check the identities of detected arrays."""
    wrong, right = Count(), Count()
    for z in DISTANCES_M:
        wrong.include(confusions[z].wrong)
        right.include(confusions[z].right)
    far = confusions[FAR_M]
    return Finding(
        f"Section IV-A: arrays with different M-sequences are distinguished, {view}.",
        f"At 25 m to 80 m: right {counted(right)}, taken for another {counted(wrong)}; at {FAR_M:g} m right "
        f"{count_text(far.right)}, taken for another {count_text(far.wrong)}.",
        verdict_of(not wrong.errors and right.rate >= FOUND),
    )


def ingredients(measured: Scores) -> Finding:
    """Effect of the header and of the number of frames."""
    parts = [
        _summary(f"{name}, {kind}", measured[name], scenes)
        for name in VARIANTS
        for kind, scenes in _kinds(measured).items()
    ]
    claim = f"Question: the effect of header and number of frames, score above {SCORE}."
    return Finding(claim, "; ".join(parts) + ".", "shown")


def _receiver_finding(measured: Scores) -> Finding:
    """Results of the detector of the receiver."""
    parts, receiver = [], measured[RECEIVER]
    for kind, scenes in _kinds(measured).items():
        found = ", ".join(f"{z:g} m {count_text(receiver.found(scenes=scenes, distance_m=z))}" for z in DISTANCES_M)
        parts.append(f"{kind}: films with a false alarm {_by_scene(receiver, scenes)}, found {found}")
    return Finding("Question: the receiver's detector with default settings.", "; ".join(parts) + ".", "shown")


def counted(count: Count) -> str:
    """Count with 95 % interval as text."""
    return f"{count_text(count)} ({interval_text(count, '.1%', '-')})"


def _score_tables(measured: Scores) -> list[Table]:
    """Arrays found at 1 % of false alarms, and false alarms by scene at both thresholds."""
    rows = [[name, *(counted(measured[name].found_at(z, 0.01)) for z in DISTANCES_M)] for name in VARIANTS]
    rows.append([RECEIVER, *(counted(measured[RECEIVER].found(distance_m=z)) for z in DISTANCES_M)])
    tables = [
        Table(
            "Arrays found at no more than 10 false alarms in 1000 frames",
            ["variant", *(f"{z:g} m" for z in DISTANCES_M)],
            rows,
        )
    ]
    fitted = {name: measured[name].fitted_threshold() for name in VARIANTS}
    scenes = _scenes(measured)
    for thresholds, title in (
        (dict.fromkeys(VARIANTS, SCORE), "the receiver's threshold"),
        (fitted, f"the threshold that {FOUND:.0%} of the arrays exceed"),
    ):
        rows = [
            [name, f"{t:.3f}", *(counted(measured[name].false_alarms(t, [scene])) for scene in scenes)]
            for name, t in thresholds.items()
        ]
        tables.append(Table(f"Films with a false alarm at {title}", ["variant", "threshold", *scenes], rows))
    return tables


def _identity_table(alone: Mapping[float, Confusion], beside: Mapping[float, Confusion]) -> Table:
    rows = [
        [f"{z:g} m, {view}", counted(c.right), counted(c.wrong), counted(c.missed)]
        for view, by_distance in (("alone", alone), ("two in view", beside))
        for z, c in by_distance.items()
    ]
    return Table("Identities", ["distance", "right", "taken for another (of those found)", "missed"], rows)
