"""Formats: a packet's mode and the code rate of each layer, signalled by its later header pairs (section 4.1).

A format is a number of 11 bits. A Reed-Muller code turns it into a word of 16 bits, one for each cell of the header;
any two words differ in at least 4 bits. A cell whose bit is 1 has half the contrast. Format 0 dims no cell.
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
"""Code rates that a header can signal, numbers 1 to 7 (section 4.1); number 0 is the rate both ends have agreed on."""

Mode = Literal["paired", "single", "short"]

MODES: tuple[Mode, ...] = ("paired", "single", "short")
"""Modes by number; 3 is reserved (section 4.1)."""

SHORT_PAIRS = 13
"""Data pairs of a packet of the short mode (section 4.1): with two header pairs 30 patterns, 3 s at 10 patterns a
second. Half as many would hold no block of 8 x 8 LEDs below the rate 9/10; twice would take 5.6 s."""

ALL_MODES = 4
"""Modes in a header, including reserved modes."""

RATE_BITS = 3
"""Bits of a layer's rate number: eight numbers."""

BITS = 11
"""Bits of a format's number: two of the mode, three each of the high, middle and low layer's rate. RM(2, 4) has 11."""

WORD_BITS = 16
"""Bits of a format's word: the 4 x 4 cells of the header, the length of RM(2, 4)."""

DIMMED = 0.5
"""Contrast of a cell whose bit of the word is 1 (section 4.1): only this contrast between 0 and 1 has integer levels,
3 and 1. A flat cell of contrast 0 would be lost to detection by the header."""


def _signalled(rate: float) -> float:
    """Rate of the table that is meant; 0.667 means 2/3."""
    nearest = min(SIGNALLED_RATES, key=lambda r: abs(r - rate))
    if abs(nearest - rate) > RATE_SLACK:
        raise ValueError("a header can name the rates 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 and 9/10")
    return nearest


SignalledRate = Annotated[float, BeforeValidator(as_number), AfterValidator(_signalled)]
"""One of `SIGNALLED_RATES`, also as a fraction such as "2/3" or rounded to three digits."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Format:
    """Mode and code rates of a packet.

    Attributes
    ----------
    mode
        "paired": every data pattern is followed by its inverse. "single": every data pattern carries new data, which
        doubles the data rate (but for 1/32 at 16 x 16 LEDs); only the receiver "soft" reads it. "short": as "paired",
        and the packet has 13 data pairs, so that a slow light's packets take seconds; ``signal.data_pairs`` must be 13.
    high
        Rate of the high layer's turbo code in information bits per sent bit: 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 or 9/10;
        left out: ``signal.rate.high``. A larger rate carries more data and tolerates less noise.
    middle
        The same for the middle layer; left out: ``signal.rate.middle``.
    low
        The same for the low layer; left out: ``signal.rate.low``.
    """

    mode: Mode = "paired"
    high: SignalledRate | None = None
    middle: SignalledRate | None = None
    low: SignalledRate | None = None

    @property
    def number(self) -> int:
        """Number the header signals, F = 512 M + 64 h + 8 m + l (section 4.1): 0 to 1535."""
        total = MODES.index(self.mode)
        for rate in (self.high, self.middle, self.low):
            total = (total << RATE_BITS) + (0 if rate is None else 1 + SIGNALLED_RATES.index(rate))
        return total

    def rates(self, agreed: RateSettings) -> tuple[float, float, float]:
        """Return the rates of the high, middle and low layer in information bits per sent bit.

        Parameters
        ----------
        agreed
            Rates that both ends have agreed on, for the layers whose rate the format leaves open.
        """
        high, middle, low = (getattr(self, name) or getattr(agreed, name) for name in LAYERS)
        return high, middle, low


AGREED = Format()
"""Format 0: data pairs at the rates both ends have agreed on."""


def format_of(number: int) -> Format:
    """Return the format of a number, the inverse of `Format.number`.

    Parameters
    ----------
    number
        Number of the format, 0 to 1535.

    Raises
    ------
    ValueError
        The number is of a reserved mode, or not a format's at all.
    """
    if not 0 <= number < len(MODES) << 3 * RATE_BITS:
        raise ValueError(f"a format is 0 to {(len(MODES) << 3 * RATE_BITS) - 1}, not {number}")
    codes = [number >> RATE_BITS * place & 7 for place in (2, 1, 0)]
    high, middle, low = (SIGNALLED_RATES[code - 1] if code else None for code in codes)
    return Format(mode=MODES[number >> 3 * RATE_BITS], high=high, middle=middle, low=low)


def mode_number(number: int) -> int:
    """Return the number of a format's mode, M = F div 512 (section 4.1): 0 to 3.

    Parameters
    ----------
    number
        Number of the format, 0 to 2047.
    """
    return number >> 3 * RATE_BITS


class UnreadableModeError(ValueError):
    """A packet's mode is not known to this version, or does not go with the settings: it is ignored (section 15)."""


def check_mode(number: int, data_pairs: int) -> None:
    """Check that packets of a format's mode can be read.

    Parameters
    ----------
    number
        Number of the format, 0 to 2047.
    data_pairs
        Data pairs of a packet that are expected.

    Raises
    ------
    UnreadableModeError
        The mode is 3, or the mode is short and another number of pairs is expected.
    """
    if mode_number(number) >= len(MODES):
        raise UnreadableModeError(f"its mode, {mode_number(number)}, is not known to this version")
    if not readable(data_pairs)[number]:
        raise UnreadableModeError(
            f"its mode, short, has {SHORT_PAIRS} data pairs, and signal.data_pairs is {data_pairs}: set it to "
            f"{SHORT_PAIRS}"
        )


def known_format(number: int, data_pairs: int) -> Format:
    """Return the format of a number; the agreed format for an unreadable mode, see `check_mode`.

    Parameters
    ----------
    number
        Number of the format, 0 to 2047.
    data_pairs
        Data pairs of a packet that are expected.
    """
    return format_of(number) if readable(data_pairs)[number] else AGREED


@lru_cache
def readable(data_pairs: int) -> NDArray[np.bool_]:
    """Tell which formats can be read.

    Parameters
    ----------
    data_pairs
        Data pairs of a packet that are expected; the short mode has 13.

    Returns
    -------
    (2048,) by format number, read-only.
    """
    modes = np.repeat(np.arange(ALL_MODES), 1 << 3 * RATE_BITS)
    found = (modes < len(MODES)) & ((modes != MODES.index("short")) | (data_pairs == SHORT_PAIRS))
    found.setflags(write=False)
    return found


@lru_cache(maxsize=2)
def words(modes: int = len(MODES)) -> NDArray[np.uint8]:
    """Return the words of all formats, from the Reed-Muller code RM(2, 4) (section 4.1).

    Parameters
    ----------
    modes
        Number of modes: 3 known modes, or all 4.

    Returns
    -------
    (512 modes, 16) uint8 bits 0 and 1, read-only: row by format number, column 4 row + column of the cell.
    """
    # w = f0 + f1 v0 + f2 v1 + f3 v2 + f4 v3 + f5 v0 v1 + f6 v0 v2 + ... + f10 v2 v3 (modulo 2)
    index = np.arange(WORD_BITS)
    v = [index >> bit & 1 for bit in range(4)]
    # 1; v0 ... v3; v0 v1, v0 v2, v0 v3, v1 v2, v1 v3, v2 v3
    rows = np.array([np.ones(WORD_BITS, int), *v, *(a * b for a, b in combinations(v, 2))])
    numbers = np.arange(modes << 3 * RATE_BITS)
    found = ((numbers[:, None] >> np.arange(BITS) & 1) @ rows % 2).astype(np.uint8)
    found.setflags(write=False)
    return found
