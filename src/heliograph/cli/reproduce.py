"""heliograph reproduce."""

import sys
from pathlib import Path

from heliograph.base.files import clear_write_errors
from heliograph.cli import console


def run_reproduce(
    figures: list[str], quick: bool, output: Path, data: Path | None, seed: int, workers: int | None
) -> None:
    """Run the paper's experiments and write their report."""
    from heliograph.experiments.report import Context
    from heliograph.experiments.reproduce import chosen, done_before, recordings_in, reproduce
    from heliograph.sweeps.executors import cores, fewer_workers

    keys = chosen(figures)
    known = {"quick": quick, "seed": seed, "workers": workers or cores(), **recordings_in(data)}
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    if fewer := fewer_workers(workers):
        console.complain(fewer)
    before = done_before(keys, Context(**known), output)
    if before:
        console.complain(
            f"{len(before)} of {len(keys)} experiments were done before and are taken from {output}; "
            "choose another --output to run them again"
        )
    try:
        with console.progress("reproducing", len(keys)) as advance:
            done = 0

            def begin(key: str, _: object) -> None:
                nonlocal done
                done = keys.index(key)
                advance(done)

            context = Context(**known, progress=lambda _, part: advance(done + part))
            results = reproduce(keys, context, output, begin, before)
    except KeyboardInterrupt:
        console.complain(
            f"interrupted; {output} holds the experiments done so far, and the same command goes on from there"
        )
        sys.exit(console.INTERRUPTED)
    for result in results:
        for finding in result.findings:
            console.say_prose(f"{result.key:8} {finding.verdict:8} {finding.claim} Measured: {finding.ours}")
    if quick:
        console.say("a quick run: the intervals are wide")
    console.say(f"look at {output / 'report.html'}")
