"""GenICam cameras through the producer (.cti) that their maker gives, by harvesters."""

import glob
import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.pixel_formats import PixelFormat, pixel_format
from heliograph.media.live.settings import OFF, Asked, CameraSettings, Value

FOLDERS = "GENICAM_GENTL64_PATH"
"""Variable of the environment in which producers' folders are named (GenTL 1.6, section 3.3)."""

BUFFERS = 32
"""Frames that the producer holds at a time. Chosen: 32 ms of a camera of 1000 frames/s, longer than Python's lock is
kept by another thread."""

NAMES: dict[str, tuple[str, ...]] = {
    "exposure_us": ("ExposureTime", "ExposureTimeAbs"),
    "gain": ("Gain", "GainRaw"),
    "rate_hz": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    "pixel_format": ("PixelFormat",),
}
"""Features of a setting, those of newer cameras first (SFNC 2.7)."""

AUTOMATIC = {"exposure_us": "ExposureAuto", "gain": "GainAuto"}
"""Features that must be off for a setting to hold."""


class GenicamCamera:
    """A camera behind a GenICam producer; see `Camera`."""

    def __init__(self, address: str):
        self._address = address
        self._harvester: Any = None
        self._acquirer: Any = None
        self._format: PixelFormat | None = None
        self._width = self._height = self._broken = 0
        self._channel = "luma"
        self._ticks_hz: float | None = None

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and set the camera; see `Camera`."""
        self._harvester = _harvester(settings)
        found = self._harvester.device_info_list
        info = next((one for one in found if self._address in ("", one.id_, _said(one, "serial_number"))), None)
        if info is None:
            raise MediaError(f"no producer has a camera '{self._address}'; 'heliograph cameras' lists what is there")
        try:
            self._acquirer = self._harvester.create(found.index(info))
        except Exception as error:  # harvesters and genicam raise what they like
            raise MediaError(
                f"camera '{info.id_}' cannot be opened ({brief(error)}): does another program use it?"
            ) from None
        self._acquirer.num_buffers = BUFFERS
        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, _counter(self))
        asked = Asked()
        self._set(settings, asked)
        return self._form(settings, asked, f"{_said(info, 'vendor')} {_said(info, 'model')}")

    def frames(self, wait_s: float) -> Sequence[Picture]:
        """Return the pictures that came; see `Camera`."""
        try:
            if not self._acquirer.is_acquiring():
                self._acquirer.start()
            buffer = self._acquirer.try_fetch(timeout=max(wait_s, 1e-3), is_raw=True)
            broken, self._broken = self._broken, 0
            pictures = [Picture(None)] * broken
            if buffer is not None:
                pictures.append(self._picture(buffer))
                buffer.parent.queue_buffer(buffer)
        except MediaError:
            raise
        except Exception as error:  # harvesters and genicam raise what they like
            raise CameraLostError(f"{type(error).__name__}: {brief(error)}") from None
        return pictures

    def close(self) -> None:
        """Stop the camera and let go of it; see `Camera`."""
        acquirer, harvester, self._acquirer, self._harvester = self._acquirer, self._harvester, None, None
        for end in (acquirer and acquirer.stop, acquirer and acquirer.destroy, harvester and harvester.reset):
            try:
                if end:
                    end()
            except Exception as error:  # a camera that is gone cannot be stopped
                logging.getLogger(__name__).debug("closing: %s", error)

    def broke(self) -> None:
        """Take note of a picture of which a part came."""
        self._broken += 1

    def _set(self, settings: CameraSettings, asked: Asked) -> None:
        if self._node("AcquisitionMode") is not None and self._read("AcquisitionMode") != "Continuous":
            self._write("AcquisitionMode", "Continuous")
        if settings.pixel_format is not None:
            with asked.setting("pixel_format", settings.pixel_format, self._formats):
                self._write("PixelFormat", settings.pixel_format)
        if settings.region is not None:
            with asked.setting("region", settings.region):
                self._write_region(settings.region)
        for key, value in (("exposure_us", settings.exposure_us), ("gain", settings.gain)):
            if value is not None:
                with asked.setting(key, value):
                    if self._node(AUTOMATIC[key]) is not None:
                        self._write(AUTOMATIC[key], "Off")
                    self._write(self._known(key), value)
        if settings.rate_hz is not None:
            with asked.setting("rate_hz", settings.rate_hz):
                if self._node("AcquisitionFrameRateEnable") is not None:
                    self._write("AcquisitionFrameRateEnable", "1")
                self._write(self._known("rate_hz"), settings.rate_hz)
        if settings.trigger is not None:
            with asked.setting("trigger", settings.trigger):
                self._write_trigger(settings)
        for key, text in settings.features.items():
            with asked.setting(key, text):
                self._write(key, text)

    def _form(self, settings: CameraSettings, asked: Asked, model: str) -> CameraForm:
        self._width, self._height = self._whole("Width"), self._whole("Height")
        name = str(self._read("PixelFormat"))
        self._channel = settings.channel
        try:
            self._format = pixel_format(name)
        except MediaError as error:
            raise MediaError(f"{error}; this camera has {', '.join(self._formats())}") from None
        offsets = (self._whole(key) if self._node(key) is not None else 0 for key in ("OffsetX", "OffsetY"))
        asked.got("region", settings.region, (*offsets, self._width, self._height))
        for key, names in NAMES.items():
            there = next((one for one in names if self._node(one) is not None), None)
            if there is not None:
                asked.got(key, getattr(settings, key), self._read(there))
        if self._node("TriggerMode") is not None:
            on = self._read("TriggerMode") == "On"
            asked.got("trigger", settings.trigger, str(self._read("TriggerSource")) if on else OFF)
        for key, text in settings.features.items():
            asked.got(key, text, str(self._read(key)))
        rate = asked.settings.get("rate_hz")
        return CameraForm(
            self._width, self._height, self._format.bits, float(str(rate)) if rate else None, model, asked.settings,
            tuple(asked.departures),
        )  # fmt: skip

    def _formats(self) -> list[str]:
        return list(self._node("PixelFormat").symbolics)

    def _known(self, key: str) -> str:
        """Name of the feature of a setting."""
        for name in NAMES[key]:
            if self._node(name) is not None:
                return name
        raise MediaError(f"it has no feature {NAMES[key][0]}")

    def _node(self, name: str) -> Any:
        """A feature that can be read or written; None where there is none."""
        nodes = self._acquirer.remote_device.node_map
        return getattr(nodes, name, None) if nodes.has_node(name) else None

    def _read(self, name: str) -> Value:
        node = self._node(name)
        if node is None:
            raise MediaError(f"the camera has no feature {name}")
        try:
            value = node.value
        except Exception as error:
            raise MediaError(f"{name} cannot be read: {brief(error)}") from None
        return str(value).lower() if isinstance(value, bool) else value

    def _whole(self, name: str) -> int:
        """A feature that is a whole number."""
        return int(str(self._read(name)))

    def _write(self, name: str, value: Value) -> None:
        node = self._node(name)
        if node is None:
            raise MediaError(f"it has no feature {name}")
        try:
            if isinstance(value, str):
                node.from_string(value)
            else:
                node.value = type(node.value)(value)
        except Exception as error:
            raise MediaError(f"{brief(error)}{_bounds(node)}") from None

    def _write_region(self, region: tuple[int, int, int, int]) -> None:
        """Set the part of the sensor; the corner goes to 0 first, as it bounds the size."""
        places = dict(zip(("OffsetX", "OffsetY", "Width", "Height"), region, strict=True))
        corner = {key: places.pop(key) for key in ("OffsetX", "OffsetY")}
        there = {key: value for key, value in corner.items() if value or self._node(key) is not None}
        for key, value in (*dict.fromkeys(there, 0).items(), *places.items(), *there.items()):
            self._write(key, value)

    def _write_trigger(self, settings: CameraSettings) -> None:
        if not settings.triggered and self._node("TriggerMode") is None:
            return
        if self._node("TriggerSelector") is not None:
            self._write("TriggerSelector", "FrameStart")
        if settings.triggered and settings.trigger is not None:
            self._write("TriggerSource", settings.trigger)
        self._write("TriggerMode", "On" if settings.triggered else "Off")

    def _picture(self, buffer: Any) -> Picture:
        # the producer fills the buffer anew once it has it back: what is kept is copied, but not more than that
        data = np.frombuffer(buffer.raw_buffer, np.uint8)[int(_asked(buffer, "image_offset") or 0) :]
        padding = int(_asked(buffer, "padding_x") or 0)
        assert self._format is not None
        if len(data) < self._format.size(self._width, self._height, padding):
            return Picture(None)
        pixels = self._format.pixels(data, self._width, self._height, padding, self._channel).copy()
        number = _asked(buffer, "frame_id")
        return Picture(pixels, None if number is None else int(number), self._stamp(buffer))

    def _stamp(self, buffer: Any) -> int | None:
        """Start of a picture's exposure by the camera's clock in ns."""
        stamp = _asked(buffer, "timestamp_ns")
        if stamp is not None:
            return int(stamp) or None
        ticks = _asked(buffer, "timestamp")
        if not ticks:
            return None
        if self._ticks_hz is None:
            self._ticks_hz = float(_asked(buffer.parent.parent, "timestamp_frequency") or 1e9)
        return round(int(ticks) * 1e9 / self._ticks_hz)


def _counter(camera: GenicamCamera) -> Any:
    """What harvesters calls for each picture of which a part came."""
    from harvesters.core import Callback

    class Broke(Callback):  # type: ignore[misc]  # harvesters has no types
        def emit(self, context: object = None) -> None:  # noqa: ARG002 - harvesters names it
            camera.broke()

    return Broke()


def _asked(of: Any, name: str) -> Any:
    """What a producer says of something; None where it does not."""
    try:
        return getattr(of, name)
    except Exception:  # genicam raises what it likes
        return None


def _said(info: Any, name: str) -> str:
    return str(_asked(info, name) or "")


def _bounds(node: Any) -> str:
    """What a number may be, for an error."""
    low, high, step = (_asked(node, name) for name in ("min", "max", "inc"))
    if low is None or high is None:
        return ""
    return f" ({low:g} to {high:g}" + (f" in steps of {step:g})" if step else ")")


def producers(settings: CameraSettings) -> list[str]:
    """Return the files of GenICam producers: the one that is named, or those in the folders of `FOLDERS`."""
    if settings.producer is not None:
        if not Path(settings.producer).is_file():
            raise MediaError(f"there is no producer {settings.producer}: check the name of the .cti file")
        return [settings.producer]
    folders = [folder for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
    files = sorted(file for folder in folders for file in glob.glob(os.path.join(glob.escape(folder), "*.cti")))
    if not files:
        where = f"{', '.join(folders)} has none" if folders else f"{FOLDERS} is not set"
        raise MediaError(
            f"GenICam cameras need their maker's producer (.cti), and {where}: install the maker's driver, or give the "
            "file by --camera producer=FILE"
        )
    return files


def _harvester(settings: CameraSettings) -> Any:
    """The producers' cameras, found anew."""
    try:
        from harvesters.core import Harvester
    except ImportError as error:
        raise MediaError(
            f"GenICam cameras need the package harvesters ({brief(error)}): pip install harvesters"
        ) from None
    files = producers(settings)
    logging.getLogger("harvesters").setLevel(logging.CRITICAL)  # what is wrong is said in one line of our own
    harvester = Harvester()
    for file in files:
        try:
            harvester.add_file(file, check_validity=True)
        except OSError as error:
            raise MediaError(f"the producer {file} cannot be loaded: {brief(error)}") from None
    harvester.update()
    return harvester


def find(settings: CameraSettings) -> list[Found]:
    """List the cameras of all producers."""
    harvester = _harvester(settings)
    try:
        return [
            Found(info.id_, f"{_said(info, 'vendor')} {_said(info, 'model')}, {_said(info, 'tl_type')}")
            for info in harvester.device_info_list
        ]
    finally:
        harvester.reset()


KIND = CameraKind(GenicamCamera, find)
"""Cameras behind GenICam producers."""
