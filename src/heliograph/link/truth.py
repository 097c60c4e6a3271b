"""The truth of a simulated film, in a file beside it: what was sent, and where the arrays were in each frame.

Only error counting and pictures read it, never a receiver.
"""

import contextlib
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.config import from_mapping, to_mapping
from heliograph.base.errors import MediaError, SettingsError
from heliograph.channel import Truth
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages
from heliograph.signal.settings import LAYERS

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
]
"""An array in a frame: `ArrayTruth`, with the first pattern shown in it or -1."""


def row_type(arrays: int) -> np.dtype[Any]:
    """Type of a frame's row."""
    return np.dtype([("index", "i8"), ("time_s", "f8"), ("arrays", ARRAY_FIELDS, (arrays,))])


def truth_path(film: Path) -> Path:
    """Name of the truth file of a film: FILM.truth.npz."""
    return film.with_name(film.name + ".truth.npz")


class TruthWriter:
    """Writes the truth of a film frame by frame; the file appears whole when finished.

    Parameters
    ----------
    path
        The .npz file.
    settings, messages, seed
        What was simulated.
    """

    def __init__(self, path: Path, settings: LinkSettings, messages: Sequence[Messages], seed: int):
        self._path, self._settings, self._messages, self._seed = path, settings, messages, seed
        self._type = row_type(len(settings.channel.arrays))
        try:
            self._rows = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115 - lives as long as the writer
        except OSError as error:
            raise MediaError(f"cannot write in {path.parent}: {error.strerror}") from None
        self._count = 0

    def add(self, truth: Truth) -> None:
        """Append a frame."""
        row = np.zeros(1, self._type)
        row["index"], row["time_s"] = truth.index, truth.time_s
        row["arrays"][0] = [
            (a.x, a.y, a.pitch_px, a.roll_rad, a.distance_m, a.visible, a.patterns[0] if a.patterns else -1)
            for a in truth.arrays
        ]
        self._rows.write(row.tobytes())
        self._count += 1

    def finish(self) -> None:
        """Write the file."""
        partial = self._path.with_name(f".{self._path.name}.partial")
        try:
            self._write(partial)
            os.replace(partial, self._path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise MediaError(
                f"cannot write {self._path}: {error.strerror}; make room or choose another place"
            ) from None
        finally:
            self._rows.close()

    def abort(self) -> None:
        """Leave nothing behind."""
        self._rows.close()

    def _write(self, partial: Path) -> None:
        about = {"settings": to_mapping(self._settings), "seed": self._seed, "messages": self._message_names()}
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr("about.json", json.dumps(about))
            for name, data in zip(_flat(self._message_names()), _contents(self._messages), strict=True):
                archive.writestr(name, data)
            with archive.open("frames.npy", "w", force_zip64=True) as out:
                header = {"descr": np.lib.format.dtype_to_descr(self._type), "fortran_order": False}
                np.lib.format.write_array_header_2_0(out, {**header, "shape": (self._count,)})
                self._rows.seek(0)
                while block := self._rows.read(1 << 20):
                    out.write(block)

    def _message_names(self) -> list[dict[str, list[str]]]:
        return [
            {name: [f"messages/{k}/{name}/{i}" for i in range(len(m.get(name, ())))] for name in LAYERS}
            for k, m in enumerate(self._messages)
        ]


@dataclass(frozen=True)
class TruthFile:
    """A truth file opened for reading.

    Attributes
    ----------
    path
        The file.
    settings, messages, seed
        What was simulated.
    """

    path: Path
    settings: LinkSettings
    messages: Sequence[Messages]
    seed: int

    def rows(self) -> Iterator[NDArray[Any]]:
        """Rows of `row_type`, one a frame."""
        kind = row_type(len(self.settings.channel.arrays))
        with _broken_is_clear(self.path), zipfile.ZipFile(self.path) as archive, archive.open("frames.npy") as file:
            np.lib.format.read_magic(file)
            np.lib.format.read_array_header_2_0(file)
            while block := file.read(CHUNK * kind.itemsize):
                yield from np.frombuffer(block, kind)


def open_truth(path: Path) -> TruthFile:
    """Open a truth file.

    Raises
    ------
    MediaError
        It is missing, damaged, or no truth file.
    """
    if not path.is_file():
        raise MediaError(f"there is no truth file {path}; 'heliograph simulate' writes it beside the film")
    with _broken_is_clear(path), zipfile.ZipFile(path) as archive:
        about = json.loads(archive.read("about.json"))
        messages = [{n: [archive.read(i) for i in names] for n, names in m.items()} for m in about["messages"]]
        return TruthFile(path, from_mapping(LinkSettings, about["settings"]), messages, about["seed"])


@contextlib.contextmanager
def _broken_is_clear(path: Path) -> Iterator[None]:
    try:
        yield
    except (zipfile.BadZipFile, KeyError, ValueError, EOFError, SettingsError) as error:
        raise MediaError(f"{path} is no truth file, or damaged ({error}); simulate the film again") from None


def _flat(names: list[dict[str, list[str]]]) -> list[str]:
    return [name for by_layer in names for layer in LAYERS for name in by_layer[layer]]


def _contents(messages: Sequence[Messages]) -> Iterator[bytes]:
    for by_layer in messages:
        for layer in LAYERS:
            yield from by_layer.get(layer, ())
