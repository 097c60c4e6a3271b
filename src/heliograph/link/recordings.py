"""Real recordings for the channel, from files: background footage and motion of a car."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.files import read_bounded
from heliograph.channel import Footage, ImuTrace
from heliograph.media import open_film

MOST_TRACE = 1 << 28
"""Most bytes of a motion file: an hour at 1000 samples a second takes 220 MB."""

IMU_COLUMNS = ("t_s", "gyro_fwd_rad_s", "gyro_right", "gyro_down", "speed_m_s")
"""Columns of a motion file, by name in its first line: time, rates about forward, right and down axis, car speed."""


def load_footage(path: Path) -> Footage:
    """Footage from any video file; it is read again from the start whenever the channel needs it."""
    with open_film(path, expand_range=True) as film:
        rate = film.rate_hz
        next(iter(film))

    def frames() -> Iterator[NDArray[np.uint8]]:
        with open_film(path, expand_range=True) as film:
            for frame in film:
                yield (frame.pixels >> (frame.bits - 8)).astype(np.uint8)

    return Footage(frames, rate)


def load_imu(path: Path) -> ImuTrace:
    """Motion of a car from a CSV file."""
    table = _table(path)
    lacking = [name for name in IMU_COLUMNS if name not in (table.dtype.names or ())]
    if lacking:
        raise MediaError(f"{path} lacks the column '{lacking[0]}'; a motion file has {', '.join(IMU_COLUMNS)}")
    try:
        return ImuTrace.from_columns(*(np.atleast_1d(table[name]) for name in IMU_COLUMNS))
    except ValueError as error:
        raise MediaError(f"{path}: {error}") from None


def _table(path: Path) -> Any:
    """A CSV file's columns by name, NaN where there is no number."""
    try:
        text = read_bounded(path, MOST_TRACE).decode()
    except OSError as error:
        raise MediaError(f"cannot read the motion file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise MediaError(f"the motion file {path} is no text; give a CSV file") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a file without rows: its length is checked
            return np.genfromtxt(text.splitlines(), delimiter=",", names=True, dtype=np.float64)
    except IndexError:  # NumPy's, where all lines are blank or comments
        raise MediaError(f"the motion file {path} is empty; a motion file has {', '.join(IMU_COLUMNS)}") from None
    except ValueError as error:
        reason = str(error).splitlines()[:2][-1].strip()  # the second line names the row that is short
        raise MediaError(f"cannot read the motion file {path}: {reason}") from None
