"""heliograph demo."""

import contextlib
import sys
from pathlib import Path

from heliograph.base.errors import HeliographError
from heliograph.base.files import clear_write_errors
from heliograph.base.words import counted
from heliograph.cli import console, options
from heliograph.cli.simulate import scene_from


def _with_street(preset: str, file: Path | None, assignments: list[str] | None) -> list[str]:
    """Assignments by which there is a street behind the arrays, unless something is said of the background."""
    said = options.laid_over(file, assignments).get("channel", {})
    kind = "street-night" if preset == "night" else "street"
    street = [] if isinstance(said, dict) and "background" in said else [f"channel.background.kind='{kind}'"]
    return [*street, *(assignments or ())]


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
    from heliograph.experiments.demo.drive import film_bytes, run
    from heliograph.link.film import frames_of

    settings, recordings = scene_from(preset, file, _with_street(preset, file, assignments), background, imu)
    new = not output.exists()
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    size = max(1, round(film_bytes(settings) / 1e6))
    console.say(f"{output / 'drive.mp4'}: a film of {frames_of(settings)} frames, about {size} MB")
    film = output / "drive.mp4"
    before = film.stat().st_mtime_ns if film.exists() else None
    try:
        demonstration = run(output, settings, seed, recordings, console.progress)
    except KeyboardInterrupt:
        # receiving it has an ending of its own
        written = film.exists() and film.stat().st_mtime_ns != before
        console.complain(f"interrupted; {film} holds the frames so far" if written else "interrupted")
        sys.exit(console.INTERRUPTED)
    except HeliographError:
        if new:
            with contextlib.suppress(OSError):
                output.rmdir()  # unless something is in it
        raise
    report = demonstration.counts
    for array in report["arrays"]:
        layers = ", ".join(f"{n} {t['ok']}/{t['ok'] + t['failed']}" for n, t in array["layers"].items())
        console.say(f"array {array['id']}: {counted(array['packets'], 'packet')}; codewords read: {layers}")
    console.say(f"{counted(report['frames'], 'frame')} at {report['frames_per_second']:.0f} frames/s")
    console.say(f"look at {output / 'report.html'}")
    if isinstance(demonstration.ending, KeyboardInterrupt):
        console.complain(f"interrupted after {counted(report['frames'], 'frame')}; {output} holds the results so far")
        sys.exit(console.INTERRUPTED)
    if demonstration.ending is not None:
        raise demonstration.ending
