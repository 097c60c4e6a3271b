"""Fig. 11 and 12: the array cut out without and with tracking, and five ways of tracking on the same films."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

from heliograph.experiments.result import Context, ExperimentResult, Table
from heliograph.experiments.tracking.pictures import pictures
from heliograph.experiments.tracking.runs import TRACKERS, TrackingFilm, run_trackers
from heliograph.experiments.tracking.score import NEAR_PX, ScoreTable, TrackingScore, scores
from heliograph.experiments.tracking.verdicts import OURS, findings, rates
from heliograph.link.settings import load_settings

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
