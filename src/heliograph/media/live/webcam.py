"""Webcams of Linux (Video4Linux) through PyAV."""

import contextlib
import queue
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import MediaError, SettingsError
from heliograph.media import planes
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.settings import Asked, CameraSettings

if TYPE_CHECKING:
    import av

DEVICES = Path("/sys/class/video4linux")
"""Where Linux lists its video devices."""

FIRST = "/dev/video0"
"""Device that is taken where none is named."""

HELD = 8
"""Pictures that wait at most. Chosen; those that find no place wait within Linux, which then drops newer ones."""

CLOSING_S = 1.0
"""Time that a webcam gets to give its last picture. Chosen: longer than any exposure."""

NOT_BY_US = "webcams are set by v4l2-ctl (package v4l-utils), such as 'v4l2-ctl -d {} -c {}=...'"
"""Cure for settings that PyAV does not reach."""

UNCODED = ("rawvideo", "wrapped_avframe")
"""What FFmpeg calls the codec of pictures that are not coded."""

CONTROLS = {"exposure_us": "auto_exposure=1,exposure_time_absolute", "gain": "gain"}
"""Settings that v4l2-ctl sets, and what it calls them."""


class Webcam:
    """A webcam; see `Camera`. It stamps its pictures by the system's clock, and does not number them."""

    device = "v4l2"
    """What FFmpeg calls devices of this kind."""

    def __init__(self, address: str):
        self._address = address or FIRST
        self._container: Any = None
        self._channel = "luma"
        self._came: queue.Queue[Picture | BaseException | None] = queue.Queue(HELD)
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and set the camera; see `Camera`."""
        import av

        self._channel = settings.channel
        options = self._options(settings)
        try:
            self._container = av.open(self._address, "r", format=self.device, options=options)
        except (av.error.FFmpegError, OSError) as error:
            why = getattr(error, "strerror", None) or str(error)
            cure = "'heliograph cameras' lists what is there; you may have to join the group video"
            raise MediaError(f"{self._address} cannot be opened as a webcam ({why}): {cure}") from None
        stream = self._container.streams.video[0]
        context, asked = stream.codec_context, Asked()
        layout = context.format
        rate = stream.average_rate or stream.base_rate
        asked.got("region", settings.region, (0, 0, context.width, context.height))
        name = layout.name if context.name in UNCODED and layout else context.name
        asked.got("pixel_format", settings.pixel_format, name)
        if rate:
            asked.got("rate_hz", settings.rate_hz, float(rate))
        bits = max(8, layout.components[0].bits) if layout else 8
        known = DEVICES / Path(self._address).name / "name"
        model = known.read_text(errors="replace").strip() if known.is_file() else self._address
        return CameraForm(
            context.width, context.height, bits, float(rate) if rate else None, model, asked.settings,
            tuple(asked.departures),
        )  # fmt: skip

    def frames(self, wait_s: float) -> Sequence[Picture] | None:
        """Return the pictures that came; see `Camera`."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="webcam", daemon=True)
            self._thread.start()
        pictures = []
        try:
            came = self._came.get(timeout=wait_s)
            while isinstance(came, Picture):
                pictures.append(came)
                came = self._came.get_nowait()
        except queue.Empty:
            return pictures
        if pictures:  # the end is told with the next call
            self._came.put(came)
            return pictures
        if came is not None:
            raise came
        return None

    def close(self) -> None:
        """Stop the camera and let go of it; see `Camera`."""
        self._closing.set()
        if self._thread is not None:
            with contextlib.suppress(queue.Empty):
                self._came.get_nowait()  # its thread may wait for a place
            self._thread.join(CLOSING_S)
            if self._thread.is_alive():
                return  # FFmpeg waits for a picture that does not come: it cannot be closed meanwhile
        if self._container is not None:
            self._container.close()
            self._container = None

    def _read(self) -> None:
        """Take pictures, in a thread of its own: FFmpeg waits for the next one for as long as it takes."""
        import av

        end: BaseException | None = None
        try:
            for packet in self._container.demux(video=0):
                for picture in self._decoded(packet):
                    while not self._closing.is_set():
                        with contextlib.suppress(queue.Full):
                            self._came.put(picture, timeout=CLOSING_S / 4)
                            break
                if self._closing.is_set():
                    return
        except (av.error.FFmpegError, OSError) as error:
            end = CameraLostError(str(getattr(error, "strerror", None) or error))
        except BaseException as error:  # raised by `frames`, in the thread that asks for pictures
            end = error
        while not self._closing.is_set():
            with contextlib.suppress(queue.Full):
                self._came.put(end, timeout=CLOSING_S / 4)
                return

    def _decoded(self, packet: "av.Packet[Any]") -> list[Picture]:
        """Pictures of a packet; one of which a part came has no pixels."""
        import av

        try:
            return [self._picture(picture) for picture in packet.decode()]
        except (av.error.InvalidDataError, ValueError):
            return [Picture(None)]

    def _options(self, settings: CameraSettings) -> dict[str, str]:
        """What FFmpeg is told; a SettingsError where it cannot set that."""
        for key, control in CONTROLS.items():
            if getattr(settings, key) is not None:
                raise SettingsError(f"{key}: {NOT_BY_US.format(self._address, control)}")
        if settings.triggered or settings.features:
            raise SettingsError(f"a webcam has no trigger and no features; {NOT_BY_US.format(self._address, 'NAME')}")
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

    def _picture(self, picture: "av.VideoFrame") -> Picture:
        pixels, _ = planes.to_gray(picture, False, self._channel)
        if picture.pts is None or picture.time_base is None:
            return Picture(pixels)
        return Picture(pixels, stamp_ns=round(picture.pts * picture.time_base * 10**9))


def find(_settings: CameraSettings) -> list[Found]:
    """List the video devices of Linux."""
    found = []
    for folder in sorted(DEVICES.glob("video*"), key=lambda path: int(path.name.removeprefix("video"))):
        first = (folder / "index").read_text().strip() if (folder / "index").is_file() else "0"
        if first == "0":  # others of the same camera have no pictures
            found.append(Found(f"/dev/{folder.name}", (folder / "name").read_text(errors="replace").strip()))
    if not found:
        raise MediaError("webcams: Linux knows of none (/dev/video*): plug one in; they need no library of their own")
    return found


KIND = CameraKind(Webcam, find)
"""Webcams."""
