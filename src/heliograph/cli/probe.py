"""heliograph probe, and its word in short where nothing is received."""

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError
from heliograph.base.files import clear_write_errors
from heliograph.base.words import counted
from heliograph.cli import console, options

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heliograph.link.settings import LinkSettings
    from heliograph.media import FilmReader
    from heliograph.probe import Findings
    from heliograph.signal.settings import SignalSettings

PAGE = "probe.html"
"""Name of the page in the folder of the results."""


def run_probe(
    film: Path,
    seen: options.FilmOptions,
    camera: list[str] | None,
    frames: int | None,
    output: Path | None,
    preset: str,
    file: Path | None,
    changes: list[str],
    as_json: bool,
) -> None:
    """Tell what a film shows; whatever ends it, what was found before is shown."""
    import cv2

    from heliograph.link.truth import signal_of
    from heliograph.media import open_film
    from heliograph.media.live.reader import is_camera
    from heliograph.probe import probe_film
    from heliograph.probe.page import write_page
    from heliograph.probe.words import as_mapping, lines

    settings = options.settings_from(preset, file, changes)
    base, signal_changes = options.settings_from(preset, None, None), options.signal_changes(file, changes)
    cv2.setNumThreads(1)  # as `receive`
    # frames of a live camera that are looked at where nobody says how many: two seconds of the reference link
    frames = 2048 if frames is None and is_camera(film) else frames
    with open_film(film, **seen.keywords(), camera=camera or ()) as source:
        signal, departure = signal_of(source, base.signal, signal_changes)
        if departure:
            console.complain(departure)
        if output is not None:
            with clear_write_errors(output):
                output.mkdir(parents=True, exist_ok=True)
        expected = source.frame_count if frames is None else min(frames, source.frame_count or frames)
        with console.progress("probing", expected) as advance:
            found = probe_film(source, signal, settings.receive, advance, most=frames)
    if as_json:
        console.say_json(as_mapping(found))
    else:
        for line in lines(found):
            console.say_prose(line)
    if output is not None:
        write_page(output / PAGE, found)
        if not as_json:
            console.say(f"page {output / PAGE}")
    elif not as_json:
        console.note(f"--output DIR writes {PAGE}, the same with pictures")
    if isinstance(found.broken, KeyboardInterrupt):
        console.complain(f"interrupted after {counted(found.times.count, 'frame')}; what they show is above")
        sys.exit(console.INTERRUPTED)
    if found.broken is not None:
        raise found.broken
    if found.error:
        raise HeliographError(found.error)
    sys.exit(0 if found.read else console.NO_ARRAY)


def found_array(report: "Mapping[str, Any]") -> bool:
    """True if a codeword of an array was decoded in a film, by the report of its reception."""
    return bool(report["arrays"])


def why_unread(
    source: "FilmReader",
    signal: "SignalSettings",
    settings: "LinkSettings",
    report: dict[str, Any],
    ending: BaseException | None,
    quiet: bool = False,
) -> "Findings | None":
    """What a film shows of which nothing was read, also put into the report; None where something was, or it broke off.

    Of a long film some stretches are looked at, spread over it.
    """
    from heliograph.base.errors import MediaError
    from heliograph.link.film import silent
    from heliograph.probe import probe_film
    from heliograph.probe.activity import MOST_FRAMES
    from heliograph.probe.words import as_mapping

    refused = isinstance(ending, HeliographError) and not isinstance(ending, MediaError)
    if found_array(report) or not (ending is None or refused):
        return None
    # stretches of a film in which no array was found that are looked at once more, spread over it
    most, every = 8 * MOST_FRAMES, 1
    if source.frame_count is not None:
        every, most = max(1, source.frame_count // most), source.frame_count
    with contextlib.nullcontext(silent) if quiet else console.progress("asking why", most) as advance:
        found = probe_film(source, signal, settings.receive, advance, reading=False, every=every, most=most)
    report["probe"] = as_mapping(found)
    if isinstance(found.broken, KeyboardInterrupt):
        raise found.broken
    return found
