"""heliograph convert."""

import sys
from pathlib import Path

from heliograph.base.errors import MediaError
from heliograph.base.words import counted
from heliograph.cli import console, options
from heliograph.cli.live import LiveOptions, attend, ended_by_ctrl_c, show_counts


def run_convert(
    film: Path, output: Path, seen: options.FilmOptions, live: LiveOptions, codec: str | None, crf: float | None
) -> None:
    """Write a film as another kind; Ctrl-C ends that of a live camera."""
    from heliograph.media import convert_film, open_film
    from heliograph.media.convert import keeps_levels
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
