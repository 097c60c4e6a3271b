"""Truth file of a simulated film, and consistency check of film and truth."""

import contextlib
import hashlib
import io
import json
import os
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import reduce
from itertools import accumulate, pairwise, product
from operator import attrgetter
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.config import from_mapping, keys_of, merge
from heliograph.base.errors import HeliographError, MediaError, brief
from heliograph.base.files import LONGEST_NAME, clear_write_errors, whole_file
from heliograph.channel.truth import NoiseModel, Truth
from heliograph.link.settings import LinkSettings
from heliograph.media import FilmReader
from heliograph.signal.block import MAX_MESSAGE
from heliograph.signal.fountain.codes import CODES
from heliograph.signal.fountain.files import SentFile
from heliograph.signal.header import IDENTITIES
from heliograph.signal.message import MAX_MESSAGES, Updates
from heliograph.signal.settings import LAYERS, SignalSettings
from heliograph.transmit import Content, Messages

MAX_ABOUT = 1 << 24  # maximum size in bytes of film metadata and of message updates
BLOCK_ROWS = 4096  # rows per read

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
"""`ArrayTruth` of a frame, with the first and the last visible pattern, or -1 and -1."""

NOISE_LEVEL = 0.5  # mean level in full scales of the rms noise in the truth file


def row_type(arrays: int) -> np.dtype[Any]:
    """Return the type of a frame row."""
    return np.dtype([("index", "i8"), ("time_s", "f8"), ("arrays", ARRAY_FIELDS, (arrays,))])


def truth_path(film: Path) -> Path:
    """Return the path of the truth file, FILM.truth.npz; shorten names that exceed the file system limit."""
    name, ending = os.fsencode(film.name), ".truth.npz"
    if len(name) + len(ending) <= LONGEST_NAME:
        return film.with_name(film.name + ending)
    ending = f"-{hashlib.sha256(name).hexdigest()[:8]}{ending}"
    return film.with_name(name[: LONGEST_NAME - len(ending)].decode(errors="ignore") + ending)


class TruthWriter:
    """Writer of a truth file, frame by frame; the file appears when finished."""

    def __init__(self, path: Path, settings: LinkSettings, messages: Sequence[Messages], seed: int, film_id: str = ""):
        self._path, self._settings, self._messages = path, settings, messages
        self._seed, self._film_id = seed, film_id
        self._type = row_type(len(settings.channel.arrays))
        with clear_write_errors(path):
            if path.is_dir():
                raise MediaError(f"{path} is a folder: move it away to make room for the truth file")
            path.parent.stat()
            # on the disk above 16 MB, 160,000 frames of an array
            self._rows = tempfile.SpooledTemporaryFile(1 << 24, dir=str(path.parent))  # noqa: SIM115 - closed in `finishing`

    def add(self, truth: Truth) -> None:
        """Append a frame."""
        row = np.zeros(1, self._type)
        row["index"], row["time_s"] = truth.index, truth.time_s
        ends = [(*a.patterns[:1], *a.patterns[-1:]) or (-1, -1) for a in truth.arrays]
        row["arrays"][0] = [
            (a.x, a.y, a.pitch_px, a.roll_rad, a.distance_m, a.visible, *end, a.homography)
            for a, end in zip(truth.arrays, ends, strict=True)
        ]
        with clear_write_errors(self._path):
            self._rows.write(row.tobytes())

    def close(self) -> None:
        """Discard the rows."""
        self._rows.close()

    @contextlib.contextmanager
    def finishing(self) -> Iterator[None]:
        """Write the file, and publish it if the block succeeds: finish the film in the block."""
        with self._rows, whole_file(self._path) as partial:
            self._write(partial)
            yield

    def _write(self, partial: Path) -> None:
        sigma = float(NoiseModel(self._settings.channel.sensor).sigma(NOISE_LEVEL))
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            messages: list[dict[str, list[Any]]] = [{layer: [] for layer in LAYERS} for _ in self._messages]
            for k, layer in product(range(len(messages)), LAYERS):
                for i, content in enumerate(self._messages[k].get(layer, ())):
                    messages[k][layer].append(_add_message(archive, f"messages/{k}/{layer}/{i}", content))
            about = {
                "settings": asdict(self._settings),
                "seed": self._seed,
                "messages": messages,
                "film_id": self._film_id,
                "noise": {"level": NOISE_LEVEL, "sigma": sigma},  # both in full scales
            }
            archive.writestr("about.json", json.dumps(about))
            with archive.open("frames.npy", "w", force_zip64=True) as out:
                shape = (self._rows.tell() // self._type.itemsize,)
                header = {"descr": np.lib.format.dtype_to_descr(self._type), "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_2_0(out, header)
                self._rows.seek(0)
                shutil.copyfileobj(self._rows, out)


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """Truth of a frame for error counts."""

    # Frame number
    index: int
    # True start of the exposure in s
    time_s: float
    # Distance of each array in m, in the order of the settings, in single precision
    distances_m: Sequence[float]
    # True for arrays with all LEDs in view
    visible: Sequence[bool]
    # Centre (x, y) and pitch of each array in px; empty if unknown
    places: Sequence[Sequence[float]] = ()
    # (arrays, 3, 3) as in `ArrayTruth`; empty if unknown
    homographies: NDArray[Any] = field(default_factory=lambda: np.empty((0, 3, 3)))


@dataclass(frozen=True)
class TruthFile:
    """Truth of a simulated film.

    Attributes
    ----------
    path
        The .npz file; frames are read on demand.
    settings
        Settings of the simulated link.
    messages
        Messages of each array by layer, in the order of ``settings.transmit.identities``.
    seed
        Seed of road, scene and noise.
    film_id
        Random id that film and truth share; empty if unknown.
    """

    path: Path
    settings: LinkSettings
    messages: Sequence[Messages]
    seed: int
    film_id: str = ""

    def frames(self) -> Iterator[FrameTruth]:
        """Yield the truth of each frame in temporal order; raise MediaError for a damaged file."""
        for row in self.rows():
            arrays = row["arrays"]
            yield FrameTruth(
                int(row["index"]),
                float(row["time_s"]),
                arrays["distance_m"].tolist(),
                arrays["visible"].tolist(),
                arrays[["x", "y", "pitch_px"]].tolist(),
                arrays["homography"],
            )

    def rows(self) -> Iterator[NDArray[Any]]:
        """Yield a row for each frame in temporal order.

        Returns
        -------
        Structured arrays of shape () with the fields ``index``, ``time_s`` (true start of the exposure in s) and
        ``arrays``: of each array ``x``, ``y`` (centre on the sensor in px), ``pitch_px``, ``roll_rad``, ``distance_m``,
        ``visible`` (all LEDs in view), ``pattern`` and ``last_pattern`` (numbers of the first and the last pattern in
        the exposure, -1 without), and ``homography`` (3, 3) from the LED grid to the sensor.

        Raises
        ------
        MediaError
            The file is damaged.
        """
        kind = row_type(len(self.settings.channel.arrays))
        with _media_errors(self.path), zipfile.ZipFile(self.path) as archive, archive.open("frames.npy") as file:
            left = count = _read_header(file, kind)
            while block := file.read(BLOCK_ROWS * kind.itemsize):
                if len(block) % kind.itemsize:
                    raise _broken(self.path, "it ends within a row")
                rows = np.frombuffer(block, kind)
                left -= len(rows)
                numbers = (rows["time_s"], *(rows["arrays"][name] for name in ("x", "y", "pitch_px", "distance_m")))
                if not all(np.isfinite(column).all() for column in numbers):
                    raise _broken(self.path, "a time, place or distance is no number")
                yield from rows
            if left:
                raise _broken(self.path, f"it should have {count} rows, not {count - left}")


def open_truth(path: Path | str) -> TruthFile:
    """Open the truth file of a simulated film.

    Parameters
    ----------
    path
        The file that ``heliograph simulate`` writes next to the film, FILM.truth.npz.

    Raises
    ------
    MediaError
        There is no such file, or it is damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise MediaError(f"there is no truth file {path}; 'heliograph simulate' writes it next to the film")
    with _media_errors(path), zipfile.ZipFile(path) as archive:
        about = json.loads(_read(archive, "about.json", MAX_ABOUT))
        messages = [{n: [_content(archive, i) for i in m[n][: MAX_MESSAGES + 1]] for n in LAYERS}
                    for m in about["messages"][: IDENTITIES + 1]]  # fmt: skip
        settings = from_mapping(LinkSettings, about["settings"])
        arrays = len(settings.channel.arrays)
        if len(messages) != arrays:
            raise _broken(path, f"it has messages of {len(messages)} arrays, not {arrays}")
        with archive.open("frames.npy") as file:
            _read_header(file, row_type(arrays))
        return TruthFile(path, settings, messages, int(about["seed"]), str(about.get("film_id", "")))


def _read(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Read an archive member of limited size."""
    size = archive.getinfo(name).file_size
    if size > max_bytes:
        raise HeliographError(f"{name} has {size} bytes, more than {max_bytes}")
    return archive.read(name)


def _read_header(file: IO[bytes], kind: np.dtype[Any]) -> int:
    """Read the header of the rows; return their number."""
    head = io.BytesIO(file.read(1 << 16))  # limits the memory for a damaged header
    version = np.lib.format.read_magic(head)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with warnings.catch_warnings(action="ignore"):  # from damaged headers
        shape, _, stored = readers[version](head)
    file.seek(head.tell())
    if stored != kind or len(shape) != 1:
        raise HeliographError(f"the rows have the type {stored} and the shape {shape}")
    if not shape[0]:
        raise HeliographError("it has no frames")
    return int(shape[0])


@contextlib.contextmanager
def _media_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except MediaError:
        raise
    except HeliographError as error:
        raise _broken(path, brief(error)) from None
    except zipfile.BadZipFile:
        if path.suffix.lower() not in (".npz", ""):
            raise MediaError(f"{path} is no truth file: those end in .truth.npz, next to the film") from None
        raise _broken(path, "incomplete archive") from None
    except Exception as error:  # a damaged archive raises many kinds
        # only the reasons of the operating system help the user
        raise _broken(path, getattr(error, "strerror", None) or "") from None


def _broken(path: Path, detail: str) -> MediaError:
    reason = f" ({detail})" if detail else ""
    return MediaError(f"{path} is no truth file, or damaged{reason}; simulate the film again")


def _add_message(archive: zipfile.ZipFile, member: str, content: Content) -> Any:
    """Add the bytes of a message to the archive; return the member, with the name of a file or the times of updates."""
    if isinstance(content, SentFile):
        archive.writestr(member, content.data)
        return {"file": member, "name": content.name, "code": content.code}
    if isinstance(content, Updates):
        times, parts = zip(*content.contents, strict=True)
        archive.writestr(member, b"".join(parts))
        return {"updates": member, "times_s": list(times), "lengths": [len(data) for data in parts]}
    archive.writestr(member, content)
    return member


def _content(archive: zipfile.ZipFile, entry: Any) -> Content:
    """Return the content of an entry by `_add_message`."""
    if isinstance(entry, str):
        return _read(archive, entry, MAX_MESSAGE)
    if "file" in entry:
        if entry["code"] not in CODES:
            raise HeliographError(f"it names a code {entry['code']!r:.40}")
        return SentFile(str(entry["name"]), _read(archive, entry["file"], MAX_MESSAGE), entry["code"])
    data, ends = _read(archive, entry["updates"], MAX_ABOUT), list(accumulate(map(int, entry["lengths"])))
    parts = [data[start:end] for start, end in pairwise([0, *ends])]
    return Updates(tuple(zip(map(float, entry["times_s"]), parts, strict=True)))


SIGNAL_TAG = "heliograph_signal"  # film metadata key of the signal settings
TRUTH_TAG = "heliograph_simulation"  # film metadata key of the random id that film and truth file share


def signal_note(signal: SignalSettings) -> dict[str, str]:
    """Return film metadata with the signal settings."""
    return {SIGNAL_TAG: json.dumps(asdict(signal))}


def noted_signal(film: object) -> dict[str, Any]:
    """Return the signal settings in the film metadata as nested mappings; empty if absent."""
    try:
        note = json.loads(getattr(film, "metadata", {}).get(SIGNAL_TAG, "{}"))
        from_mapping(SignalSettings, note)
    except (ValueError, RecursionError) as error:  # invalid JSON or settings
        reason = brief(error)
        raise MediaError(f"the film's note on its signal is unreadable ({reason}); set signal.* explicitly") from None
    return dict(note)


def signal_of(
    film: FilmReader, preset: SignalSettings, changes: Sequence[Mapping[str, Any]] = ()
) -> tuple[SignalSettings, str]:
    """Return the signal settings of a film: the preset, changed by the film metadata and then by the changes."""
    try:
        note = noted_signal(film)
    except MediaError:
        if not any(changes):
            raise
        note = {}
    noted = merge(asdict(preset), note)
    signal = from_mapping(SignalSettings, reduce(merge, changes, noted))
    departures = _differences(signal, from_mapping(SignalSettings, noted)) if note else []
    listed = ", ".join(f"{key}={ours} instead of {theirs}" for key, ours, theirs in departures)
    return signal, f"not as the film's note says: {listed}" if listed else ""


def departures(film: object, signal: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Return dotted key, value and film metadata value of differing signal settings."""
    with contextlib.suppress(HeliographError):  # an unreadable note
        return _differences(signal, from_mapping(SignalSettings, merge(asdict(signal), noted_signal(film))))
    return []


def _differences(signal: SignalSettings, other: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Return dotted key and both values of differing settings."""
    pairs = [(key, attrgetter(key)(signal), attrgetter(key)(other)) for key in keys_of(SignalSettings)]
    plain = [(key, *(list(value) if isinstance(value, tuple) else value for value in pair)) for key, *pair in pairs]
    return [(f"signal.{key}", ours, theirs) for key, ours, theirs in plain if ours != theirs]


def check_truth(film: FilmReader, truth: TruthFile, signal: SignalSettings) -> None:
    """Check that the truth belongs to the film and to the signal settings."""
    camera, film_id = truth.settings.channel.camera, film.metadata.get(TRUTH_TAG)
    if film_id and truth.film_id and film_id != truth.film_id:
        differs = "they come from different simulations"
    elif (camera.width, camera.height) != (film.width, film.height):
        differs = f"it has frames of {camera.width}x{camera.height} pixels, the film of {film.width}x{film.height}"
    # containers round the frame rate
    elif abs(camera.fps / film.rate_hz - 1) > 1e-3:
        differs = f"it has {camera.fps:g} frames/s, the film {film.rate_hz:g}"
    elif departures := _differences(signal, truth.settings.signal):
        key, ours, sent = departures[0]
        raise MediaError(
            f"{key} is {ours}, but {truth.path} says {sent} was sent: errors cannot be counted; "
            f"leave signal.* as in the film, or give no truth"
        )
    else:
        return
    raise MediaError(f"{truth.path} is not the truth of {film.path}: {differs}; give the truth file of this film")
