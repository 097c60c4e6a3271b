"""Commands that transmit: simulated films, LED patterns, and the demonstration."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import options


@options.with_groups
def simulate(
    film: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    *,
    settings: options.SettingsOptions,
    scene: options.SceneOptions,
    sent: options.SentOptions,
    codec: options.Codec = None,
    crf: Annotated[float | None, typer.Option(help="Quality of lossy H.264, 0 to 51.")] = None,
    lossless: Annotated[bool, typer.Option(help="Store H.264 without loss.")] = False,
    mbit_s: Annotated[
        float | None, typer.Option(help="Bit rate of H.264 or H.265 in Mbit/s, as in films of phones.")
    ] = None,
) -> None:
    """Film a drive past the arrays, and write the truth next to the film."""
    from heliograph.cli.simulate import run_simulate

    form = {"codec": codec, "crf": crf, "lossless": lossless, "mbit_s": mbit_s}
    run_simulate(film, settings, scene, sent, form)


@options.with_groups
def transmit(
    output: Annotated[
        Path,
        typer.Argument(
            help="Patterns to write: .npy, .csv, a film (.mkv, .mp4, ...); for drivers, by slot: .bits (bit planes), "
            ".h (C header), .hub75 (row scan), .shift (shift registers)."
        ),
    ],
    *,
    packets: Annotated[int, typer.Option(min=1, help="Packets to write.")] = 10,
    identity: Annotated[int, typer.Option(min=0, max=29, help="Identity of the array.")] = 0,
    slots: Annotated[bool, typer.Option("--slots", help="Write on and off by PWM slot instead of levels.")] = False,
    gamma: Annotated[
        float, typer.Option(min=1, max=4, help="Gamma of the display for a film, usually 2.2; 1 writes linear levels.")
    ] = 1.0,
    settings: options.SettingsOptions,
    sent: options.SentOptions,
) -> None:
    """Write the LED patterns of a transmission."""
    from heliograph.cli.transmit import run_transmit

    run_transmit(output, settings, sent, packets, identity, gamma, by_slot=slots)


@options.with_groups
def demo(
    *,
    output: Annotated[
        Path, typer.Option("--output", metavar="DIR", help="Folder for the film, the messages and the report.")
    ] = Path("demo"),
    settings: options.SettingsOptions,
    scene: options.SceneOptions,
) -> None:
    """Simulate the paper's drive, receive the film, and report the results in report.html."""
    from heliograph.cli.demo import run_demo

    run_demo(output, settings, scene)
