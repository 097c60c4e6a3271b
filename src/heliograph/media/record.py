"""Form of a film, the record in the container, and times by the container's clock."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from numbers import Integral, Real
from typing import Annotated

import pydantic
import pydantic.dataclasses
from pydantic import Field

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import LATEST_S

FASTEST_HZ = 1e6  # largest frame rate: a frame a tick
SLOWEST_HZ = 1e-6  # smallest frame rate, a frame in twelve days; it separates rates from damaged numbers
LARGEST = 1 << 27  # largest number of pixels of a frame, twice the largest camera of the settings

_FINEST_TICKS = 1_000_000
"""Least ticks a second in containers with a free time base. Finer ticks shorten the longest gap in MP4."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSpec:
    """Form of a film."""

    # Columns and rows in pixels
    width: int
    height: int
    # Nominal frames per second
    rate_hz: float
    # Bits of a gray level
    bits: int = 8
    # Text by name
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ranges: dict[str, tuple[type, type, float, float]] = {
            "width": (Integral, int, 1, LARGEST), "height": (Integral, int, 1, LARGEST),
            "rate_hz": (Real, float, SLOWEST_HZ, FASTEST_HZ), "bits": (Integral, int, 8, 16),
        }  # fmt: skip
        for name, (kind, plain, least, most) in ranges.items():
            value, is_number = getattr(self, name), isinstance(getattr(self, name), kind)
            if not (is_number and least <= value <= most):
                noun = "a whole number" if plain is int else "a number"
                raise MediaError(f"{name} of a film is {noun}, got {shown(value)}: give {least:g} to {most:g}")
            object.__setattr__(self, name, plain(value))  # for JSON
        if not isinstance(self.metadata, Mapping):
            raise MediaError(f"metadata of a film is texts by name, got {shown(self.metadata)}")
        if wrong := [text for item in self.metadata.items() for text in item if not isinstance(text, str)]:
            raise MediaError(f"metadata of a film maps text to text, got {shown(wrong[0])}; use str()")
        object.__setattr__(self, "metadata", dict(self.metadata))  # out of reach of the caller


@pydantic.dataclasses.dataclass(frozen=True, slots=True, kw_only=True, config={"allow_inf_nan": False})
class FilmRecord:
    """Record in a tag of the container, as JSON, in films of this package."""

    # Nominal frames per second
    rate_hz: Annotated[float, Field(ge=SLOWEST_HZ, le=FASTEST_HZ)]
    # Bits of a gray level
    bits: Annotated[int, Field(ge=8, le=16)]
    # Time of the first frame in s: containers start films at 0
    start_s: Annotated[float, Field(ge=-LATEST_S, le=LATEST_S)]
    # Text kept with the film
    metadata: dict[str, str]
    # CRC-32 of the codec's private data, which shows later re-encoding
    codec_crc: int = 0

    def dumps(self) -> str:
        """Return the record as a line of ASCII."""
        return json.dumps({"version": 1, **asdict(self)})

    @classmethod
    def loads(cls, text: str) -> "FilmRecord | None":
        """Return the record in a text, or None."""
        try:
            return pydantic.TypeAdapter(cls).validate_json(text)
        except ValueError:  # such as a ValidationError
            return None


def to_tags(record: FilmRecord, suffix: str) -> dict[str, str]:
    """Return the container tags of a record; AVI keeps few names, and NUT's reader drops tags above 1023 bytes."""
    text = record.dumps()
    if suffix != ".nut":
        return {"comment" if suffix == ".avi" else "heliograph": text}
    parts = [text[start : start + 900] for start in range(0, len(text), 900)]
    return {f"heliograph{number or ''}": part for number, part in enumerate(parts)}


def from_tags(tags: Mapping[str, str]) -> FilmRecord | None:
    """Return the record in a container's tags, or None."""
    tags = {name.lower(): text for name, text in tags.items()}  # Matroska writes capitals
    parts = [tags.get("heliograph") or tags.get("comment") or ""]
    while (part := tags.get(f"heliograph{len(parts)}")) is not None:
        parts.append(part)
    return FilmRecord.loads("".join(parts))


def rational_rate(rate_hz: float) -> Fraction:
    """Return a rate as a fraction of small numbers, such as 30000/1001."""
    exact = Fraction(rate_hz)
    return exact.limit_denominator(1001) or exact.limit_denominator(_FINEST_TICKS)


def fine_time_base(rate_hz: float) -> Fraction:
    """Return a tick in s of about 1 us, a fraction of the frame period if small numbers allow."""
    steps = rational_rate(rate_hz).numerator
    if steps > 2 * _FINEST_TICKS:
        return Fraction(1, _FINEST_TICKS)
    return Fraction(1, steps * math.ceil(_FINEST_TICKS / steps))


def restored_time(record: FilmRecord, elapsed_s: float, tick_s: float) -> float:
    """Return the time in s of a frame, free of the rounding to the container's tick."""
    elapsed_s = _on_grid(elapsed_s, record.rate_hz, 0.51 * tick_s)  # half a tick, and rounding errors
    return _on_grid(record.start_s + elapsed_s, record.rate_hz, 1e-9)


def _on_grid(time_s: float, rate_hz: float, tolerance_s: float) -> float:
    """Return the nearest multiple of the frame period within a tolerance, or the time."""
    nearest = round(time_s * rate_hz) / rate_hz
    return nearest if abs(nearest - time_s) <= tolerance_s else time_s
