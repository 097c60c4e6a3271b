"""Experiments run by name, and their report: each claim beside the measurement."""

import io
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from heliograph.base import registry
from heliograph.base.errors import MediaError, SettingsError, printable
from heliograph.base.files import write_whole
from heliograph.experiments.report import Context, ExperimentResult, Finding, Report, Table
from heliograph.sweeps.points import Recorded, build

EXPERIMENTS = {
    "fig3": ("patterns.received", "received image at 10 m and 70 m"),
    "fig4": ("patterns.pwm", "pulse width modulation and the exposure"),
    "fig5": ("patterns.packet", "packet format"),
    "fig6": ("detection.experiment", "false detections and identities"),
    "fig7": ("patterns.header", "the header near and at 25 m"),
    "fig8": ("patterns.inverse", "inverted pattern and sum (Fig. 8 and 9)"),
    "fig11": ("tracking.experiment", "tracking over a drive (Fig. 11 and 12)"),
    "fig13": ("error_rates.experiment", "bit error rate by distance, static and driving"),
    "tables": ("patterns.parameters", "Tables I and II, data rates"),
    "flicker": ("flicker.experiment", "flicker of the whole array"),
    "systems": ("systems.experiment", "other systems in the same channel"),
    "soft": ("calibration.experiment", "the soft receiver: calibration of LLRs, and distances"),
}
"""Experiments that are run by default, by name: the module below this package that runs each, and its subject."""

FURTHER = {
    "scenes": ("error_rates.scenes", "error rates in hard scenes"),
    "repeated-packets": ("error_rates.repeated_packets", "packets received again"),
    "acquisition": ("detection.acquisition", "acquisition of an array that is switched on"),
    "known-channel": ("calibration.known_receiver", "the soft receiver beside the known channel"),
    "header-separation": ("detection.header_separation", "distances between headers"),
    "timing-loss": ("patterns.timing_loss", "loss of a camera out of step"),
}
"""Experiments beside the paper's, which are run by name only."""

ALIASES = {"fig9": "fig8", "fig12": "fig11", "table1": "tables", "table2": "tables", "calibration": "soft"}

CLIPS = "driving"
IMU = Path("motion") / "car-imu.csv"
"""Places of clips and motion trace in a folder of recordings."""


def chosen(names: Sequence[str]) -> list[str]:
    """Names of the experiments that are asked for, each once."""
    keys = [ALIASES.get(name, name) for name in map(str.lower, names)]
    for key in keys:
        if key not in EXPERIMENTS and key not in FURTHER:
            close = get_close_matches(key, [*EXPERIMENTS, *FURTHER, *ALIASES], 1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join([*EXPERIMENTS, *FURTHER])}"
            raise SettingsError(f"unknown experiment '{key}'; {hint}")
    return list(dict.fromkeys(keys)) or list(EXPERIMENTS)


def recordings_in(folder: Path | None) -> dict[str, Any]:
    """Clips and motion trace of a folder of recordings, as fields of `Context`."""
    if folder is None:
        return {}
    films = sorted(path for path in (folder / CLIPS).glob("*") if path.suffix.lower() == ".mp4")
    clips = dict[str, Path]()
    for path in films:
        name = printable(path.stem)
        clips[printable(path.name) if name in clips else name] = path
    if not clips:
        raise MediaError(f"{folder} has no {CLIPS}/*.mp4; give a folder of recordings, or none to use a drawn scene")
    imu = folder / IMU
    return {"clips": clips, "imu": imu if imu.is_file() else None}


def done_before(keys: Sequence[str], context: Context, folder: Path) -> dict[str, ExperimentResult]:
    """Results that an earlier run left in a folder, by name: of the same effort, seed, recordings and code alone."""
    if not folder.is_dir():
        return {}
    run = _run(context)
    found = ((key, _read_parts(folder, key, run)) for key in keys)
    return {key: result for key, result in found if result is not None}


def reproduce(
    keys: Sequence[str],
    context: Context,
    folder: Path,
    begin: Callable[[str, str], None],
    before: Mapping[str, ExperimentResult] | None = None,
) -> list[ExperimentResult]:
    """Run experiments and write the report again after each, so that an interrupted run leaves what it had."""
    run, done = _run(context), dict(before or {})
    todo = [key for key in keys if key not in done]
    if done:
        _write_pages(folder, [done[key] for key in keys if key in done], context, todo)
    for key in todo:
        module, title = {**EXPERIMENTS, **FURTHER}[key]
        begin(key, title)
        result = import_module(f"heliograph.experiments.{module}").run(context)
        _write_parts(folder, result, run)
        done[key] = result
        missing = [key for key in keys if key not in done]
        _write_pages(folder, [done[key] for key in keys if key in done], context, missing)
    return [done[key] for key in keys]


def _write_pages(
    folder: Path, results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()
) -> None:
    write_report(folder / "report.html", results, context, missing)
    write_whole(folder / "report.md", markdown(results, context, missing).encode())


def _not_run(missing: Sequence[str]) -> str:
    return f"Not run yet: {', '.join(missing)}. The same command goes on from here."


def write_report(
    path: Path, results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()
) -> None:
    """Write the page of all results."""
    page = Report("The experiments of Nagura et al. 2010, measured")
    scene = f"footage {', '.join(context.clips)}" if context.clips else "a drawn scene"
    motion = "a recorded trace" if context.imu else "a road by ISO 8608"
    page.text(f"Simulated in the reference link; background: {scene}; shake: {motion}; seed {context.seed}.", note=True)
    if context.quick:
        page.text("A quick run: few trials, so the intervals are wide.")
    if missing:
        page.text(_not_run(missing))
    found = Counter(str(finding.verdict) for result in results for finding in result.findings)
    page.badges((word, f"{word}: {count}") for word, count in sorted(found.items()))
    for result in results:
        _add(page, result)
    page.heading("All claims and measurements")
    page.table(
        ("", "claim", "measured", "verdict"), [row for result in results for row in _verdicts(result)], prose=True
    )
    page.write(path)


def markdown(results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()) -> str:
    """Claims and measurements as a Markdown page, for a project's documents."""
    run = "A quick run: few trials, wide intervals." if context.quick else "The full run."
    scene = ", ".join(context.clips) or "a drawn scene"
    lines = ["# The paper's experiments, measured", "", f"{run} Background: {scene}; seed {context.seed}.", ""]
    if missing:
        lines += [_not_run(missing), ""]
    for result in results:
        lines += [f"## {result.title}", "", result.text, "", "| claim | measured | verdict |", "|---|---|---|"]
        lines += [f"| {_cell(f.claim)} | {_cell(f'{f.ours} {f.why}')} | {f.verdict} |" for f in result.findings]
        lines.append("")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _verdicts(result: ExperimentResult) -> list[tuple[str, str, str, str]]:
    return [(result.key, f.claim, f.ours, f.verdict) for f in result.findings]


def _add(page: Report, result: ExperimentResult) -> None:
    page.heading(result.title)
    page.text(result.text)
    for picture, caption in _drawn(result):
        page.picture(picture, caption)
    for finding in result.findings:
        page.verdict(finding.verdict, f"{finding.claim} Measured: {finding.ours} {finding.why}".rstrip())
    for table in result.tables:
        page.text(table.title)
        page.table(table.head, table.rows)


def _run(context: Context) -> dict[str, Any]:
    """All that results depend on, as plain values."""
    recordings = {**context.clips, **({"motion": context.imu} if context.imu else {})}
    digests = {name: Recorded.of(path).digest for name, path in recordings.items()}
    parts = registry.digest()
    return {"code": build(), "parts": parts, "quick": context.quick, "seed": context.seed, "recordings": digests}


def _drawn(result: ExperimentResult) -> list[tuple[bytes, str]]:
    """Pictures of a result as PNG files, with their captions."""
    found = list(result.drawn)
    for figure, caption in result.pictures:
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=130, bbox_inches="tight")
        found.append((out.getvalue(), caption))
    return found


def _write_parts(folder: Path, result: ExperimentResult, run: Mapping[str, Any]) -> None:
    """Pictures and data of a result, each file whole or not at all; the data last, as they tell that all is there."""
    pictures = _drawn(result)
    for number, (picture, _) in enumerate(pictures, 1):
        write_whole(folder / f"{result.key}-{number}.png", picture)
    content = {
        "title": result.title,
        "findings": [_plain(f) for f in result.findings],
        "data": result.data,
        "text": result.text,
        "tables": [asdict(table) for table in result.tables],
        "captions": [caption for _, caption in pictures],
        "run": run,
    }
    write_whole(folder / f"{result.key}.json", json.dumps(content, indent=1).encode())


def _read_parts(folder: Path, key: str, run: Mapping[str, Any]) -> ExperimentResult | None:
    """What `_write_parts` wrote; None where it is not there, is damaged, or is of another run."""
    try:
        content = json.loads((folder / f"{key}.json").read_bytes())
        if content["run"] != run:
            return None
        captions = [str(caption) for caption in content["captions"]]
        pictures = [(folder / f"{key}-{number}.png").read_bytes() for number in range(1, len(captions) + 1)]
        return ExperimentResult(
            key,
            content["title"],
            content["text"],
            [Finding(**finding) for finding in content["findings"]],
            (),
            [Table(**table) for table in content["tables"]],
            content["data"],
            list(zip(pictures, captions, strict=True)),
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _plain(finding: Finding) -> dict[str, str]:
    return {"claim": finding.claim, "ours": finding.ours, "verdict": finding.verdict, "why": finding.why}
