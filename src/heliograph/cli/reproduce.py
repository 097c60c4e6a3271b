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


@options.command
def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME ...]", help="Experiments, such as fig13 or scenes; default: all of the paper's."),
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
    """Run the paper's experiments, and compare claims with the measurements."""
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
                position = keys.index(key)
                advance(position)

            context = Context(**fields, progress=lambda _, part: advance(position + part))
            results = experiments.reproduce(keys, context, output, begin, earlier)
    except KeyboardInterrupt:
        console.exit_interrupted(
            f"interrupted; {output} holds the complete experiments, and the same command continues"
        )
    for result in results:
        for finding in result.findings:
            console.say_prose(f"{result.key:8} {finding.verdict:8} {finding.claim} Measured: {finding.ours}")
    if quick:
        console.say("a quick run: the intervals are wide")
    console.say(f"open {output / 'report.html'}")
