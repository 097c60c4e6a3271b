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
    "fig3": ("patterns.received", "Fig. 3: received image"),
    "fig4": ("patterns.pwm", "Fig. 4: pulse width modulation"),
    "fig5": ("patterns.packet", "Fig. 5: packet format"),
    "fig6": ("detection.experiment", "Fig. 6: false detections and identities"),
    "fig7": ("patterns.header", "Fig. 7: the header"),
    "fig8": ("patterns.inverse", "Fig. 8 and 9: inverted pattern and sum"),
    "fig11": ("tracking", "Fig. 11 and 12: tracking"),
    "fig13": ("error_rates.experiment", "Bit error rate by distance, static and driving (Fig. 13)"),
    "tables": ("patterns.parameters", "Tables I and II, data rates"),
    "flicker": ("flicker", "Flicker of the array"),
    "systems": ("systems", "Other systems in the same channel"),
    "soft": ("calibration", "The soft receiver: calibration of LLRs, and distances"),
    "scenes": ("error_rates.scenes", "Hard scenes"),
}
"""Module and title of each experiment, by name; "scenes" runs by name only."""

ALIASES = {"fig9": "fig8", "fig12": "fig11", "table1": "tables", "table2": "tables", "calibration": "soft"}


def chosen(names: Sequence[str]) -> list[str]:
    """Unique names of the requested experiments, or all default experiments."""
    keys = [ALIASES.get(name, name) for name in map(str.lower, names)]
    for key in keys:
        if key not in EXPERIMENTS:
            close = get_close_matches(key, [*EXPERIMENTS, *ALIASES], 1)
            hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(EXPERIMENTS)}"
            raise SettingsError(f"unknown experiment '{key}'; {hint}")
    return list(dict.fromkeys(keys)) or [key for key in EXPERIMENTS if key != "scenes"]


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
    return {key: result for key in keys if (result := _read_result(folder, key, run)) is not None}


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
        begin(key, EXPERIMENTS[key][1])
        done[key] = run_experiment(key, context)
        _write_result(folder, done[key], run)
        write_pages()
    return [done[key] for key in keys]


def run_experiment(key: str, context: Context) -> ExperimentResult:
    """Run an experiment, and draw the figures."""
    from heliograph.experiments import plots  # Matplotlib is slow to import

    name, title = EXPERIMENTS[key]
    module = import_module(f"heliograph.experiments.{name}")
    result: ExperimentResult = plots.styled(module.run)(context)
    # the description is the docstring of the module after the summary
    description = (module.__doc__ or "").partition("\n\n")[2]
    drawn = [(plots.figure_svg(figure), caption) for figure, caption in result.pictures]
    return replace(result, key=key, title=title, text=f"{result.text} {description}".strip(), pictures=(), drawn=drawn)


def _note(missing: Sequence[str]) -> str:
    return f"Not run yet: {', '.join(missing)}. Repeat the command to run the rest."


def write_report(
    path: Path, results: Sequence[ExperimentResult], context: Context, missing: Sequence[str] = ()
) -> None:
    """Write the HTML page of all results: first all claims, then each experiment."""
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
    page.heading("All claims and measurements")
    rows = [(result.key, f.claim, f.ours, f.verdict) for result in results for f in result.findings]
    page.table(("", "claim", "measured", "verdict"), rows, prose=True)
    for result in results:
        page.heading(result.title)
        for paragraph in result.text.split("\n\n"):
            page.text(paragraph)
        for picture, caption in result.drawn:
            page.picture(picture, caption)
        for finding in result.findings:
            page.verdict(finding.verdict, f"{finding.claim} Measured: {finding.ours} {finding.why}".rstrip())
        for table in result.tables:
            page.table(table.head, table.rows, title=table.title)
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
    recordings = [*context.clips.items(), ("motion", context.imu)]
    return {
        "code": build(),
        "parts": registry.digest(),
        "quick": context.quick,
        "seed": context.seed,
        "recordings": {name: Recorded.of(path).digest for name, path in recordings if path},
    }


def _write_result(folder: Path, result: ExperimentResult, run: Mapping[str, Any]) -> None:
    """Write pictures and data; the data file comes last, as the mark of a complete result."""
    for number, (picture, _) in enumerate(result.drawn, 1):
        write_whole(folder / f"{result.key}-{number}.svg", picture)
    plain = asdict(replace(result, drawn=()))
    fields = {name: plain[name] for name in ("title", "findings", "data", "text", "tables")}
    content = {**fields, "captions": [caption for _, caption in result.drawn], "run": run}
    write_whole(folder / f"{result.key}.json", json.dumps(content, indent=1).encode())


def _read_result(folder: Path, key: str, run: Mapping[str, Any]) -> ExperimentResult | None:
    """Read a result of the same run; None if it is missing, damaged or of another run."""
    try:
        content = json.loads((folder / f"{key}.json").read_bytes())
        if content["run"] != run:
            return None
        captions = [str(caption) for caption in content["captions"]]
        pictures = [(folder / f"{key}-{number}.svg").read_bytes() for number in range(1, len(captions) + 1)]
        return ExperimentResult(
            key=key,
            title=content["title"],
            text=content["text"],
            findings=[Finding(**finding) for finding in content["findings"]],
            tables=[Table(**table) for table in content["tables"]],
            data=content["data"],
            drawn=list(zip(pictures, captions, strict=True)),
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
