"""Camera frame with pixels, exposure time and sensor position."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import HeliographError, shown

Pixels = NDArray[np.uint8] | NDArray[np.uint16]  # gray levels, (rows, columns)
BITS = {np.dtype(np.uint8): (8, 8), np.dtype(np.uint16): (9, 16)}  # minimum and maximum bits by pixel type
LATEST_S = 1e10  # maximum magnitude of a time in s: Unix time is 1.8e9 s; larger numbers have other units, such as ns


@dataclass(frozen=True, slots=True)
class Frame:
    """Camera frame or sensor window.

    Attributes
    ----------
    index
        Frame number in the film, at least 0; a dropped frame leaves a gap.
    time_s
        Start time of the exposure in seconds on the camera clock.
    pixels
        Gray levels from 0 to full scale, shape (rows, columns), uint8 (8 bit) or uint16 (9 to 16 bit). Array views in
        any memory order are allowed. The frame shares the array. The receivers "plain", "soft" and "screen" copy
        writable pixels, so a program may reuse the array for the next frame.
    bits
        Bits per gray level, 8 to 16; full scale is ``2**bits - 1``.
    origin
        Sensor coordinates (x, y) of ``pixels[0, 0]`` in pixels: (0, 0) for a full frame, otherwise the window corner.

    Raises
    ------
    HeliographError
        A field has the wrong type, shape or range, or some pixels are masked. The constructor does not check gray
        levels, which keeps the cost at microseconds per frame.
    """

    index: int
    time_s: float
    pixels: Pixels
    bits: int = 8
    origin: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        _check_pixels(self.pixels, self.bits)
        # array subclasses may redefine arithmetic
        object.__setattr__(self, "pixels", np.asarray(self.pixels))
        if not (_is_whole(self.index) and abs(self.index) < 1 << 62):  # neighbouring indices must fit 64 bits too
            raise HeliographError(f"a frame's index is its number, a whole one, not {shown(self.index)}")
        if not (isinstance(self.time_s, (int, float, np.integer, np.floating)) and abs(self.time_s) <= LATEST_S):
            cure = "if the camera gives no times, divide index by the frame rate"
            time = f"a time in seconds, at most {LATEST_S:g}, not {shown(self.time_s)}"
            raise HeliographError(f"a frame's time_s is {time}; {cure}")
        if not (isinstance(self.origin, tuple) and len(self.origin) == 2 and all(map(_is_whole, self.origin))):
            raise HeliographError(f"a frame's origin is a tuple (x, y) of whole pixels, not {shown(self.origin)}")

    @classmethod
    def from_array(
        cls,
        image: ArrayLike,
        index: int = 0,
        *,
        time_s: float | None = None,
        rate_hz: float | None = None,
        bits: int | None = None,
    ) -> "Frame":
        """Make a frame of an image as other libraries give it.

        Parameters
        ----------
        image
            uint8, uint16 or real numbers from 0 to 1: gray levels (rows, columns), or colours (rows, columns, 3 or 4)
            in the order red, green, blue, which become their luma, 0.299 R + 0.587 G + 0.114 B.
        index
            Frame number.
        time_s, rate_hz
            Start time of the exposure in s, or frames per second for ``time_s = index / rate_hz``.
        bits
            Bits per gray level; by default 8 for uint8 and 16 for other numbers.

        Raises
        ------
        HeliographError
            The image has another form, or neither or both of time and rate are given.
        """
        pixels = np.asarray(image)
        if (time_s is None) == (rate_hz is None) or rate_hz == 0:
            raise HeliographError("a frame takes either time_s, a time in seconds, or rate_hz, the frames per second")
        if pixels.ndim == 3 and pixels.shape[2] in (3, 4) and pixels.dtype.kind in "uf":
            luma = pixels[..., :3] @ np.array([0.299, 0.587, 0.114])
            pixels = np.rint(luma).astype(pixels.dtype) if pixels.dtype.kind == "u" else luma
        if pixels.dtype.kind == "f":
            most = (1 << (bits or 16)) - 1
            pixels = np.rint(np.clip(pixels, 0, 1) * most).astype(np.uint8 if most < 256 else np.uint16)
        levels = bits or (8 if pixels.dtype == np.uint8 else 16)
        return cls(index, index / rate_hz if rate_hz else float(time_s or 0.0), pixels, levels)

    @property
    def full_scale(self) -> int:
        """Largest gray level, ``2**bits - 1``."""
        return (1 << self.bits) - 1

    def copied(self) -> "Frame":
        """Return the frame with a C-contiguous copy of the pixels."""
        return replace(self, pixels=self.pixels.copy(order="C"))


def check_unmasked(pixels: NDArray[Any]) -> None:
    """Raise a HeliographError for masked pixels."""
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
