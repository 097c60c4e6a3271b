"""heliograph demo."""

import sys
from pathlib import Path

from heliograph.base.files import clear_write_errors
from heliograph.cli import console
from heliograph.cli.simulate import scene_from


def run_demo(
    output: Path,
    seed: int,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    background: Path | None,
    imu: Path | None,
) -> None:
    """Simulate, receive, report."""
    from heliograph.experiments.demo.drive import run

    settings, recordings = scene_from(preset, file, assignments, background, imu)
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    demonstration = run(output, settings, seed, recordings, console.progress)
    report = demonstration.counts
    for array in report["arrays"]:
        layers = ", ".join(f"{n} {t['ok']}/{t['ok'] + t['failed']}" for n, t in array["layers"].items())
        console.say(f"array {array['id']}: {array['packets']} packets; codewords read: {layers}")
    console.say(f"{report['frames']} frames at {report['frames_per_second']:.0f} frames/s")
    console.say(f"look at {output / 'report.html'}")
    if isinstance(demonstration.ending, KeyboardInterrupt):
        console.complain(f"interrupted after {report['frames']} frames; {output} holds the results so far")
        sys.exit(console.INTERRUPTED)
    if demonstration.ending is not None:
        raise demonstration.ending
