"""Tracking: the array cut out without and with tracking, and errors of six trackers.

All trackers process films of a drive with different backgrounds, the same motion and the same noise. Each tracker
starts at the detected pose, at the end of the first header, and gets no help later. Error: distance between the tracked
and the true centre, averaged over the two frames of a pair.

Inverted signals: the tracker of the receiver. PWM lights the first part of T_b, so the sum shows the array 0.2 ms
before the middle of the exposure, the time of the truth; the tracker corrects for this. Known pattern: blocks of 4 x 4
LEDs in the corners are always lit, the others show random data with no inverse; each frame is fitted with the same
motion model. A diverging fit counts as lost. Background: Lucas-Kanade on features around the array; the median motion
from a key pair is added up. This tracker measures neither the size of the array nor drift, and assumes that the near
array moves like the background. General trackers: only TrackerMIL of OpenCV 5 needs no trained model. It has boxes of
integer pixels and random features with no seed, so results depend on earlier films of the process. Template matching
has sub-pixel resolution. Both process the sums of pairs, which exist only because of the inverses.

Vibration left: error within a packet of 100 ms after subtraction of the best straight line, as if each header gave
position and steady motion. A tracker fails if at least half of the vibration is left. Small aperture: the background is
5 or 8 stops darker, the array equally bright. Footage adds the shake and the drive of another camera to the background,
which disadvantages the background tracker; the drawn scene is a fair test. A dark film is therefore judged only if the
background tracker works in a similar film by day: the drawn scene for drawn films, the other clips for clips with
"night" in their names. Trackers process full frames; the known pattern needs other films, rendered up to 24 px around
the array.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.channel.camera import film
from heliograph.channel.truth import ArrayTruth, Truth
from heliograph.experiments import plots
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.experiments.trackers import (
    BackgroundMotion,
    Follower,
    InvertedSignals,
    KnownPattern,
    MultipleInstance,
    TemplateMatch,
    is_in_header,
    known_leds,
    known_light,
)
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.receive.build import search_parameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import cut_out

KNOWN, OURS = "known pattern", "inverted signals"
TRACKERS: Mapping[str, type[Follower]] = {
    "none": Follower,
    OURS: InvertedSignals,
    KNOWN: KnownPattern,
    "background": BackgroundMotion,
    "OpenCV MIL": MultipleInstance,
    "OpenCV template": TemplateMatch,
}
"""Trackers by name."""

Pair = tuple[Frame, Frame, ArrayTruth, ArrayTruth]  # two successive frames, and the truth of the array in both

Error = tuple[float, float, float]  # errors of x and y in px, and relative error of the pitch

Cut = tuple[float, tuple[Floats, Floats]]  # time, and the sum cut out at the first pose and at the tracked pose


@dataclass(frozen=True)
class TrackingRun:
    """Errors of the trackers in a film, by pair of frames."""

    name: str
    # (n,) time in s, and true side of the array in px
    times_s: Floats
    side_px: Floats
    # (n,) number of the packet
    packet: NDArray[np.int64]
    # By tracker (n, 3): error of x and y in px, and relative error of the pitch (NaN: not estimated)
    errors: Mapping[str, Floats]
    # Sums for the pictures
    cuts: list[Cut] = field(default_factory=list)


def run_trackers(
    clips: Mapping[str, Path], imu: Path | None, seed: int, named: tuple[str, LinkSettings]
) -> TrackingRun:
    """Run all trackers on a film, given by name and settings, with recorded footage and motion, if any."""
    name, settings = named
    channel = settings.channel
    footage = load_footage(clips[name]) if channel.background.kind == "footage" else None
    recordings = Recordings(footage=footage, imu=load_imu(imu) if imu else None)
    pairs = _pairs(simulate(settings, default_messages(settings), seed, recordings))
    # the detector needs fewer pairs after a header
    held = deque[Pair](maxlen=17)
    found = _detect(settings, pairs, held)
    if found is None:
        raise HeliographError(f"the array was not found in the film '{name}'")
    length_s = channel.duration_s or (channel.distance_m - channel.stop_m) / channel.speed_m_s
    moments = np.linspace(0.02, 0.97, 8) * length_s * channel.camera.fps
    cut_frames = [max(int(k), held[-1][0].index) for k in moments]
    others = [name for name in TRACKERS if name != KNOWN]
    rows, errors, cuts = _follow(settings, found, chain(held, pairs), others, cut_frames)
    # the same drive, scene and noise with the light of the known pattern, rendered around the array
    known_film = film(
        channel,
        [known_light(settings, settings.transmit.identities[0], seed)],
        np.random.default_rng(seed),
        pattern_period_s=settings.signal.pattern_period_s,
        slot_order=settings.signal.slot_order,
        footage=recordings.footage,
        imu=recordings.imu,
        roi_margin_px=24,  # more than the window of a tracker on the array
    )
    errors |= _follow(settings, found, _pairs(known_film), [KNOWN])[1]
    times, pitch = np.array(rows).T
    packet = np.floor(times / settings.signal.packet_s + 1e-6).astype(np.int64)
    arrays = {tracker: np.array(errors[tracker]) for tracker in TRACKERS}
    return TrackingRun(name, times, settings.signal.side * pitch, packet, arrays, cuts)


def _pairs(frames: Iterator[tuple[Frame, Truth]]) -> Iterator[Pair]:
    """Frames 0 and 1, 2 and 3, ..."""
    for (first, true), (second, later) in zip(frames, frames, strict=False):
        yield first, second, true.arrays[0], later.arrays[0]


def _detect(settings: LinkSettings, pairs: Iterable[Pair], held: deque[Pair]) -> Detection | None:
    """Search pairs for the array, and hold the last pairs."""
    detector = PyramidSearch(search_parameters(settings.receive, settings.signal), settings.signal)
    for pair in pairs:
        held.append(pair)
        if hits := [hit for frame in pair[:2] for hit in detector.search(frame)]:
            return hits[0]
    return None


def _follow(
    settings: LinkSettings,
    found: Detection,
    pairs: Iterable[Pair],
    names: Sequence[str],
    cut_frames: Sequence[int] = (),
) -> tuple[list[tuple[float, float]], dict[str, list[Error]], list[Cut]]:
    """Start trackers at the last pair of the detected header, and follow the array.

    Returns time and pitch of each pair, errors by tracker, and the sums of the first pairs from `cut_frames`
    on, cut out twice as wide as the array.
    """
    signal, frames, followers = settings.signal, list(cut_frames), dict[str, Follower]()
    poses, rows, cuts = dict[str, Pose](), list[tuple[float, float]](), list[Cut]()
    errors: dict[str, list[Error]] = {name: [] for name in names}
    for pattern, inverted, true, later in pairs:
        since = pattern.time_s - found.start_time_s
        if followers:
            x, y, pitch = (0.5 * (getattr(true, n) + getattr(later, n)) for n in ("x", "y", "pitch_px"))
            rows.append((pattern.time_s, pitch))
            for name, follower in followers.items():
                pose = poses[name] = follower.update(pattern, inverted)
                relative = pose.pitch / pitch - 1 if follower.sized else np.nan
                errors[name].append((pose.x - x, pose.y - y, relative))
        elif since > -1e-9 and not is_in_header(settings, since + 2 * signal.pattern_period_s):
            followers = {name: TRACKERS[name](settings, found, pattern, inverted) for name in names}
        if frames and pattern.index >= frames[0]:
            frames.pop(0)
            if OURS in poses:
                fixed, tracked = (_sum_at(pattern, inverted, p, signal.side) for p in (found.fit.pose, poses[OURS]))
                cuts.append((pattern.time_s, (fixed, tracked)))
    return rows, errors, cuts


def _sum_at(pattern: Frame, inverted: Frame, pose: Pose, side: int) -> Floats:
    half = round(side * pose.pitch)
    window = (round(pose.x) - half, round(pose.y) - half, 2 * half + 1, 2 * half + 1)
    return cut_out(pattern, window) + cut_out(inverted, window)


BACKGROUND = "background"

NEAR_PX = 0.25  # largest error in px that counts as near


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingScore:
    """Errors of a tracker in a film."""

    pairs: int
    # Error of the centre in px: rms and 99.9 % quantile over the pairs
    rms_px: float
    q999_px: float
    # Pairs with an error of up to 0.25 px
    near: int
    # Pairs with an error in x or y above half the side, so that a cut-out twice as wide lacks a part of the array
    lost: int
    # Rms error in px within a packet after subtraction of the best straight line
    shake_px: float
    # Relative rms error of the pitch; None if not estimated
    pitch: float | None


ScoreTable = Mapping[str, Mapping[str, TrackingScore]]  # scores by film and tracker


def scores(runs: Sequence[TrackingRun]) -> ScoreTable:
    """Score all trackers, by film and tracker."""
    return {run.name: {name: score(run, errors) for name, errors in run.errors.items()} for run in runs}


def score(run: TrackingRun, errors: Floats) -> TrackingScore:
    """Score a tracker."""
    off = np.hypot(errors[:, 0], errors[:, 1])
    return TrackingScore(
        pairs=len(off),
        rms_px=_rms(off),
        q999_px=float(np.quantile(off, 0.999)),
        near=int((off <= NEAR_PX).sum()),
        lost=int((np.abs(errors[:, :2]).max(1) > run.side_px / 2).sum()),
        shake_px=_shake(run, errors[:, :2]),
        pitch=None if np.isnan(errors[:, 2]).any() else _rms(errors[:, 2]),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _shake(run: TrackingRun, errors: Floats) -> float:
    rests = []
    for packet in np.unique(run.packet):
        part = run.packet == packet
        # a line through fewer pairs would hide the vibration
        if part.sum() >= 10:
            line = np.vander(run.times_s[part] - run.times_s[part][0], 2)
            rests.append(errors[part] - line @ np.linalg.lstsq(line, errors[part], rcond=None)[0])
    return float(np.sqrt(np.mean(np.sum(np.concatenate(rests) ** 2, axis=1)))) if rests else 0.0


def _pictures(runs: Sequence[TrackingRun]) -> list[tuple[Figure, str]]:
    """Cut-outs without and with tracking in the first film, and the errors in all films."""
    shown = runs[0]
    names = [f"{time:.2f} s" for time, _ in shown.cuts]
    drawn = []
    for k, label in enumerate(("Fig. 11: without tracking", "Fig. 12: with tracking by inverted signals")):
        images = [cuts[k] for _, cuts in shown.cuts]
        figure = plots.image_row(images, names, largest=max(float(image.max()) for image in images))
        caption = f"{label}: pattern plus inverse, cut out twice as wide as the detected array, {shown.name}."
        drawn.append((figure, caption))
    caption = "Error of the tracked centre over time; the array is lost above the dashed line, half of the side."
    return [*drawn, (_error_plot(runs), caption)]


def _error_plot(runs: Sequence[TrackingRun]) -> Figure:
    columns = min(len(runs), 4)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(10, 0.6 + 2.8 * rows))
    colours = (plots.GRAY, plots.BLUE, plots.GREEN, plots.ORANGE, "C3", "C4")
    for k, run in enumerate(runs):
        axes = figure.add_subplot(rows, columns, k + 1, title=run.name, xlabel="time (s)")
        for (name, errors), colour in zip(run.errors.items(), colours, strict=True):
            off = np.maximum(np.hypot(errors[:, 0], errors[:, 1]), 1e-4)
            axes.plot(run.times_s, off, color=colour, lw=0.8, label=name)
        axes.plot(run.times_s, run.side_px / 2, color="black", lw=0.8, ls="--", label="half of the side")
        axes.set(yscale="log", ylim=(1e-4, 1e3), ylabel="error (px)" if k % columns == 0 else "")
    plots.legend_below(figure)
    return figure


@dataclass(frozen=True, slots=True)
class TrackingRate:
    """Data rate of a tracking method."""

    method: str
    # Data bits per pattern
    bits: int
    # True if an inverse follows each pattern
    inverse: bool = True

    @property
    def kb_s(self) -> float:
        """Data bits per shown pattern, or kb/s at 1000 patterns/s, inverses included, headers and code left out."""
        return self.bits / (2 if self.inverse else 1)


def rates(lost: int | None = None) -> list[TrackingRate]:
    """Data rates by method; `lost` bits of a known pattern carry no data."""
    left = 256 - (int(known_leds(16).sum()) if lost is None else lost)
    return [
        TrackingRate("none", 256, False),
        TrackingRate(OURS, 256),
        TrackingRate(KNOWN, left, False),
        TrackingRate("known pattern, inverses sent all the same", left),
        TrackingRate("background", 256, False),
        TrackingRate("background, inverses sent all the same", 256),
        TrackingRate("OpenCV's, on the sums of pairs", 256),
    ]


def findings(table: ScoreTable, dark: Mapping[str, Mapping[str, Sequence[str]]], *, full: bool = True) -> list[Finding]:
    """Judge all claims; `dark` maps a condition to dark films and counterparts by day."""
    other = {
        BACKGROUND: "The background's motion with no help from later headers.",
        KNOWN: "Tracking by known LEDs (64 of 256 lit), each frame separately.",
        "OpenCV MIL": "A general tracker: OpenCV's TrackerMIL, fed with the sums of pairs.",
        "OpenCV template": "Another: template matching, fed with the sums of pairs.",
    }
    return [
        _without_tracking(table, full),
        _with_tracking(table),
        *(_background(table, condition, films) for condition, films in dark.items()),
        _dark(table, [film for films in dark.values() for film in films]),
        rate_finding(rates()),
        *(Finding(claim, _by_film(table, name, _errors_text), "shown") for name, claim in other.items()),
    ]


def _by_film(table: ScoreTable, name: str, text: Callable[[TrackingScore], str]) -> str:
    """Text of a tracker for each film."""
    return "; ".join(f"{film}: {text(row[name])}" for film, row in table.items()) + "."


def _errors_text(s: TrackingScore) -> str:
    return f"rms {s.rms_px:.3f} px, 99.9 % {s.q999_px:.3f} px, {s.lost} of {s.pairs} pairs lost"


def _without_tracking(table: ScoreTable, full: bool) -> Finding:
    stays = [film for film, row in table.items() if not row["none"].lost]
    rest = "" if full else " The films cover a part of the drive."
    return Finding(
        "Fig. 11: without tracking, the array moves out of the cut-out.",
        _by_film(table, "none", lambda s: f"partly out in {s.lost} of {s.pairs} pairs"),
        verdict_of(not stays if full or not stays else None),
        f"It stays inside in: {', '.join(stays)}.{rest}" if stays else "",
    )


def _with_tracking(table: ScoreTable) -> Finding:
    # the array counts as centred if 99.9 % of the pairs are within 1 px
    bad = [film for film, row in table.items() if row[OURS].lost or row[OURS].q999_px > 1]
    return Finding(
        "Fig. 12: with tracking by inverted signals, the array is reliably captured in the middle of the cut-out.",
        _by_film(table, OURS, lambda s: f"99.9 % of {s.pairs} pairs within {s.q999_px:.3f} px, {s.lost} lost"),
        verdict_of(not bad),
        f"More than 1 px off, or lost, in: {', '.join(bad)}." if bad else "",
    )


def _background(table: ScoreTable, condition: str, films: Mapping[str, Sequence[str]]) -> Finding:
    """IV.B.2: the motion vector of the background fails with no background light."""
    days = dict.fromkeys(day for by_day in films.values() for day in by_day)
    # fraction of the vibration that the background tracker leaves; it fails from 1/2 on
    left = {f: table[f][BACKGROUND].shake_px / max(table[f]["none"].shake_px, 1e-9) for f in (*days, *films)}
    judged = [film for film, by_day in films.items() if any(left[day] < 0.5 for day in by_day)]
    failed = [film for film in judged if left[film] >= 0.5]
    works = [film for film in judged if film not in failed]
    why = [
        f"Not judged: {film}, as the tracker fails in all similar films by day." for film in films if film not in judged
    ]
    if works:
        rest = f"it fails in: {', '.join(failed)}." if failed else "it fails in none."
        why.append(f"It still removes more than half of the vibration in: {', '.join(works)}; {rest}")
    texts = [
        f"{film}: {table[film][BACKGROUND].shake_px:.3f} of {table[film]['none'].shake_px:.3f} px vibration left "
        f"({fraction:.0%}), {table[film][BACKGROUND].pairs} pairs"
        for film, fraction in left.items()
    ]
    return Finding(
        f"IV.B.2: the motion vector of the background cannot track {condition}, as there is no background light.",
        f"{'; '.join(texts)}.",
        verdict_of(None if not judged or (works and failed) else not works),
        " ".join(why),
    )


def _dark(table: ScoreTable, films: Sequence[str]) -> Finding:
    dark = {film: table[film] for film in films}
    bad = [
        f"{film} (99.9 % within {row[OURS].q999_px:.3f} px, {row[OURS].lost} lost)"
        for film, row in dark.items()
        if row[OURS].near < row[OURS].pairs
    ]
    return Finding(
        "IV.B: inverted signals solve this problem: they need no background.",
        _by_film(dark, OURS, lambda s: f"{s.near} of {s.pairs} pairs within {NEAR_PX:g} px"),
        verdict_of(not bad),
        f"Not all pairs in: {', '.join(bad)}." if bad else "",
    )


def rate_finding(table: list[TrackingRate]) -> Finding:
    """IV.B.1: the known pattern costs data rate, inverted signals improve the rate."""
    by = {rate.method: rate for rate in table}
    ours, known, both = by[OURS], by[KNOWN], by["known pattern, inverses sent all the same"]
    holds = ours.kb_s > known.kb_s
    why = (
        "The inverse costs half of the patterns, the known LEDs less. The claim is true only among systems that "
        "send the inverse anyway, as is needed against flicker."
    )
    return Finding(
        "IV.B: a known tracking pattern takes LEDs from the data; inverted signals use all LEDs, so the data rate is "
        "higher.",
        f"Known pattern: {256 - known.bits} of 256 bits a pattern lost, {known.bits} left, {known.kb_s:g} kb/s; "
        f"inverted signals: 256 bits a pair, {ours.kb_s:g} a pattern shown, {ours.kb_s:g} kb/s; a known pattern "
        f"whose patterns are inverted all the same, against flicker and background: {both.kb_s:g} kb/s.",
        verdict_of(holds),
        "" if holds else why,
    )


DAY, NIGHT = "drawn scene", "no light"
APERTURE = {"5 stops less": 2.0**-5, "8 stops less": 2.0**-8}  # background light at f/11 and f/32, relative to f/2


def run(context: Context) -> ExperimentResult:
    """Run all trackers on all films."""
    job = partial(run_trackers, context.clips, context.imu, context.seed)
    runs = context.each("tracking", job, _films(context))
    table = scores(runs)
    dark = {
        "at a small aperture": {name: [DAY] for name in APERTURE},
        "at night": {NIGHT: [DAY], **night_clips(context.clips)},
    }
    return ExperimentResult(
        findings=findings(table, dark, full=not context.quick),
        pictures=_pictures(runs),
        tables=tables(table),
        data={
            "scores": {film: {name: asdict(s) for name, s in row.items()} for film, row in table.items()},
            "rates_kb_s": {rate.method: rate.kb_s for rate in rates()},
        },
    )


def night_clips(clips: Iterable[str]) -> dict[str, list[str]]:
    """Clips with "night" in their names, each with all clips by day."""
    names = list(clips)
    dark = [name for name in names if "night" in name.lower()]
    return {name: [day for day in names if day not in dark] for name in dark}


def _films(context: Context) -> list[tuple[str, LinkSettings]]:
    """The drive with a drawn scene, at small apertures, at night, and with each clip."""
    backgrounds: dict[str, dict[str, Any]] = {
        DAY: {"kind": "synthetic"},
        **{name: {"kind": "synthetic", "gain": gain} for name, gain in APERTURE.items()},
        NIGHT: {"kind": "flat", "level": 0.0},
    }
    films = [*backgrounds.items(), *((name, {"kind": "footage"}) for name in context.clips)]
    common = {"shake": "imu"} if context.imu else {"shake": "road", "road_class": "C"}
    # a quick run films 2 s in total
    part = {"distance_m": 50.0, "duration_s": 2.0 / len(films)} if context.quick else {}
    out = []
    for name, background in films:
        emitter = {"panel_level": 0.0} if name == NIGHT else {}
        settings = load_settings("paper", {"channel": {**common, **part, "background": background, "emitter": emitter}})
        out.append((name, settings))
    return out


def tables(table: ScoreTable) -> list[Table]:
    """Errors by tracker and film."""
    pairs = next(iter(table.values()))[OURS].pairs
    cells: dict[str, Callable[[TrackingScore], str]] = {
        f"Error of the centre, rms / 99.9 % in px ({pairs} pairs a film)": _error_cell,
        "Vibration left within a packet, rms in px": lambda s: f"{s.shake_px:.3f}",
        f"Pairs within {NEAR_PX:g} px, and pairs lost": lambda s: f"{s.near / s.pairs:.1%}, {s.lost}",
        "Error of the pitch, rms": lambda s: "none" if s.pitch is None else f"{s.pitch:.2%}",
    }
    rows = {
        title: [[name, *(cell(row[name]) for row in table.values())] for name in TRACKERS]
        for title, cell in cells.items()
    }
    return [Table(name, ["tracker", *table], part) for name, part in rows.items()]


def _error_cell(s: TrackingScore) -> str:
    form = ".3f" if s.q999_px < 10 else ".1f"
    return f"{s.rms_px:{form}} / {s.q999_px:{form}}"
