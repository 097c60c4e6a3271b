"""Conversion of a film into another kind, with gray levels and times."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.base.files import room_for
from heliograph.media import hdf5
from heliograph.media.film import checked_path, create_film
from heliograph.media.live.reader import live_of
from heliograph.media.reader import FilmReader


def keeps_levels(target: Path, codec: str | None, crf: float | None) -> bool:
    """True if `convert_film` keeps the gray levels of the source."""
    return crf is None and codec != "mjpeg" and target.suffix.lower() != ".avi"


def convert_film(
    source: FilmReader,
    target: str | os.PathLike[str],
    progress: Callable[[int], None] | None = None,
    *,
    codec: str | None = None,
    crf: float | None = None,
) -> int:
    """Write a film's frames into a film of another kind; its rate, bits and metadata go with them.

    Parameters
    ----------
    source
        The film, opened by `open_film`.
    target
        The film to write; its suffix chooses the kind, see `create_film`.
    progress
        Called with the number of frames written.
    codec
        "ffv1", "h264" or "mjpeg"; None for the suffix's default.
    crf
        Quality of lossy H.264, 0 to 51; None keeps every gray level, but in AVI and MJPEG.

    Returns
    -------
    Frames written. On Ctrl-C the film is closed with the frames so far, and KeyboardInterrupt is raised again. A film
    that had the target's name before stays as it was, unless all is written or the source is a live camera.

    Raises
    ------
    MediaError
        The source is no film, or the one to be written. Or the film cannot be written, or its kind does not hold rate
        or bits: nothing is left. Or the source is damaged: its whole frames are kept in the target, likewise.
    """
    if not isinstance(source, FilmReader):
        raise MediaError(f"convert_film takes a film as open_film gives it, not {type(source).__name__}")
    path = checked_path(target)
    if path.exists() and source.path.exists() and path.samefile(source.path):
        raise MediaError(f"{path} is read and would be written: give the output another name")
    bits, new = source.bits, not path.exists()
    if path.suffix.lower() in hdf5.SUFFIXES:
        room_for(path, (source.frame_count or 0) * source.width * source.height * (1 if bits == 8 else 2))
    coded: dict[str, Any] = {"codec": codec, "crf": crf}
    if crf is None and (codec == "h264" or (codec is None and path.suffix.lower() == ".mp4")):
        coded["lossless"] = True
    coded |= {"width": source.width, "height": source.height, "rate_hz": source.rate_hz, "bits": bits}
    with create_film(path, metadata=source.metadata, **coded) as film:
        try:
            for frame in source:
                film.write(frame)
                if progress is not None:
                    progress(film.frames_written)
        except (MediaError, KeyboardInterrupt):
            # what a camera has shown does not come again
            if film.frames_written and (new or live_of(source) is not None):
                film.finish()  # does nothing where it could not be written, and is gone
            raise
    return film.frames_written
