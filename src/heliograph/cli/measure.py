"""Commands of `heliograph measure`: measurements with arguments."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import SettingsError
from heliograph.base.files import write_whole
from heliograph.base.workers import limit_threads
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.experiments import code_errors, known_receiver
from heliograph.experiments import ranging as ranges
from heliograph.experiments.detection import acquisition as detection
from heliograph.experiments.detection import header_separation as headers
from heliograph.experiments.error_rates import real_input
from heliograph.experiments.error_rates import repeated_packets as repetition
from heliograph.experiments.error_rates import scenes as hard_scenes
from heliograph.experiments.patterns import timing_loss as timing
from heliograph.experiments.report import Context
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.statistics import Count
from heliograph.signal.code import CODES, list_codes
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.executors import cores, fewer_workers

measure = typer.Typer(name="measure", rich_markup_mode=None, add_completion=False)

Clips = Annotated[list[Path], typer.Argument(metavar="CLIP...", help="Recorded footage.")]
ImuOption = Annotated[Path, typer.Option("--imu", metavar="CSV", help="Recorded car motion.")]
First = Annotated[int, typer.Option(min=0, help="Seed of the first trial; the others follow.")]
LayerOption = Annotated[str, typer.Option(help="Layer to count: high, middle or low.")]


@measure.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Run a measurement and print the counts."""
    console.help_unless_command(context)


def complete_scene(start: str) -> list[str]:
    """Return scenes for shell completion."""
    return [name for name in hard_scenes.SCENES if name.startswith(start)]


def complete_code(start: str) -> list[str]:
    """Return channel codes for shell completion."""
    return [name for name in list_codes() if name.startswith(start)]


def measurement(function: Callable[..., None]) -> Callable[..., None]:
    """Make a measurement of a function; see `options.with_options`."""
    return measure.command()(options.with_options(function))


@measurement
def scenes(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENE ...]", help="All by default.", autocompletion=complete_scene)
    ] = None,
    at: str = option("Distances in m.", "M,M", default="50,80"),
    packets: int = option("Blocks: packets of arrays at rest, or films.", default=20, min=1),
    first: First = 0,
    receiver: str = option("Receiver to use.", default="soft"),
    workers: options.WorkersOption = None,
) -> None:
    """Measure error rates in hard scenes.

    Tilted and occluded arrays, failed LEDs, night, sun and six arrays.
    """
    if unknown := sorted({*(scene or ())} - {*hard_scenes.SCENES}):
        raise SettingsError(f"there is no scene {', '.join(unknown)}; there are {', '.join(hard_scenes.SCENES)}")
    distances, context = _numbers(at), _context(workers)
    for name in scene or hard_scenes.SCENES:
        found = hard_scenes.measure([name], distances, range(first, first + packets), receiver, context)
        for (_, distance), counts in found.items():
            console.say(f"{name}, {distance:g} m: {hard_scenes.counts_text(counts)}")


@measurement
def acquisition(
    trials: int = option("Trials.", default=3000, min=1),
    first: First = 0,
    within: int = option("Maximum number of patterns between switching on and the next header.", default=100, min=0),
    assignments: options.Assignments = None,
    workers: options.WorkersOption = None,
) -> None:
    """Measure the detection of arrays that are switched on."""
    changes = tuple(assignments or ())
    todo = [detection.AcquisitionTrial(seed, within, changes) for seed in range(first, first + trials)]
    with console.progress("trials", trials) as advance:
        outcomes = detection.measure(todo, _context(workers, lambda done: advance(done * trials)))
    for trial, outcome in zip(todo, outcomes, strict=True):
        if outcome.headers != 1:
            console.say(f"trial {trial.seed}: {'by its second header' if outcome.headers else 'missed'}")
    console.say(detection.outcomes_text(outcomes))


@measurement
def repeated_packets(
    distance: float = option("Distance in m in the middle of a film.", default=160.0),
    layer: LayerOption = "middle",
    receptions: int = option("Packets of a film.", default=5, min=1),
    films: int = option("Films.", default=20, min=1),
    assignments: options.Assignments = None,
    workers: options.WorkersOption = None,
) -> None:
    """Count wrong codewords of repeated packets."""
    settings = repetition.film_settings(distance, receptions, assignments or ())
    counts = repetition.measure(settings, _layer(layer), receptions, films, _context(workers))
    for number, count in enumerate(counts, 1):
        console.say(f"{distance:g} m, {layer}, reception {number}: {_count_text(count)}")


@measurement
def known_channel(
    distance: float = option("Distance in m.", default=110.0),
    layer: LayerOption = "low",
    brightness: str = option("Brightness of the array.", "X,X", default="0.7,0.8,0.9,1"),
    packets: int = option("Packets at each brightness.", default=100, min=1),
    workers: options.WorkersOption = None,
) -> None:
    """Measure the loss of the soft receiver by its estimates.

    Estimates of pose, blur, gain and noise, compared with the known channel.
    """
    todo = known_receiver.tasks(distance, _layer(layer), _numbers(brightness), packets)
    with console.progress("cases", len(todo)) as advance:
        context = _context(workers, lambda done: advance(done * len(todo)))
        counts = context.each("known channel", known_receiver.measure, todo)
    for task, count in zip(todo, counts, strict=True):
        channel = "known" if task.known else "blind"
        console.say(f"{distance:g} m, {layer}, brightness {task.brightness:g}, {channel}: {_count_text(count)}")


@measurement
def drives(
    clips: Clips,
    imu: ImuOption,
    seed: options.Seed = 1,
    assignments: options.Assignments = None,
    margin: int | None = option("Film only the array with a margin of PX; default: complete frames.", "PX"),
) -> None:
    """Count wrong codewords of drives with recorded footage.

    A drive over each clip, with the recorded shake.
    """
    for clip in clips:
        found = real_input.drive(real_input.RealScene(clip, imu, seed, tuple(assignments or ())), margin)
        console.say_lines("\n  ".join([f"{clip.name}: {found.frames} frames", *real_input.error_lines(found.errors)]))


@measurement
def empty(
    clips: Clips,
    imu: ImuOption,
    seed: options.Seed = 3,
    assignments: options.Assignments = None,
    native: bool = option("Use the frames of the clip, a frame per pattern period.", None, "--native", default=False),
    seconds: float = option("Length of each film, unless --native.", default=6.7),
    frames: int | None = option("Maximum number of frames of each clip.", "N", min=1),
) -> None:
    """Count false detections in clips that show no array."""
    changes, total = (f"channel.duration_s={seconds}", *(assignments or ())), None
    for clip in clips:
        found = real_input.empty(real_input.RealScene(clip, imu, seed, changes), frames, native=native)
        total = found if total is None else total + found
        console.say(f"{clip.name}: {found.text()}; {found.without_header} without header")
    if total is not None:
        console.say(f"all clips, per frame: {total.text()}")


@measurement
def lossy(
    film: Annotated[Path, typer.Argument(help="Simulated film, with the truth in the same folder.")],
    out: Annotated[Path, typer.Argument(help="Film to write.")],
) -> None:
    """Count errors of a film after lossy encoding.

    By libx264, preset medium, crf 18, yuv420p.
    """
    truth = open_truth(truth_path(film))
    real_input.encode_again(film, out)
    reception = real_input.receive_again(out, truth)
    kilobytes = out.stat().st_size / 1e3 / max(reception.frames, 1)
    lines = real_input.error_lines(reception.errors) if reception.errors else ()
    console.say(f"{out}: {reception.frames} frames, {kilobytes:.1f} kB a frame")
    console.say_lines("\n".join(f"  {line}" for line in lines))


@measurement
def codes(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[CODE ...]", help="All by default.", autocompletion=complete_code)
    ] = None,
    ebn0: str = option("Values of Eb/N0 in dB.", "DB,DB", default="0,0.5,1,1.5,2"),
    bits: int = option("Coded bits of a packet's layer.", default=1536, min=1),
    rate: float = option("Information bits per coded bit.", default=1 / 3, min=0.05, max=0.9),
    errors: int = option("Wrong blocks that complete a point.", default=100, min=1),
    blocks: int = option("Maximum number of blocks of a point.", default=2000, min=1),
    seed: options.Seed = 1,
    figure: Path | None = option("Draw the block error rates, as SVG.", "FILE"),
) -> None:
    """Count wrong blocks of channel codes over Eb/N0.

    Same white Gaussian noise for all codes, 95 % intervals.
    """
    counts, chosen, points = dict[tuple[str, float], Count](), names or list_codes(), _numbers(ebn0)
    for name in chosen:
        family = CODES[name]
        try:
            plan = family(bits, rate)
        except ValueError as error:
            raise SettingsError(f"the code {name} has no codeword: {error}; change --bits or --rate") from None
        for point in points:
            count = counts[name, point] = code_errors.count_blocks(plan, point, errors, blocks, seed)
            console.say(f"{name}, {plan.code.k} of {plan.code.length} bits, {point:g} dB: {_count_text(count)}")
    if figure:
        write_whole(figure, code_errors.draw(counts, chosen))


@measurement
def ranging(
    at: str = option("Distances in m.", "M,M", default="25,40,60,80,105"),
    films: int = option("Films at each distance.", default=40, min=1),
    first: First = 1000,
    workers: options.WorkersOption = None,
    as_json: options.JsonList = False,
) -> None:
    """Compare distance and pose of the array with published references.

    Receivers, phase-only correlation (POC) and an ArUco marker on the same road; rms errors, 95 % intervals.
    """
    distances = _numbers(at)
    total = films * len(distances)
    with console.progress("films", total, is_hidden=as_json) as advance:
        context = _context(workers, lambda done: advance(done * total))
        found = ranges.measure(distances, range(first, first + films), context)
    if as_json:
        console.say_json([asdict(accuracy) for accuracy in found])
    else:
        head = ["distance", "method", "found", "distance error", "lateral", "yaw"]
        console.say_table(head, [[*_accuracy_row(accuracy)] for accuracy in found])


def _accuracy_row(a: ranges.Accuracy) -> Iterator[str]:
    yield from (f"{a.distance_m:g} m", a.method, f"{a.found}/{a.films}")
    yield f"{a.distance_error:.2%} ({a.low:.2%} to {a.high:.2%})" if a.found else "-"
    yield "-" if a.lateral_m is None else f"{a.lateral_m:.2g} m"
    yield "-" if a.yaw_deg is None else f"{a.yaw_deg:.2g} deg"


@measurement
def header_separation(
    distances: Annotated[
        list[float] | None, typer.Argument(metavar="[M ...]", help="Distances in m; default: a selection.")
    ] = None,
) -> None:
    """Calculate the distances between blurred headers.

    Tables in Markdown, for the blur of the reference link.
    """
    found = [headers.separation(distance_m) for distance_m in distances or headers.DISTANCES_M]
    console.say_lines("\n\n".join(table.markdown() for table in headers.tables(found)))


@measurement
def timing_loss() -> None:
    """Calculate the loss of an unsynchronised camera.

    A table in Markdown by rate, exposure and phase.
    """
    console.say_lines(timing.table(timing.measure()).markdown())


def _context(workers: int | None, progress: Callable[[float], None] = lambda _: None) -> Context:
    """Return the context of an experiment; `progress` receives the completed fraction."""
    if fewer := fewer_workers(workers):
        console.complain(fewer)
    limit_threads()
    return Context(quick=False, workers=workers or cores(), progress=lambda _, done: progress(done))


def _count_text(count: Count) -> str:
    low, high = count.interval()
    return f"{count.errors} of {count.trials} wrong ({low:.2g} to {high:.2g})"


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise SettingsError(f"'{text}' is no list of numbers; separate numbers by commas, such as 50,80") from None


def _layer(name: str) -> str:
    if name not in LAYERS:
        raise SettingsError(f"unknown layer '{name}'; choose from {', '.join(LAYERS)}")
    return name
