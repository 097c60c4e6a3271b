"""How a film is to be read, beyond what its file says."""

from dataclasses import dataclass
from numbers import Real

from heliograph.base.errors import MediaError, shown
from heliograph.media.record import FASTEST_HZ, SLOWEST_HZ

CHANNELS = ("luma", "red", "green", "blue")
"""What is taken of a colour for a gray level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """How a film is to be read."""

    # Frames per second that the camera took, 1e-6 to 1e6; None believes the file
    rate_hz: float | None = None
    # Whether to stretch limited-range video (black at 16, white at 235) to the full scale
    expand_range: bool = False
    # One of `CHANNELS`; of gray films all of them are the gray levels
    channel: str = "luma"

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not _is_rate(self.rate_hz):
            raise MediaError(
                f"a camera takes {SLOWEST_HZ:g} to {FASTEST_HZ:g} frames/s, not {shown(self.rate_hz)}; give the rate "
                "it was set to"
            )
        if self.channel not in CHANNELS:
            raise MediaError(f"there is no channel {shown(self.channel)}: choose one of {', '.join(CHANNELS)}")


def _is_rate(value: object) -> bool:
    return isinstance(value, Real) and bool(value <= FASTEST_HZ) and not value < SLOWEST_HZ
