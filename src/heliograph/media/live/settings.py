"""Settings of a live camera from ``--camera key=value``, and the comparison of requested and actual values."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors, from_mapping
from heliograph.base.errors import MediaError, SettingsError, brief, shown
from heliograph.base.toml_text import parse_assignment


def _split_region(value: Any) -> Any:
    """Return the numbers of a text such as "0,0,128,64"."""
    return tuple(part.strip() for part in value.split(",")) if isinstance(value, str) else value


Whole = Annotated[int, Field(ge=0, le=1 << 16)]
Region = Annotated[tuple[Whole, Whole, Whole, Whole], BeforeValidator(_split_region)]
Text = Annotated[str, Field(min_length=1, max_length=200)]


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CameraSettings:
    """Requested settings of a live camera; None leaves a setting unchanged.

    Attributes
    ----------
    exposure_us
        Exposure time in us, above 0. A full pattern period collects all light. Automatic exposure is switched off.
    gain
        Gain in units of the camera, mostly dB. Automatic gain is switched off.
    rate_hz
        Frames per second, above 0.
    region
        X,Y,WIDTH,HEIGHT of the active part of the sensor, in pixels.
    pixel_format
        Format of transmitted pixels, such as Mono8, Mono12p or BayerRG8.
    trigger
        Name of the line with pulses for the exposures, such as Line1; "off" lets the camera run freely.
    producer
        File of a GenICam producer (.cti), for cameras of the kind "genicam".
    duration_s
        Time in s after which the film ends, above 0; None for an endless film.
    queue_s
        Longest time in s for which frames wait for the receiver, 0.01 to 60, within half a GB. A full queue drops
        frames. Until the receiver finds an array, a frame takes several times as long as later.
    reconnect
        Attempts to reach a lost camera, 0 to 100.
    channel
        Gray level of a colour: luma, red, green or blue; as --channel.
    features
        Features of the camera: text by name. Names begin with a capital letter.
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
        """True if pulses start the exposures."""
        return self.trigger not in (None, "off")


def camera_settings(given: Mapping[str, Any] | Iterable[str] = ()) -> CameraSettings:
    """Return settings of a camera."""
    if isinstance(given, str) or not isinstance(given, (Mapping, Iterable)):
        raise SettingsError(f"settings of a camera are by name, such as {{'exposure_us': 500}}, not {shown(given)}")
    known: dict[str, Any] = {}
    features: dict[str, str] = {}
    for name, value in (given if isinstance(given, Mapping) else dict(map(_split, given))).items():
        if not isinstance(name, str):
            raise SettingsError(f"a camera's setting is named by text, not {shown(name)}")
        if name[:1].isupper() and value is not None:
            features[name] = str(value).lower() if isinstance(value, bool) else str(value)
        elif value is not None:
            known[name] = value if isinstance(value, (int, float, tuple, list)) else str(value)
    return from_mapping(CameraSettings, known | ({"features": features} if features else {}))


def _split(text: str) -> tuple[str, str]:
    """Return the name and the value of a text such as "exposure_us=500"."""
    parse_assignment(text)  # refuses other texts
    name, _, value = text.partition("=")
    if "." in name:
        raise SettingsError(f"a camera has no setting '{brief(name)}'; its names have no dots")
    return name.strip(), value.strip().strip("\"'")


Value = str | float | Sequence[int]  # A setting's value: text, a number, or a region


@contextmanager
def setting_errors(name: str, value: Value, known: Callable[[], Sequence[str]] | None = None) -> Iterator[None]:
    """Add the setting to a camera's error in the block."""
    try:
        yield
    except MediaError as error:
        values = f"; it knows {', '.join(known())}" if known else ""
        raise SettingsError(f"the camera does not take {name}={_written(value)}: {error}{values}") from None


def compare_settings(
    requested: CameraSettings, actual: Mapping[str, Value]
) -> tuple[dict[str, object], tuple[str, ...]]:
    """Return the actual values as text, and a text for each difference from a requested value."""
    departures = []
    for name, value in actual.items():
        wanted = requested.features.get(name) if name[:1].isupper() else getattr(requested, name)
        if wanted is not None and not _is_same(wanted, value):
            departures.append(f"{name} is {_written(value)}, asked for {_written(wanted)}")
    return {name: _written(value) for name, value in actual.items()}, tuple(departures)


def _is_same(requested: Value, actual: Value) -> bool:
    """True if texts are equal, or numbers are; cameras may round to single precision or to lines."""
    first, second = _written(requested), _written(actual)
    try:
        return requested == actual or abs(float(first) - float(second)) <= 1e-4 * abs(float(first))
    except ValueError:  # no numbers
        return first.lower() == second.lower()


def _written(value: Value) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if isinstance(value, (int, float)) else ",".join(map(str, value))
