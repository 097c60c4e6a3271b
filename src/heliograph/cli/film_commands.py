"""Commands for films and live cameras."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import MediaError
from heliograph.cli import options


@options.with_groups
def receive(
    films: Annotated[list[Path], typer.Argument(metavar="FILM...", parser=options.parse_film, help=options.FILM_KINDS)],
    *,
    detect: options.DetectOptions,
    results: options.OutputOptions,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="FILE", help="Truth of the film, for error counts.")
    ] = None,
    film: options.FilmOptions,
    settings: options.SettingsOptions,
    live: options.RecordOptions,
    as_json: options.Json = False,
    events: options.EventOptions,
    crew: options.WorkerOptions,
) -> None:
    """Find arrays in films or in front of a live camera, and read the messages; diagnose unreadable films.

    A live camera is camera:KIND or camera:KIND:ADDRESS; 'heliograph cameras' lists the connected cameras. The reception
    ends with Ctrl-C, after --duration S, or at the end of the camera.

    Films of 'simulate' contain a note of the signal, which overrides the preset. --settings and --set override the
    note; a line reports differences. For several films, or a folder of films, the output is a line of JSON for each
    film; --output has a folder for each film, and existing results are not computed again. The exit status is 3 if no
    array was found in any film.
    """
    from heliograph.cli.receive import run_receive
    from heliograph.cli.receive_many import is_many, run_many

    chosen = settings.changed(overrides=detect.assignments())
    received = options.ReceiveOptions(film, chosen, results, truth, live, events, as_json)
    if not is_many(films) and crew == options.WorkerOptions():
        run_receive(films[0], received)
        return
    is_watched = events.follow or events.send or events.verbose
    if truth or live.camera or live.record or live.duration is not None or is_watched:
        raise MediaError(
            "--truth, --follow, --send, --verbose and cameras' options accept a single film: receive films in turn"
        )
    run_many(films, received, crew)


def cameras(camera: options.CameraOption = None, as_json: options.Json = False) -> None:
    """List the connected live cameras by names for 'receive', and the missing requirements of other kinds."""
    from heliograph.cli.convert import run_cameras

    run_cameras(camera, as_json=as_json)


@options.with_groups
def probe(
    film: options.Film,
    *,
    detect: options.DetectOptions,
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=1, metavar="N", help="Probe only the first N frames; live camera: 2048."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="DIR", help="Folder for probe.html, with pictures.")
    ] = None,
    film_options: options.FilmOptions,
    camera: options.CameraOption = None,
    settings: options.SettingsOptions,
    as_json: options.Json = False,
) -> None:
    """Describe a film: frames, light and noise, blinking regions, why each is or is not an array, and the remedy.

    The exit status is 0 if an array is read with these settings, 3 if no array is read, and 1 if the film is truncated,
    or the receiver refuses the frame rate.
    """
    from heliograph.cli.probe import run_probe

    chosen = settings.changed(overrides=detect.assignments())
    run_probe(film, film_options, chosen, camera, frames, output, as_json=as_json)


@options.with_groups
def convert(
    film: options.Film,
    output: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    *,
    film_options: options.FilmOptions,
    codec: options.Codec = None,
    crf: Annotated[
        float | None, typer.Option(help="Quality of lossy H.264, 0 to 51; by default all gray levels are kept.")
    ] = None,
    live: options.LiveOptions,
) -> None:
    """Convert a film to another format, with gray levels and times; .h5 is the fastest to read.

    A live camera is recorded until Ctrl-C, or for --duration S.
    """
    from heliograph.cli.convert import run_convert

    run_convert(film, output, film_options, live, codec, crf)


@options.with_groups
def serve(
    films: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILM]...", parser=options.parse_film, help=f"Films for page Watch. {options.FILM_KINDS}"
        ),
    ] = None,
    *,
    address: options.AddressOptions,
    browse: Annotated[bool, typer.Option("--open", help="Open the pages in this machine's browser.")] = False,
    camera: options.CameraOption = None,
    receiver: options.Receiver = None,
    settings: options.SettingsOptions,
) -> None:
    """Serve pages for a browser: watch the receiver, transmit by a screen, receive by the camera of a phone.

    By default only this machine has access. With --host, an address with a token is printed, on a terminal also as a
    QR code. Uploaded films are deleted when the server ends. Ctrl-C ends the server.
    """
    from heliograph.cli.serve import run_serve

    chosen = settings.changed(overrides=options.DetectOptions(receiver).assignments())
    run_serve(films or [], address, camera, chosen, browse=browse)
