"""Conversion of films, and list of live cameras."""

from pathlib import Path

from heliograph.base.errors import MediaError
from heliograph.base.words import counted
from heliograph.cli import console
from heliograph.cli.live import ended_by_ctrl_c, report_camera, show_counts
from heliograph.cli.options import FilmOptions, LiveOptions, refuse_to_replace
from heliograph.media import convert_film, open_film
from heliograph.media.film import keeps_levels
from heliograph.media.live.camera import PREFIX, list_cameras
from heliograph.media.live.reader import live_of
from heliograph.media.live.settings import camera_settings


def run_cameras(assignments: list[str] | None, *, as_json: bool) -> None:
    """List the connected cameras, and the missing requirements of other kinds."""
    cameras, missing = list_cameras(camera_settings(assignments or ()))
    if as_json:
        console.say_json({"cameras": cameras, "lacking": missing})
        return
    width = max((len(camera["name"]) for camera in cameras), default=0)
    for camera in cameras:
        console.say(f"{camera['name']:{width}}  {camera['text']}")
    if not cameras:
        console.say("no camera found")
    for kind, reason in missing.items():
        console.say_prose(f"{PREFIX}{kind}: {reason}")


def run_convert(
    film: Path, output: Path, film_options: FilmOptions, live: LiveOptions, codec: str | None, crf: float | None
) -> None:
    """Convert a film, or record a live camera until Ctrl-C."""
    refuse_to_replace(output, (film,))
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
