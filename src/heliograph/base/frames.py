"""A camera frame: pixels, time of the exposure, and place on the sensor."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import HeliographError, shown

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
"""Gray levels, shape (rows, columns)."""

BITS = {np.dtype(np.uint8): (8, 8), np.dtype(np.uint16): (9, 16)}
"""Minimum and maximum bits of a gray level by the type of the pixels."""

LATEST_S = 1e10
"""Maximum magnitude of a time in s: times since 1970 are 1.8e9 s, and larger numbers in other units, such as ns."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One camera frame, or a window of it.

    Attributes
    ----------
    index
        Number of the frame in the film, at least 0; a dropped frame leaves a gap.
    time_s
        Start of the exposure in seconds, by the camera's clock.
    pixels
        Gray levels from 0 to full scale, shape (rows, columns), uint8 (8 bit) or uint16 (9 to 16 bit). A view of any
        array is allowed, in any order in memory. The frame shares the array; the receivers "plain", "soft" and
        "screen" copy pixels unless they are read-only, so the array may be filled again for the next frame.
    bits
        Bits of a gray level, 8 to 16; full scale is ``2**bits - 1``.
    origin
        (x, y) on the sensor of ``pixels[0, 0]`` in pixels; (0, 0) for a full frame, else the window's corner.

    Raises
    ------
    HeliographError
        The pixels are no gray levels, or some are masked; or time, number, bits or corner are none. Levels are not
        looked at, so that a frame costs microseconds.
    """

    index: int
    time_s: float
    pixels: Pixels
    bits: int = 8
    origin: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        _check_pixels(self.pixels, self.bits)
        # subclasses of arrays compute in other ways
        object.__setattr__(self, "pixels", np.asarray(self.pixels))
        if not (_is_whole(self.index) and abs(self.index) < 1 << 62):  # neighbours have 64 bits too
            raise HeliographError(f"a frame's index is its number, a whole one, not {shown(self.index)}")
        if not (isinstance(self.time_s, (int, float, np.integer, np.floating)) and abs(self.time_s) <= LATEST_S):
            raise HeliographError(
                f"a frame's time_s is a time in seconds, at most {LATEST_S:g}, not {shown(self.time_s)}; if the camera "
                f"gives no times, divide index by the frame rate"
            )
        if not (isinstance(self.origin, tuple) and len(self.origin) == 2 and all(map(_is_whole, self.origin))):
            raise HeliographError(
                f"a frame's origin is (x, y) on the sensor in whole pixels, a tuple, not {shown(self.origin)}"
            )

    @property
    def full_scale(self) -> int:
        """Largest gray level, ``2**bits - 1``."""
        return (1 << self.bits) - 1

    def copied(self) -> "Frame":
        """Return the frame with a C-contiguous copy of the pixels."""
        return replace(self, pixels=self.pixels.copy(order="C"))


def check_unmasked(pixels: NDArray[Any]) -> None:
    """Raise a HeliographError if some pixels of a frame are masked."""
    if isinstance(pixels, np.ma.MaskedArray) and (count := np.count_nonzero(pixels.mask)):
        raise HeliographError(f"{count} pixels of a frame are masked; give them a level, such as by pixels.filled(0)")


def _check_pixels(pixels: Any, bits: Any) -> None:
    if not isinstance(pixels, np.ndarray):
        raise HeliographError(f"a frame's pixels are a NumPy array, not {type(pixels).__name__}; use numpy.asarray")
    if pixels.ndim != 2:
        raise HeliographError(f"a frame's pixels are (rows, columns), not {pixels.shape}; turn colours into gray")
    if pixels.dtype not in BITS:
        raise HeliographError(f"a frame's pixels are uint8 or uint16, not {pixels.dtype}; scale them and use astype")
    least, most = BITS[pixels.dtype]
    if not (_is_whole(bits) and least <= bits <= most):
        held = "8 bits" if least == most else f"{least} to {most} bits"
        raise HeliographError(f"gray levels of {pixels.dtype} have {held}, not {shown(bits)}; say bits= of the frame")
    check_unmasked(pixels)


def _is_whole(value: Any) -> bool:
    return type(value) is int or isinstance(value, np.integer)
