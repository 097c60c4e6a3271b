"""Commands of `heliograph measure`: measurements with arguments."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliograph.base.errors import SettingsError
from heliograph.cli import console, options

if TYPE_CHECKING:
    from heliograph.experiments.report import Context
    from heliograph.measure.statistics import Count

app = typer.Typer(rich_markup_mode=None)

Clips = Annotated[list[Path], typer.Argument(metavar="CLIP...", help="Recorded footage.")]
ImuOption = Annotated[Path, typer.Option("--imu", metavar="CSV", help="Recorded car motion.")]
First = Annotated[int, typer.Option(min=0, help="Seed of the first trial; the others follow.")]
LayerOption = Annotated[str, typer.Option(help="Layer to count: high, middle or low.")]


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Run a measurement and print the counts."""
    options.help_unless_command(context)


@app.command()
def scenes(
    scene: Annotated[list[str] | None, typer.Argument(metavar="[SCENE ...]", help="All by default.")] = None,
    at: Annotated[str, typer.Option(metavar="M,M", help="Distances in m.")] = "50,80",
    packets: Annotated[int, typer.Option(min=1, help="Blocks: packets of arrays at rest, or films.")] = 20,
    first: First = 0,
    receiver: Annotated[str, typer.Option(help="Receiver to use.")] = "soft",
    workers: options.WorkersOption = None,
) -> None:
    """Measure error rates in hard scenes: tilted, occluded, failed LEDs, night, sun, six arrays."""
    from heliograph.experiments.error_rates.scenes import SCENES, counts_text, measure

    unknown = sorted({*(scene or ())} - {*SCENES})
    if unknown:
        raise SettingsError(f"there is no scene {', '.join(unknown)}; there are {', '.join(SCENES)}")
    distances, context = _numbers(at), _context(workers)
    for name in scene or SCENES:
        found = measure([name], distances, range(first, first + packets), receiver, context)
        for (_, distance), counts in found.items():
            console.say(f"{name}, {distance:g} m: {counts_text(counts)}")


@app.command()
def acquisition(
    trials: Annotated[int, typer.Option(min=1, help="Trials.")] = 3000,
    first: First = 0,
    within: Annotated[
        int, typer.Option(min=0, help="Maximum number of patterns between switching on and the next header.")
    ] = 100,
    assignments: options.Assignments = None,
    workers: options.WorkersOption = None,
) -> None:
    """Measure the probability and time of detection after an array is switched on."""
    from heliograph.experiments.detection.acquisition import AcquisitionTrial, measure, outcomes_text

    changes = tuple(assignments or ())
    todo = [AcquisitionTrial(seed, within, changes) for seed in range(first, first + trials)]
    with console.progress("trials", trials) as advance:
        outcomes = measure(todo, _context(workers, lambda done: advance(done * trials)))
    for trial, outcome in zip(todo, outcomes, strict=True):
        if outcome.headers != 1:
            console.say(f"trial {trial.seed}: {'by its second header' if outcome.headers else 'missed'}")
    console.say(outcomes_text(outcomes))


@app.command()
def repeated_packets(
    distance: Annotated[float, typer.Option(help="Distance in m in the middle of a film.")] = 160.0,
    layer: LayerOption = "middle",
    receptions: Annotated[int, typer.Option(min=1, help="Packets of a film.")] = 5,
    films: Annotated[int, typer.Option(min=1, help="Films.")] = 20,
    assignments: options.Assignments = None,
    workers: options.WorkersOption = None,
) -> None:
    """Count wrong codewords in each reception of a repeated packet."""
    from heliograph.experiments.error_rates.repeated_packets import film_settings, measure

    settings = film_settings(distance, receptions, assignments or ())
    for number, count in enumerate(measure(settings, _layer(layer), receptions, films, _context(workers)), 1):
        console.say(f"{distance:g} m, {layer}, reception {number}: {_count_text(count)}")


@app.command()
def known_channel(
    distance: Annotated[float, typer.Option(help="Distance in m.")] = 110.0,
    layer: LayerOption = "low",
    brightness: Annotated[str, typer.Option(metavar="X,X", help="Brightness of the array.")] = "0.7,0.8,0.9,1",
    packets: Annotated[int, typer.Option(min=1, help="Packets at each brightness.")] = 100,
    workers: options.WorkersOption = None,
) -> None:
    """Measure the loss of the soft receiver from estimates of pose, blur, gain and noise."""
    from heliograph.experiments.calibration.known_receiver import measure, tasks

    todo = tasks(distance, _layer(layer), _numbers(brightness), packets)
    with console.progress("cases", len(todo)) as advance:
        context = _context(workers, lambda done: advance(done * len(todo)))
        counts = context.each("known channel", measure, todo)
    for task, count in zip(todo, counts, strict=True):
        channel = "known" if task.known else "blind"
        console.say(f"{distance:g} m, {layer}, brightness {task.brightness:g}, {channel}: {_count_text(count)}")


@app.command()
def drives(
    clips: Clips,
    imu: ImuOption,
    seed: options.Seed = 1,
    assignments: options.Assignments = None,
    margin: Annotated[
        int | None,
        typer.Option(metavar="PX", help="Film only the array with a margin of PX; default: complete frames."),
    ] = None,
) -> None:
    """Count wrong codewords in a drive over each clip, with the recorded shake."""
    from heliograph.experiments.error_rates.real_input import RealScene, drive, error_lines

    for clip in clips:
        found = drive(RealScene(clip, imu, seed, tuple(assignments or ())), margin)
        console.say(f"{clip.name}: {found.frames} frames")
        for line in error_lines(found.errors):
            console.say(f"  {line}")


@app.command()
def empty(
    clips: Clips,
    imu: ImuOption,
    seed: options.Seed = 3,
    assignments: options.Assignments = None,
    native: Annotated[
        bool, typer.Option("--native", help="Use the frames of the clip, a frame per pattern period.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="Length of each film, unless --native.")] = 6.7,
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Maximum number of frames of each clip.")
    ] = None,
) -> None:
    """Count false detections and packets in clips that show no array."""
    from heliograph.experiments.error_rates import real_input

    changes, total = (f"channel.duration_s={seconds}", *(assignments or ())), None
    for clip in clips:
        found = real_input.empty(real_input.RealScene(clip, imu, seed, changes), frames, native=native)
        total = found if total is None else total + found
        console.say(f"{clip.name}: {found.text()}; {found.without_header} without header")
    if total is not None:
        console.say(f"all clips, per frame: {total.text()}")


@app.command()
def lossy(
    film: Annotated[Path, typer.Argument(help="Simulated film, with the truth in the same folder.")],
    out: Annotated[Path, typer.Argument(help="Film to write.")],
) -> None:
    """Count errors of a film after encoding by libx264 (preset medium, crf 18, yuv420p)."""
    from heliograph.experiments.error_rates.real_input import encode_again, error_lines, receive_again
    from heliograph.link.truth import open_truth, truth_path

    truth = open_truth(truth_path(film))
    encode_again(film, out)
    reception = receive_again(out, truth)
    kilobytes = out.stat().st_size / 1e3 / max(reception.frames, 1)
    console.say(f"{out}: {reception.frames} frames, {kilobytes:.1f} kB a frame")
    for line in error_lines(reception.errors) if reception.errors else ():
        console.say(f"  {line}")


@app.command()
def header_separation(
    distances: Annotated[
        list[float] | None, typer.Argument(metavar="[M ...]", help="Distances in m; default: a selection.")
    ] = None,
) -> None:
    """Calculate distances between headers under the blur of the reference link, as tables in Markdown."""
    from heliograph.experiments.detection.header_separation import DISTANCES_M, separation, tables

    console.say_lines(
        "\n\n".join(table.markdown() for table in tables([separation(z) for z in distances or DISTANCES_M]))
    )


@app.command()
def timing_loss() -> None:
    """Calculate the loss of an unsynchronised camera by rate, exposure and phase, as a table in Markdown."""
    from heliograph.experiments.patterns.timing_loss import measure, table

    console.say_lines(table(measure()).markdown())


def _context(workers: int | None, progress: Callable[[float], None] = lambda _: None) -> "Context":
    """Return the context of an experiment; `progress` receives the completed fraction."""
    from heliograph.base.workers import limit_threads
    from heliograph.experiments.report import Context
    from heliograph.sweeps.executors import cores, fewer_workers

    if fewer := fewer_workers(workers):
        console.complain(fewer)
    limit_threads()
    return Context(quick=False, workers=workers or cores(), progress=lambda _, done: progress(done))


def _count_text(count: "Count") -> str:
    low, high = count.interval()
    return f"{count.errors} of {count.trials} wrong ({low:.2g} to {high:.2g})"


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise SettingsError(f"'{text}' is no list of numbers; separate numbers by commas, such as 50,80") from None


def _layer(name: str) -> str:
    from heliograph.signal.settings import LAYERS

    if name not in LAYERS:
        raise SettingsError(f"unknown layer '{name}'; choose from {', '.join(LAYERS)}")
    return name
