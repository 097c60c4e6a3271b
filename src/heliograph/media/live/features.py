"""Cameras with GenICam features (SFNC 2.7): settings, read-back, buffers and pictures."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.media.live.camera import CameraForm, Picture
from heliograph.media.live.pixel_formats import PixelFormat, pixel_format
from heliograph.media.live.settings import CameraSettings, Value, compare_settings, setting_errors

_NAMES = {
    "pixel_format": ("PixelFormat",),
    "rate_hz": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    "exposure_us": ("ExposureTime", "ExposureTimeAbs"),
    "gain": ("Gain", "GainRaw"),
}
"""Features of a setting, in new and old cameras."""

_SWITCHES = {
    "rate_hz": (("AcquisitionFrameRateEnable", "1"), ("AcquisitionFrameRateEnabled", "1")),
    "exposure_us": (("ExposureAuto", "Off"),),
    "gain": (("GainAuto", "Off"),),
}
"""Additional features of a setting, with values."""


class FeatureCamera(ABC):
    """Common part of cameras with features; see `Camera`."""

    def __init__(self, address: str):
        self._address = address
        self._format: PixelFormat | None = None
        self._width = self._height = 0
        self._channel = "luma"
        self.n_buffers = 0

    @abstractmethod
    def _has(self, name: str) -> bool:
        """True if a feature can be read or written."""

    @abstractmethod
    def _read(self, name: str) -> Value: ...

    @abstractmethod
    def _write(self, name: str, value: Value) -> None: ...

    @abstractmethod
    def _values(self, name: str) -> list[str]:
        """Return the possible values of a feature."""

    def _name(self, key: str) -> str | None:
        """Return the name of a setting's feature; None if the camera has none."""
        return next((name for name in _NAMES[key] if self._has(name)), None)

    def _configure(self, settings: CameraSettings, model: str) -> CameraForm:
        """Apply and read back the settings."""
        if self._has("AcquisitionMode") and self._read("AcquisitionMode") != "Continuous":
            self._write("AcquisitionMode", "Continuous")
        self._apply(settings)
        actual = self._read_back(settings)
        texts, departures = compare_settings(settings, actual)
        rate_hz = float(str(actual.get("rate_hz", 0)))
        assert self._format is not None
        # half a second of frames: a lost packet may delay all frames behind it by 0.1 s; at most 256 MB
        frame_bytes = max(1, self._format.size(self._width, self._height, 0))
        most = max(16, min(512, (1 << 28) // frame_bytes))
        self.n_buffers = min(most, max(16, round(0.5 * rate_hz))) if rate_hz else most
        return CameraForm(self._width, self._height, self._format.bits, rate_hz or None, model, texts, departures)

    def _apply(self, settings: CameraSettings) -> None:
        """Set pixels first, as rates depend on them, and user-defined features last."""
        if settings.pixel_format is not None:
            with setting_errors("pixel_format", settings.pixel_format, lambda: self._values("PixelFormat")):
                self._write("PixelFormat", settings.pixel_format)
        if settings.region is not None:
            with setting_errors("region", settings.region):
                self._write_region(settings.region)
        for key in ("exposure_us", "gain", "rate_hz"):
            value = getattr(settings, key)
            if value is None:
                continue
            with setting_errors(key, value):
                for switch, state in _SWITCHES[key]:
                    if self._has(switch):
                        self._write(switch, state)
                self._write(self._name(key) or _NAMES[key][0], value)
        # a camera with a rate runs freely, also after a program that left a trigger
        if settings.trigger is not None or settings.rate_hz is not None:
            with setting_errors("trigger", settings.trigger or "off"):
                self._write_trigger(settings)
        for key, text in settings.features.items():
            with setting_errors(key, text):
                self._write(key, text)

    def _write_region(self, region: tuple[int, int, int, int]) -> None:
        """Set the part of the sensor; the corner goes to 0 first, as the size depends on the corner."""
        x, y, width, height = region
        corner = {name: place for name, place in (("OffsetX", x), ("OffsetY", y)) if place or self._has(name)}
        for name, place in (*dict.fromkeys(corner, 0).items(), ("Width", width), ("Height", height), *corner.items()):
            self._write(name, place)

    def _write_trigger(self, settings: CameraSettings) -> None:
        if not settings.triggered and not self._has("TriggerMode"):
            return
        if self._has("TriggerSelector"):
            self._write("TriggerSelector", "FrameStart")
        if settings.triggered and settings.trigger is not None:
            self._write("TriggerSource", settings.trigger)
        self._write("TriggerMode", "On" if settings.triggered else "Off")

    def _read_back(self, settings: CameraSettings) -> dict[str, Value]:
        """Read the values of all settings, and the form of a picture."""
        x, y = (int(str(self._read(name))) if self._has(name) else 0 for name in ("OffsetX", "OffsetY"))
        self._width, self._height = (int(str(self._read(name))) for name in ("Width", "Height"))
        self._channel = settings.channel
        try:
            self._format = pixel_format(str(self._read("PixelFormat")))
        except MediaError as error:
            raise MediaError(f"{error}; this camera has {', '.join(self._values('PixelFormat'))}") from None
        actual: dict[str, Value] = {"region": (x, y, self._width, self._height)}
        for key in _NAMES:
            if (name := self._name(key)) is not None:
                actual[key] = self._read(name)
        if self._has("TriggerMode"):
            actual["trigger"] = str(self._read("TriggerSource")) if self._read("TriggerMode") == "On" else "off"
        return actual | {key: str(self._read(key)) for key in settings.features}

    def _picture(self, data: NDArray[np.uint8], padding: int, number: Any, stamp_ns: int | None) -> Picture:
        """Convert the bytes of a buffer into a picture, incomplete if some bytes are missing."""
        assert self._format is not None
        if len(data) < self._format.size(self._width, self._height, padding):
            return Picture(None)
        pixels = self._format.pixels(data, self._width, self._height, padding, self._channel)
        return Picture(pixels, None if number is None else int(number), stamp_ns or None)
