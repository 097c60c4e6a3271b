"""Pictures in memory: decode them, and take gray levels of their colours."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import BITS, Pixels

LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green and red in luma (Rec. ITU-R BT.601)."""

SILENT = 0
"""OpenCV's level of logging at which it says nothing, LOG_LEVEL_SILENT."""

_BGR = {"blue": 0, "green": 1, "red": 2}
"""Place of each colour in a pixel of OpenCV and of .cine files."""


def decode(data: bytes) -> NDArray[np.generic] | None:
    """Return a PNG, TIFF, JPEG or other picture that OpenCV reads, turned as it says; None where it is damaged.

    Parameters
    ----------
    data
        The whole file, of which the first page is taken.

    Returns
    -------
    (rows, columns) for gray, (rows, columns, 3) for blue, green and red; of the file's own type.
    """
    import cv2

    with _silence():
        try:
            picture: NDArray[np.generic] | None = cv2.imdecode(np.frombuffer(data, np.uint8), _as_it_is())
        except cv2.error:
            return None
    return picture


def checked_form(path: Path, picture: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a picture if it is one of gray levels or of three colours."""
    if picture.dtype not in BITS or picture.shape[2:] not in ((), (3,)):
        kind = f"{picture.dtype} in {(*picture.shape, 1)[2]} channels"
        raise MediaError(f"{path} has pixels of {kind}: save gray or RGB of 8 or 16 bits")
    return picture


def to_gray(picture: NDArray[np.generic], channel: str) -> Pixels:
    """Return the gray levels of a picture. Returns (rows, columns) gray levels of the same type."""
    pixels: Pixels
    if picture.ndim == 2:
        pixels = np.ascontiguousarray(picture)
    elif channel == "luma":
        pixels = np.rint(picture @ np.array(LUMA)).astype(picture.dtype)
    else:
        pixels = np.ascontiguousarray(picture[..., _BGR[channel]])
    return pixels


def _as_it_is() -> int:
    """OpenCV's flags for a picture with its own bits, in gray or colour, turned as it says."""
    import cv2

    return int(cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep OpenCV from writing of damaged pictures to standard error: what is wrong is said in one line of our own."""
    import cv2

    # OpenCV 4.5 has no room of its own for it
    log = getattr(cv2.utils, "logging", cv2)
    before = log.getLogLevel()
    log.setLogLevel(SILENT)
    try:
        yield
    finally:
        log.setLogLevel(before)
