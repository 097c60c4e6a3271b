"""Axes of a TIFF stack and bits of its levels, as ImageJ, OME and tifffile describe them."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tifffile import TiffPage

_IMAGEJ = re.compile(r"^(images|channels|slices|frames)=(\d{1,9})\s*$", re.MULTILINE)
"""Lengths in ImageJ's description: pictures in all, and the axes."""

_OME_PIXELS = re.compile(r"<(?:\w+:)?Pixels\b[^>]*>")
"""Element of OME-XML that has the lengths of a series."""

_OME = re.compile(r"\b(SizeZ|SizeT|SizeC|SignificantBits)\s*=\s*[\"'](\d{1,9})[\"']")
"""Lengths of the axes and bits of a level in it."""

_SHAPE = re.compile(r"shape=\(([\d, ]+)\)")
"""Shape in the description by old releases of tifffile."""

_CHANNELS = ("channels", "SizeC", "C")
"""Names of the axis of channels."""

_MAX_CHANNELS = 7
"""Most channels that ImageJ shows. tifffile writes any stack of pictures as ImageJ's channels if no axes are given."""


@dataclass(frozen=True, slots=True)
class Description:
    """Description of a stack."""

    # Lengths above 1 of the axes beside rows and columns, under the description's own names
    axes: Mapping[str, int] = field(default_factory=dict)
    # Number of pictures; 1 if the description states none
    frames: int = 1
    # True if the program writes stacks as one page with all pictures as its data
    in_one_page: bool = True
    # Bits of a gray level; None if the description states none
    bits: int | None = None

    @property
    def has_channels(self) -> bool:
        """True if several pictures belong to one time."""
        return any(name in self.axes and (len(self.axes) > 1 or self.axes[name] <= _MAX_CHANNELS) for name in _CHANNELS)


def read_description(page: "TiffPage") -> Description:
    """Return the axes and bits that a page's description states."""
    text = page.description
    if text.startswith("ImageJ="):
        said = {name: int(length) for name, length in _IMAGEJ.findall(text)}
        return Description(_long(said, but="images"), max(1, said.get("images", 1)))
    if (pixels := _OME_PIXELS.search(text)) is not None:
        said = {name: int(length) for name, length in _OME.findall(pixels[0])}
        bits = said.pop("SignificantBits", None)
        said["SizeC"] = said.get("SizeC", 1) // max(1, page.samplesperpixel)
        return Description(_long(said), math.prod(said.values()), in_one_page=False, bits=bits)
    return _shaped(page, text)


def _long(lengths: Mapping[str, int], but: str = "") -> dict[str, int]:
    return {name: length for name, length in lengths.items() if length > 1 and name != but}


def _shaped(page: "TiffPage", text: str) -> Description:
    """Description by tifffile: the shape of the whole array, and the letters of its axes."""
    try:
        if text.startswith("{"):
            said = json.loads(text)
            shape, letters = [int(length) for length in said["shape"]], str(said.get("axes", ""))
        else:
            found = _SHAPE.match(text)
            shape, letters = [int(length) for length in (found[1] if found else "").split(",") if length.strip()], ""
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Description()
    outer, inner = shape[: -len(page.shape)], shape[-len(page.shape) :]
    if not outer or inner != list(page.shape) or min(outer) < 1:
        return Description()
    names = (
        list(letters[: len(outer)])
        if len(letters) == len(shape)
        else [f"axis {number}" for number in range(len(outer))]
    )
    return Description(_long(dict(zip(names, outer, strict=True))), math.prod(outer))
