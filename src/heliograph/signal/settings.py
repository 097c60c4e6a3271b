"""Signal settings, on which transmitter and receiver must agree (section 1)."""

from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors
from heliograph.base.errors import SettingsError, shown
from heliograph.signal.code import CODES
from heliograph.signal.pwm import SLOT_ORDER, SLOTS

LAYERS = ("high", "middle", "low")  # layers in priority order (section 5)
MULTIPLICITY = (1, 2, 1)  # data matrix quarters per layer: D11; D12 and D21; D22 (section 5)

RATE_SLACK = 1e-3
"""Tolerance for rounded rates, so that 0.333 means 1/3 and 0.667 means 2/3. The closest fractions, 3/5 and 2/3, differ
by 0.067, so rates would stay unambiguous up to 0.03."""


def as_number(value: Any) -> Any:
    """Convert text such as '1/3' or '0.5' to a number; return other values unchanged."""
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ArithmeticError):
        return value


CodeRate = Annotated[float, BeforeValidator(as_number), Field(ge=0.333, le=0.9)]
"""Information bits per sent bit, from 1/3, the mother code rate, to 9/10."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class RateSettings:
    """Turbo code rates by layer.

    Attributes
    ----------
    high
        High layer rate in information bits per sent bit, 1/3 to 9/10; a fraction such as "2/3" is allowed. A higher
        rate carries more data and tolerates less noise.
    middle
        Middle layer rate in information bits per sent bit.
    low
        Low layer rate in information bits per sent bit.
    """

    high: CodeRate = 1 / 3
    middle: CodeRate = 1 / 3
    low: CodeRate = 1 / 3


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SignalSettings:
    """Signal settings for an array.

    Attributes
    ----------
    side
        LEDs per row and column, 4 to 128, a multiple of 4 because the header has 4 x 4 cells. A larger array carries
        more data per pattern and, at equal LED pitch, has a longer detection range.
    pattern_period_s
        Pattern duration T_b in s, 1e-6 to 1. A shorter duration carries more data per second and needs a higher camera
        frame rate; each frame then collects less light.
    slot_order
        Order in which increasing levels light the four PWM slots of T_b, numbered 0 to 3 in time: a permutation of
        0, 1, 2, 3.
    header_pairs
        Pairs of header and inverted header at the packet start, 1 to 16. More pairs make header detection more reliable
        and leave less time for data; a packet that signals a format needs 2 or more.
    data_pairs
        Pairs of data pattern and inverted pattern per packet, 1 to 4096. More pairs allow longer codewords, which
        correct more errors, and reduce header overhead; headers and packets are then less frequent.
    rate
        Turbo code rates by layer.
    code
        Name of the channel code. The air interface uses "turbo"; `heliograph.list_codes` also names those of other
        standards, for research at both ends, and others may be registered.
    modulation
        "haar", the hierarchical code, or "ook", on-off keying for each LED.
    light
        Display of level k, 0 to 4: "pwm" lights k out of four slots per T_b, for LEDs; "steady" shows k / 4 of the full
        luminance during T_b, for screens.
    header
        "m_sequence", which identifies the array, or "all_on", for comparison: every LED on, then off.
    """

    side: Annotated[int, Field(ge=4, le=128, multiple_of=4)] = 16
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
        """Patterns per packet, including inverses."""
        return 2 * (self.header_pairs + self.data_pairs)

    @property
    def packet_s(self) -> float:
        """Packet duration in seconds."""
        return self.packet_patterns * self.pattern_period_s


def check_signal(settings: object) -> None:
    """Raise a SettingsError unless `settings` is a `SignalSettings`."""
    if not isinstance(settings, SignalSettings):
        raise SettingsError(f"a signal has SignalSettings, not {shown(settings)}; those of a link are .signal")
