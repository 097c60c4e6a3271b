"""Film of a data set: frames, truth and cut-outs in an HDF5 file, readable by `open_film`."""

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.files import clear_write_errors, whole_file
from heliograph.base.frames import Frame, Pixels
from heliograph.channel.truth import Truth
from heliograph.datasets.plan import PlannedFilm
from heliograph.link.simulate import Recordings, simulate, transmitters
from heliograph.link.truth import SIGNAL_TAG
from heliograph.measure.bench import dithered, random_messages
from heliograph.media.hdf5 import PatientFile
from heliograph.sweeps.points import load_recording


def write_planned(path: Path, film: PlannedFilm, before: int, progress: Callable[[float], None]) -> None:
    """Simulate a film and write the file atomically; report progress in films, `before` of which are finished."""
    settings = dithered(film.settings, film.seed)
    messages = random_messages(settings, film.seed)
    recordings = Recordings(**{kind: load_recording(kind, file) for kind, file in film.point.recordings.items()})
    with whole_file(path) as partial, _open(partial, path) as file:
        first, last = [10**9] * len(messages), [-1] * len(messages)
        side_m = settings.signal.side * settings.channel.emitter.pitch_m
        for count, (frame, truth) in enumerate(simulate(settings, messages, film.seed, recordings), 1):
            row = {"frames": frame.pixels, "times_s": np.float64(frame.time_s), **_truth_row(truth, side_m)}
            for name, value in (row | _cutout_row(frame, truth, film.cutout_px)).items():
                _append(file, name, value)
            for k, array in enumerate(truth.arrays):
                first[k] = min([first[k], *array.patterns])
                last[k] = max([last[k], *array.patterns])
            progress(before + min(count / max(film.frames, 1), 1.0))
        for k, sender in enumerate(transmitters(settings, messages)):
            begin = min(first[k], last[k] + 1)
            group = file.create_group(f"sent/{k}")
            group.attrs.update(identity=settings.transmit.identities[k], first_pattern=begin)
            for pattern in islice(sender.levels(), begin, last[k] + 1):
                _append(group, "levels", pattern)
            for layer, parts in messages[k].items():
                data = b"".join(part for part in parts if isinstance(part, bytes))
                group[f"messages/{layer}"] = np.frombuffer(data, np.uint8)
        file.attrs.update(
            rate_hz=settings.channel.camera.fps,
            bits=settings.channel.sensor.bits,
            metadata=json.dumps({SIGNAL_TAG: json.dumps(asdict(settings.signal))}),
            split=film.split,
            number=film.number,
            seed=film.seed,
            varied=json.dumps(dict(film.point.choice)),
            settings=json.dumps(asdict(settings)),
        )


def _append(group: Any, name: str, value: Any) -> None:
    """Append a row to a data set of a group."""
    shape = value.shape
    if name not in group:
        # images in separate chunks
        chunks = (1 if len(shape) > 1 else 64, *(n or 1 for n in shape))
        group.create_dataset(name, (0, *shape), value.dtype, maxshape=(None, *shape), chunks=chunks)
    data = group[name]
    data.resize(len(data) + 1, axis=0)
    data[-1] = value


def _truth_row(truth: Truth, side_m: float) -> dict[str, Any]:
    arrays = truth.arrays
    ends = [(array.patterns[0], array.patterns[-1]) if array.patterns else (-1, -1) for array in arrays]  # -1: dark
    return {
        "truth/index": np.int64(truth.index),
        "truth/time_s": np.float64(truth.time_s),
        "truth/corners": np.array([corners(array.homography, side_m) for array in arrays], np.float32),
        "truth/homography": np.array([array.homography for array in arrays]),
        "truth/distance_m": np.array([array.distance_m for array in arrays], np.float32),
        "truth/visible": np.array([array.visible for array in arrays], bool),
        "truth/patterns": np.array(ends, np.int32),
    }


def corners(homography: Floats, side_m: float) -> Floats:
    """Return the corners of an array in the image, upper left first, then clockwise; NaN behind the camera."""
    square = side_m / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    points = np.column_stack([square, np.ones(4)]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(points[:, 2:] > 0, points[:, :2] / points[:, 2:], np.nan)


def _cutout_row(frame: Frame, truth: Truth, size: int) -> dict[str, Any]:
    cut = [cut_out(frame.pixels, array.x, array.y, size) for array in truth.arrays]
    return {
        "cutouts/pixels": np.array([pixels for pixels, _ in cut]),
        "cutouts/origin": np.array([origin for _, origin in cut], np.int32),
    }


def cut_out(pixels: Pixels, x: float, y: float, size: int) -> tuple[Pixels, tuple[int, int]]:
    """Return a square of pixels around a position, 0 outside the frame, and the corner."""
    rows, columns = pixels.shape
    x, y = (float(np.clip(np.nan_to_num(at, nan=-size), -size, end + size)) for at, end in ((x, columns), (y, rows)))
    left, top = round(x - (size - 1) / 2), round(y - (size - 1) / 2)
    out: Pixels = np.zeros((size, size), pixels.dtype)
    i, j = max(top, 0), max(left, 0)
    part = pixels[i : max(top + size, 0), j : max(left + size, 0)]
    out[i - top : i - top + part.shape[0], j - left : j - left + part.shape[1]] = part
    return out, (left, top)


@contextlib.contextmanager
def _open(partial: Path, target: Path) -> Iterator[Any]:
    """Create an HDF5 file; convert errors."""
    with clear_write_errors(target):
        disk = PatientFile(partial)
        try:
            with h5py.File(disk, "w") as file:
                yield file
        finally:
            disk.close()
            if disk.error is not None:
                raise disk.error
