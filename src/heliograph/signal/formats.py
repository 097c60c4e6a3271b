"""Formats: what a packet's later header pairs name of it, its mode and the code rate of each layer.

A format is a number of 11 bits. A Reed-Muller code makes 16 bits of it, one a cell of the header; any two words
differ in at least 4. Where the bit is 1, the cell has half of its contrast. Format 0 is the header as it always was.
"""

from functools import lru_cache
from itertools import combinations
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG
from heliograph.signal.settings import LAYERS, RateSettings, as_number

RATES = (2 / 5, 1 / 2, 3 / 5, 2 / 3, 3 / 4, 5 / 6, 9 / 10)
"""Rates that a header can name, numbers 1 to 7; number 0 is the rate both ends have agreed on."""

Mode = Literal["paired", "single"]

MODES: tuple[Mode, ...] = ("paired", "single")
"""Modes by number; 2 and 3 are kept free."""

RATE_BITS = 3
"""Bits that name a layer's rate."""

BITS = 11
"""Bits of a format's number: two of the mode, three each of the high, middle and low layer's rate."""

DIMMED = 0.5
"""Contrast of a cell whose bit of the word is 1."""


def _named(rate: float) -> float:
    """The rate of the table that is meant; 0.667 means 2/3."""
    nearest = min(RATES, key=lambda r: abs(r - rate))
    if abs(nearest - rate) > 1e-3:
        raise ValueError("a header can name the rates 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 and 9/10")
    return nearest


NamedRate = Annotated[float, BeforeValidator(as_number), AfterValidator(_named)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Format:
    """Mode and rates of a packet.

    Attributes
    ----------
    mode
        "paired", every data pattern followed by its inverse, or "single", new data in every pattern.
    high, middle, low
        Rate of the turbo code by layer, one of `RATES`; None for the one that ``signal.rate`` agrees on.
    """

    mode: Mode = "paired"
    high: NamedRate | None = None
    middle: NamedRate | None = None
    low: NamedRate | None = None

    @property
    def number(self) -> int:
        """What the header names, 512 mode + 64 high + 8 middle + low."""
        total = MODES.index(self.mode)
        for rate in (self.high, self.middle, self.low):
            total = (total << RATE_BITS) + (0 if rate is None else 1 + RATES.index(rate))
        return total

    def rates(self, agreed: RateSettings) -> tuple[float, float, float]:
        """Rates of the three layers."""
        high, middle, low = (getattr(self, name) or getattr(agreed, name) for name in LAYERS)
        return high, middle, low


AGREED = Format()
"""Format 0: pairs, at the rates both ends have agreed on."""


def format_of(number: int) -> Format:
    """The format of a number.

    Raises
    ------
    ValueError
        The number is of a mode that is kept free, or no format's at all.
    """
    if not 0 <= number < len(MODES) << 3 * RATE_BITS:
        raise ValueError(f"a format is 0 to {(len(MODES) << 3 * RATE_BITS) - 1}, not {number}")
    codes = [number >> RATE_BITS * place & 7 for place in (2, 1, 0)]
    high, middle, low = (RATES[code - 1] if code else None for code in codes)
    return Format(mode=MODES[number >> 3 * RATE_BITS], high=high, middle=middle, low=low)


@lru_cache(maxsize=1)
def words() -> NDArray[np.uint8]:
    """Words of all formats by number, (formats, 16) uint8, cell 4 row + column: the Reed-Muller code RM(2, 4)."""
    index = np.arange(16)
    v = [index >> bit & 1 for bit in range(4)]
    # 1; v0 ... v3; v0 v1, v0 v2, v0 v3, v1 v2, v1 v3, v2 v3
    rows = np.array([np.ones(16, int), *v, *(a * b for a, b in combinations(v, 2))])
    numbers = np.arange(len(MODES) << 3 * RATE_BITS)
    found = ((numbers[:, None] >> np.arange(BITS) & 1) @ rows % 2).astype(np.uint8)
    found.setflags(write=False)
    return found
