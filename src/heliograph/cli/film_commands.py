"""Commands on films and live cameras: receive, convert, cameras, probe, with their options."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import MediaError
from heliograph.base.words import counted
from heliograph.cli import console, options
from heliograph.cli.light_commands import Codec
from heliograph.cli.live import LiveOptions, attend, ended_by_ctrl_c, show_counts


def run_cameras(assignments: list[str] | None, as_json: bool) -> None:
    """List the cameras that are there, and say of each kind without any what it lacks."""
    from heliograph.media.live.camera import PREFIX, list_cameras
    from heliograph.media.live.settings import camera_settings

    found, lacking = list_cameras(camera_settings(assignments or ()))
    if as_json:
        console.say_json({"cameras": found, "lacking": lacking})
        return
    width = max((len(camera["name"]) for camera in found), default=0)
    for camera in found:
        console.say(f"{camera['name']:{width}}  {camera['text']}")
    if not found:
        console.say("no camera found")
    for kind, why in lacking.items():
        console.say_prose(f"{PREFIX}{kind}: {why}")


def run_convert(
    film: Path, output: Path, seen: options.FilmOptions, live: LiveOptions, codec: str | None, crf: float | None
) -> None:
    """Write a film as another kind; Ctrl-C ends that of a live camera."""
    from heliograph.media import convert_film, open_film
    from heliograph.media.film import keeps_levels
    from heliograph.media.live.reader import live_of

    options.refuse_to_replace(output, (film,))
    written, new = 0, not output.exists()

    def kept() -> str:
        """What is in the output, where it was not written to its end."""
        if not new and camera is None:
            return f"{output} is as it was"
        return (
            f"{output} holds the {counted(written, 'frame')} so far"
            if written and output.exists()
            else "nothing was written"
        )

    with open_film(film, **seen.keywords(), **live.keywords(film)) as source:
        camera = live_of(source)
        if camera is not None:
            attend(camera)
        try:
            with console.progress("converting", source.frame_count) as advance, ended_by_ctrl_c(camera):

                def note(frames: int) -> None:
                    nonlocal written
                    written = frames
                    advance(frames)

                count = convert_film(source, output, note, codec=codec, crf=crf)
        except KeyboardInterrupt:
            console.complain(f"interrupted; {kept()}")
            sys.exit(console.INTERRUPTED)
        except MediaError as error:
            raise MediaError(f"{error}; {kept()}") if written else error from None
    exact = "" if keeps_levels(output, codec, crf) else "; its gray levels are not quite those of the source"
    console.say(f"{output}: {counted(count, 'frame')}{exact}")
    show_counts(camera)


READ = (
    "Video, .h5, .mraw, .cine, TIFF stack, .npy, folder of pictures, or their names such as img%04d.png. Or a live "
    "camera, camera:KIND:ADDRESS."
)
"""Films that are read, for the help."""


def film_argument(text: str) -> Path:
    """Take what is given for a film: the path of a file, or the name of a live camera."""
    from heliograph.media.live.reader import film_path

    return film_path(text)


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
Duration = Annotated[
    float | None, typer.Option(metavar="S", help="Seconds after which a live camera is left.", show_default=False)
]
Receiver = Annotated[
    str | None,
    typer.Option(
        help="Receiver: plain, soft, screen (for a phone's film of a screen) or one of your own; that of the preset if "
        "left out.",
        show_default=False,
        autocompletion=options.begun_receivers,
    ),
]


def receive(
    films: Annotated[list[Path], typer.Argument(metavar="FILM...", parser=film_argument, help=READ)],
    receiver: Receiver = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the messages and the packet log.", show_default=False),
    ] = None,
    files: Annotated[
        Path | None,
        typer.Option(
            "--files",
            metavar="DIR",
            show_default=False,
            help="Folder for files that were sent whole; what lacks symbols goes on there with the next film. If left "
            "out: the folder 'files' in that of --output.",
        ),
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
    duration: Duration = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HDF5 film of the last seconds of a live camera in which an array was lost or a packet not read, "
            "or of its end where nothing was read.",
            show_default=False,
        ),
    ] = None,
    record_s: Annotated[
        float, typer.Option("--record-s", metavar="S", min=0.1, max=3600, help="Seconds that --record keeps.")
    ] = 10.0,
    as_json: options.Json = False,
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
    scheduler: options.Scheduler = None,
) -> None:
    """Find arrays in films, or before a live camera, and read what they send; where nothing is read it says why.

    A live camera is camera:KIND or camera:KIND:ADDRESS; 'heliograph cameras' lists what is there. It is received until
    Ctrl-C, for --duration S, or to the camera's end.

    Films of 'simulate' hold a note of their signal, which wins over the preset. --settings and --set win over the
    note; a line says where they differ from it. Of several films, or a folder of films, a line of JSON is printed for
    each; --output has a folder for each, and what is there already is not read again. The exit status is 3 where no
    array was found, of several films in none of them.
    """
    from heliograph.cli.live import LiveOptions, Told
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
        run_many(films, seen, preset, settings, changes, output, (workers, scheduler), files)
        return
    live = LiveOptions(camera, duration, record, record_s)
    told = Told(follow, verbose, tuple(send or ()))
    run_receive(films[0], seen, output, truth, preset, settings, changes, as_json, told, live, files)


def cameras(camera: CameraOption = None, as_json: options.Json = False) -> None:
    """List the live cameras that are there, by the names that 'receive' takes, and what is missing to see others."""
    run_cameras(camera, as_json)


def probe(
    film: Annotated[Path, typer.Argument(metavar="FILM", parser=film_argument, help=READ)],
    receiver: Receiver = None,
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
    corners: Corners = None,
    region: Region = None,
    camera: CameraOption = None,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
    as_json: options.Json = False,
) -> None:
    """Tell what a film shows: its frames, light and noise, what blinks, why that is or is no array, what to change.

    The exit status is 0 where an array is read with the settings as they are, 3 where none is, and 1 where the film
    breaks off, or the receiver refuses its rate.
    """
    from heliograph.cli.probe import run_probe

    seen = options.FilmOptions(fps, crop, binning, rotate, channel)
    changes = [*(assignments or ()), *([f"receive.receiver='{receiver}'"] if receiver else ())]
    changes += options.place_changes(corners, region)
    run_probe(film, seen, camera, frames, output, preset, settings, changes, as_json)


def convert(
    film: Annotated[Path, typer.Argument(metavar="FILM", parser=film_argument, help=READ)],
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
    camera: CameraOption = None,
    duration: Duration = None,
) -> None:
    """Write a film as another kind, with its gray levels and times; .h5 is the fastest to read.

    A live camera is recorded until Ctrl-C, or for --duration S.
    """
    from heliograph.cli.live import LiveOptions

    seen, live = options.FilmOptions(fps, crop, binning, rotate, channel), LiveOptions(camera, duration)
    run_convert(film, output, seen, live, codec, crf)


def serve(
    films: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILM]...", parser=film_argument, help=f"Films that page Watch offers. {READ}"),
    ] = None,
    host: Annotated[
        str,
        typer.Option("--host", help="Address of this machine to wait at; 0.0.0.0 lets others come in, by a token."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port to wait at; 0 takes a free one.")] = 8000,
    certificate: Annotated[
        Path | None,
        typer.Option(
            "--certificate",
            metavar="PEM",
            show_default=False,
            help="Certificate for HTTPS: browsers of other machines keep their camera from pages without.",
        ),
    ] = None,
    key: Annotated[
        Path | None, typer.Option("--key", metavar="PEM", show_default=False, help="Key of the certificate.")
    ] = None,
    browse: Annotated[bool, typer.Option("--open", help="Open the pages in this machine's browser.")] = False,
    camera: CameraOption = None,
    receiver: Receiver = None,
    preset: options.Preset = "paper",
    settings: options.SettingsFile = None,
    assignments: options.Assignments = None,
) -> None:
    """Show pages in a browser: watch what the receiver does, transmit by a screen, receive by a phone's camera.

    This machine alone reaches them, unless --host says otherwise: then an address with a token is printed, and its QR
    code on a terminal. Films that a page uploads are kept until the server ends. Ctrl-C ends it.
    """
    from heliograph.cli.serve import run_serve

    changes = [*(assignments or ()), *([f"receive.receiver='{receiver}'"] if receiver else ())]
    run_serve(films or [], (host, port), certificate, key, browse, camera, preset, settings, changes)
