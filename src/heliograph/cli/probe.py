"""Diagnosis of films."""

import sys
from pathlib import Path

import cv2

from heliograph.base.errors import HeliographError, counted
from heliograph.base.files import clear_write_errors
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.media import open_film
from heliograph.media.live.reader import is_camera
from heliograph.probe import probe_film
from heliograph.probe.page import write_page
from heliograph.probe.screens import with_receiver_for
from heliograph.probe.words import as_mapping, lines


@options.command
def probe(
    film: options.Film,
    *,
    detect: options.DetectOptions,
    frames: int | None = option("Probe only the first N frames; live camera: 2048.", "N", min=1),
    output: Path | None = option("Folder for probe.html, with pictures.", "DIR"),
    film_options: options.FilmOptions,
    camera: options.CameraOption = None,
    settings: options.SettingsOptions,
    as_json: options.Json = False,
) -> None:
    """Diagnose a film: light, regions, arrays, causes, remedies.

    Describes frames, light and noise, and why each blinking region is or is not an array.

    The exit status is 0 if an array is read with these settings, 3 if no array is read, and 1 if the film is truncated,
    or the receiver refuses the frame rate.
    """
    is_auto, settings = settings.is_auto(detect.receiver), settings.changed(overrides=detect.assignments())
    link = settings.load()
    cv2.setNumThreads(1)  # as in receive
    # two seconds of a live camera of the reference link
    frames = 2048 if frames is None and is_camera(film) else frames
    with open_film(film, **film_options.keywords(), camera=camera or ()) as source:
        signal, departure = settings.signal_of(source)
        if departure:
            console.complain(departure)
        if is_auto:
            link, _ = with_receiver_for(source, signal, link)
        if output is not None:
            with clear_write_errors(output):
                output.mkdir(parents=True, exist_ok=True)
        total = source.frame_count if frames is None else min(frames, source.frame_count or frames)
        with console.progress("probing", total) as advance:
            findings = probe_film(source, signal, link.receive, advance, most=frames)
    if as_json:
        console.say_json(as_mapping(findings))
    else:
        for line in lines(findings):
            console.say_prose(line)
    if output is not None:
        page = output / "probe.html"
        write_page(page, findings)
        if not as_json:
            console.say(f"page {page}")
    elif not as_json:
        console.note("--output DIR writes probe.html, with pictures")
    if findings.broken == "interrupted":
        frame_count = counted(findings.times.count, "frame")
        console.exit_interrupted(f"interrupted after {frame_count}; the findings so far are above")
    if findings.broken or findings.error:
        raise HeliographError(findings.broken or findings.error)
    sys.exit(0 if findings.read else console.NO_ARRAY)
