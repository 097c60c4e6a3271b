"""Figs. 11 and 12: the array cut out without and with tracking, and errors of five trackers."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict
from heliograph.experiments.tracking.runs import KNOWN, TRACKERS, TrackingFilm, TrackingRun, run_trackers
from heliograph.experiments.tracking.trackers import KNOWN_BLOCK_PX, known_leds
from heliograph.link.settings import load_settings

NEAR_PX = 0.25
"""Largest error in px that counts as near."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingScore:
    """Errors of one tracker in one film."""

    # Pairs of frames tracked
    pairs: int
    # rms_px, q999_px: error of the array's centre in px: rms and the 99.9 % quantile over the pairs
    rms_px: float
    q999_px: float
    # Pairs with an error of up to 0.25 px
    near: int
    # Pairs with an error in x or y of more than half the array's side: in a cut-out twice as wide as the array a part
    # of it is missing
    lost: int
    # Rms error in px within a packet after its best straight line in time is taken out: the vibration left for a
    # receiver that finds the array again at each header and knows its mean motion
    shake_px: float
    # Relative rms error of the pitch; None where the tracker gives none
    pitch: float | None


ScoreTable = Mapping[str, Mapping[str, TrackingScore]]
"""By film and tracker."""


def scores(runs: Sequence[TrackingRun]) -> dict[str, dict[str, TrackingScore]]:
    """Scores of all trackers, by film and tracker."""
    return {run.name: {name: score(run, errors) for name, errors in run.errors.items()} for run in runs}


def score(run: TrackingRun, errors: Floats) -> TrackingScore:
    """Score of a tracker."""
    off = np.hypot(errors[:, 0], errors[:, 1])
    widest = np.abs(errors[:, :2]).max(1)
    pitch = None if np.isnan(errors[:, 2]).any() else float(np.sqrt(np.mean(errors[:, 2] ** 2)))
    return TrackingScore(
        pairs=len(off),
        rms_px=float(np.sqrt(np.mean(off**2))),
        q999_px=float(np.quantile(off, 0.999)),
        near=int((off <= NEAR_PX).sum()),
        lost=int((widest > run.side_px / 2).sum()),
        shake_px=_shake(run, errors[:, :2]),
        pitch=pitch,
    )


def _shake(run: TrackingRun, errors: Floats) -> float:
    rests = []
    for packet in np.unique(run.packet):
        part = run.packet == packet
        # least pairs of a packet from which a straight line is taken out
        if part.sum() >= 10:
            line = np.vander(run.times_s[part] - run.times_s[part][0], 2)
            way = np.linalg.lstsq(line, errors[part], rcond=None)[0]
            rests.append(errors[part] - line @ way)
    return float(np.sqrt(np.mean(np.sum(np.concatenate(rests) ** 2, axis=1)))) if rests else 0.0


COLOURS = (plots.GRAY, plots.BLUE, plots.GREEN, plots.ORANGE, plots.PINK, plots.PURPLE)
"""Colour of each tracker."""


def pictures(runs: Sequence[TrackingRun]) -> list[tuple[Figure, str]]:
    """The array cut out without and with tracking in the first film, and the errors in all; each with its caption."""
    shown = runs[0]
    names = [f"{time:.2f} s" for time, _ in shown.cuts]
    drawn = []
    for place, label in ((0, "Fig. 11: without tracking"), (1, "Fig. 12: with tracking by inverted signals")):
        images = [cuts[place] for _, cuts in shown.cuts]
        figure = plots.image_row(images, names, largest=max(float(image.max()) for image in images))
        caption = f"{label}: pattern plus inverse, cut out twice as wide as the array was found, {shown.name}."
        drawn.append((figure, caption))
    caption = "Error of the tracked centre over time; the dashed line is half of the array's side, where it is lost."
    return [*drawn, (_error_lines(runs), caption)]


def _error_lines(runs: Sequence[TrackingRun]) -> Figure:
    columns = min(len(runs), 4)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(12, 0.6 + 2.8 * rows))
    for k, one in enumerate(runs):
        axes = figure.add_subplot(rows, columns, k + 1)
        for (name, errors), colour in zip(one.errors.items(), COLOURS, strict=True):
            off = np.maximum(np.hypot(errors[:, 0], errors[:, 1]), 1e-4)
            axes.plot(one.times_s, off, color=colour, lw=0.8, label=name)
        axes.plot(one.times_s, one.side_px / 2, color=plots.BLACK, lw=0.8, ls="--")
        axes.set(yscale="log", ylim=(1e-4, 1e3), title=one.name, xlabel="time (s)")
        axes.set_ylabel("error (px)" if k % columns == 0 else "")
        plots.tidy(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.tight_layout(rect=(0, 0.3 / figure.get_figheight() * 1.2, 1, 1))
    figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure


OURS, BACKGROUND = "inverted signals", "background"

MIDDLE_PX = 1.0
"""The array counts as in the middle of its cut-out if 99.9 % of the pairs are at most this many px off."""

LEFT = 0.5
"""Fraction of the vibration left from which on a tracker counts as failing."""

SIDE, PATTERNS_S = 16, 1000


@dataclass(frozen=True, slots=True)
class TrackingRate:
    """Data rate that a tracking method leaves."""

    # Name of the tracking method in tables
    method: str
    # Data bits per pattern, 0 to 256
    bits: int
    # Whether each pattern is followed by its inverse
    inverse: bool

    @property
    def per_slot(self) -> float:
        """Data bits per pattern shown, an inverse counted as one."""
        return self.bits / (2 if self.inverse else 1)

    @property
    def kb_s(self) -> float:
        """Data rate in kb/s, headers and code left out."""
        return self.per_slot * PATTERNS_S / 1000


def rates(lost: int | None = None) -> list[TrackingRate]:
    """Data rates by method."""
    every = SIDE * SIDE
    left = every - (int(known_leds(SIDE).sum()) if lost is None else lost)
    return [
        TrackingRate("none", every, False),
        TrackingRate("inverted signals", every, True),
        TrackingRate("known pattern", left, False),
        TrackingRate("known pattern, inverses sent all the same", left, True),
        TrackingRate("background", every, False),
        TrackingRate("background, inverses sent all the same", every, True),
        TrackingRate("OpenCV's, on the sums of pairs", every, True),
    ]


def findings(
    table: ScoreTable, dark: Mapping[str, Mapping[str, Sequence[str]]], *, whole: bool = True
) -> list[Finding]:
    """All claims."""
    return [
        _without(table, whole),
        _with(table),
        *(_background(table, what, films) for what, films in dark.items()),
        _dark(table, [film for films in dark.values() for film in films]),
        rate_finding(rates()),
        _shown(table, BACKGROUND, "The background's motion alone, not helped by later headers."),
        _shown(table, KNOWN, f"Tracking by known LEDs ({4 * KNOWN_BLOCK_PX**2} of 256 lit), each frame by itself."),
        _shown(table, "OpenCV MIL", "A general tracker: OpenCV's TrackerMIL, fed with the sums of pairs."),
        _shown(table, "OpenCV template", "Another: template matching, fed with the sums of pairs."),
    ]


def _without(table: ScoreTable, whole: bool) -> Finding:
    parts = {film: row["none"] for film, row in table.items()}
    stays = [film for film, s in parts.items() if not s.lost]
    return Finding(
        "Fig. 11: without tracking, the array moves out of the cut-out.",
        _list({film: f"partly out in {s.lost} of {s.pairs} pairs" for film, s in parts.items()}),
        _verdict(not stays) if whole or not stays else "shown",
        f"It stays inside in: {', '.join(stays)}.{'' if whole else ' The films are a part of the drive.'}"
        if stays
        else "",
    )


def _with(table: ScoreTable) -> Finding:
    parts = {film: row[OURS] for film, row in table.items()}
    bad = [film for film, s in parts.items() if s.lost or s.q999_px > MIDDLE_PX]
    texts = {f: f"99.9 % of {s.pairs} pairs within {s.q999_px:.3f} px, {s.lost} lost" for f, s in parts.items()}
    return Finding(
        "Fig. 12: with tracking by inverted signals, the array is reliably captured in the middle of the cut-out.",
        _list(texts),
        _verdict(not bad),
        f"More than {MIDDLE_PX:g} px off, or lost, in: {', '.join(bad)}." if bad else "",
    )


def _background(table: ScoreTable, what: str, films: Mapping[str, Sequence[str]]) -> Finding:
    """IV.B.2: the motion vector of the background fails where there is no background light."""
    days = dict.fromkeys(day for by_day in films.values() for day in by_day)
    kept = {film: _left(table, film) for film in (*days, *films)}
    judged = [film for film, by_day in films.items() if any(kept[day] < LEFT for day in by_day)]
    failed = [film for film in judged if kept[film] >= LEFT]
    works = [film for film in judged if film not in failed]
    why = [f"Not judged: {film}, as it works in none of its kind by day." for film in films if film not in judged]
    if works:
        rest = f"it fails in: {', '.join(failed)}." if failed else "it fails in none."
        why.append(f"It still takes out more than half of the vibration in: {', '.join(works)}; {rest}")
    texts = {
        film: f"{table[film][BACKGROUND].shake_px:.3f} of {table[film]['none'].shake_px:.3f} px vibration left "
        f"({left:.0%}), {table[film][BACKGROUND].pairs} pairs"
        for film, left in kept.items()
    }
    return Finding(
        f"IV.B.2: the motion vector of the background cannot track {what}, as there is no background light.",
        _list(texts),
        "shown" if not judged or (works and failed) else _verdict(not works),
        " ".join(why),
    )


def _left(table: ScoreTable, film: str) -> float:
    """Fraction of the vibration that the background's motion leaves."""
    return table[film][BACKGROUND].shake_px / max(table[film]["none"].shake_px, 1e-9)


def _dark(table: ScoreTable, films: list[str]) -> Finding:
    parts = {film: table[film][OURS] for film in films}
    bad = [film for film, s in parts.items() if s.near < s.pairs]
    return Finding(
        "IV.B: inverted signals solve this problem: they need no background.",
        _list({film: f"{s.near} of {s.pairs} pairs within {NEAR_PX:g} px" for film, s in parts.items()}),
        _verdict(not bad),
        f"Not all pairs in: {', '.join(f'{film} ({_left_over(parts[film])})' for film in bad)}." if bad else "",
    )


def _left_over(s: TrackingScore) -> str:
    return f"99.9 % within {s.q999_px:.3f} px, {s.lost} lost"


def rate_finding(table: list[TrackingRate]) -> Finding:
    """IV.B.1: the known pattern costs data rate, inverted signals improve on it."""
    by = {rate.method: rate for rate in table}
    ours, known = by["inverted signals"], by["known pattern"]
    both = by["known pattern, inverses sent all the same"]
    holds = ours.kb_s > known.kb_s
    lost = SIDE**2 - known.bits
    return Finding(
        "IV.B: a known tracking pattern takes LEDs from the data; inverted signals use the whole array, so the data "
        "rate is higher.",
        f"Known pattern: {lost} of 256 bits a pattern lost, {known.bits} left, {known.kb_s:g} kb/s; inverted signals: "
        f"256 bits a pair, {ours.per_slot:g} a pattern shown, {ours.kb_s:g} kb/s; a known pattern whose patterns are "
        f"inverted all the same, against flicker and background: {both.kb_s:g} kb/s.",
        _verdict(holds),
        ""
        if holds
        else "The inverse costs half of the patterns, the known LEDs less. The claim is true only among systems that "
        "send the inverse anyway, as is needed against flicker.",
    )


def _shown(table: ScoreTable, name: str, what: str) -> Finding:
    texts = {film: _text(row[name]) for film, row in table.items()}
    return Finding(what, _list(texts), "shown")


def _text(s: TrackingScore) -> str:
    return f"rms {s.rms_px:.3f} px, 99.9 % {s.q999_px:.3f} px, {s.lost} of {s.pairs} pairs lost"


def _list(texts: dict[str, str]) -> str:
    return "; ".join(f"{film}: {text}" for film, text in texts.items()) + "."


def _verdict(holds: bool) -> Verdict:
    return "holds" if holds else "differs"


DAY = "drawn scene"
APERTURE = {"5 stops less": 2.0**-5, "8 stops less": 2.0**-8}
"""Background light at the small apertures, by that at f/2: f/11 and f/32."""

NIGHT = "no light"
START_M, SHORT_S = 50.0, 2.0
"""Distance in m at which the films of a quick run begin, and their length in s, all together."""

TEXT = (
    "One drive, filmed before several backgrounds with the same motion and the same noise, tracked by all. Each "
    "tracker starts at the pose that the receiver's detector found, at the end of the first header, and none is "
    "helped later. Error: distance of the tracked centre from the true one, the mean of the pair's two frames. "
    "Inverted signals: the receiver's own tracker; PWM lights the first part of T_b, so a sum shows the array some "
    "0.2 ms before the middle of the exposures, where the truth is taken: the tracker allows for that. Known "
    "pattern: four blocks of 4 x 4 LEDs in the corners always lit, random data elsewhere, no inverse, "
    "each frame fitted with the same motion model; its light differs, its headers do not; where its fit runs away "
    "it counts as lost, and stays. Background: Lucas-Kanade on features around the array, their median motion from "
    "a key pair, added up; it measures neither the array's size nor its own drift, and takes the array, "
    "which is nearer, to move like the background. General: of OpenCV 5 only TrackerMIL needs no trained model; "
    "its boxes have whole pixels, and its features are drawn by a generator that cannot be set, so its numbers "
    "change with the films a process tracked before; sub-pixel template matching stands beside it. Both get the "
    "sums of pairs, which exist only because inverses are sent. Vibration left: error within a packet of 100 ms "
    "after its best straight line is taken out, so as if each header gave position and steady motion anew; a "
    "tracker that leaves half of it or more is said to fail. Small aperture: the background's light is cut by 5 or "
    "8 stops, the array's is kept, as it is in all films. Footage brings the shake and the drive of its own camera "
    "into the background, which the array does not have: that counts against the background's motion vector, the "
    "drawn scene is its fair test. A dark film is therefore judged only where the background's motion vector works "
    "in one of its kind by day: drawn films beside the drawn scene, clips with night in their names beside the "
    "other clips. All trackers see every pair of whole frames; the known pattern, which has films of its own, sees "
    "24 px around the array."
)


def run(context: Context) -> ExperimentResult:
    """Run all trackers on all films."""
    runs = context.each("tracking", run_trackers, _films(context))
    table = scores(runs)
    dark = {
        "at a small aperture": {name: [DAY] for name in APERTURE},
        "at night": {NIGHT: [DAY], **night_clips(context.clips)},
    }
    return ExperimentResult(
        key="fig11",
        title="Fig. 11 and 12: tracking",
        text=TEXT,
        findings=findings(table, dark, whole=not context.quick),
        pictures=pictures(runs),
        tables=tables(table),
        data={"scores": _plain(table), "rates_kb_s": {rate.method: rate.kb_s for rate in rates()}},
    )


def night_clips(clips: Iterable[str]) -> dict[str, list[str]]:
    """Clips filmed at night, by their names, each with those filmed by day."""
    every = list(clips)
    dark = [name for name in every if "night" in name.lower()]
    return {name: [day for day in every if day not in dark] for name in dark}


def _films(context: Context) -> list[TrackingFilm]:
    """The drive before a drawn scene, at small apertures, at night, and before each clip."""
    drawn = {"kind": "synthetic"}
    films = [_film(context, DAY, drawn)]
    films += [_film(context, name, {**drawn, "gain": gain}) for name, gain in APERTURE.items()]
    films.append(_film(context, NIGHT, {"kind": "flat", "level": 0.0}, {"panel_level": 0.0}))
    return films + [_film(context, name, {"kind": "footage"}, clip=name) for name in context.clips]


def _film(
    context: Context,
    name: str,
    background: Mapping[str, Any],
    emitter: Mapping[str, Any] | None = None,
    clip: str | None = None,
) -> TrackingFilm:
    shake = {"shake": "imu"} if context.imu else {"shake": "road", "road_class": "C"}
    part = (
        {"distance_m": START_M, "duration_s": SHORT_S / (2 + len(APERTURE) + len(context.clips))}
        if context.quick
        else {}
    )
    channel = {**shake, **part, "background": background, "emitter": emitter or {}}
    return TrackingFilm(
        name=name,
        settings=load_settings("paper", {"channel": channel}),
        seed=context.seed,
        clip=context.clips[clip] if clip else None,
        imu=context.imu,
    )


def tables(table: ScoreTable) -> list[Table]:
    """Errors by tracker and film, and the data rate each way of tracking leaves."""
    some = next(iter(table.values()))[OURS].pairs
    return [
        _table(f"Error of the centre, rms / 99.9 % in px ({some} pairs a film)", table, _error_cell),
        _table("Vibration left within a packet, rms in px", table, lambda s: f"{s.shake_px:.3f}"),
        _table(f"Pairs within {NEAR_PX:g} px, and pairs lost", table, lambda s: f"{s.near / s.pairs:.1%}, {s.lost}"),
        _table("Error of the pitch, rms", table, lambda s: "none" if s.pitch is None else f"{s.pitch:.2%}"),
        Table(
            "Data rate by way of tracking: bits of a pattern, halved where an inverse follows, times 1000 patterns a "
            "second; headers (4 of 100 patterns) and code left out",
            ["tracking", "bits lost", "bits a pattern", "bits a pattern shown", "kb/s"],
            [[r.method, str(256 - r.bits), str(r.bits), f"{r.per_slot:g}", f"{r.kb_s:g}"] for r in rates()],
        ),
    ]


def _table(title: str, table: ScoreTable, cell: Callable[[TrackingScore], str]) -> Table:
    rows = [[name, *(cell(row[name]) for row in table.values())] for name in TRACKERS]
    return Table(title, ["tracker", *table], rows)


def _error_cell(s: TrackingScore) -> str:
    return f"{s.rms_px:.3f} / {s.q999_px:.3f}" if s.q999_px < 10 else f"{s.rms_px:.1f} / {s.q999_px:.1f}"


def _plain(table: ScoreTable) -> dict[str, dict[str, dict[str, Any]]]:
    return {film: {name: asdict(one) for name, one in row.items()} for film, row in table.items()}
