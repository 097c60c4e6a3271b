"""Truth of a simulated film, in a file beside it, and the check that film and truth agree."""

import contextlib
import hashlib
import io
import json
import lzma
import os
import struct
import tempfile
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.config import from_mapping, keys_of, merge, to_mapping
from heliograph.base.errors import HeliographError, MediaError, brief
from heliograph.base.files import LONGEST_NAME, clear_write_errors, whole_file
from heliograph.channel import NoiseModel, Truth
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages
from heliograph.media import FilmReader
from heliograph.signal.block import MAX_MESSAGE
from heliograph.signal.fountain.codes import CODES
from heliograph.signal.fountain.files import SentFile
from heliograph.signal.header import IDENTITIES
from heliograph.signal.message import MAX_MESSAGES, Updates
from heliograph.signal.settings import LAYERS, SignalSettings
from heliograph.transmit import Content

MOST_ABOUT = 1 << 24
"""Most bytes of the text about a film: its settings and the names of its messages take 700 kB at most."""

MOST_HEADER = 1 << 16
"""Most bytes of the header of the rows, of which version 1.0 holds no more; one written here has 400."""

CHUNK = 4096
"""Rows read at once."""

ARRAY_FIELDS = [
    ("x", "f4"),
    ("y", "f4"),
    ("pitch_px", "f4"),
    ("roll_rad", "f4"),
    ("distance_m", "f4"),
    ("visible", "?"),
    ("pattern", "i4"),
    ("last_pattern", "i4"),
    ("homography", "f4", (3, 3)),
]
"""An array in a frame: `ArrayTruth`, with the first and the last pattern shown in it, or -1 and -1."""

NOISE_LEVEL = 0.5
"""Mean level, by full scale, for which the truth states the rms noise."""


def row_type(arrays: int) -> np.dtype[Any]:
    """Type of a frame's row."""
    return np.dtype([("index", "i8"), ("time_s", "f8"), ("arrays", ARRAY_FIELDS, (arrays,))])


def truth_path(film: Path) -> Path:
    """Return the path of a film's truth file, FILM.truth.npz; a name too long for file systems is cut."""
    name, ending = os.fsencode(film.name), ".truth.npz"
    if len(name) + len(ending) <= LONGEST_NAME:
        return film.with_name(film.name + ending)
    ending = f"-{hashlib.sha256(name).hexdigest()[:8]}{ending}"
    return film.with_name(name[: LONGEST_NAME - len(ending)].decode(errors="ignore") + ending)


class TruthWriter:
    """Writes the truth of a film frame by frame; the file appears whole when finished."""

    def __init__(self, path: Path, settings: LinkSettings, messages: Sequence[Messages], seed: int, film_id: str = ""):
        self._path, self._settings, self._messages = path, settings, messages
        self._seed, self._film_id = seed, film_id
        self._type = row_type(len(settings.channel.arrays))
        with clear_write_errors(path):
            if path.is_dir():
                raise MediaError(f"{path} is a folder: move it away, the film's truth goes there")
            self._rows = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115 - lives as long as the writer
        self._count = 0

    def add(self, truth: Truth) -> None:
        """Append a frame."""
        row = np.zeros(1, self._type)
        row["index"], row["time_s"] = truth.index, truth.time_s
        row["arrays"][0] = [
            (a.x, a.y, a.pitch_px, a.roll_rad, a.distance_m, a.visible, *_ends(a.patterns), a.homography)
            for a in truth.arrays
        ]
        with clear_write_errors(self._path):
            self._rows.write(row.tobytes())
        self._count += 1

    @contextlib.contextmanager
    def finishing(self) -> Iterator[None]:
        """Write the file; it takes its place when the block ends well, and not at all otherwise.

        So a film can be finished in the block, and there is never a film beside the truth of another one.
        """
        try:
            with whole_file(self._path) as partial:
                self._write(partial)
                yield
        finally:
            self.abort()

    def abort(self) -> None:
        """Leave nothing behind."""
        with contextlib.suppress(OSError):  # what is buffered may find no room
            self._rows.close()

    def _write(self, partial: Path) -> None:
        names = _names(self._messages)
        sigma = float(NoiseModel(self._settings.channel.sensor).sigma(NOISE_LEVEL))
        about = {
            "settings": to_mapping(self._settings),
            "seed": self._seed,
            "messages": names,
            "film_id": self._film_id,
            "noise": {"level": NOISE_LEVEL, "sigma": sigma},  # both by full scale
        }
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr("about.json", json.dumps(about))
            for name, data in _contents(self._messages):
                archive.writestr(name, data)
            with archive.open("frames.npy", "w", force_zip64=True) as out:
                header = {"descr": np.lib.format.dtype_to_descr(self._type), "fortran_order": False}
                np.lib.format.write_array_header_2_0(out, {**header, "shape": (self._count,)})
                self._rows.seek(0)
                left = self._count * self._type.itemsize  # Ctrl-C may have left a row that is not counted
                while block := self._rows.read(min(left, 1 << 20)):
                    out.write(block)
                    left -= len(block)


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """The part of a frame's truth that errors are counted with."""

    # Number of the frame
    index: int
    # True time of the start of its exposure in s
    time_s: float
    # Distance of each array in m, in the order of the settings, rounded to single precision as in a file
    distances_m: Sequence[float]
    # Whether all LEDs of each array are in view
    visible: Sequence[bool]


@dataclass(frozen=True)
class TruthFile:
    """A truth file opened for reading."""

    # The .npz file, from which rows are read when they are asked for
    path: Path
    # settings, messages, seed: what was simulated: the link, what each array sent in the order of the arrays, and the
    # seed
    settings: LinkSettings
    messages: Sequence[Messages]
    seed: int
    # Id the film has as well; empty where unknown
    film_id: str = ""

    def frames(self) -> Iterator[FrameTruth]:
        """Truth of each frame, in the order of time; a MediaError where the file is damaged."""
        for row in self.rows():
            arrays = row["arrays"]
            yield FrameTruth(
                int(row["index"]), float(row["time_s"]), arrays["distance_m"].tolist(), arrays["visible"].tolist()
            )

    def rows(self) -> Iterator[NDArray[Any]]:
        """Rows of `row_type`, one per frame, in the order of time."""
        kind = row_type(len(self.settings.channel.arrays))
        with _broken_is_clear(self.path), zipfile.ZipFile(self.path) as archive, archive.open("frames.npy") as file:
            left = count = _count(file, kind)
            while block := file.read(CHUNK * kind.itemsize):
                if len(block) % kind.itemsize:
                    raise _broken(self.path, "it ends within a row")
                rows = np.frombuffer(block, kind)
                left -= len(rows)
                _check_rows(rows)
                yield from rows
            if left:
                raise _broken(self.path, f"it should have {count} rows, not {count - left}")


def open_truth(path: Path) -> TruthFile:
    """Open a truth file."""
    if not path.is_file():
        raise MediaError(f"there is no truth file {path}; 'heliograph simulate' writes it beside the film")
    with _broken_is_clear(path), zipfile.ZipFile(path) as archive:
        about = json.loads(_read(archive, "about.json", MOST_ABOUT))
        messages = [{n: [_content(archive, i) for i in m[n][: MAX_MESSAGES + 1]] for n in LAYERS}
                    for m in about["messages"][: IDENTITIES + 1]]  # fmt: skip
        settings = from_mapping(LinkSettings, about["settings"])
        arrays = len(settings.channel.arrays)
        if len(messages) != arrays:
            raise _broken(path, f"it has messages of {len(messages)} arrays, not {arrays}")
        with archive.open("frames.npy") as file:
            _count(file, row_type(arrays))
        return TruthFile(path, settings, messages, int(about["seed"]), str(about.get("film_id", "")))


def _read(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Read a part of an archive, of which a small file may hold very much."""
    size = archive.getinfo(name).file_size
    if size > most:
        raise HeliographError(f"{name} has {size} bytes, more than {most}")
    return archive.read(name)


def _count(file: IO[bytes], kind: np.dtype[Any]) -> int:
    """Read the header of the rows, which NumPy would read whatever its length: return how many rows follow."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise HeliographError(f"its rows are in version {version[0]}.{version[1]} of .npy, not 1.0 or 2.0")
    width, read = _HEADERS[version]
    length = file.read(width)
    size = int.from_bytes(length, "little")
    if size > MOST_HEADER:
        raise HeliographError(f"the header of its rows has {size} bytes, more than {MOST_HEADER}")
    with warnings.catch_warnings(action="ignore"):  # of what only damage makes of the header
        shape, _, stored = read(io.BytesIO(length + file.read(size)))
    if stored != kind:
        raise HeliographError(f"its rows have the type {stored}, not {kind}")
    if len(shape) != 1:
        raise HeliographError(f"its rows have the shape {shape}, not one for each frame")
    if not shape[0]:
        raise HeliographError("it has no frames")
    return int(shape[0])


_HEADERS = {(1, 0): (2, np.lib.format.read_array_header_1_0), (2, 0): (4, np.lib.format.read_array_header_2_0)}
"""Bytes of a header's length, and what reads length and header, by the version of .npy."""


_BROKEN = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, OSError,
    LookupError, ValueError, TypeError, AttributeError, NotImplementedError, RuntimeError, OverflowError,
    SyntaxError, tokenize.TokenError,
)  # fmt: skip
"""All that a damaged archive, or an archive of something else, makes of reading it."""


@contextlib.contextmanager
def _broken_is_clear(path: Path) -> Iterator[None]:
    try:
        yield
    except MediaError:
        raise
    except HeliographError as error:
        raise _broken(path, brief(error)) from None
    except zipfile.BadZipFile:
        if path.suffix.lower() not in (".npz", ""):
            raise MediaError(f"{path} is no truth file: those end in .truth.npz, beside the film") from None
        raise _broken(path, "no whole archive") from None
    except _BROKEN as error:
        # what Python calls it helps nobody, but a system's reason, such as a right that lacks, does
        raise _broken(path, getattr(error, "strerror", None) or "") from None


def _check_rows(rows: NDArray[Any]) -> None:
    numbers = (rows["time_s"], *(rows["arrays"][name] for name in ("x", "y", "pitch_px", "distance_m")))
    if not all(np.isfinite(column).all() for column in numbers):
        raise HeliographError("a time, place or distance is no number")


def _broken(path: Path, what: str) -> MediaError:
    reason = f" ({what})" if what else ""
    return MediaError(f"{path} is no truth file, or damaged{reason}; simulate the film again")


def _ends(patterns: Sequence[int]) -> tuple[int, int]:
    return (patterns[0], patterns[-1]) if patterns else (-1, -1)


def _names(messages: Sequence[Messages]) -> list[dict[str, list[Any]]]:
    """What stands for each message: the name of its bytes; of a file its own name too; of updates their times."""
    return [
        {name: [_name(_place(k, name, i), one) for i, one in enumerate(by_layer.get(name, ()))] for name in LAYERS}
        for k, by_layer in enumerate(messages)
    ]


def _place(array: int, layer: str, message: int) -> str:
    return f"messages/{array}/{layer}/{message}"


def _name(place: str, content: Content) -> Any:
    if isinstance(content, SentFile):
        return {"file": place, "name": content.name, "code": content.code}
    if isinstance(content, Updates):
        return {"updates": place, "times_s": [time_s for time_s, _ in content.contents],
                "lengths": [len(data) for _, data in content.contents]}  # fmt: skip
    return place


def _contents(messages: Sequence[Messages]) -> Iterator[tuple[str, bytes]]:
    for k, by_layer in enumerate(messages):
        for layer in LAYERS:
            for i, one in enumerate(by_layer.get(layer, ())):
                yield _place(k, layer, i), _bytes_of(one)


def _bytes_of(content: Content) -> bytes:
    if isinstance(content, SentFile):
        return content.data
    return b"".join(data for _, data in content.contents) if isinstance(content, Updates) else content


def _content(archive: zipfile.ZipFile, named: Any) -> Content:
    """A message by what stands for it."""
    if isinstance(named, str):
        return _read(archive, named, MAX_MESSAGE)
    if "file" in named:
        if named["code"] not in CODES:
            raise HeliographError(f"it names a code {named['code']!r:.40}")
        return SentFile(str(named["name"]), _read(archive, named["file"], MAX_MESSAGE), named["code"])
    data, ends = _read(archive, named["updates"], MOST_ABOUT), list(accumulate(map(int, named["lengths"])))
    parts = [data[start:end] for start, end in zip([0, *ends], ends, strict=False)]
    return Updates(tuple(zip(map(float, named["times_s"]), parts, strict=True)))


SIGNAL_TAG = "heliograph_signal"
"""Metadata of a film that holds its signal's settings; a receiver may know them."""

TRUTH_TAG = "heliograph_simulation"
"""Metadata of a simulated film that names its truth file: a random id both have."""


def signal_note(signal: SignalSettings) -> dict[str, str]:
    """Return what a film notes of its signal, as metadata."""
    return {SIGNAL_TAG: json.dumps(to_mapping(signal))}


def noted_signal(film: FilmReader) -> dict[str, Any]:
    """Signal settings that a film notes, as nested mappings; empty where it notes none."""
    text = film.metadata.get(SIGNAL_TAG)
    if text is None:
        return {}
    try:
        note = json.loads(text)
        from_mapping(SignalSettings, note)
    except (ValueError, RecursionError) as error:  # no JSON, or no settings
        raise MediaError(
            f"the film's note on its signal is unreadable ({brief(error)}); set signal.* yourself"
        ) from None
    return dict(note)


def signal_of(
    film: FilmReader, preset: SignalSettings, changes: Sequence[Mapping[str, Any]] = ()
) -> tuple[SignalSettings, str]:
    """Signal of a film: the preset's, changed by the film's note and then by the changes."""
    try:
        note = noted_signal(film)
    except MediaError:
        if not any(changes):
            raise
        note = {}
    noted = merge(to_mapping(preset), note)
    tree = noted
    for change in changes:
        tree = merge(tree, change)
    signal = from_mapping(SignalSettings, tree)
    departures = _differences(signal, from_mapping(SignalSettings, noted)) if note else []
    listed = ", ".join(f"{key}={ours} instead of {theirs}" for key, ours, theirs in departures)
    return signal, f"not as the film's note says: {listed}" if listed else ""


def departures(film: object, signal: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Return the settings in which a signal differs from what a film notes: dotted key, value, noted value."""
    try:
        note = json.loads(getattr(film, "metadata", {}).get(SIGNAL_TAG, "{}"))
        return _differences(signal, from_mapping(SignalSettings, merge(to_mapping(signal), note)))
    except (ValueError, RecursionError):  # no JSON, or no settings
        return []


def _differences(one: SignalSettings, other: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Dotted keys in which two signals differ, with both values."""
    pairs = [(key, _value(one, key), _value(other, key)) for key in keys_of(SignalSettings)]
    return [(f"signal.{key}", _shown(a), _shown(b)) for key, a, b in pairs if a != b]


def _value(settings: Any, key: str) -> Any:
    for part in key.split("."):
        settings = getattr(settings, part)
    return settings


def _shown(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def check_truth(film: FilmReader, truth: TruthFile, signal: SignalSettings) -> None:
    """Check that errors can be counted: the truth is that of the film, and the signal is the one that was sent."""
    camera, own = truth.settings.channel.camera, film.metadata.get(TRUTH_TAG)
    size, rate = (camera.width, camera.height), camera.fps
    if own and truth.film_id and own != truth.film_id:
        differs = "they come from different simulations"
    elif size != (film.width, film.height):
        differs = f"it has frames of {size[0]}x{size[1]} pixels, the film of {film.width}x{film.height}"
    # relative departure of a film's rate from its truth's that a container's rounding explains
    elif abs(rate / film.rate_hz - 1) > 1e-3:
        differs = f"it has {rate:g} frames/s, the film {film.rate_hz:g}"
    elif departures := _differences(signal, truth.settings.signal):
        key, ours, sent = departures[0]
        raise MediaError(
            f"{key} is {ours}, but {truth.path} says {sent} was sent: errors cannot be counted; "
            f"leave signal.* as the film notes it, or give no truth"
        )
    else:
        return
    raise MediaError(f"{truth.path} is not the truth of {film.path}: {differs}; give the one written beside the film")
