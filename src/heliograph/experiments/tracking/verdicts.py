"""The paper's claims about tracking beside what was measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from heliograph.experiments.result import Finding, Verdict
from heliograph.experiments.tracking.known import KNOWN_BLOCK_PX, known_leds
from heliograph.experiments.tracking.runs import KNOWN
from heliograph.experiments.tracking.score import NEAR_PX, ScoreTable, TrackingScore

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
