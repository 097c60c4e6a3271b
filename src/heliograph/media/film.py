"""Open, create and convert films. A suffix selects the kind of a new film."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.files import room_for
from heliograph.base.frames import Pixels
from heliograph.media import hdf5, images, phantom, photron, tiff, video_read, video_write
from heliograph.media.arrays import ArrayReader, refuse_dump
from heliograph.media.live.reader import LiveReader, film_path, is_camera, live_of
from heliograph.media.live.settings import CameraSettings, camera_settings
from heliograph.media.phantom import PhantomReader
from heliograph.media.photron import PhotronReader
from heliograph.media.reader import FilmReader, Reading, clear_read_errors
from heliograph.media.record import FilmSpec
from heliograph.media.tiff import TiffReader
from heliograph.media.view import ViewReader, check_view
from heliograph.media.writer import FilmWriter, ThreadedSink, clear_errors, partial_path

FILM_SUFFIXES = (*video_write.CODECS, *hdf5.SUFFIXES)  # suffixes of new films


_KINDS: tuple[tuple[Callable[[Path, Reading], FilmReader], Callable[[Path, bytes], bool], tuple[str, ...]], ...] = (
    # raw frames begin with any bytes
    (PhotronReader, lambda path, _: path.suffix.lower() in photron.SUFFIXES, ()),
    (images.AnimationReader, images.is_animation, ()),
    (images.ImagesReader, images.is_picture, ()),
    (PhantomReader, lambda _, head: head.startswith(phantom.SIGNATURE), (".cine",)),
    (TiffReader, lambda _, head: head.startswith(tiff.SIGNATURES), tiff.SUFFIXES),
    (ArrayReader, lambda _, head: head.startswith(b"\x93NUMPY"), (".npy",)),
    (hdf5.Hdf5Reader, lambda path, _: hdf5.is_hdf5(path), hdf5.SUFFIXES),
)
"""Reader, check of path and first bytes, and usual suffixes of kinds for which FFmpeg is not needed."""

_NO_FILMS = {
    b"MATLAB 5.0 MAT-file": "is of MATLAB before 7.3: save it there with '-v7.3', the frames as (row, column, frame)",
    b"PK\x03\x04": "is an archive, such as .zip or .npz: unpack it and give the film in it",
    b"\x1f\x8b": "is compressed by gzip: unpack it first",
}
"""Advice on files of other kinds, by first bytes."""


def open_film(
    path: str | os.PathLike[str],
    *,
    expand_range: bool = False,
    rate_hz: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    binning: int = 1,
    rotate: int = 0,
    channel: str = "luma",
    camera: Mapping[str, Any] | Iterable[str] = (),
) -> FilmReader:
    """Open a recording or a camera as gray frames: a film of `create_film`, a video, a camera file, or pictures.

    ======================================== ============================ =================================
    recording                                name                         rate and times
    ======================================== ============================ =================================
    HDF5 of `create_film`                    .h5, .hdf5                   of the file
    Photron                                  .mraw, .cih or .cihx         header: record rate over step
    Phantom                                  .cine                        the camera's rate and stamps
    TIFF, a page for each frame              .tif, .tiff                  ``rate_hz``
    a picture for each frame                 folder, or ``img%04d.png``   ``rate_hz``
    single picture                           .png, .jpg, .bmp, .webp ...  ``rate_hz``
    animated picture                         .gif, .png, .webp            the pictures' delays
    NumPy's array (frames, rows, columns)    .npy                         ``rate_hz``
    any video known to FFmpeg                .mp4, .mov, .avi, .y4m ...   of the file
    a live camera                            ``camera:KIND:ADDRESS``      the camera's rate and clock
    ======================================== ============================ =================================

    Gray levels are those in the file: luma of YUV video is not rescaled, RGB is weighted to luma by Rec. ITU-R BT.601.
    The display matrix of a video puts the frames upright.

    Parameters
    ----------
    path
        The file, the folder of pictures, or a pattern of names with %d or %04d for a number. The content selects the
        kind; only Photron needs the suffix.
    expand_range
        True to stretch limited-range video (black at 16, white at 235, usual for dashcams) to full scale, as the
        commands and the pages do. Untagged YUV video counts as limited, as in FFmpeg and players; MJPEG, RGB, gray and
        raw recordings count as full range. Films of `create_film` are full range and stay unchanged.
    rate_hz
        Frames per second of the camera, above 0, if the file claims another rate, as in slow motion, or has no clock.
        Frame k then has the time ``k / rate_hz``; gaps between even stamps count as missing frames. None for the times
        of the file.
    crop
        (x, y, width, height) of the kept part in pixels of the upright frames; x and y count from 0 at the upper left.
        None for the full frames.
    binning
        Side in pixels, 1 to 16, of squares in the kept part; each square becomes a pixel with the mean level. With 2 a
        pixel averages all filters of a Bayer mosaic.
    rotate
        Clockwise rotation of the part afterwards: 0, 90, 180 or 270 degrees.
    channel
        "luma", "red", "green" or "blue": gray level of a colour.
    camera
        Settings of a live camera by name, see `heliograph.media.live.settings.CameraSettings`, or texts such as
        "exposure_us=500". Recordings take none. A live film lasts until stopped; ``rate_hz`` then replaces only a
        missing rate of the camera, and no times.

    Returns
    -------
    FilmReader
        A context manager and iterable of `heliograph.base.frames.Frame`.

    Raises
    ------
    MediaError
        An option is invalid, or a rate is needed; the file is missing, empty, no film, or damaged beyond reading;
        or a folder has no pictures. Iterating reports later damage, after the good frames.
    SettingsError
        The camera does not know a setting, or the value is out of range.
    """
    path = film_path(path)
    check_view(crop, binning, rotate)
    reading = Reading(rate_hz=rate_hz, expand_range=expand_range, channel=channel)
    settings = camera_settings(camera)
    if is_camera(path):
        film: FilmReader = LiveReader(str(path), reading, settings)
    elif settings != CameraSettings():
        raise MediaError(f"{path} is a recording: only a live camera, such as camera:aravis, takes settings")
    else:
        film = _open_recording(path, reading)
    return film if (crop, binning, rotate) == (None, 1, 0) else ViewReader(film, crop, binning, rotate)


def _open_recording(path: Path, reading: Reading) -> FilmReader:
    head = None
    with clear_read_errors(path):
        is_there = path.exists()
        if path.is_dir() or images.is_pattern(path):
            return images.ImagesReader(path, reading)
        if path.is_file():
            with path.open("rb") as file:
                head = file.read(64)
            for open_kind, matches, _ in _KINDS:
                if matches(path, head):
                    return open_kind(path, reading)
    if not is_there:
        raise MediaError(f"there is no file {path}: check the name")
    if head is None:
        raise MediaError(f"{path} is a pipe or a device: save the film to a file first")
    if not head:
        raise MediaError(f"{path} is empty: copy or record it again")
    for signature, advice in _NO_FILMS.items():
        if head.startswith(signature):
            raise MediaError(f"{path} {advice}")
    try:
        return video_read.VideoReader(path, reading)
    except MediaError:
        refuse_dump(path)
        for open_kind, _, suffixes in _KINDS:
            if path.suffix.lower() in suffixes:
                return open_kind(path, reading)  # reports the damage
        raise


def create_film(
    path: str | os.PathLike[str],
    *,
    width: int,
    height: int,
    rate_hz: float,
    bits: int = 8,
    codec: str | None = None,
    metadata: Mapping[str, str] | None = None,
    crf: float | None = None,
    lossless: bool = False,
    mbit_s: float | None = None,
) -> FilmWriter:
    """Create a film; the suffix selects the kind.

    ======= ======================= =============== ==================================================================
    suffix  codecs, default first   exact levels    times
    ======= ======================= =============== ==================================================================
    .nut    ffv1, h264, h265, mjpeg ffv1, lossless  to 1 us, exact on the grid of ``rate_hz``
    .mkv    ffv1, h264, h265, mjpeg ffv1, lossless  exact on the grid, elsewhere to 1 ms; up to 1000 frames a second
    .mp4    h264, h265              lossless        to 1 us, exact on the grid
    .avi    mjpeg                   no              the grid only; up to 1000 frames a second
    .h5     none                    yes             exact
    ======= ======================= =============== ==================================================================

    The grid is the first frame's time plus multiples of ``1 / rate_hz``; frames may be missing.

    Parameters
    ----------
    path
        The target; an existing file is replaced when the film is finished, not before.
    width
        Columns in pixels, at least 1.
    height
        Rows in pixels, at least 1.
    rate_hz
        Nominal frames per second, 1e-6 to 1e6.
    bits
        Bits of a gray level: 8 to 16 with FFV1 and HDF5, 8 to 10 with H.264, 8 with MJPEG.
    codec
        "ffv1", "h264", "h265" or "mjpeg"; None for the suffix's default.
    metadata
        Text to keep with the film, by name.
    crf
        Quality of lossy H.264, from 0 (best) to 51; None for 12, an unbiased error of about 1.4 gray levels rms in
        noise of 1.5. The usual 18 wipes the noise out.
    lossless
        True for H.264 that keeps every bit: faster than FFV1, but few players show such films.
    mbit_s
        Bit rate of H.264 or H.265 in Mbit/s, 0.1 to 1000: the film is then like a phone's, in 4:2:0 and limited
        range. None for a constant quality.

    Returns
    -------
    FilmWriter
        A context manager with ``write``, ``finish`` and ``abort``.

    Raises
    ------
    MediaError
        Unknown suffix or codec, settings in conflict, or no right to write there.
    """
    target = film_path(path)
    suffix = target.suffix.lower()
    if suffix not in FILM_SUFFIXES:
        suffixes = ", ".join(FILM_SUFFIXES)
        raise MediaError(f"unknown kind of film {target.name!r}: the name must end in one of {suffixes}")
    spec = FilmSpec(
        width=width, height=height, rate_hz=rate_hz, bits=bits, metadata={} if metadata is None else metadata
    )
    is_hdf5 = suffix in hdf5.SUFFIXES
    if is_hdf5 and (codec is not None or crf is not None or mbit_s is not None):
        raise MediaError(f"{suffix} films are not coded: leave out codec and crf, or choose .mkv, .nut, .mp4 or .avi")
    name = "" if is_hdf5 else video_write.choose_codec(spec, suffix, codec, crf, lossless, mbit_s)
    partial = partial_path(target)
    try:
        with clear_errors(target):
            if is_hdf5:  # writes faster than a queue passes frames on
                return FilmWriter(target, partial, spec, hdf5.Hdf5Sink(partial, spec))
            sink = video_write.VideoSink(partial, target.suffix.lower(), spec, name, crf, lossless, mbit_s)
            return FilmWriter(target, partial, spec, ThreadedSink(sink))
    except MediaError:
        partial.unlink(missing_ok=True)
        raise


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
    """Write a film's frames, rate, bits and metadata into a film of another kind.

    Parameters
    ----------
    source
        The film, opened by `open_film`.
    target
        The film to write; the suffix selects the kind, see `create_film`.
    progress
        Called with the number of frames written.
    codec
        "ffv1", "h264" or "mjpeg"; None for the suffix's default.
    crf
        Quality of lossy H.264, 0 to 51; None keeps every gray level, but in AVI and MJPEG.

    Returns
    -------
    Frames written. Ctrl-C closes the film with the frames so far and raises KeyboardInterrupt again. An existing
    target is replaced only if all is written, or if the source is a live camera.

    Raises
    ------
    MediaError
        The source is no film, or is the target. The target cannot be written, or does not support rate or bits; no
        file is left. The source is damaged; the target keeps the good frames, as after Ctrl-C.
    """
    if not isinstance(source, FilmReader):
        raise MediaError(f"convert_film takes a film as open_film gives it, not {type(source).__name__}")
    path = film_path(target)
    if path.exists() and source.path.exists() and path.samefile(source.path):
        raise MediaError(f"{path} is read and would be written: give the output another name")
    bits, new, suffix = source.bits, not path.exists(), path.suffix.lower()
    if suffix in hdf5.SUFFIXES:
        room_for(path, (source.frame_count or 0) * source.width * source.height * (1 if bits == 8 else 2))
    lossless = crf is None and (codec == "h264" or (codec is None and suffix == ".mp4"))
    size: dict[str, Any] = {"width": source.width, "height": source.height, "rate_hz": source.rate_hz, "bits": bits}
    with create_film(path, metadata=source.metadata, codec=codec, crf=crf, lossless=lossless, **size) as film:
        try:
            for frame in source:
                film.write(frame)
                if progress is not None:
                    progress(film.frames_written)
        except (MediaError, KeyboardInterrupt):
            # frames of a camera do not come again
            if film.frames_written and (new or live_of(source) is not None):
                film.finish()  # no effect after a failed write
            raise
    return film.frames_written


class ColourFilm:
    """A film opened for reading in colour: iterate it for the frames; each iteration starts at the first frame.

    Memory does not grow with the film. Use it as a context manager, or call `close`.

    Parameters
    ----------
    films
        The film opened once for each of red, green and blue.

    Attributes
    ----------
    path
        The film's file, for error messages.
    width, height
        Columns and rows of a frame in pixels.
    bits
        Bits of a gray level, 8 to 16.
    rate_hz
        Frames per second of the camera.
    frame_count
        Expected frames, for a progress display; None if unknown.
    """

    def __init__(self, films: tuple[FilmReader, FilmReader, FilmReader]) -> None:
        self._films, first = films, films[0]
        self.path: Path = first.path
        self.width, self.height, self.bits = first.width, first.height, first.bits
        self.rate_hz, self.frame_count = first.rate_hz, first.frame_count

    def __iter__(self) -> Iterator[Pixels]:
        """Yield the frames in order of time.

        Yields
        ------
        Pixels
            (rows, columns, 3) uint8 for 8 bit, else uint16: red, green and blue.

        Raises
        ------
        MediaError
            The film is closed or damaged, as for `open_film`.
        """
        for frames in zip(*self._films, strict=True):
            pixels: Pixels = np.dstack([frame.pixels for frame in frames])  # type: ignore[assignment]
            yield pixels

    def close(self) -> None:
        """Close the film; may be called twice."""
        for film in self._films:
            film.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_colours(path: str | os.PathLike[str], **options: Any) -> ColourFilm:
    """Open a recording in colour, for panels with LEDs of several colours.

    The film is decoded once for each colour. In a gray film all three colours are the gray levels.

    Parameters
    ----------
    path
        The file, the folder of pictures, or a pattern of names with %d or %04d for a number.
    options
        Options of `open_film` except for the channel: rate_hz, crop, binning, rotate, expand_range.

    Returns
    -------
    ColourFilm
        A context manager and iterable of arrays (rows, columns, 3) of red, green and blue.

    Raises
    ------
    MediaError
        A channel is given, or the film cannot be read, as for `open_film`.
    """
    if "channel" in options:
        raise MediaError("a film in colour has all channels: leave channel out, or use open_film")
    red, green, blue = (open_film(path, channel=colour, **options) for colour in ("red", "green", "blue"))
    return ColourFilm((red, green, blue))
