"""The paper's experiments, each with its claims beside what was measured."""

import io
import json
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError, SettingsError
from heliograph.base.files import write_whole
from heliograph.experiments.report import Report
from heliograph.experiments.result import Chapter, Context, Finding

EXPERIMENTS = {
    "fig3": ("patterns.received", "received image at 10 m and 70 m"),
    "fig4": ("patterns.pwm", "pulse width modulation and the exposure"),
    "fig5": ("patterns.packet", "packet format"),
    "fig6": ("detection.experiment", "false detections, and identities told apart"),
    "fig7": ("patterns.header", "the header near and at 25 m"),
    "fig8": ("patterns.inverse", "inverted pattern and sum (Fig. 8 and 9)"),
    "fig11": ("tracking.experiment", "tracking over a drive (Fig. 11 and 12)"),
    "fig13": ("error_rates.experiment", "bit error rate by distance, static and driving"),
    "tables": ("patterns.parameters", "Tables I and II, data rates"),
    "flicker": ("flicker.experiment", "flicker of the whole array"),
    "systems": ("systems.experiment", "other systems in the same channel"),
    "soft": ("calibration.experiment", "the soft receiver: likelihoods and distances"),
}
"""Experiments by name: the module below this package that runs each, and what it shows."""

ALIASES = {"fig9": "fig8", "fig12": "fig11", "table1": "tables", "table2": "tables"}

CLIPS = "driving"
IMU = Path("motion") / "car-imu.csv"
"""Where a folder of recordings has its clips and its motion trace."""


def chosen(names: Sequence[str]) -> list[str]:
    """Names of experiments as asked for, all where none is named.

    Raises
    ------
    SettingsError
        There is no experiment of a name; the message names the nearest.
    """
    keys = [ALIASES.get(name, name) for name in map(str.lower, names)]
    for key in keys:
        if key not in EXPERIMENTS:
            close = get_close_matches(key, [*EXPERIMENTS, *ALIASES], 1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(EXPERIMENTS)}"
            raise SettingsError(f"unknown figure '{key}'; {hint}")
    return list(dict.fromkeys(keys)) or list(EXPERIMENTS)


def recordings_in(folder: Path | None) -> dict[str, Any]:
    """Clips and motion trace of a folder of recordings, as fields of `Context`."""
    if folder is None:
        return {}
    clips = {path.stem: path for path in sorted((folder / CLIPS).glob("*.mp4"))}
    if not clips:
        raise MediaError(f"{folder} has no {CLIPS}/*.mp4; give a folder of recordings, or none to use a drawn scene")
    imu = folder / IMU
    return {"clips": clips, "imu": imu if imu.is_file() else None}


def reproduce(keys: Sequence[str], context: Context, folder: Path, begin: Callable[[str, str], None]) -> list[Chapter]:
    """Run experiments and write the report anew after each, so that an interrupted run leaves what it had.

    Parameters
    ----------
    keys
        Names of `EXPERIMENTS`.
    context
        What they may use.
    folder
        Gets report.html, its claims as report.md, pictures (NAME-1.png, ...) and data (NAME.json).
    begin
        Called with name and title before each.
    """
    chapters: list[Chapter] = []
    for key in keys:
        module, title = EXPERIMENTS[key]
        begin(key, title)
        chapter = import_module(f"heliograph.experiments.{module}").run(context)
        _write_parts(folder, chapter)
        chapters.append(chapter)
        write_report(folder / "report.html", chapters, context)
        write_whole(folder / "report.md", markdown(chapters, context).encode())
    return chapters


def write_report(path: Path, chapters: Sequence[Chapter], context: Context) -> None:
    """Write the page of all chapters."""
    page = Report("The experiments of Nagura et al. 2010, measured")
    scene = f"footage {', '.join(context.clips)}" if context.clips else "a drawn scene"
    motion = "a recorded trace" if context.imu else "a road by ISO 8608"
    page.text(f"Simulated in the reference link; background: {scene}; shake: {motion}; seed {context.seed}.", note=True)
    if context.quick:
        page.text("A quick run: few trials, so the intervals are wide.")
    page.heading("Claims and measurements")
    page.table(("", "claim", "measured", "verdict"), [row for c in chapters for row in _verdicts(c)], prose=True)
    for chapter in chapters:
        _add(page, chapter)
    page.write(path)


def markdown(chapters: Sequence[Chapter], context: Context) -> str:
    """Claims and measurements as a Markdown page, for a project's documents."""
    run = "A quick run: few trials, wide intervals." if context.quick else "The full run."
    scene = ", ".join(context.clips) or "a drawn scene"
    lines = ["# The paper's experiments, measured", "", f"{run} Background: {scene}; seed {context.seed}.", ""]
    for chapter in chapters:
        lines += [f"## {chapter.title}", "", chapter.text, "", "| claim | measured | verdict |", "|---|---|---|"]
        lines += [f"| {_cell(f.claim)} | {_cell(f'{f.ours} {f.why}')} | {f.verdict} |" for f in chapter.findings]
        lines.append("")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _verdicts(chapter: Chapter) -> list[tuple[str, str, str, str]]:
    return [(chapter.key, f.claim, f.ours, f.verdict) for f in chapter.findings]


def _add(page: Report, chapter: Chapter) -> None:
    page.heading(chapter.title)
    page.text(chapter.text)
    for finding in chapter.findings:
        page.text(f"{finding.verdict}: {finding.claim} Measured: {finding.ours} {finding.why}".rstrip())
    for figure, caption in chapter.pictures:
        page.figure(figure, caption)
    for table in chapter.tables:
        page.text(table.title)
        page.table(table.head, table.rows)


def _write_parts(folder: Path, chapter: Chapter) -> None:
    """Pictures and data of a chapter, each file whole or not at all."""
    for number, (figure, _) in enumerate(chapter.pictures, 1):
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=130, bbox_inches="tight")
        write_whole(folder / f"{chapter.key}-{number}.png", picture.getvalue())
    content = {"title": chapter.title, "findings": [_plain(f) for f in chapter.findings], "data": chapter.data}
    write_whole(folder / f"{chapter.key}.json", json.dumps(content, indent=1).encode())


def _plain(finding: Finding) -> dict[str, str]:
    return {"claim": finding.claim, "ours": finding.ours, "verdict": finding.verdict, "why": finding.why}
