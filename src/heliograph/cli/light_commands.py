"""The commands that send: into a simulated film, to an array or a display, and the demo, with their options."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.cli import options

High = Annotated[str | None, options.message_option("high")]
Middle = Annotated[str | None, options.message_option("middle")]
Low = Annotated[str | None, options.message_option("low")]
FileOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--file",
        metavar="PATH",
        show_default=False,
        help="File that the layers without a message send: any of its symbols that are enough give it back; may be "
        "repeated.",
    ),
]
FileCode = Annotated[
    str,
    typer.Option("--file-code", help="Code of --file: cauchy, read everywhere, or raptorq, for megabytes."),
]
JunctionOption = Annotated[
    Path | None,
    typer.Option(
        "--junction",
        metavar="TOML",
        show_default=False,
        help="Junction whose lights the high layer tells of, as SPATEM, and whose lanes the middle one, as MAPEM.",
    ),
]
Codec = Annotated[
    str | None, typer.Option(help="Codec of the film: ffv1, h264, h265 or mjpeg; chosen by the suffix if left out.")
]


def simulate(
    film: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    seed: options.Seed = 0,
    background: options.BackgroundOption = None,
    imu: options.Imu = None,
    high: High = None,
    middle: Middle = None,
    low: Low = None,
    file: FileOption = None,
    file_code: FileCode = "cauchy",
    junction: JunctionOption = None,
    codec: Codec = None,
    crf: Annotated[float | None, typer.Option(help="Quality of lossy H.264, 0 to 51.")] = None,
    lossless: Annotated[bool, typer.Option(help="Store H.264 without loss.")] = False,
    mbit_s: Annotated[
        float | None, typer.Option(help="Bit rate of H.264 or H.265 in Mbit/s: a film as phones write it.")
    ] = None,
) -> None:
    """Film a drive past the arrays, and write its truth beside it."""
    from heliograph.cli.simulate import run_simulate

    run_simulate(film, preset, settings, assignments, seed, background, imu,
                 options.Sent(high, middle, low, tuple(file or ()), file_code, junction),
                 {"codec": codec, "crf": crf, "lossless": lossless, "mbit_s": mbit_s})  # fmt: skip


def transmit(
    output: Annotated[
        Path,
        typer.Argument(
            help="Patterns to write: .npy, .csv, a film (.mkv, .mp4, ...); for drivers, by slot: .bits (bit planes), "
            ".h (C header), .hub75 (row scan), .shift (shift registers)."
        ),
    ],
    packets: Annotated[int, typer.Option(min=1, help="Packets to write.")] = 10,
    identity: Annotated[int, typer.Option(min=0, max=29, help="Identity of the array.")] = 0,
    slots: Annotated[bool, typer.Option("--slots", help="Write on and off by PWM slot instead of levels.")] = False,
    gamma: Annotated[
        float,
        typer.Option(
            min=1, max=4, help="Gamma of the display that a film is for, usually 2.2; 1 writes the levels themselves."
        ),
    ] = 1.0,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    high: High = None,
    middle: Middle = None,
    low: Low = None,
    file: FileOption = None,
    file_code: FileCode = "cauchy",
    junction: JunctionOption = None,
) -> None:
    """Write the LED patterns of a transmission."""
    from heliograph.cli.transmit import run_transmit

    sent = options.Sent(high, middle, low, tuple(file or ()), file_code, junction)
    run_transmit(output, packets, identity, slots, preset, settings, assignments, sent, gamma)


def demo(
    output: Annotated[
        Path, typer.Option("--output", metavar="DIR", help="Folder for the film, the messages and the report.")
    ] = Path("demo"),
    seed: options.Seed = 0,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    background: options.BackgroundOption = None,
    imu: options.Imu = None,
) -> None:
    """Simulate the paper's drive, receive it, and show what arrived in report.html."""
    from heliograph.cli.demo import run_demo

    run_demo(output, seed, preset, settings, assignments, background, imu)
