"""Form of a film, the record in the container, and times by the container's clock."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from numbers import Integral, Real

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import LATEST_S

FASTEST_HZ = 1e6
"""Largest frame rate: a frame a tick."""

SLOWEST_HZ = 1e-6
"""Smallest frame rate, a frame in twelve days; it separates rates from damaged numbers."""

_FINEST_TICKS = 1_000_000
"""Least ticks a second in containers with a free time base. Finer ticks shorten the longest gap in MP4."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSpec:
    """Form of a film."""

    # Columns in pixels, at least 1
    width: int
    # Rows in pixels, at least 1
    height: int
    # Nominal frames per second, above 0 and at most 1e6
    rate_hz: float
    # Bits of a gray level, 8 to 16
    bits: int = 8
    # Text by name
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kinds = {"width": (Integral, "a whole number"), "height": (Integral, "a whole number"),
                 "bits": (Integral, "a whole number"), "rate_hz": (Real, "a number"),
                 "metadata": (Mapping, "texts by name")}  # fmt: skip
        for name, (kind, label) in kinds.items():
            if not isinstance(getattr(self, name), kind):
                raise MediaError(f"{name} of a film is {label}, got {shown(getattr(self, name))}")
        if self.width < 1 or self.height < 1:
            raise MediaError(f"a film is at least 1x1 pixels, got {self.width}x{self.height}")
        if not 0 < self.rate_hz <= FASTEST_HZ:
            raise MediaError(f"rate_hz must lie above 0 and at most 1e6 frames a second, got {shown(self.rate_hz)}")
        if not 8 <= self.bits <= 16:
            raise MediaError(f"a gray level has 8 to 16 bits, got bits={self.bits}")
        for name, text in self.metadata.items():
            if not (isinstance(name, str) and isinstance(text, str)):
                raise MediaError(f"metadata maps text to text, got {shown(name)}: {shown(text)}; use str()")
        # plain values for JSON, out of reach of the caller
        for name, plain in (("width", int), ("height", int), ("bits", int), ("rate_hz", float), ("metadata", dict)):
            object.__setattr__(self, name, plain(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmRecord:
    """Record in a tag of the container, as JSON, in films of this package."""

    # Nominal frames per second
    rate_hz: float
    # Bits of a gray level, 8 to 16
    bits: int
    # Time of the first frame in s: containers start films at 0
    start_s: float
    # Text kept with the film
    metadata: dict[str, str]
    # CRC-32 of the codec's private data, which shows later re-encoding
    codec_crc: int = 0

    def dumps(self) -> str:
        """Return the record as a line of ASCII."""
        return json.dumps({"version": 1, **{name: getattr(self, name) for name in self.__slots__}})

    @classmethod
    def loads(cls, text: str) -> "FilmRecord | None":
        """Return the record in a text, or None."""
        try:
            fields = json.loads(text)
            metadata = {str(name): str(text) for name, text in fields["metadata"].items()}
            rate_hz, start_s = float(fields["rate_hz"]), float(fields["start_s"])
            bits, crc = int(fields["bits"]), int(fields["codec_crc"])
            record = cls(rate_hz=rate_hz, bits=bits, start_s=start_s, metadata=metadata, codec_crc=crc)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None
        is_valid = SLOWEST_HZ <= record.rate_hz <= FASTEST_HZ and 8 <= record.bits <= 16
        return record if is_valid and abs(record.start_s) <= LATEST_S else None


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
