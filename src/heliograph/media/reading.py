"""How a film is to be read, beyond what its file says."""

from dataclasses import dataclass
from numbers import Real

from heliograph.base.errors import MediaError, shown

CHANNELS = ("luma", "red", "green", "blue")
"""What is taken of a colour for a gray level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """How a film is to be read.

    Attributes
    ----------
    rate_hz
        Frames per second that the camera took, above 0; None believes the file.
    expand_range
        Whether to stretch limited-range video (black at 16, white at 235) to the full scale.
    channel
        One of `CHANNELS`; of gray films all of them are the gray levels.

    Raises
    ------
    MediaError
        The rate is not above 0, or there is no such channel.
    """

    rate_hz: float | None = None
    expand_range: bool = False
    channel: str = "luma"

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not _is_rate(self.rate_hz):
            raise MediaError(
                f"a camera takes more than 0 frames/s, not {shown(self.rate_hz)}; give the rate it was set to"
            )
        if self.channel not in CHANNELS:
            raise MediaError(f"there is no channel {shown(self.channel)}: choose one of {', '.join(CHANNELS)}")


def _is_rate(value: object) -> bool:
    """Whether it is a number above 0 that a float can hold."""
    try:
        return isinstance(value, Real) and 0 < float(value) < float("inf")
    except OverflowError:
        return False
