"""Demonstration: simulation, reception and report of a drive."""

import contextlib
from functools import partial
from pathlib import Path
from typing import Any

from heliograph.base.errors import HeliographError, counted
from heliograph.base.files import clear_write_errors
from heliograph.cli import console, options
from heliograph.cli.first_use import compile_ahead
from heliograph.cli.options import option
from heliograph.cli.simulate import load_scene
from heliograph.experiments.demo import film_bytes, run
from heliograph.link.film import frames_of
from heliograph.web.replay import receive_and_record


@options.command
def demo(
    *,
    output: Path = option("Folder for the film, the messages and the report.", "DIR", default=Path("demo")),
    settings: options.SettingsOptions,
    scene: options.SceneOptions,
) -> None:
    """Simulate the paper's drive, receive it, and write a report.

    The report is DIR/report.html; DIR/replay.html shows every moment of the reception.
    """
    channel = settings.overlay().get("channel", {})
    if not isinstance(channel, dict) or "background" not in channel:
        kind = "street-night" if settings.preset == "night" else "street"
        settings = settings.changed([f"channel.background.kind='{kind}'"])
    link, recordings = load_scene(settings, scene)
    compile_ahead()
    is_new, film = not output.exists(), output / "drive.mp4"
    with clear_write_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    console.say(f"{film}: a film of {frames_of(link)} frames, about {max(1, round(film_bytes(link) / 1e6))} MB")
    old_time = film.stat().st_mtime_ns if film.exists() else None
    shown = dict[str, Any]()

    def show(report: dict[str, Any]) -> None:
        shown.update(report)
        for array in report["arrays"]:
            layers = ", ".join(
                f"{name} {tally['ok']}/{tally['ok'] + tally['failed']}" for name, tally in array["layers"].items()
            )
            packets = f"array {array['id']}: {counted(array['packets'], 'packet')}"
            console.say(f"{link.receive.receiver}, {packets}; codewords read: {layers}")
        console.say(f"{counted(report['frames'], 'frame')} at {report['frames_per_second']:.0f} frames/s")
        console.say(f"open {output / 'report.html'}, and {output / 'replay.html'} to look at every moment")

    try:
        receive = partial(receive_and_record, output / "replay.html")
        run(output, link, scene.seed, recordings, console.progress, show, receive)
    except KeyboardInterrupt:
        if shown:
            frames = counted(shown["frames"], "frame")
            console.exit_interrupted(f"interrupted after {frames}; {output} holds the results so far")
        is_written = film.exists() and film.stat().st_mtime_ns != old_time
        console.exit_interrupted(f"interrupted; {film} holds the frames so far" if is_written else "interrupted")
    except HeliographError:
        if is_new:
            with contextlib.suppress(OSError):
                output.rmdir()  # fails unless empty
        raise
