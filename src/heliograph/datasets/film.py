"""One film of a data set: frames, truth and cut-outs in one HDF5 file, which `open_film` reads as any film."""

import contextlib
import json
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.config import to_mapping
from heliograph.base.errors import MediaError
from heliograph.base.files import whole_file
from heliograph.base.frames import Frame, Pixels
from heliograph.channel import Truth
from heliograph.datasets.plan import PlannedFilm
from heliograph.link.simulate import Recordings, load_footage, load_imu, simulate, transmitters
from heliograph.link.truth import SIGNAL_TAG
from heliograph.measure.bench import dithered, random_messages
from heliograph.media.hdf5 import PatientFile
from heliograph.sweeps.points import Recorded

STEP = 64
"""Rows by which data sets of a file grow. Chosen: it bounds memory, and one is rarely resized."""

CORNERS = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Corners of the LED area in sides of it: upper left, upper right, lower right, lower left as the array counts."""

NONE = -1
"""Stands for a pattern where a frame shows none."""


def write_planned(path: Path, film: PlannedFilm, progress: Callable[[int], None]) -> None:
    """Simulate a film into a file that appears whole or not at all."""
    settings = dithered(film.settings, film.seed)
    messages = random_messages(settings, film.seed)
    recordings = Recordings(
        footage=_loaded(film.point.recordings.get("footage"), load_footage),
        imu=_loaded(film.point.recordings.get("imu"), load_imu),
    )
    with whole_file(path) as partial, _opened(partial, path) as file:
        rows = _Rows(file)
        first, last = [10**9] * len(messages), [NONE] * len(messages)
        side_m = settings.signal.side * settings.channel.emitter.pitch_m
        for count, (frame, truth) in enumerate(simulate(settings, messages, film.seed, recordings), 1):
            rows.add({"frames": frame.pixels, "times_s": frame.time_s, **_truth_of(truth, side_m)})
            rows.add(_cutouts(frame, truth, film.cutout_px))
            for k, one in enumerate(truth.arrays):
                first[k] = min([first[k], *one.patterns])
                last[k] = max([last[k], *one.patterns])
            progress(count)
        rows.finish()
        for k, sender in enumerate(transmitters(settings, messages)):
            begin = min(first[k], last[k] + 1)
            levels = file.create_group(f"sent/{k}")
            levels.attrs.update(identity=settings.transmit.identities[k], first_pattern=begin)
            shown = _Rows(levels)
            for pattern in islice(sender.levels(), begin, last[k] + 1):
                shown.add({"levels": pattern})
            shown.finish()
            for layer, parts in messages[k].items():
                levels[f"messages/{layer}"] = np.frombuffer(
                    b"".join(part for part in parts if isinstance(part, bytes)), np.uint8
                )
        camera = settings.channel.camera
        file.attrs.update(
            rate_hz=camera.fps,
            bits=settings.channel.sensor.bits,
            metadata=json.dumps({SIGNAL_TAG: json.dumps(to_mapping(settings.signal))}),
            split=film.split,
            number=film.number,
            seed=film.seed,
            varied=json.dumps(dict(film.point.choice)),
            settings=json.dumps(to_mapping(settings)),
        )


class _Rows:
    """Appends to data sets of a file, a row of each at a time."""

    def __init__(self, group: Any) -> None:
        self._group = group
        self._waiting: dict[str, list[NDArray[Any]]] = {}

    def add(self, row: dict[str, Any]) -> None:
        """Append a value to each data set named."""
        for name, value in row.items():
            waiting = self._waiting.setdefault(name, [])
            waiting.append(np.array(value))
            if len(waiting) == STEP:
                self._write(name)

    def finish(self) -> None:
        """Write what is left."""
        for name in self._waiting:
            self._write(name)

    def _write(self, name: str) -> None:
        waiting = self._waiting[name]
        if not waiting:
            return
        values = np.stack(waiting)
        if name not in self._group:
            shape = values.shape[1:]
            chunk = 1 if len(shape) > 1 else STEP  # pictures one by one
            self._group.create_dataset(
                name, (0, *shape), values.dtype, maxshape=(None, *shape), chunks=(chunk, *(n or 1 for n in shape))
            )
        data = self._group[name]
        data.resize(len(data) + len(values), axis=0)
        data[-len(values) :] = values
        waiting.clear()


def _truth_of(truth: Truth, side_m: float) -> dict[str, Any]:
    arrays = truth.arrays
    ends = [(one.patterns[0], one.patterns[-1]) if one.patterns else (NONE, NONE) for one in arrays]
    return {
        "truth/index": np.int64(truth.index),
        "truth/time_s": np.float64(truth.time_s),
        "truth/corners": np.array([corners(one.homography, side_m) for one in arrays], np.float32),
        "truth/homography": np.array([one.homography for one in arrays]),
        "truth/distance_m": np.array([one.distance_m for one in arrays], np.float32),
        "truth/visible": np.array([one.visible for one in arrays], bool),
        "truth/patterns": np.array(ends, np.int32),
    }


def corners(homography: Floats, side_m: float) -> Floats:
    """Corners of an array in the image."""
    seen = np.column_stack([side_m * CORNERS, np.ones(4)]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(seen[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)


def _cutouts(frame: Frame, truth: Truth, size: int) -> dict[str, Any]:
    cut = [cut_out(frame.pixels, one.x, one.y, size) for one in truth.arrays]
    return {
        "cutouts/pixels": np.array([pixels for pixels, _ in cut]),
        "cutouts/origin": np.array([origin for _, origin in cut], np.int32),
    }


def cut_out(pixels: Pixels, x: float, y: float, size: int) -> tuple[Pixels, tuple[int, int]]:
    """Pixels about a place."""
    rows, columns = pixels.shape
    x, y = (float(np.clip(np.nan_to_num(at, nan=-size), -size, most + size)) for at, most in ((x, columns), (y, rows)))
    left, top = round(x - (size - 1) / 2), round(y - (size - 1) / 2)
    out: Pixels = np.zeros((size, size), pixels.dtype)
    i, j = max(top, 0), max(left, 0)
    part = pixels[i : max(top + size, 0), j : max(left + size, 0)]
    out[i - top : i - top + part.shape[0], j - left : j - left + part.shape[1]] = part
    return out, (left, top)


def _loaded(recorded: Recorded | None, load: Callable[[Path], Any]) -> Any:
    if recorded is None:
        return None
    path = Path(recorded.path)
    if Recorded.of(path).digest != recorded.digest:
        raise MediaError(f"the recording {path} has changed while the data set was written: put it back")
    return load(path)


@contextlib.contextmanager
def _opened(partial: Path, target: Path) -> Iterator[Any]:
    """A new HDF5 file; what fails is told in one line that names the target."""
    import h5py

    disk = None
    try:
        disk = PatientFile(partial)
        with h5py.File(disk, "w") as file:
            yield file
        if disk.error is not None:
            raise disk.error
    except OSError as error:
        found = (disk.error if disk is not None else None) or error
        reason = found.strerror or found
        raise MediaError(f"cannot write {target}: {reason}; make room or choose another place") from None
    finally:
        if disk is not None:
            disk.close()
