"""What a film says about itself beside its pictures, and how its clock is kept in a container."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from heliograph.base.errors import MediaError

TAG = "heliograph"  # tag of the record in a container; Matroska turns it into capitals
AVI_TAG = "comment"  # AVI keeps only a few named tags
_TAG_LENGTH = 900  # NUT's reader drops texts above 1023 bytes without a word
FASTEST_HZ = 1e6  # one tick of the finest clock
FINEST_TICKS = 1_000_000  # ticks a second at least, in containers with a free time base


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSpec:
    """Form of a film.

    Attributes
    ----------
    width, height
        Size in pixels.
    rate_hz
        Nominal frames per second, above 0 and at most 1e6.
    bits
        Bits of a gray level, 8 to 16.
    metadata
        Free text by free names.
    """

    width: int
    height: int
    rate_hz: float
    bits: int = 8
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise MediaError(f"a film is at least 1x1 pixels, asked for {self.width}x{self.height}")
        if not (math.isfinite(self.rate_hz) and 0 < self.rate_hz <= FASTEST_HZ):
            raise MediaError(f"rate_hz must lie above 0 and at most 1e6 frames a second, got {self.rate_hz}")
        if not 8 <= self.bits <= 16:
            raise MediaError(f"a gray level has 8 to 16 bits, got bits={self.bits}")
        for name, text in self.metadata.items():
            if not (isinstance(name, str) and isinstance(text, str)):
                raise MediaError(f"metadata maps text to text, got {name!r}: {text!r}; turn the value into text first")


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """What our own films carry in one tag, as JSON.

    ``start_s`` is the time of the first frame: containers count from it, since they start films at zero.
    ``codec_crc`` is a CRC of the codec's private data: it tells our own FFV1 stream from a later re-encoding that
    inherited the tag.
    """

    rate_hz: float
    bits: int
    start_s: float
    metadata: dict[str, str]
    codec_crc: int = 0

    def dumps(self) -> str:
        """Return the record as one line of ASCII."""
        fields = {"version": 1, **{name: getattr(self, name) for name in self.__slots__}}
        return json.dumps(fields)

    @classmethod
    def loads(cls, text: str) -> "Record | None":
        """Return the record, or None where the text is somebody else's."""
        try:
            fields = json.loads(text)
            return cls(
                rate_hz=float(fields["rate_hz"]),
                bits=int(fields["bits"]),
                start_s=float(fields["start_s"]),
                metadata={str(k): str(v) for k, v in fields["metadata"].items()},
                codec_crc=int(fields["codec_crc"]),
            )
        except (ValueError, KeyError, TypeError, AttributeError):
            return None


def to_tags(record: Record, suffix: str) -> dict[str, str]:
    """Return the container tags that carry a record; NUT needs several for a long one."""
    text = record.dumps()
    if suffix != ".nut":
        return {AVI_TAG if suffix == ".avi" else TAG: text}
    parts = [text[start : start + _TAG_LENGTH] for start in range(0, len(text), _TAG_LENGTH)]
    return {f"{TAG}{number or ''}": part for number, part in enumerate(parts)}


def from_tags(tags: Mapping[str, str]) -> Record | None:
    """Return the record carried by a container's tags, or None."""
    tags = {name.lower(): text for name, text in tags.items()}
    parts = [tags.get(TAG) or tags.get(AVI_TAG) or ""]
    while (part := tags.get(f"{TAG}{len(parts)}")) is not None:
        parts.append(part)
    return Record.loads("".join(parts))


def rational_rate(rate_hz: float) -> Fraction:
    """Return the rate as a fraction of small numbers, e.g. 30000/1001."""
    return Fraction(rate_hz).limit_denominator(1001) or Fraction(rate_hz).limit_denominator(1_000_000)


def fine_time_base(rate_hz: float) -> Fraction:
    """Return a tick of at most 1 us that also divides the frame period, where small numbers allow it.

    Ticks much finer than that would overflow the 32-bit frame durations of MP4 in a gap of a few seconds.
    """
    steps = rational_rate(rate_hz).numerator
    if steps > 2 * FINEST_TICKS:
        return Fraction(1, FINEST_TICKS)
    return Fraction(1, steps * math.ceil(FINEST_TICKS / steps))


def on_grid(time_s: float, rate_hz: float, tolerance_s: float) -> float:
    """Return the nearest multiple of the frame period if it is within the tolerance, else the time itself."""
    nearest = round(time_s * rate_hz) / rate_hz
    return nearest if abs(nearest - time_s) <= tolerance_s else time_s


def restored_time(record: Record, elapsed_s: float, tick_s: float) -> float:
    """Return the time of a frame of our own film, free of the rounding to the container's tick."""
    elapsed_s = on_grid(elapsed_s, record.rate_hz, 0.51 * tick_s)
    return on_grid(record.start_s + elapsed_s, record.rate_hz, 1e-9)
