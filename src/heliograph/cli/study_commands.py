"""Commands for error counts, budgets, data sets and experiments, with options."""

import os
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.workers import THREAD_LIMITS
from heliograph.cli import console, options

SweepVary = Annotated[
    list[str] | None, options.vary_option("Repeat it for a grid. 'receiver' and 'preset' are keys as well.")
]
BudgetVary = Annotated[
    list[str] | None, options.vary_option("Repeat it for a grid. Default: distances from 25 m to 200 m.")
]
DatasetVary = Annotated[
    list[str] | None, options.vary_option("Such as distances, scenes, faults. Each combination gets films.")
]


STATIC = options.SettingsOptions("static")


@options.with_groups
def sweep(
    *,
    vary: SweepVary = None,
    settings: options.SettingsOptions = STATIC,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for the results. A stopped sweep continues from this folder."
        ),
    ] = None,
    min_errors: Annotated[int, typer.Option(min=1, help="Wrong codewords of each layer that complete a point.")] = 50,
    max_codewords: Annotated[
        int, typer.Option(min=1, help="Maximum number of codewords of a layer at a point.")
    ] = 1000,
    max_seconds: Annotated[
        float | None, typer.Option(help="Maximum computing time of a point in s, summed over the workers.")
    ] = None,
    crew: options.WorkerOptions,
    scene: options.SceneOptions,
    as_json: options.JsonList = False,
) -> None:
    """Count errors over a grid of settings, without films."""
    os.environ.update(THREAD_LIMITS)  # before the import of NumPy
    from heliograph.cli.sweep import run_sweep
    from heliograph.sweeps.plan import plan
    from heliograph.sweeps.tally import StopRule

    overlay = settings.overlay()
    points = plan(options.parse_vary_options(vary), settings.preset, overlay, scene.seed, scene.background, scene.imu)
    stop_rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    run_sweep(points, stop_rule, output, crew, as_json=as_json)


@options.with_groups
def budget(
    *,
    vary: BudgetVary = None,
    settings: options.SettingsOptions = STATIC,
    candela: Annotated[
        float | None,
        typer.Option(
            metavar="CD", help="Luminous intensity of an LED on its axis; default: value of channel.emitter.all_on."
        ),
    ] = None,
    f_number: Annotated[float, typer.Option("--f-number", help="Focal length over the lens's opening.")] = 11.0,
    efficiency: Annotated[
        float, typer.Option(help="Electrons a photon: transmission of the lens times quantum efficiency.")
    ] = 0.4,
    wavelength_nm: Annotated[float, typer.Option("--wavelength", metavar="NM", help="Wavelength of the LEDs.")] = 625.0,
    as_json: options.JsonList = False,
) -> None:
    """Calculate the budget of a planned link: light, electrons, pixels, blur, range of each layer, flicker.

    Geometry, lens, sensor and LEDs are settings of 'channel'; see --set and --vary.
    """
    from heliograph.cli.budget import run_budget
    from heliograph.link.photometry import LightSettings

    light = LightSettings(candela=candela, f_number=f_number, efficiency=efficiency, wavelength_nm=wavelength_nm)
    run_budget(vary, settings, light, as_json=as_json)


@options.with_groups
def dataset(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder for the data set.")],
    *,
    vary: DatasetVary = None,
    films: Annotated[int, typer.Option("--films", min=1, help="Films of each combination.")] = 10,
    splits: Annotated[
        str, typer.Option("--splits", metavar="SHARES", help="Shares of train, validation and test.")
    ] = "80,10,10",
    packets: Annotated[
        int | None,
        typer.Option(
            min=1, help="Length of a film in packets; default: a packet at rest, the complete drive in motion."
        ),
    ] = None,
    settings: options.SettingsOptions = STATIC,
    seed: options.Seed = 0,
    background: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            metavar="VIDEO",
            help="Recorded footage for the background; may be repeated: each video serves a single split.",
        ),
    ] = None,
    imu: options.Imu = None,
    size: Annotated[bool, typer.Option("--size", help="Print the size and write no data.")] = False,
) -> None:
    """Write films with truth and cut-outs, split for training detectors and decoders.

    The size is printed first. The same command continues a stopped run. DATASHEET.md in DIR describes the data set.
    """
    from heliograph.cli.dataset import parse_shares, run_dataset
    from heliograph.datasets.plan import planned

    overlay, values, shares = settings.overlay(), options.parse_vary_options(vary), parse_shares(splits)
    plan = planned(values, settings.preset, overlay, films, shares, packets, seed, background or [], imu)
    run_dataset(folder, plan, seed, size_only=size)


def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME ...]", help="Experiments, such as fig13 or scenes; default: all of the paper's."),
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
            help="Folder of recordings, driving/*.mp4 and motion/car-imu.csv; default: a drawn background and a "
            "simulated road.",
        ),
    ] = None,
    seed: options.Seed = 0,
    workers: options.WorkersOption = None,
) -> None:
    """Run the paper's experiments, and compare claims with the measurements."""
    from heliograph.cli.reproduce import run_reproduce

    run_reproduce(figures or [], output, data, seed, workers, quick=quick)


def presets(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Preset to print as TOML, with the meaning of each setting.", autocompletion=options.complete_preset
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List the presets, or print all settings of a preset."""
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
