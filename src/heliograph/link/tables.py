"""CSV files with motion: named columns of numbers."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import MediaError
from heliograph.base.files import read_bounded

TRAJECTORY_COLUMNS = ("time_s", "x_m", "y_m")
"""Necessary columns of a trajectory."""


def read_columns(
    path: Path, columns: Sequence[str], optional: Sequence[str] = (), kind: str = "motion"
) -> list[Floats]:
    """Read named columns of a CSV file; missing optional columns are 0, other text than numbers is NaN."""
    try:
        text = read_bounded(path, 1 << 28).decode("utf-8-sig")  # an hour at 1000 samples/s takes 220 MB
    except OSError as error:
        raise MediaError(f"cannot read the {kind} file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise MediaError(f"the {kind} file {path} is no text; give a CSV file") from None
    known = f"a {kind} file has {', '.join(columns)}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty table; the length is checked later
            # invalid numbers become NaN
            table: Any = np.genfromtxt(text.splitlines(), delimiter=",", names=True, dtype=np.float64)
    except IndexError:  # all lines are blank or comments
        raise MediaError(f"the {kind} file {path} is empty; {known}") from None
    except ValueError as error:
        reason = str(error).splitlines()[:2][-1].strip()  # the second line names the incomplete row
        raise MediaError(f"cannot read the {kind} file {path}: {reason}") from None
    names = table.dtype.names or ()
    if lacking := [name for name in columns if name not in names]:
        raise MediaError(f"{path} lacks the column '{lacking[0]}'; {known}")
    rows = np.zeros(np.size(table))
    return [np.atleast_1d(table[name]) if name in names else rows for name in (*columns, *optional)]


def load_trajectory(path: Path) -> tuple[tuple[float, ...], ...]:
    """Load the points of `channel.trajectory` from a CSV file."""
    table = np.stack(read_columns(path, TRAJECTORY_COLUMNS, ("z_m", "yaw_deg"), "trajectory"), -1)
    if not np.isfinite(table).all():
        row = int(np.argwhere(~np.isfinite(table))[0, 0]) + 1
        raise MediaError(f"{path}: row {row} below the header lacks a number; fill the cell, or remove the row")
    if len(table) < 2:
        raise MediaError(f"{path} has {len(table)} points; a trajectory has at least 2")
    return tuple(map(tuple, table.tolist()))
