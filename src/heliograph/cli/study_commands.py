"""The commands that count, estimate and compare, with their options."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import console, options


def sweep(
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUES",
            show_default=False,
            help="Key and its values: 1,2 or first:last:step. Repeat it for a grid. 'receiver' and 'preset' serve too.",
        ),
    ] = None,
    preset: options.Preset = "static",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    seed: options.Seed = 0,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="DIR",
            help="Folder for the results. A sweep that was stopped continues from it.",
            show_default=False,
        ),
    ] = None,
    min_errors: Annotated[
        int, typer.Option(min=1, help="A point ends once each layer has so many wrong codewords.")
    ] = 50,
    max_codewords: Annotated[int, typer.Option(min=1, help="Most codewords of a layer at a point.")] = 1000,
    max_seconds: Annotated[
        float | None,
        typer.Option(help="Most computing time of a point in s, summed over the workers.", show_default=False),
    ] = None,
    workers: options.WorkersOption = None,
    scheduler: options.Scheduler = None,
    background: options.BackgroundOption = None,
    imu: options.Imu = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON list and nothing else.")] = False,
) -> None:
    """Count errors over a grid of settings, without films."""
    from heliograph.cli.sweep import run_sweep

    limits = {"min_errors": min_errors, "max_codewords": max_codewords, "max_seconds": max_seconds}
    run_sweep(vary, preset, settings, assignments, seed, output, limits, (workers, scheduler), (background, imu),
              as_json)  # fmt: skip


def budget(
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUES",
            show_default=False,
            help="Key and its values: 1,2 or first:last:step. Repeat it for a grid. Distances from 25 m to 200 m if "
            "left out.",
        ),
    ] = None,
    preset: options.Preset = "static",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    candela: Annotated[
        float | None,
        typer.Option(
            metavar="CD",
            show_default=False,
            help="Luminous intensity of an LED on its axis; if left out, what channel.emitter.all_on stands for.",
        ),
    ] = None,
    f_number: Annotated[float, typer.Option("--f-number", help="Focal length over the lens's opening.")] = 11.0,
    efficiency: Annotated[
        float, typer.Option(help="Electrons a photon: transmission of the lens times quantum efficiency.")
    ] = 0.4,
    wavelength_nm: Annotated[float, typer.Option("--wavelength", metavar="NM", help="Wavelength of the LEDs.")] = 625.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON list and nothing else.")] = False,
) -> None:
    """Say what a link has before it is built: light, electrons, pixels, blur, range of each layer, flicker.

    Geometry, lens, sensor and LEDs are settings of 'channel'; --set and --vary change them.
    """
    from heliograph.cli.budget import run_budget

    light = {"candela": candela, "f_number": f_number, "efficiency": efficiency, "wavelength_nm": wavelength_nm}
    run_budget(vary, preset, settings, assignments, light, as_json)


def dataset(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the data set; a new one.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUES",
            show_default=False,
            help="Key and its values, 1,2 or first:last:step: distances, scenes, faults. Each combination gets films.",
        ),
    ] = None,
    films: Annotated[int, typer.Option("--films", min=1, help="Films of each combination.")] = 10,
    splits: Annotated[
        str, typer.Option("--splits", metavar="SHARES", help="Shares of train, validation and test.")
    ] = "80,10,10",
    packets: Annotated[
        int | None,
        typer.Option(
            min=1,
            show_default=False,
            help="Length of a film in packets; left out, one where nothing moves, else the whole drive.",
        ),
    ] = None,
    preset: options.Preset = "static",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    seed: options.Seed = 0,
    background: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            metavar="VIDEO",
            show_default=False,
            help="Recorded footage for the background; repeat it: each serves one split alone.",
        ),
    ] = None,
    imu: options.Imu = None,
    size: Annotated[bool, typer.Option("--size", help="Say how large it will be, and write nothing.")] = False,
) -> None:
    """Write films with truth and cut-outs, split for training detectors and decoders.

    The size is said first. What was stopped goes on by the same command. DATASHEET.md in DIR says what it has.
    """
    from heliograph.cli.dataset import run_dataset

    run_dataset(folder, vary, preset, settings, assignments, (films, packets), splits, seed, (background or [], imu),
                size)  # fmt: skip


def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME ...]", help="Experiments, such as fig13 or scenes; all of the paper's if left out."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer trials: two minutes on two cores in place of ten.")
    ] = False,
    output: Annotated[
        Path, typer.Option("--output", metavar="DIR", help="Folder for the report, the pictures and the data.")
    ] = Path("reproduction"),
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            metavar="DIR",
            show_default=False,
            help="Folder of recordings, driving/*.mp4 and motion/car-imu.csv; else the background is drawn and the "
            "road simulated.",
        ),
    ] = None,
    seed: options.Seed = 0,
    workers: options.WorkersOption = None,
) -> None:
    """Run the paper's experiments, and compare its claims with what was measured."""
    from heliograph.cli.reproduce import run_reproduce

    run_reproduce(figures or [], quick, output, data, seed, workers)


def presets(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Preset to print as TOML, with the meaning of each setting.",
            show_default=False,
            autocompletion=options.begun_presets,
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List the presets, or print one with all its settings."""
    from heliograph.base.config import to_mapping
    from heliograph.base.toml_text import to_toml
    from heliograph.cli.describe import comment
    from heliograph.link.settings import PRESETS, LinkSettings, load_settings

    if name is None and as_json:
        console.say_json({key: text for key, (text, _) in PRESETS.items()})
    elif name is None:
        for key, (text, _) in PRESETS.items():
            console.say(f"{key:12} {text}")
    else:
        tree = to_mapping(load_settings(name))
        console.say_json(tree) if as_json else console.say_lines(comment(to_toml(tree), LinkSettings))
