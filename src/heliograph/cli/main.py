"""The command `heliograph`."""

import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.registry import load_parts
from heliograph.cli import console, measure, options

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

app.add_typer(measure.app, name="measure")

NAME = "heliograph"
"""What the command is called, also as ``python -m heliograph``."""

TyperError: type[Exception] = getattr(typer, "TyperException", typer.BadParameter.__mro__[2])
"""What a wrong command line raises: before Typer 0.27, Click's exception at the root of `typer.BadParameter`."""

READ = "Video, .h5, .mraw, .cine, TIFF stack, .npy, folder of pictures, or their names such as img%04d.png."
"""Films that are read, for the help."""

High = Annotated[str | None, options.message_option("high")]
Middle = Annotated[str | None, options.message_option("middle")]
Low = Annotated[str | None, options.message_option("low")]
Version = Annotated[
    bool,
    typer.Option("--version", help="Print the version and end.", is_eager=True, callback=options.say_version),
]
Codec = Annotated[
    str | None, typer.Option(help="Codec of the film: ffv1, h264 or mjpeg; chosen by the suffix if left out.")
]
Fps = Annotated[
    float | None,
    typer.Option(
        "--fps",
        metavar="RATE",
        show_default=False,
        help="Frames per second that the camera took, where the film claims another rate, as in slow motion, or has no "
        "clock: a folder of pictures, TIFF, .npy.",
    ),
]
Crop = Annotated[
    str | None,
    typer.Option(
        "--crop",
        metavar="X,Y,WIDTH,HEIGHT",
        show_default=False,
        help="Part of the frames that is read, in pixels; x and y count from 0 at the upper left.",
    ),
]
Bin = Annotated[
    int,
    typer.Option(
        "--bin",
        metavar="SIDE",
        help="Take the mean of squares of so many pixels a side, 1 to 16; 2 for a Bayer mosaic.",
    ),
]
Rotate = Annotated[
    int, typer.Option("--rotate", metavar="DEGREES", help="Turn the part clockwise: 0, 90, 180 or 270 degrees.")
]
Channel = Annotated[str, typer.Option("--channel", help="Gray level of a colour: luma, red, green or blue.")]
Corners = Annotated[
    str | None,
    typer.Option(
        "--corners",
        metavar="X,Y,X,Y,X,Y,X,Y",
        show_default=False,
        help="Where an array is that is not found by itself: the four corners of its LED area one after the other, in "
        "pixels of the frames as they are read. Sets receive.detect.corners.",
    ),
]
Region = Annotated[
    str | None,
    typer.Option(
        "--region",
        metavar="X,Y,WIDTH,HEIGHT",
        show_default=False,
        help="Part of the frames in which arrays are looked for, however faint; they are followed beyond it. Sets "
        "receive.detect.region.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler whose workers compute, in place of --workers.", show_default=False
    ),
]
CameraOption = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="KEY=VALUE",
        show_default=False,
        help="Set a live camera: exposure_us, gain, rate_hz, region=X,Y,WIDTH,HEIGHT, pixel_format, trigger, producer, "
        "queue_s, reconnect, or a feature by the camera's own name, such as BlackLevel; may be repeated.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


@app.callback(invoke_without_command=True)
def main(context: typer.Context, load: options.Load = None, version: Version = False) -> None:  # noqa: ARG001 - it acts by itself
    """Data sent by an LED array, received by a high-speed camera on a moving car."""
    for file in load or ():
        load_parts(file)
    options.help_unless_command(context)


@app.command()
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
    codec: Codec = None,
    crf: Annotated[float | None, typer.Option(help="Quality of lossy H.264, 0 to 51.")] = None,
    lossless: Annotated[bool, typer.Option(help="Store H.264 without loss.")] = False,
) -> None:
    """Film a drive past the arrays, and write its truth beside it."""
    from heliograph.cli.simulate import run_simulate

    run_simulate(film, preset, settings, assignments, seed, background, imu, (high, middle, low),
                 {"codec": codec, "crf": crf, "lossless": lossless})  # fmt: skip


@app.command()
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
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    high: High = None,
    middle: Middle = None,
    low: Low = None,
) -> None:
    """Write the LED patterns of a transmission."""
    from heliograph.cli.transmit import run_transmit

    run_transmit(output, packets, identity, slots, preset, settings, assignments, (high, middle, low))


@app.command()
def receive(
    films: Annotated[
        list[Path], typer.Argument(metavar="FILM...", help=f"{READ} Or a live camera, camera:KIND:ADDRESS.")
    ],
    receiver: Annotated[
        str | None,
        typer.Option(
            help="Receiver: plain, soft or one of your own; that of the preset if left out.",
            show_default=False,
            autocompletion=options.begun_receivers,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the messages and the packet log.", show_default=False),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="FILE", help="Truth of the film, to count errors by.", show_default=False),
    ] = None,
    fps: Fps = None,
    crop: Crop = None,
    binning: Bin = 1,
    rotate: Rotate = 0,
    channel: Channel = "luma",
    corners: Corners = None,
    region: Region = None,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    camera: CameraOption = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds after which a live camera is left.", show_default=False),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HDF5 film of the last seconds of a live camera in which an array was lost or a packet not read.",
            show_default=False,
        ),
    ] = None,
    record_s: Annotated[
        float, typer.Option("--record-s", metavar="S", min=0.1, max=3600, help="Seconds that --record keeps.")
    ] = 10.0,
    as_json: Json = False,
    follow: Annotated[
        bool,
        typer.Option("--follow", help="Print a JSON line for each array found or lost, each packet and message."),
    ] = False,
    send: Annotated[
        list[str] | None,
        typer.Option(
            "--send",
            metavar="ADDRESS",
            show_default=False,
            help="Send these lines too: udp://HOST:PORT, or ws://127.0.0.1:PORT for clients of a WebSocket; may be "
            "repeated.",
        ),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say the same in words on standard error.")] = False,
    workers: options.WorkersOption = None,
    scheduler: Scheduler = None,
) -> None:
    """Find arrays in films, or before a live camera, and read what they send; where nothing is read it says why.

    A live camera is camera:KIND or camera:KIND:ADDRESS; 'heliograph cameras' lists what is there. It is received until
    Ctrl-C, for --duration S, or to the camera's end.

    Films of 'simulate' hold a note of their signal, which wins over the preset. --settings and --set win over the
    note; a line says where they differ from it. Of several films, or a folder of films, a line of JSON is printed for
    each; --output has a folder for each, and what is there already is not read again. The exit status is 3 where no
    array was found, of several films in none of them.
    """
    from heliograph.cli.live import LiveOptions
    from heliograph.cli.news import Told
    from heliograph.cli.receive import run_receive
    from heliograph.cli.receive_many import is_many, run_many

    seen = options.FilmOptions(fps, crop, binning, rotate, channel)
    changes = [*(assignments or ()), *([f"receive.receiver='{receiver}'"] if receiver else ())]
    changes += options.place_changes(corners, region)
    if is_many(films) or workers is not None or scheduler is not None:
        if truth or follow or send or verbose or camera or record or duration is not None:
            raise MediaError(
                "--truth, --follow, --send, --verbose and cameras' options take one film: receive the films one by one"
            )
        run_many(films, seen, preset, settings, changes, output, (workers, scheduler))
        return
    live = LiveOptions(camera, duration, record, record_s)
    told = Told(follow, verbose, tuple(send or ()))
    run_receive(films[0], seen, output, truth, preset, settings, changes, as_json, told, live)


@app.command()
def cameras(camera: CameraOption = None, as_json: Json = False) -> None:
    """List the live cameras that are there, by the names that 'receive' takes, and what is missing to see others."""
    from heliograph.cli.cameras import run_cameras

    run_cameras(camera, as_json)


@app.command()
def probe(
    film: Annotated[Path, typer.Argument(metavar="FILM", help=f"{READ} Or a live camera, camera:KIND:ADDRESS.")],
    receiver: Annotated[
        str | None,
        typer.Option(
            help="Receiver that is to read it: plain, soft or one of your own; that of the preset if left out.",
            show_default=False,
            autocompletion=options.begun_receivers,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            "--frames",
            min=1,
            metavar="N",
            show_default=False,
            help="Look at the first N frames alone; of a live camera at 2048 if left out.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for probe.html, the same with pictures.", show_default=False
        ),
    ] = None,
    fps: Fps = None,
    crop: Crop = None,
    binning: Bin = 1,
    rotate: Rotate = 0,
    channel: Channel = "luma",
    camera: CameraOption = None,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    as_json: Json = False,
) -> None:
    """Tell what a film shows: its frames, light and noise, what blinks, why that is or is no array, what to change.

    The exit status is 0 where an array is read with the settings as they are, and 3 where none is.
    """
    from heliograph.cli.probe import run_probe

    seen = options.FilmOptions(fps, crop, binning, rotate, channel)
    changes = [*(assignments or ()), *([f"receive.receiver='{receiver}'"] if receiver else ())]
    run_probe(film, seen, camera, frames, output, preset, settings, changes, as_json)


@app.command()
def convert(
    film: Annotated[Path, typer.Argument(help=READ)],
    output: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    fps: Fps = None,
    crop: Crop = None,
    binning: Bin = 1,
    rotate: Rotate = 0,
    channel: Channel = "luma",
    codec: Codec = None,
    crf: Annotated[
        float | None,
        typer.Option(help="Quality of lossy H.264, 0 to 51; without it every gray level is kept.", show_default=False),
    ] = None,
) -> None:
    """Write a film as another kind, with its gray levels and times; .h5 is the fastest to read."""
    from heliograph.cli.convert import run_convert

    run_convert(film, output, options.FilmOptions(fps, crop, binning, rotate, channel), codec, crf)


@app.command()
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


@app.command()
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
    scheduler: Scheduler = None,
    background: options.BackgroundOption = None,
    imu: options.Imu = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON list and nothing else.")] = False,
) -> None:
    """Count errors over a grid of settings, without films."""
    from heliograph.cli.sweep import run_sweep

    limits = {"min_errors": min_errors, "max_codewords": max_codewords, "max_seconds": max_seconds}
    run_sweep(vary, preset, settings, assignments, seed, output, limits, (workers, scheduler), (background, imu),
              as_json)  # fmt: skip


@app.command()
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


@app.command()
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


@app.command()
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


@app.command()
def presets(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Preset to print as TOML, with the meaning of each setting.",
            show_default=False,
            autocompletion=options.begun_presets,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the presets, or print one with all its settings."""
    from heliograph.base.config import to_mapping
    from heliograph.base.describe import commented
    from heliograph.base.toml_text import to_toml
    from heliograph.link.settings import PRESETS, LinkSettings, load_settings

    if name is None and as_json:
        console.say_json({key: text for key, (text, _) in PRESETS.items()})
    elif name is None:
        for key, (text, _) in PRESETS.items():
            console.say(f"{key:12} {text}")
    else:
        tree = to_mapping(load_settings(name))
        console.say_json(tree) if as_json else console.say(commented(to_toml(tree), LinkSettings).rstrip())


def _usage(error: Exception) -> None:
    """Say what is wrong with the command line, in one line."""
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    if "No such option: --load" in text and context:
        text = "--load FILE stands before the command"
        context = context.find_root()
    command = f"{context.command_path} --help" if context else "heliograph --help"
    console.complain(f"{' '.join(text.split()).rstrip('.')}; see '{command}'")


def _check_streams() -> None:
    """End before any work where the results would have nowhere to go; errors that nobody hears are left out."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
    if sys.stdout is None:
        console.complain("standard output is closed; give it somewhere to go, such as > /dev/null")
        sys.exit(1)


def run() -> None:
    """Entry of the command: every error becomes one line and a non-zero status."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the receiver's matrices are too small to share among threads
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # told to end: as tidy as after Ctrl-C
    _check_streams()
    try:
        status = app(standalone_mode=False, prog_name=NAME)
    except HeliographError as error:
        console.complain(str(error))
        sys.exit(1)
    except TyperError as error:
        _usage(error)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        console.complain("interrupted")
        sys.exit(console.INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except MemoryError:
        console.complain("not enough memory; make the film shorter or its frames smaller")
        sys.exit(1)
    except OSError as error:
        console.complain(f"{error.filename or 'input or output'}: {error.strerror or error}")
        sys.exit(1)
    if status == console.INTERRUPTED:  # typer's way to hand on Ctrl-C
        console.complain("interrupted")
    sys.exit(status)
