"""Conversion of films."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import MediaError, counted
from heliograph.cli import console, options
from heliograph.cli.live import ended_by_ctrl_c, report_camera, show_counts
from heliograph.cli.options import option
from heliograph.media import convert_film, open_film
from heliograph.media.film import keeps_levels
from heliograph.media.live.reader import live_of


@options.command
def convert(
    film: options.Film,
    output: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    *,
    film_options: options.FilmOptions,
    codec: options.Codec = None,
    crf: float | None = option("Quality of lossy H.264, 0 to 51; by default all gray levels are kept."),
    live: options.LiveOptions,
) -> None:
    """Convert a film to another format.

    Gray levels and times are kept; .h5 is the fastest to read.

    A live camera is recorded until Ctrl-C, or for --duration S.
    """
    options.refuse_to_replace(output, (film,))
    is_new = not output.exists()

    def output_state() -> str:
        """Describe the output after an early end."""
        if not is_new and camera is None:
            return f"{output} is unchanged"
        if advance.done and output.exists():
            return f"{output} holds the {counted(int(advance.done), 'frame')} so far"
        return "nothing was written"

    with open_film(film, **film_options.keywords(), **live.keywords(film)) as source:
        camera = live_of(source)
        if camera is not None:
            report_camera(camera)
        advance = console.Progress()
        try:
            with console.progress("converting", source.frame_count) as advance, ended_by_ctrl_c(camera):
                count = convert_film(source, output, advance, codec=codec, crf=crf)
        except KeyboardInterrupt:
            console.exit_interrupted(f"interrupted; {output_state()}")
        except MediaError as error:
            raise MediaError(f"{error}; {output_state()}") if advance.done else error from None
    exact = "" if keeps_levels(output, codec, crf) else "; gray levels differ slightly from the source"
    console.say(f"{output}: {counted(count, 'frame')}{exact}")
    show_counts(camera)
