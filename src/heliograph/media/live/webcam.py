"""Webcams of Linux (Video4Linux) through PyAV."""

import queue
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError, SettingsError
from heliograph.media import planes
from heliograph.media.libraries import av
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.settings import CameraSettings, Value, compare_settings

DEVICES = Path("/sys/class/video4linux")  # folder of the video devices of Linux


class Webcam:
    """A webcam; see `Camera`. Pictures have stamps of the system's clock, and no numbers."""

    device = "v4l2"
    """FFmpeg's name of the kind of device."""

    closing_s = 1.0
    """Time for the last picture at the end, longer than any exposure."""

    def __init__(self, address: str):
        self._address = address or "/dev/video0"
        self._container: Any = None
        self._channel = "luma"
        self._pictures: queue.SimpleQueue[Picture | BaseException | None] = queue.SimpleQueue()
        self._is_closing = False
        self._thread: threading.Thread | None = None

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and configure the camera; see `Camera`."""
        self._channel = settings.channel
        options = self._options(settings)
        try:
            self._container = av.open(self._address, "r", format=self.device, options=options)
        except (av.error.FFmpegError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            cure = "see 'heliograph cameras'; you may have to join the group video"
            raise MediaError(f"{self._address} cannot be opened as a webcam ({reason}): {cure}") from None
        stream = self._container.streams.video[0]
        context, layout = stream.codec_context, stream.codec_context.format
        rate_hz = float(stream.average_rate or stream.base_rate or 0)
        is_raw = context.name in ("rawvideo", "wrapped_avframe") and layout
        actual: dict[str, Value] = {
            "region": (0, 0, context.width, context.height),
            "pixel_format": layout.name if is_raw else context.name,
        }
        bits = max(8, layout.components[0].bits) if layout else 8
        label = DEVICES / Path(self._address).name / "name"
        model = label.read_text(errors="replace").strip() if label.is_file() else self._address
        texts, departures = compare_settings(settings, actual | ({"rate_hz": rate_hz} if rate_hz else {}))
        return CameraForm(context.width, context.height, bits, rate_hz or None, model, texts, departures)

    def frames(self, wait_s: float) -> Sequence[Picture] | None:
        """Return the pictures since the last call; see `Camera`."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="webcam", daemon=True)
            self._thread.start()
        pictures = []
        try:
            picture = self._pictures.get(timeout=wait_s)
            while isinstance(picture, Picture):
                pictures.append(picture)
                picture = self._pictures.get_nowait()
        except queue.Empty:
            return pictures
        if pictures:  # the next call reports the end
            self._pictures.put(picture)
            return pictures
        if picture is not None:
            raise picture
        return None

    def close(self) -> None:
        """Stop and release the camera; see `Camera`."""
        self._is_closing = True
        if self._thread is not None:
            self._thread.join(self.closing_s)
            if self._thread.is_alive():
                return  # FFmpeg cannot close the device while waiting for a picture
        if self._container is not None:
            self._container.close()
            self._container = None

    def _read(self) -> None:
        """Queue pictures in a thread, as FFmpeg may wait endlessly for the next picture."""
        end: BaseException | None = None
        try:
            for packet in self._container.demux(video=0):
                for picture in self._decode(packet):
                    self._pictures.put(picture)
                if self._is_closing:
                    return
        except (av.error.FFmpegError, OSError) as error:
            end = CameraLostError(str(getattr(error, "strerror", None) or error))
        except BaseException as error:  # raised again by `frames`
            end = error
        self._pictures.put(end)

    def _decode(self, packet: "av.Packet[Any]") -> list[Picture]:
        """Return the pictures of a packet; an incomplete picture has no pixels."""
        try:
            return [self._convert(picture) for picture in packet.decode()]
        except (av.error.InvalidDataError, ValueError):
            return [Picture(None)]

    def _options(self, settings: CameraSettings) -> dict[str, str]:
        """Return FFmpeg's options, or refuse a setting."""
        cure = "webcams are set by v4l2-ctl (package v4l-utils), such as 'v4l2-ctl -d {} -c {}=...'"
        for key, control in (("exposure_us", "auto_exposure=1,exposure_time_absolute"), ("gain", "gain")):
            if getattr(settings, key) is not None:
                raise SettingsError(f"{key}: {cure.format(self._address, control)}")
        if settings.triggered or settings.features:
            raise SettingsError(f"a webcam has no trigger and no features; {cure.format(self._address, 'NAME')}")
        options: dict[str, str] = {}
        if settings.region is not None:
            x, y, width, height = settings.region
            if x or y:
                raise SettingsError(f"region {x},{y},{width},{height}: a webcam's begins at 0,0; use --crop for a part")
            options["video_size"] = f"{width}x{height}"
        if settings.rate_hz is not None:
            options["framerate"] = f"{settings.rate_hz:g}"
        if settings.pixel_format is not None:
            options["input_format"] = settings.pixel_format
        return options

    def _convert(self, picture: "av.VideoFrame") -> Picture:
        pixels, _ = planes.to_gray(picture, False, self._channel)
        if picture.pts is None or picture.time_base is None:
            return Picture(pixels)
        return Picture(pixels, stamp_ns=round(picture.pts * picture.time_base * 10**9))


def find(_settings: CameraSettings, devices: Path = DEVICES) -> list[Found]:
    """List the video devices of Linux."""
    found = []
    for folder in sorted(devices.glob("video*"), key=lambda path: int(path.name.removeprefix("video"))):
        first = (folder / "index").read_text().strip() if (folder / "index").is_file() else "0"
        if first == "0":  # further devices of a camera have no pictures
            found.append(Found(f"/dev/{folder.name}", (folder / "name").read_text(errors="replace").strip()))
    if not found:
        raise MediaError("webcams: Linux knows of none (/dev/video*): plug one in; no library is needed")
    return found


KIND = CameraKind(Webcam, find)  # webcams
