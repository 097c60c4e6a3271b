"""Settings of a live camera from ``--camera key=value``, and the report of requested and actual values."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors, from_mapping
from heliograph.base.errors import MediaError, SettingsError, brief, shown
from heliograph.base.toml_text import parse_assignment

OFF = "off"
"""The trigger's name where the camera runs freely."""


def _as_region(value: Any) -> Any:
    """Return the numbers of a text such as "0,0,128,64"."""
    return tuple(part.strip() for part in value.split(",")) if isinstance(value, str) else value


Whole = Annotated[int, Field(ge=0, le=1 << 16)]
"""Pixels of a sensor along a side."""

Region = Annotated[tuple[Whole, Whole, Whole, Whole], BeforeValidator(_as_region)]
"""Column, row, columns and rows of a part of a sensor."""

Text = Annotated[str, Field(min_length=1, max_length=200)]
"""A name, or what a user calls a value."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CameraSettings:
    """What a live camera is asked for. What is left out stays as the camera has it.

    Attributes
    ----------
    exposure_us
        Exposure time in us, above 0. One of a pattern period sees all of its light. Automatic exposure is switched off.
    gain
        Gain as the camera counts it, mostly in dB. Automatic gain is switched off.
    rate_hz
        Frames per second, above 0.
    region
        X,Y,WIDTH,HEIGHT of the part of the sensor that is read, in pixels.
    pixel_format
        Pixels as they are sent, such as Mono8, Mono12p or BayerRG8.
    trigger
        Name of the line whose pulses start the exposures, such as Line1; "off" lets the camera run freely.
    producer
        File of a GenICam producer (.cti), for cameras of the kind "genicam".
    duration_s
        Time in s after which the film ends, above 0; left out, it ends when it is stopped.
    queue_s
        Time in s for which frames wait for the receiver at most, 0.01 to 60, within half a GB. Frames that find no
        place are dropped. Until an array is found a frame takes several times as long as later.
    reconnect
        Tries to reach a camera that was lost, 0 to 100.
    channel
        What is taken of a colour for a gray level: luma, red, green or blue; as --channel.
    features
        Features of the camera itself, by their own names: text by name. They begin with a capital letter.
    """

    exposure_us: Annotated[float, Field(gt=0, le=1e9)] | None = None
    gain: Annotated[float, Field(ge=-100, le=1e6)] | None = None
    rate_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    region: Region | None = None
    pixel_format: Text | None = None
    trigger: Text | None = None
    producer: Text | None = None
    duration_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    queue_s: Annotated[float, Field(ge=0.01, le=60)] = 5.0
    reconnect: Annotated[int, Field(ge=0, le=100)] = 6
    channel: Literal["luma", "red", "green", "blue"] = "luma"
    features: Mapping[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> "CameraSettings":
        if self.region is not None and not self.region[2] * self.region[3]:
            raise ValueError(f"region {','.join(map(str, self.region))} has no pixels; give X,Y,WIDTH,HEIGHT")
        if self.trigger is not None and self.trigger.lower() == "software":
            raise ValueError("trigger is a line whose pulses start exposures, such as Line1, or 'off', not Software")
        return self

    @property
    def triggered(self) -> bool:
        """Whether something else than the camera's own clock starts its exposures."""
        return self.trigger not in (None, OFF)


def camera_settings(given: Mapping[str, Any] | Iterable[str] = ()) -> CameraSettings:
    """Return settings of a camera."""
    if isinstance(given, str) or not isinstance(given, (Mapping, Iterable)):
        raise SettingsError(f"settings of a camera are by name, such as {{'exposure_us': 500}}, not {shown(given)}")
    known: dict[str, Any] = {}
    features: dict[str, str] = {}
    for name, value, text in _pairs(given):
        if value is None:
            continue
        if name[:1].isupper():
            features[name] = text
        elif name in ("pixel_format", "trigger", "producer", "region") and not isinstance(value, (tuple, list)):
            known[name] = text
        else:
            known[name] = value
    return from_mapping(CameraSettings, known | ({"features": features} if features else {}))


def _pairs(given: Mapping[str, Any] | Iterable[str]) -> Iterable[tuple[str, Any, str]]:
    """Names with their values, and these as text."""
    if isinstance(given, Mapping):
        for name, value in given.items():
            if not isinstance(name, str):
                raise SettingsError(f"a camera's setting is named by text, not {shown(name)}")
            yield name, value, str(value).lower() if isinstance(value, bool) else str(value)
        return
    for text in given:
        parsed = parse_assignment(text)
        name, value = next(iter(parsed.items()))
        if isinstance(value, Mapping):
            raise SettingsError(f"a camera has no setting '{brief(text.partition('=')[0])}'; its names have no dots")
        yield name, value, text.partition("=")[2].strip().strip("\"'")


ROUNDED = 1e-4
"""Relative difference of numbers up to which they are the same: a camera may hold them in single precision, or in whole
lines. Chosen."""

Value = str | float | Sequence[int]
"""A setting's value: text, a number, or a region."""


class Asked:
    """Settings of a camera, as asked for and as read back."""

    def __init__(self) -> None:
        self.settings: dict[str, object] = {}
        self.departures: list[str] = []

    @contextmanager
    def setting(self, name: str, value: Value, known: Callable[[], Sequence[str]] | None = None) -> Iterator[None]:
        """Turn a camera's error, raised in the block that sets it, into one that names the setting."""
        try:
            yield
        except MediaError as error:
            values = f"; it knows {', '.join(known())}" if known else ""
            raise SettingsError(f"the camera does not take {name}={_written(value)}: {error}{values}") from None

    def got(self, name: str, asked: Value | None, value: Value) -> None:
        """Keep a value as read back, and note where it is another one than was asked for."""
        self.settings[name] = _written(value)
        if asked is not None and not _same(asked, value):
            self.departures.append(f"{name} is {_written(value)}, asked for {_written(asked)}")


def _same(asked: Value, value: Value) -> bool:
    if asked == value:
        return True
    one, other = _written(asked), _written(value)
    try:
        return abs(float(one) - float(other)) <= ROUNDED * abs(float(one))
    except ValueError:  # no numbers
        return one.lower() == other.lower()


def _written(value: Value) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if isinstance(value, (int, float)) else ",".join(map(str, value))
