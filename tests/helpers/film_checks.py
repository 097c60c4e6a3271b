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


def form(path: Path, **options: Any) -> tuple[int, int, int, float, int | None]:
    """Return width, height, bits, frame rate and number of frames."""
    with open_film(path, **options) as film:
        return film.width, film.height, film.bits, film.rate_hz, film.frame_count


def holds(path: Path, levels: Any, times_s: Any = None, indices: Any = None, **options: Any) -> bool:
    """Return True if a film has the levels, and the times within 2 ns and the numbers if given."""
    frames = read(path, **options)
    assert times_s is None or [frame.time_s for frame in frames] == pytest.approx(times_s, abs=2e-9)
    assert indices is None or [frame.index for frame in frames] == list(indices)
    return same(frames, levels)


def ends(path: Path, levels: Any, says: str, **options: Any) -> bool:
    """Return True if a film has the levels before an error with a text."""
    frames, message = refused(path, **options)
    assert says in message
    return len(frames) == len(levels) and same(frames, levels)


def counts_of(film: LiveReader) -> CameraCounts:
    assert film.counts is not None
    return film.counts
