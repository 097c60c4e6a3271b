"""Reproduction of the paper's experiments."""

from pathlib import Path

from heliograph.base.files import clear_write_errors
from heliograph.cli import console
from heliograph.experiments.report import Context
from heliograph.experiments.reproduce import chosen, done_before, recordings_in, reproduce
from heliograph.sweeps.executors import cores, fewer_workers


def run_reproduce(
    figures: list[str], output: Path, data: Path | None, seed: int, workers: int | None, *, quick: bool
) -> None:
    """Run experiments, and print and report the findings."""
    keys = chosen(figures)
    fields = {"quick": quick, "seed": seed, "workers": workers or cores(), **recordings_in(data)}
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    if fewer := fewer_workers(workers):
        console.complain(fewer)
    earlier = done_before(keys, Context(**fields), output)
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
            results = reproduce(keys, context, output, begin, earlier)
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
