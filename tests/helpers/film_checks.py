"""Write small films; read whole, damaged and live films."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import create_film, open_film
from heliograph.media.live.grabber import CameraCounts
from heliograph.media.live.reader import LiveReader


def uniform(values: Any, rows: int, columns: int, kind: type = np.uint8) -> Any:
    """Return a frame (rows, columns) of one level for each value."""
    return np.multiply.outer(np.asarray(values, kind), np.ones((rows, columns), kind))


def write_levels(path: Path | str, levels: Any, rate_hz: float = 1000.0, bits: int = 8, **options: Any) -> Path:
    """Write frames (n, rows, columns) at a constant rate."""
    rows, columns = levels.shape[1:]
    with create_film(path, width=columns, height=rows, rate_hz=rate_hz, bits=bits, **options) as film:
        for number, pixels in enumerate(levels):
            film.write(Frame(number, number / rate_hz, pixels, bits))
    return Path(path)


def read(path: Path, **options: Any) -> list[Frame]:
    with open_film(path, **options) as film:
        return list(film)


def refused(path: Path, **options: Any) -> tuple[list[Frame], str]:
    """Return the frames before the error, and the error, which has a single line."""
    got: list[Frame] = []
    with pytest.raises(MediaError) as caught, open_film(path, **options) as film:
        got.extend(film)
    assert "\n" not in str(caught.value)
    return got, str(caught.value)


def same(frames: list[Frame], levels: Any) -> bool:
    """Return True if all frames have the levels."""
    return all(np.array_equal(frame.pixels, sent) for frame, sent in zip(frames, levels, strict=True))


def starts(frames: list[Frame], levels: Any) -> bool:
    """Return True if the frames have the first levels."""
    return same(frames, levels[: len(frames)])


def counts_of(film: LiveReader) -> CameraCounts:
    assert film.counts is not None
    return film.counts
