"""Settings of the signal: everything both ends must agree on (section 1)."""

from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors
from heliograph.base.errors import SettingsError, shown
from heliograph.signal.code import CODES
from heliograph.signal.pwm import SLOT_ORDER, SLOTS

LAYERS = ("high", "middle", "low")
"""Layers in the order of priority (section 5)."""

MULTIPLICITY = (1, 2, 1)
"""Quarters of the data matrix of each layer: D11; D12 and D21; D22 (section 5)."""

RATE_SLACK = 1e-3
"""Rates may differ by this from the fraction they mean, so that 0.333 is 1/3 and 0.667 is 2/3: three digits. The
closest fractions, 3/5 and 2/3, lie 0.067 apart, so up to 0.03 no rate would be ambiguous."""


def as_number(value: Any) -> Any:
    """Return the number that a text states; anything else is returned as it is.

    Parameters
    ----------
    value
        Value of a setting; text such as '1/3' or '0.5' is a number.
    """
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ArithmeticError):
        return value


CodeRate = Annotated[float, BeforeValidator(as_number), Field(ge=1 / 3 - RATE_SLACK, le=0.9 + RATE_SLACK)]
"""Information bits per sent bit: from 1/3, the mother code's rate, to 9/10."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class RateSettings:
    """Rates of the turbo code by layer.

    Attributes
    ----------
    high
        Rate of the high layer in information bits per sent bit, 1/3 to 9/10; a fraction such as "2/3" may be written. A
        larger rate carries more data and tolerates less noise.
    middle
        The same for the middle layer.
    low
        The same for the low layer.
    """

    high: CodeRate = 1 / 3
    middle: CodeRate = 1 / 3
    low: CodeRate = 1 / 3


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SignalSettings:
    """The signal of an array's light.

    Attributes
    ----------
    side
        LEDs in a row and in a column, 4 to 64, a multiple of 4 because the header has 4 x 4 cells. A larger array
        carries more data per pattern and, at the same pitch of its LEDs, is found from further away.
    pattern_period_s
        Duration T_b of a pattern in s, 1e-6 to 1. A shorter duration carries more data per second and needs a camera
        with as many frames per second; each frame then collects less light.
    slot_order
        Order in which the four PWM slots of T_b, numbered 0 to 3 in time, are lit as the level rises: a permutation of
        0, 1, 2, 3.
    header_pairs
        Pairs of header and inverted header at the start of a packet, 1 to 16. More make headers surer and leave less
        time for data; a packet that signals its format needs 2 or more.
    data_pairs
        Pairs of data pattern and inverted pattern in a packet, 1 to 4096. More give larger codewords, which correct
        more errors, and less time spent on headers; headers and packets then come less often.
    rate
        Rates of the turbo code by layer.
    code
        Name of the channel code. "turbo" is the air interface's; others may be registered for research, and both ends
        must then have them.
    modulation
        "haar", the hierarchical code, or "ook", on-off keying of each LED.
    light
        How a level k of 0 to 4 is shown: "pwm", fully lit in k of the four slots of T_b, as LEDs do it; or "steady", at
        k / 4 of the full luminance for all of T_b, as a screen does it.
    header
        "m_sequence", which names the array's identity, or "all_on", for comparison: every LED on, then off.
    """

    side: Annotated[int, Field(ge=4, le=64, multiple_of=4)] = 16
    pattern_period_s: Annotated[float, Field(ge=1e-6, le=1.0)] = 1e-3
    slot_order: tuple[int, ...] = SLOT_ORDER
    header_pairs: Annotated[int, Field(ge=1, le=16)] = 2
    data_pairs: Annotated[int, Field(ge=1, le=4096)] = 48
    rate: RateSettings = RateSettings()
    code: Annotated[str, AfterValidator(CODES.check)] = "turbo"
    modulation: Literal["haar", "ook"] = "haar"
    light: Literal["pwm", "steady"] = "pwm"
    header: Literal["m_sequence", "all_on"] = "m_sequence"

    @model_validator(mode="after")
    def _consistent(self) -> "SignalSettings":
        if sorted(self.slot_order) != list(SLOT_ORDER):
            raise ValueError(f"slot_order is a permutation of 0 to {SLOTS - 1}, not {list(self.slot_order)}")
        return self

    @property
    def packet_patterns(self) -> int:
        """Patterns of a packet, inverses included."""
        return 2 * (self.header_pairs + self.data_pairs)

    @property
    def packet_s(self) -> float:
        """Duration of a packet in seconds."""
        return self.packet_patterns * self.pattern_period_s


def check_signal(settings: object) -> None:
    """Check what is given for the settings of a signal.

    Parameters
    ----------
    settings
        What was given, of any type.

    Raises
    ------
    SettingsError
        It is no `SignalSettings`.
    """
    if not isinstance(settings, SignalSettings):
        raise SettingsError(
            f"settings of a signal are SignalSettings, not {shown(settings)}; those of a link are .signal"
        )
