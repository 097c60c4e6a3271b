"""Settings of the signal: all that both ends must agree on."""

from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG
from heliograph.signal.pwm import SLOTS

LAYERS = ("high", "middle", "low")
"""Priority layers in the order of priority."""

MULTIPLICITY = (1, 2, 1)
"""Quarters of the data matrix each layer owns: D11; D12 and D21; D22."""


def as_number(value: Any) -> Any:
    """Let a rate be written as a fraction, '1/3'."""
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ArithmeticError):
        return value


# 1e-3 of slack: 0.333 means 1/3
Rate = Annotated[float, BeforeValidator(as_number), Field(ge=1 / 3 - 1e-3, le=0.9 + 1e-3)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class RateSettings:
    """Rate of the turbo code by layer: information bits by transmitted bit, 1/3 to 9/10."""

    high: Rate = 1 / 3
    middle: Rate = 1 / 3
    low: Rate = 1 / 3


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SignalSettings:
    """The light's signal.

    Attributes
    ----------
    side
        LEDs in a row and in a column; a multiple of 4, for the header's cells.
    pattern_period_s
        T_b, the time a pattern is shown.
    slot_order
        Order in which the PWM slots of a period are lit as the level rises.
    header_pairs
        Pairs of header and inverted header before the data of a packet.
    data_pairs
        Pairs of data pattern and inverted pattern in a packet.
    rate
        Rate of the turbo code by layer.
    modulation
        "haar", the hierarchical code, or "ook", plain on-off keying of each LED.
    header
        "m_sequence", which tells the array's identity, or, for comparison, "all_on": every LED on, then off.
    """

    side: Annotated[int, Field(ge=4, le=64, multiple_of=4)] = 16
    pattern_period_s: Annotated[float, Field(ge=1e-6, le=1.0)] = 1e-3
    slot_order: tuple[int, ...] = tuple(range(SLOTS))
    header_pairs: Annotated[int, Field(ge=1, le=16)] = 2
    data_pairs: Annotated[int, Field(ge=1, le=4096)] = 48
    rate: RateSettings = RateSettings()
    modulation: Literal["haar", "ook"] = "haar"
    header: Literal["m_sequence", "all_on"] = "m_sequence"

    @model_validator(mode="after")
    def _consistent(self) -> "SignalSettings":
        if sorted(self.slot_order) != list(range(SLOTS)):
            raise ValueError(f"slot_order is a permutation of 0 to {SLOTS - 1}, not {list(self.slot_order)}")
        return self

    @property
    def packet_patterns(self) -> int:
        """Patterns of a packet, inverted ones counted."""
        return 2 * (self.header_pairs + self.data_pairs)

    @property
    def packet_s(self) -> float:
        """Duration of a packet in seconds."""
        return self.packet_patterns * self.pattern_period_s
