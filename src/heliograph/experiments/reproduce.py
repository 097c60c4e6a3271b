"""Run experiments by name and write a report of all claims and measurements."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
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
    "flicker": ("flicker.experiment", "flicker of the array"),
    "systems": ("systems.experiment", "other systems in the same channel"),
    "soft": ("calibration.experiment", "the soft receiver: calibration of LLRs, and distances"),
}
"""Module and subject of each default experiment, by name."""

FURTHER = {
    "scenes": ("error_rates.scenes", "error rates in hard scenes"),
    "repeated-packets": ("error_rates.repeated_packets", "repeated packets"),
    "acquisition": ("detection.acquisition", "acquisition of an array that is switched on"),
    "known-channel": ("calibration.known_receiver", "the soft receiver and the known channel"),
    "header-separation": ("detection.header_separation", "distances between headers"),
    "timing-loss": ("patterns.timing_loss", "loss of an unsynchronised camera"),
}
"""Experiments that run by name only."""

ALIASES = {"fig9": "fig8", "fig12": "fig11", "table1": "tables", "table2": "tables", "calibration": "soft"}


def chosen(names: Sequence[str]) -> list[str]:
    """Unique names of the requested experiments, or all default experiments."""
    keys = [ALIASES.get(name, name) for name in map(str.lower, names)]
    for key in keys:
        if key not in EXPERIMENTS and key not in FURTHER:
            close = get_close_matches(key, [*EXPERIMENTS, *FURTHER, *ALIASES], 1)
            hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join([*EXPERIMENTS, *FURTHER])}"
            raise SettingsError(f"unknown experiment '{key}'; {hint}")
    return list(dict.fromkeys(keys)) or list(EXPERIMENTS)


def recordings_in(folder: Path | None) -> dict[str, Any]:
    """Clips and motion trace of a folder of recordings, as fields of `Context`."""
    if folder is None:
        return {}
    clips = dict[str, Path]()
    for path in sorted((folder / "driving").glob("*")):
        if path.suffix.lower() == ".mp4":
            name = printable(path.stem)
            clips[printable(path.name) if name in clips else name] = path
    if not clips:
        raise MediaError(f"{folder} has no driving/*.mp4; give a folder of recordings, or none to use a drawn scene")
    imu = folder / "motion" / "car-imu.csv"
    return {"clips": clips, "imu": imu if imu.is_file() else None}


def done_before(keys: Sequence[str], context: Context, folder: Path) -> dict[str, ExperimentResult]:
    """Results of an earlier run with the same effort, seed, recordings and code, by name."""
    if not folder.is_dir():
        return {}
    run = _run_identity(context)
    results = {key: _read_result(folder, key, run) for key in keys}
    return {key: result for key, result in results.items() if result is not None}


def reproduce(
    keys: Sequence[str],
    context: Context,
    folder: Path,
    begin: Callable[[str, str], None],
    before: Mapping[str, ExperimentResult] | None = None,
) -> list[ExperimentResult]:
    """Run the missing experiments, and write the report after each, so that an interruption keeps the results."""
    run, done = _run_identity(context), dict(before or {})

    def write_pages() -> None:
        results = [done[key] for key in keys if key in done]
        missing = [key for key in keys if key not in done]
        write_report(folder / "report.html", results, context, missing)
        write_whole(folder / "report.md", markdown(results, context, missing).encode())

    if done:
        write_pages()
    for key in [key for key in keys if key not in done]:
        module, title = {**EXPERIMENTS, **FURTHER}[key]
        begin(key, title)
        done[key] = _rendered(import_module(f"heliograph.experiments.{module}").run(context))
        _write_result(folder, done[key], run)
        write_pages()
    return [done[key] for key in keys]


def _note(missing: Sequence[str]) -> str:
    return f"Not run yet: {', '.join(missing)}. Repeat the command to run the rest."


def write_report(
    path: Path, results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()
) -> None:
    """Write the HTML page of all results."""
    page = Report("The experiments of Nagura et al. 2010, measured")
    scene = f"footage {', '.join(context.clips)}" if context.clips else "a drawn scene"
    motion = "a recorded trace" if context.imu else "a road by ISO 8608"
    page.text(f"Simulated in the reference link; background: {scene}; shake: {motion}; seed {context.seed}.", note=True)
    if context.quick:
        page.text("A quick run: few trials, so the intervals are wide.")
    if missing:
        page.text(_note(missing))
    verdicts = Counter(str(finding.verdict) for result in results for finding in result.findings)
    page.badges((verdict, f"{verdict}: {count}") for verdict, count in sorted(verdicts.items()))
    for result in results:
        page.heading(result.title)
        for paragraph in result.text.split("\n\n"):
            page.text(paragraph)
        for picture, caption in result.drawn:
            page.picture(picture, caption)
        for finding in result.findings:
            page.verdict(finding.verdict, f"{finding.claim} Measured: {finding.ours} {finding.why}".rstrip())
        for table in result.tables:
            page.text(table.title)
            page.table(table.head, table.rows)
    page.heading("All claims and measurements")
    rows = [(result.key, f.claim, f.ours, f.verdict) for result in results for f in result.findings]
    page.table(("", "claim", "measured", "verdict"), rows, prose=True)
    page.write(path)


def markdown(results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()) -> str:
    """Claims and measurements in Markdown."""
    run = "A quick run: few trials, wide intervals." if context.quick else "The full run."
    scene = ", ".join(context.clips) or "a drawn scene"
    lines = ["# The paper's experiments, measured", "", f"{run} Background: {scene}; seed {context.seed}.", ""]
    if missing:
        lines += [_note(missing), ""]
    for result in results:
        rows = [[f.claim, f"{f.ours} {f.why}", f.verdict] for f in result.findings]
        cells = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
        table = Table("", ["claim", "measured", "verdict"], cells)
        lines += [f"## {result.title}", "", result.text, "", table.markdown(), ""]
    return "\n".join(lines)


def _run_identity(context: Context) -> dict[str, Any]:
    """Plain values that determine the results."""
    recordings = {**context.clips, **({"motion": context.imu} if context.imu else {})}
    digests = {name: Recorded.of(path).digest for name, path in recordings.items()}
    parts = registry.digest()
    return {"code": build(), "parts": parts, "quick": context.quick, "seed": context.seed, "recordings": digests}


def _rendered(result: ExperimentResult) -> ExperimentResult:
    """Result with PNG files instead of figures."""
    if not result.pictures:
        return result
    from heliograph.experiments.plots import figure_png  # Matplotlib is slow to import

    return replace(result, pictures=(), drawn=[(figure_png(figure), caption) for figure, caption in result.pictures])


def _write_result(folder: Path, result: ExperimentResult, run: Mapping[str, Any]) -> None:
    """Write pictures and data; the data file comes last, as the mark of a complete result."""
    for number, (picture, _) in enumerate(result.drawn, 1):
        write_whole(folder / f"{result.key}-{number}.png", picture)
    content = {
        "title": result.title,
        "findings": [asdict(finding) for finding in result.findings],
        "data": result.data,
        "text": result.text,
        "tables": [asdict(table) for table in result.tables],
        "captions": [caption for _, caption in result.drawn],
        "run": run,
    }
    write_whole(folder / f"{result.key}.json", json.dumps(content, indent=1).encode())


def _read_result(folder: Path, key: str, run: Mapping[str, Any]) -> ExperimentResult | None:
    """Read a result of the same run; None if it is missing, damaged or of another run."""
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
