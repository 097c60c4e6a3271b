"""The form of a film, the record of it that a container carries, and the film's times by the container's clock."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from numbers import Integral, Real

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import LATEST_S

TAG = "heliograph"
"""Tag of the record in a container; Matroska turns it into capitals."""

AVI_TAG = "comment"
"""Tag of the record in AVI, which keeps only a few named tags."""

_TAG_LENGTH = 900
"""Most bytes of a tag: NUT's reader drops texts above 1023 bytes without an error. Chosen below that with some room."""

FASTEST_HZ = 1e6
"""Largest frame rate: one frame a tick of `FINEST_TICKS`."""

SLOWEST_HZ = 1e-6
"""Least frame rate of a film: a frame in twelve days. Chosen; it tells a rate from a damaged number."""

FINEST_TICKS = 1_000_000
"""Least ticks a second in containers with a free time base. Chosen: 1 us is a 250th of a PWM slot of 0.25 ms. Twice as
many would halve the longest gap between frames that MP4's 32-bit durations hold."""

_LARGEST_TERM = 1001
"""Largest denominator of a frame rate: that of television's rates such as 30000/1001."""

_ROUNDED_TICKS = 0.51
"""Ticks by which a time may be off the grid of frames and still count as rounded to it: half a tick, and rounding
errors."""

_ROUNDED_S = 1e-9
"""Seconds by which a restored time may be off that grid, by rounding errors of double precision."""


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
    # Any text by any names
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, kind, called in (*((name, Integral, "a whole number") for name in ("width", "height", "bits")),
                                   ("rate_hz", Real, "a number"), ("metadata", Mapping, "texts by name")):  # fmt: skip
            if not isinstance(getattr(self, name), kind):
                raise MediaError(f"{name} of a film is {called}, got {shown(getattr(self, name))}")
        if self.width < 1 or self.height < 1:
            raise MediaError(f"a film is at least 1x1 pixels, asked for {self.width}x{self.height}")
        if not 0 < self.rate_hz <= FASTEST_HZ:
            raise MediaError(f"rate_hz must lie above 0 and at most 1e6 frames a second, got {shown(self.rate_hz)}")
        if not 8 <= self.bits <= 16:
            raise MediaError(f"a gray level has 8 to 16 bits, got bits={self.bits}")
        for name, text in self.metadata.items():
            if not (isinstance(name, str) and isinstance(text, str)):
                raise MediaError(
                    f"metadata maps text to text, got {shown(name)}: {shown(text)}; turn the value into text first"
                )
        # as plain values, which JSON takes, and which the caller cannot change any more
        for name, plain in (("width", int), ("height", int), ("bits", int), ("rate_hz", float), ("metadata", dict)):
            object.__setattr__(self, name, plain(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmRecord:
    """Record that our own films carry in a tag of the container, as JSON."""

    # Nominal frames per second
    rate_hz: float
    # Bits of a gray level, 8 to 16
    bits: int
    # Time of the first frame in s: containers start films at 0
    start_s: float
    # Text kept with the film
    metadata: dict[str, str]
    # CRC-32 of the codec's private data: it distinguishes our own FFV1 stream from a later re-encoding that inherited
    # the tag
    codec_crc: int = 0

    def dumps(self) -> str:
        """Return the record as one line of ASCII."""
        fields = {"version": 1, **{name: getattr(self, name) for name in self.__slots__}}
        return json.dumps(fields)

    @classmethod
    def loads(cls, text: str) -> "FilmRecord | None":
        """Return the record that a text holds, or None where it holds none."""
        try:
            fields = json.loads(text)
            record = cls(
                rate_hz=float(fields["rate_hz"]),
                bits=int(fields["bits"]),
                start_s=float(fields["start_s"]),
                metadata={str(k): str(v) for k, v in fields["metadata"].items()},
                codec_crc=int(fields["codec_crc"]),
            )
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None
        sound = (
            SLOWEST_HZ <= record.rate_hz <= FASTEST_HZ and 8 <= record.bits <= 16 and abs(record.start_s) <= LATEST_S
        )
        return record if sound else None


def to_tags(record: FilmRecord, suffix: str) -> dict[str, str]:
    """Return the container tags that carry a record; NUT needs several for a long one."""
    text = record.dumps()
    if suffix != ".nut":
        return {AVI_TAG if suffix == ".avi" else TAG: text}
    parts = [text[start : start + _TAG_LENGTH] for start in range(0, len(text), _TAG_LENGTH)]
    return {f"{TAG}{number or ''}": part for number, part in enumerate(parts)}


def from_tags(tags: Mapping[str, str]) -> FilmRecord | None:
    """Return the record that a container's tags carry, or None."""
    tags = {name.lower(): text for name, text in tags.items()}
    parts = [tags.get(TAG) or tags.get(AVI_TAG) or ""]
    while (part := tags.get(f"{TAG}{len(parts)}")) is not None:
        parts.append(part)
    return FilmRecord.loads("".join(parts))


def rational_rate(rate_hz: float) -> Fraction:
    """Return a rate as a fraction of small numbers, such as 30000/1001."""
    exact = Fraction(rate_hz)
    return exact.limit_denominator(_LARGEST_TERM) or exact.limit_denominator(FINEST_TICKS)


def fine_time_base(rate_hz: float) -> Fraction:
    """Return a tick in s of at most 1 us that also divides the frame period, where small numbers allow it.

    Ticks much finer than that would overflow the 32-bit frame durations of MP4 in a gap of a few seconds.
    """
    steps = rational_rate(rate_hz).numerator
    if steps > 2 * FINEST_TICKS:
        return Fraction(1, FINEST_TICKS)
    return Fraction(1, steps * math.ceil(FINEST_TICKS / steps))


def on_grid(time_s: float, rate_hz: float, tolerance_s: float) -> float:
    """Return the nearest multiple of the frame period if it is within a tolerance, else the time itself."""
    nearest = round(time_s * rate_hz) / rate_hz
    return nearest if abs(nearest - time_s) <= tolerance_s else time_s


def restored_time(record: FilmRecord, elapsed_s: float, tick_s: float) -> float:
    """Return the time in s of a frame of our own film, free of the rounding to the container's tick."""
    elapsed_s = on_grid(elapsed_s, record.rate_hz, _ROUNDED_TICKS * tick_s)
    return on_grid(record.start_s + elapsed_s, record.rate_hz, _ROUNDED_S)
