"""A camera frame: pixels, time of the exposure, and place on the sensor."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import HeliographError, shown

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
"""Gray levels, shape (rows, columns)."""

BITS = {np.dtype(np.uint8): (8, 8), np.dtype(np.uint16): (9, 16)}
"""Minimum and maximum bits of a gray level by the type of the pixels."""

LATEST_S = 1e10
"""Largest magnitude of a time in s: 317 years. Times of day count from 1970 in some cameras, which is 1.8e9 s; larger
numbers are in other units, such as ns."""

LATEST_INDEX = 1 << 62
"""Largest magnitude of the number of a frame, so that neighbouring numbers have 64 bits too."""


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
        "screen" copy the pixels of each frame that they take, so the array may be filled again for the next frame.
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
        if type(self.pixels) is not np.ndarray:
            check_unmasked(self.pixels)
            # subclasses compute in other ways
            object.__setattr__(self, "pixels", np.asarray(self.pixels))
        if not (_is_whole(self.index) and abs(self.index) <= LATEST_INDEX):
            raise HeliographError(f"a frame's index is its number, a whole one, not {shown(self.index)}")
        if not (isinstance(self.time_s, (int, float, np.integer, np.floating)) and abs(self.time_s) <= LATEST_S):
            raise HeliographError(
                f"a frame's time_s is a time in seconds, at most {LATEST_S:g}, not {shown(self.time_s)}; number the "
                f"frames and divide by their rate where the camera gives no times"
            )
        if not (isinstance(self.origin, tuple) and len(self.origin) == 2 and all(map(_is_whole, self.origin))):
            raise HeliographError(
                f"a frame's origin is (x, y) on the sensor in whole pixels, a tuple, not {shown(self.origin)}"
            )

    @property
    def full_scale(self) -> int:
        """Largest gray level, ``2**bits - 1``."""
        return (1 << self.bits) - 1

    def at_time(self, time_s: float) -> "Frame":
        """Return the frame with another start of the exposure in seconds, unchecked."""
        return _unchecked(self.index, time_s, self)

    def copied(self) -> "Frame":
        """Return the frame with a C-contiguous copy of the pixels, unchecked."""
        frame = _unchecked(self.index, self.time_s, self)
        object.__setattr__(frame, "pixels", np.array(self.pixels, order="C"))
        return frame

    def numbered(self, index: int) -> "Frame":
        """Return the frame with another number, unchecked."""
        return _unchecked(index, self.time_s, self)


def _unchecked(index: int, time_s: float, of: Frame) -> Frame:
    """Return a frame with the checked pixels of another frame."""
    frame = object.__new__(Frame)
    for name, value in zip(_FIELDS, (index, time_s, of.pixels, of.bits, of.origin), strict=True):
        object.__setattr__(frame, name, value)
    return frame


_FIELDS = Frame.__slots__


def check_next(frame: Frame, last: Frame | None) -> None:
    """Raise a HeliographError unless this is a `Frame` with pixels, of the same camera as the last frame, if any."""
    if not isinstance(frame, Frame):
        raise HeliographError(
            f"a receiver takes heliograph.Frame, not {type(frame).__name__}; write Frame(index, time_s, pixels)"
        )
    if not frame.pixels.size:
        raise HeliographError(f"frame {frame.index} has no pixels: its shape is {frame.pixels.shape}; leave it out")
    if last is None:
        return
    if frame.bits != last.bits or frame.pixels.dtype != last.pixels.dtype:
        raise HeliographError(
            f"all frames have the same bits: frame {frame.index} has {frame.bits} ({frame.pixels.dtype}), the one "
            f"before {last.bits} ({last.pixels.dtype}); take a new receiver where the camera changes"
        )
    if frame.pixels.shape != last.pixels.shape and frame.origin == last.origin == (0, 0):
        sizes = " after ".join(f"{item.pixels.shape[1]}x{item.pixels.shape[0]}" for item in (frame, last))
        raise HeliographError(
            f"all whole frames have the same size: frame {frame.index} has {sizes} pixels; give windows their origin "
            f"on the sensor, or take a new receiver where the camera changes"
        )


def check_order(frame: Frame, last: Frame, by_index: bool = False) -> None:
    """Raise a HeliographError if a frame does not follow the last one in time, or in number where that counts."""
    if frame.time_s <= last.time_s or (by_index and frame.index <= last.index):
        raise HeliographError(
            f"frames must follow in time: frame {frame.index} at {frame.time_s:.6f} s came after "
            f"frame {last.index} at {last.time_s:.6f} s"
        )


def check_unmasked(pixels: NDArray[Any]) -> None:
    """Raise a HeliographError if some pixels of a frame are masked."""
    if isinstance(pixels, np.ma.MaskedArray) and (count := np.count_nonzero(pixels.mask)):
        raise HeliographError(f"{count} pixels of a frame are masked; give them a level, such as by pixels.filled(0)")


def _check_pixels(pixels: Any, bits: Any) -> None:
    if not isinstance(pixels, np.ndarray):
        raise HeliographError(f"a frame's pixels are a NumPy array, not {type(pixels).__name__}; use numpy.asarray")
    if pixels.ndim != 2:
        raise HeliographError(
            f"a frame's pixels are gray levels of shape (rows, columns), not {pixels.shape}; turn colours into gray, "
            f"such as by cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)"
        )
    if pixels.dtype not in BITS:
        raise HeliographError(
            f"a frame's pixels are uint8 or uint16, not {pixels.dtype}; scale them to gray levels and use astype"
        )
    least, most = BITS[pixels.dtype]
    if not (_is_whole(bits) and least <= bits <= most):
        held = "8 bits" if least == most else f"{least} to {most} bits"
        raise HeliographError(f"gray levels of {pixels.dtype} have {held}, not {shown(bits)}; say bits= of the frame")


def _is_whole(value: Any) -> bool:
    return type(value) is int or isinstance(value, np.integer)
