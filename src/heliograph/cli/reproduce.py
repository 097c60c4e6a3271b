"""Reproduction of the paper's experiments."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.files import clear_write_errors
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.experiments import reproduce as experiments
from heliograph.experiments.report import Context
from heliograph.sweeps.executors import cores, fewer_workers

VERDICTS = {"holds": "pass", "differs": "differs", "shown": "not tested"}  # words for the verdicts of findings


def complete_experiment(start: str) -> list[str]:
    """Return experiments for shell completion."""
    return [name for name in experiments.EXPERIMENTS if name.startswith(start)]


@options.command
def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME ...]",
            help="Experiments, such as fig13 or scenes; default: all of the paper's.",
            autocompletion=complete_experiment,
        ),
    ] = None,
    quick: bool = option("Fewer trials: two minutes on two cores in place of ten.", None, "--quick", default=False),
    output: Path = option("Folder for the report, the pictures and the data.", "DIR", default=Path("reproduction")),
    data: Path | None = option(
        "Folder of recordings, driving/*.mp4 and motion/car-imu.csv; default: a drawn background and a simulated road.",
        "DIR",
    ),
    seed: options.Seed = 0,
    workers: options.WorkersOption = None,
) -> None:
    """Run the paper's experiments, and compare the claims."""
    keys = experiments.chosen(figures or [])
    fields = {"quick": quick, "seed": seed, "workers": workers or cores(), **experiments.recordings_in(data)}
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    if fewer := fewer_workers(workers):
        console.complain(fewer)
    earlier = experiments.done_before(keys, Context(**fields), output)
    if earlier:
        console.complain(
            f"{len(earlier)} of {len(keys)} experiments are complete in {output} and are not repeated; "
            "choose another --output to repeat experiments"
        )
    try:
        with console.progress("reproducing", len(keys)) as advance:
            position = 0

            def begin(key: str, _: object) -> None:
                nonlocal position
                advance(keys.index(key))

            context = Context(**fields, progress=lambda _, part: advance(position + part))
            results = experiments.reproduce(keys, context, output, begin, earlier)
    except KeyboardInterrupt:
        console.exit_interrupted(
            f"interrupted; {output} holds the complete experiments, and the same command continues"
        )
    for result in results:
        for finding in result.findings:
            measured = f" Measured: {finding.ours}" if finding.verdict == "differs" else ""
            console.say_prose(f"{result.key:12} {VERDICTS[finding.verdict]:10} {finding.claim}{measured}")
    if quick:
        console.say("a quick run: the intervals are wide")
    console.say(f"open {output / 'report.html'}")
