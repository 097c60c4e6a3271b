"""Formats: packet mode and code rate for each layer, signalled by the second and later header pairs (section 4.1).

A format is an 11-bit number. A Reed-Muller code maps the number to a 16-bit word with a bit per header cell; the
minimum distance is 4 bits. A 1 bit halves the contrast in the cell. Format 0 dims no cell.
"""

from functools import lru_cache
from itertools import combinations
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors
from heliograph.signal.settings import LAYERS, RATE_SLACK, RateSettings, as_number

SIGNALLED_RATES = (2 / 5, 1 / 2, 3 / 5, 2 / 3, 3 / 4, 5 / 6, 9 / 10)
"""Code rates for the rate numbers 1 to 7 (section 4.1); number 0 selects the agreed rate."""

Mode = Literal["paired", "single", "short"]

MODES: tuple[Mode, ...] = ("paired", "single", "short")  # modes by number; 3 is reserved (section 4.1)

SHORT_PAIRS = 13
"""Data pairs per packet in short mode (section 4.1): with two header pairs 30 patterns, 3 s at 10 patterns per second.
With half as many pairs, blocks for 8 x 8 LEDs fit only at rate 9/10; with twice as many, packets take 5.6 s."""

ALL_MODES = 4  # number of modes, including reserved modes

DIMMED = 0.5
"""Contrast for 1 bits (section 4.1): the only contrast between 0 and 1 with integer levels, 3 and 1. At contrast 0,
header detection would lose the cell."""


def _signalled(rate: float) -> float:
    """Return the nearest signalled rate, such as 2/3 for 0.667; raise a ValueError if the nearest is too far."""
    nearest = min(SIGNALLED_RATES, key=lambda r: abs(r - rate))
    if abs(nearest - rate) > RATE_SLACK:
        raise ValueError("a header can name the rates 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 and 9/10")
    return nearest


SignalledRate = Annotated[float, BeforeValidator(as_number), AfterValidator(_signalled)]
"""Rate from `SIGNALLED_RATES`; a fraction such as "2/3" or a number rounded to three digits is allowed."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Format:
    """Packet mode and code rates.

    Attributes
    ----------
    mode
        "paired": an inverted pattern follows every data pattern. "single": every data pattern carries new data, which
        doubles the data rate (minus 1/32 at 16 x 16 LEDs) and requires the receiver "soft" or "screen". "short": like
        "paired" with 13 data pairs, so that packets from a slow light take seconds; ``signal.data_pairs`` must be 13.
    high
        Turbo code rate in the high layer in information bits per sent bit: 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 or 9/10;
        default ``signal.rate.high``. A higher rate carries more data and tolerates less noise.
    middle
        Turbo code rate in the middle layer; default ``signal.rate.middle``.
    low
        Turbo code rate in the low layer; default ``signal.rate.low``.
    """

    mode: Mode = "paired"
    high: SignalledRate | None = None
    middle: SignalledRate | None = None
    low: SignalledRate | None = None

    @property
    def number(self) -> int:
        """Format number in the header, F = 512 M + 64 h + 8 m + l (section 4.1): 0 to 1535."""
        total = MODES.index(self.mode)
        for rate in (self.high, self.middle, self.low):
            total = 8 * total + (0 if rate is None else 1 + SIGNALLED_RATES.index(rate))
        return total

    def rates(self, agreed: RateSettings) -> tuple[float, float, float]:
        """Return the high, middle and low layer rates in information bits per sent bit.

        Parameters
        ----------
        agreed
            Agreed rates, for layers with no rate in the format.
        """
        high, middle, low = (getattr(self, name) or getattr(agreed, name) for name in LAYERS)
        return high, middle, low


AGREED = Format()  # format 0: data pairs at the agreed rates


def format_of(number: int) -> Format:
    """Return the format for a number, the inverse of `Format.number`."""
    codes = [number // step % 8 for step in (64, 8, 1)]
    high, middle, low = (SIGNALLED_RATES[code - 1] if code else None for code in codes)
    return Format(mode=MODES[number // 512], high=high, middle=middle, low=low)


class UnreadableModeError(ValueError):
    """The packet mode is unknown or does not match the settings; the receiver ignores the packet (section 15)."""


def check_mode(number: int, data_pairs: int) -> None:
    """Raise an UnreadableModeError if the mode is 3, or if the mode is short and `data_pairs` is not 13."""
    mode = number // 512  # M = F div 512 (section 4.1)
    if mode >= len(MODES):
        raise UnreadableModeError(f"its mode, {mode}, is not known to this version")
    if not readable(data_pairs)[number]:
        pairs = f"{SHORT_PAIRS} data pairs, and signal.data_pairs is {data_pairs}"
        raise UnreadableModeError(f"its mode, short, has {pairs}: set it to {SHORT_PAIRS}")


def known_format(number: int, data_pairs: int) -> Format:
    """Return the format for a number, or the agreed format for an unreadable mode."""
    return format_of(number) if readable(data_pairs)[number] else AGREED


@lru_cache
def readable(data_pairs: int) -> NDArray[np.bool_]:
    """Return a read-only (2048,) bool mask: True for each readable format number."""
    modes = np.repeat(np.arange(ALL_MODES), 512)
    found = (modes < len(MODES)) & ((modes != MODES.index("short")) | (data_pairs == SHORT_PAIRS))
    found.setflags(write=False)
    return found


@lru_cache(maxsize=2)
def words(modes: int = len(MODES)) -> NDArray[np.uint8]:
    """Return the RM(2, 4) words for all formats, (512 modes, 16) uint8, read-only (section 4.1).

    The row is the format number, the column is 4 row + column of the header cell.
    """
    # w = f0 + f1 v0 + f2 v1 + f3 v2 + f4 v3 + f5 v0 v1 + f6 v0 v2 + ... + f10 v2 v3 (modulo 2)
    index = np.arange(16)
    v = [index >> bit & 1 for bit in range(4)]
    # 1; v0 ... v3; v0 v1, v0 v2, v0 v3, v1 v2, v1 v3, v2 v3
    rows = np.array([np.ones(16, int), *v, *(a * b for a, b in combinations(v, 2))])
    numbers = np.arange(512 * modes)
    found = ((numbers[:, None] >> np.arange(11) & 1) @ rows % 2).astype(np.uint8)
    found.setflags(write=False)
    return found
